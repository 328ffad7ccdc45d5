"""Measurements of speed, size and quality. `python -m benchmarks.NAME` runs one; RESULTS.md has what they printed."""
