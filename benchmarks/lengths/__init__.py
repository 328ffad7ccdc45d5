"""Other entropy models by code lengths, on the symbols of trained scenes (python -m benchmarks.lengths)."""
