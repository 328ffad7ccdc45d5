"""Clauses 5.7 and 6.7: the frame."""

import struct
from dataclasses import dataclass

from .conventions import FRAME_RANGE_BOUND, FRAME_SHIFT_MAX, MATRIX_BOUND, TRANSLATION_BOUND
from .directory import Section
from .errors import require


@dataclass(frozen=True)
class Frame:
    """The map from positions to principal components. matrix: 9 integers, row by row. The others: 3 integers each."""

    matrix: tuple[int, ...]
    translation: tuple[int, ...]
    shift: tuple[int, ...]
    low: tuple[int, ...]
    high: tuple[int, ...]


# SPEC 5.7, 6.7, 10.1
def read_frame(data: bytes, section: Section) -> Frame:
    """Read the frame, check it, and return it."""
    at = section.offset
    numbers = struct.unpack_from("<9i3q3BB3i3i", data, at)
    frame = Frame(numbers[:9], numbers[9:12], numbers[12:15], numbers[16:19], numbers[19:22])
    require(numbers[15] == 0, "frame.reserved", at + 63)
    for n, item in enumerate(frame.matrix):
        require(abs(item) < MATRIX_BOUND, "frame.range", at + 4 * n)
    for n, item in enumerate(frame.translation):
        require(abs(item) < TRANSLATION_BOUND, "frame.range", at + 36 + 8 * n)
    for n, item in enumerate(frame.shift):
        require(item <= FRAME_SHIFT_MAX, "frame.range", at + 60 + n)
    for n, (low, high) in enumerate(zip(frame.low, frame.high)):
        require(-FRAME_RANGE_BOUND <= low < FRAME_RANGE_BOUND, "frame.range", at + 64 + 4 * n)
        require(low < high <= FRAME_RANGE_BOUND, "frame.range", at + 76 + 4 * n)
    return frame
