"""Measurements of speed, size and quality; RESULTS.md has their output. Each module states its command."""
