"""Clause 13.1: the bounds that a caller puts on anchors and memory. To pass one is no verdict on a file."""

from __future__ import annotations

from dataclasses import dataclass

from .dimensions import weight_count
from .header import Header

# Estimates in bytes, from one to two times what is measured: a weight as float32 and as an integer, with its copies; a
# point of a plane while it is decoded; a value of an anchor that is being decoded; and a value that is held.
WEIGHT, PLANE_POINT, DECODING, HOLDING = 32, 32, 56, 8


class BoundPassedError(Exception):
    """A file needs more than its caller allows. It says nothing about whether the file is a conforming bitstream.

    bound: "anchors" or "memory". needed, allowed: anchors, or bytes.
    """

    def __init__(self, bound: str, needed: int, allowed: int) -> None:
        self.bound, self.needed, self.allowed = bound, needed, allowed
        what = "bytes of memory may be needed" if bound == "memory" else "anchors are in the file"
        super().__init__(f"{needed} {what}, the caller's bound is {allowed}; this is no verdict on the file")


@dataclass(frozen=True)
class Bounds:
    """What a caller allows. None allows everything.

    anchors: N, the anchors of the file. memory: bytes that decoding takes beside the program itself.
    """

    anchors: int | None = None
    memory: int | None = None

    def check(self, header: Header, at_once: int, held: int = 0, more: int = 0) -> None:
        """Raises BoundPassedError for what passes a bound by the header alone, the anchors first.

        at_once, held, more: as for memory_needed.
        """
        if self.anchors is not None and header.anchor_count > self.anchors:
            raise BoundPassedError("anchors", header.anchor_count, self.anchors)
        needed = memory_needed(header, at_once, held, more)
        if self.memory is not None and needed > self.memory:
            raise BoundPassedError("memory", needed, self.memory)


def memory_needed(header: Header, at_once: int, held: int = 0, more: int = 0) -> int:
    """SPEC 13.1: returns about how many bytes of memory decoding takes, beside the program itself.

    at_once: the anchors that are decoded at the same time. held: the anchors of a scene that is kept. more: further
    bytes, such as those of the file.
    """
    d = header.dimensions
    values = d.attribute_width + d.offset_count
    planes = 5 * d.plane_channels * d.plane_size**2
    return weight_count(d) * WEIGHT + planes * PLANE_POINT + values * (at_once * DECODING + held * HOLDING) + more
