"""Benchmarks need the extra `benchmarks`."""

import pytest

for package in ("torch", "numba", "skimage", "bjontegaard", "matplotlib", "msgspec"):
    pytest.importorskip(package)
