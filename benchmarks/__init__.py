"""Measurements of speed, size and quality, each a module: `python -m benchmarks.NAME`. RESULTS.md has what they printed."""
