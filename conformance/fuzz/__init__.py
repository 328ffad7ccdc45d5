"""Decoders compared on many generated files."""
