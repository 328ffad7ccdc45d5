"""Measurements of speed, size and quality; RESULTS.md has their output.

`python -m benchmarks decode|scale` measures speed and scale. `python -m benchmarks.NAME` runs another benchmark.
"""
