"""Clauses 5.7 and 6.7: the frame."""

from dataclasses import dataclass

import numpy as np

from . import syntax
from .conventions import Int64
from .source import Piece

# SPEC 6.7
MATRIX_BOUND = 1 << 20
TRANSLATION_BOUND = 1 << 61
FRAME_SHIFT_MAX = 60
FRAME_RANGE_BOUND = 1 << 18


@dataclass(frozen=True)
class Frame:
    """SPEC 5.7: the frame. matrix: int64 [3, 3]. translation, shift, low and high: int64 [3]."""

    matrix: Int64
    translation: Int64
    shift: Int64
    low: Int64
    high: Int64


def parse_frame(section: Piece) -> Frame:
    """SPEC 5.7 and 6.7: returns the frame of the section. Raises BitstreamError frame.reserved or frame.range.

    The section has the correct length. The fields are checked in the order of the requirement.
    """
    struct, name = syntax.Struct("Frame", section, 0, "frame"), "frame.range"
    f = struct.fields
    # SPEC [R6.7-1]
    if f.reserved:
        raise struct.error("frame.reserved", "reserved", f.reserved, 0)
    # SPEC [R6.7-2]
    for field, low, high in (
        ("matrix", 1 - MATRIX_BOUND, MATRIX_BOUND - 1),
        ("translation", 1 - TRANSLATION_BOUND, TRANSLATION_BOUND - 1),
        ("shift", 0, FRAME_SHIFT_MAX),
    ):
        for i, value in enumerate(f[field]):
            struct.require_within(name, f"{field}[{i}]", value, low, high)
    for i, (low, high) in enumerate(zip(f.low, f.high, strict=True)):
        struct.require_within(name, f"low[{i}]", low, -FRAME_RANGE_BOUND, FRAME_RANGE_BOUND - 1)
        # The rescaling (7.5.3) divides by high - low.
        struct.require_within(name, f"high[{i}]", high, low + 1, FRAME_RANGE_BOUND)

    def array(values: list[int]) -> Int64:
        return np.array(values, dtype=np.int64)

    return Frame(array(f.matrix).reshape(3, 3), *(array(f[k]) for k in ("translation", "shift", "low", "high")))


def emit_frame(frame: Frame) -> bytes:
    """SPEC 5.7: returns the bytes of the section."""
    fields = {name: value.reshape(-1).tolist() for name, value in vars(frame).items()}
    return syntax.build("Frame", {**fields, "reserved": 0})
