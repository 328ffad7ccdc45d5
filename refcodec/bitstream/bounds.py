"""Clause 13.1: the caller's bounds on anchors, work and memory. Exceeding one is not a verdict on a file."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .cameras import CAMERAS
from .dimensions import STATIC, weight_count, work
from .directory import DATA, is_critical
from .header import Header
from .positions import CELL_LEVELS
from .splat import HARMONICS

# Estimates in bytes, one to two times the measured values: a weight as float32 and as an integer, with its copies; a
# point of a plane while it is decoded; a value of an anchor that is being decoded; and a value that is held.
WEIGHT, PLANE_POINT, DECODING, HOLDING = 32, 8, 56, 8
# Bytes for each chunk: its parsed index entry, and its objects while all chunks are held.
CHUNK, HELD_CHUNK = 192, 2048
# The number of copies of section bytes, chunk bytes and camera bytes during decoding.
READING, CAMERA = 5, 16


class BoundPassedError(Exception):
    """A file needs more than its caller allows. This is not a verdict on the conformance of the file.

    bound: "anchors", "work" or "memory". needed, allowed: anchors, units of all_work, or bytes.
    """

    bound: str
    needed: int
    allowed: int

    def __init__(self, bound: str, needed: int, allowed: int) -> None:
        self.bound, self.needed, self.allowed = bound, needed, allowed
        what = {
            "anchors": "anchors are in the file",
            "work": "units of work may be needed",
            "memory": "bytes of memory may be needed",
        }
        super().__init__(
            f"{needed} {what[bound]}, but the caller's bound is {allowed}; this is not a verdict on the file"
        )


@dataclass(frozen=True)
class Bounds:
    """What a caller allows. None allows everything.

    anchors: N, the anchors of the file. memory: bytes that decoding needs in addition to the program. work: units of
    all_work.
    """

    anchors: int | None = None
    memory: int | None = None
    work: int | None = None

    def check(self, header: Header, at_once: int, held: int = 0, more: int = 0) -> None:
        """Raises BoundPassedError for anchors, work or memory that exceed a bound by the header.

        at_once, held, more: as for memory_needed.
        """
        if self.anchors is not None and header.anchor_count > self.anchors:
            raise BoundPassedError("anchors", header.anchor_count, self.anchors)
        if self.work is not None and all_work(header) > self.work:
            raise BoundPassedError("work", all_work(header), self.work)
        self.check_bytes(memory_needed(header, at_once, held, more))

    def beside(self, held: int) -> Bounds:
        """Returns the bounds that remain while some bytes are held."""
        return self if self.memory is None else replace(self, memory=self.memory - held)

    def check_bytes(self, needed: int) -> None:
        """Raises BoundPassedError if more bytes of memory are needed than allowed."""
        if self.memory is not None and needed > self.memory:
            raise BoundPassedError("memory", needed, self.memory)


def all_work(header: Header) -> int:
    """SPEC 13.1: returns the most units of work for decoding, including weights, positions and masks."""
    d, n = header.dimensions, header.anchor_count
    return work(d, n) + 96 * weight_count(d) + 16 * n * (2 * CELL_LEVELS + d.offset_count)


def memory_needed(header: Header, at_once: int, held: int = 0, more: int = 0) -> int:
    """SPEC 13.1: returns an estimate of the bytes of memory that decoding needs in addition to the program.

    at_once: the anchors decoded at the same time. held: the anchors of a scene that is kept. more: further bytes, such
    as those of the file.
    """
    d = header.dimensions
    values = d.attribute_width + d.offset_count
    planes = 5 * d.plane_channels * d.plane_size**2
    chunks = header.chunk_count * (CHUNK + (HELD_CHUNK if held else 0))
    anchors = values * (at_once * DECODING + held * HOLDING)
    if header.render.render_model == STATIC:
        # SPEC 9.4: the Gaussians as float32, and what they are computed from.
        anchors += 8 * at_once * d.offset_count * (HARMONICS.start + d.colour_outputs)
    return weight_count(d) * WEIGHT + planes * PLANE_POINT + chunks + anchors + more


def section_bytes(header: Header, keep_ancillary: bool) -> int:
    """SPEC 13.1: returns the bytes of memory for the sections other than DATA, which are read one by one.

    keep_ancillary: whether ancillary sections are kept. Otherwise they are skipped in blocks.
    """
    kept = [section for section in header.sections if keep_ancillary and not is_critical(section.type)]
    read = [section.length for section in header.sections if is_critical(section.type) and section.type != DATA]
    all_kept = sum(section.length for section in kept)
    cameras = sum(section.length for section in kept if section.type == CAMERAS)
    return READING * max(read + [section.length for section in kept]) + all_kept + CAMERA * cameras
