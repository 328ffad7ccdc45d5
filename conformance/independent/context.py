"""Clause 7.5: geometry to context."""

import math

from .conventions import FRAME_CLAMP, LERP_BITS, SINE_LENGTH, UNIT_BITS, activation, clamp, shift_round
from .frame import Frame
from .planes import Plane

UNIT = 1 << UNIT_BITS
WHOLE = 1 << LERP_BITS


class ContextSource:
    """Computes the context of an anchor from its position."""

    def __init__(
        self, frame: Frame | None, planes: list[Plane], plane_shift: int, frequencies: int, sine: tuple[int, ...]
    ) -> None:
        """frame: None if there are no planes and no frequencies. planes: those of r = 1 and r = 2, or none.

        frequencies: L. sine: the sine table.
        """
        self._frame = frame
        self._planes = planes
        self._down = 2 * LERP_BITS - plane_shift
        self._frequencies = frequencies
        self._sine = sine

    # SPEC 7.5
    def __call__(self, position: tuple[int, int, int]) -> list[int]:
        """Return the 2 ch + 2 L inputs of F_h. position: P of each axis."""
        if self._frame is None:
            return []
        u = self._unit_coordinates(self._frame, position)
        out = []
        for plane in self._planes:
            out += self._query(plane, u[0], u[1])
        return out + self._gamma(u[2])

    # SPEC 7.5.1, 7.5.2, 7.5.3
    @staticmethod
    def _unit_coordinates(frame: Frame, position: tuple[int, int, int]) -> list[int]:
        v = []
        for r in range(3):
            a, b, c = frame.matrix[3 * r : 3 * r + 3]
            total = a * position[0] + b * position[1] + c * position[2] + frame.translation[r]
            v.append(clamp(shift_round(total, frame.shift[r]), -FRAME_CLAMP, FRAME_CLAMP))
        square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
        if square > UNIT * UNIT:
            norm = math.isqrt(square)
            factor = (2 * norm - UNIT) * UNIT // norm
            v = [x * factor // norm for x in v]
        return [clamp((x - low) * UNIT // (high - low), 0, UNIT) for x, low, high in zip(v, frame.low, frame.high)]

    # SPEC 7.5.4
    def _query(self, plane: Plane, across: int, along: int) -> list[int]:
        last = len(plane[0]) - 1
        j, fj = self._cell(across * last, last)
        i, fi = self._cell(along * last, last)
        out = []
        for grid in plane:
            top = grid[i][j] * (WHOLE - fj) + grid[i][j + 1] * fj
            bottom = grid[i + 1][j] * (WHOLE - fj) + grid[i + 1][j + 1] * fj
            out.append(activation(shift_round(top * (WHOLE - fi) + bottom * fi, self._down)))
        return out

    # SPEC 7.5.4
    @staticmethod
    def _cell(g: int, last: int) -> tuple[int, int]:
        cell = min(g >> UNIT_BITS, last - 1)
        return cell, shift_round(g - cell * UNIT, UNIT_BITS - LERP_BITS)

    # SPEC 7.5.5
    def _gamma(self, u: int) -> list[int]:
        out = []
        for k in range(self._frequencies):
            turn = shift_round(((u - UNIT // 2) << k) % UNIT, 6)
            out.append(self._sine[turn % SINE_LENGTH])
            out.append(self._sine[(turn + SINE_LENGTH // 4) % SINE_LENGTH])
        return out
