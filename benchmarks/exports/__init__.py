"""Exported scenes: quality and bytes of each format, and third-party clients."""
