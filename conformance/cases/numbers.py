"""Pseudorandom integers, the same on every machine: bytes of SHAKE-256 of a name."""

import hashlib

import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]


class Numbers:
    """A named sequence of draws. Each draw has a number, so that results depend only on the order of draws."""

    def __init__(self, name: str, seed: int = 0) -> None:
        self._name = f"{name}/{seed}"
        self._draws = 0

    def integers(self, low: int, high: int, *shape: int) -> Int64:
        """Returns int64 integers of a shape, each from low to high inclusive.

        Each is 8 bytes of SHAKE-256("NAME/SEED/DRAW"), little-endian, modulo the span, plus low.
        """
        count = int(np.prod(shape, dtype=np.int64))
        stream = hashlib.shake_256(f"{self._name}/{self._draws}".encode()).digest(8 * count)
        self._draws += 1
        return (np.frombuffer(stream, "<u8") % np.uint64(high - low + 1)).astype(np.int64).reshape(shape) + low

    def integer(self, low: int, high: int) -> int:
        """Returns one integer."""
        return int(self.integers(low, high, 1)[0])

    def chosen(self, values: list[int], *shape: int) -> Int64:
        """Returns items of a list."""
        return np.array(values, dtype=np.int64)[self.integers(0, len(values) - 1, *shape)]

    def centred(self, spread: int, *shape: int) -> Int64:
        """Returns sums of three draws of -spread to spread, which are mostly small."""
        return sum((self.integers(-spread, spread, *shape) for _ in range(3)), np.zeros(shape, np.int64))

    def bytes(self, count: int) -> bytes:
        """Returns bytes."""
        return self.integers(0, 255, count).astype(np.uint8).tobytes()
