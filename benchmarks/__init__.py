"""Measurements of speed, size and quality: `python -m benchmarks.NAME`. RESULTS.md has what they printed."""
