"""Integers that look random and are the same everywhere: the bytes of SHAKE-256 of a name."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]


class Numbers:
    """Draws of a named sequence; each draw has a number of its own, so that the order of draws is all that counts."""

    def __init__(self, name: str, seed: int = 0) -> None:
        self._name = f"{name}/{seed}"
        self._draws = 0

    def integers(self, low: int, high: int, *shape: int) -> Int64:
        """int64 of a shape, each low to high inclusive.

        Each is 8 bytes of SHAKE-256("NAME/SEED/DRAW"), little-endian, modulo the span, plus low.
        """
        count = int(np.prod(shape, dtype=np.int64))
        stream = hashlib.shake_256(f"{self._name}/{self._draws}".encode()).digest(8 * count)
        self._draws += 1
        return (np.frombuffer(stream, "<u8") % np.uint64(high - low + 1)).astype(np.int64).reshape(shape) + low

    def integer(self, low: int, high: int) -> int:
        """One of them."""
        return int(self.integers(low, high, 1)[0])

    def chosen(self, values: list[int], *shape: int) -> Int64:
        """Items of a list."""
        return np.array(values, dtype=np.int64)[self.integers(0, len(values) - 1, *shape)]

    def centred(self, spread: int, *shape: int) -> Int64:
        """Sums of three draws of -spread to spread: small numbers mostly."""
        return sum((self.integers(-spread, spread, *shape) for _ in range(3)), np.zeros(shape, np.int64))

    def bytes(self, count: int) -> bytes:
        """Bytes."""
        return self.integers(0, 255, count).astype(np.uint8).tobytes()
