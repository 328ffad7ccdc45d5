"""Clause 13.1: the caller's limits on anchors, work and memory. Exceeding one is not a verdict on a file.

`Limits` is the only place that counts memory. An operation states how many copies of a scene it holds, and which
packages it loads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Integral

from ..statuses import UsageError
from .batches import GROUP_ANCHORS
from .cameras import CAMERAS
from .dimensions import STATIC, weight_count, work
from .directory import DATA, is_critical
from .header import Header
from .positions import CELL_LEVELS
from .splat import HARMONICS, SPLAT_ANCHORS

# Estimates in bytes, one to two times the measured values: a weight as float32 and as an integer, with its copies; a
# point of a plane while it is decoded; a value of an anchor that is being decoded; and a value that is held.
WEIGHT, PLANE_POINT, DECODING, HOLDING = 32, 8, 56, 8
# Bytes for each chunk: its parsed index entry, and its objects while all chunks are held.
CHUNK, HELD_CHUNK = 192, 2048
# The number of copies of section bytes, chunk bytes and camera bytes during decoding.
READING, CAMERA = 5, 16
# The bytes of the program with the packages of decoding, and those that the packages of drawing add.
PROGRAM, DRAWING = 64 << 20, 192 << 20
# The memory for a file behind a URL, if the caller does not limit it.
URL_MEMORY = 4 << 30


class BoundPassedError(UsageError):
    """A file needs more than its caller allows. This is not a verdict on the conformance of the file.

    bound: "anchors", "work" or "memory". needed, allowed: anchors, units of all_work, or bytes.
    """

    about_input = True

    bound: str
    needed: int
    allowed: int

    def __init__(self, bound: str, needed: int, allowed: int, default: bool = False) -> None:
        """default: whether the caller did not choose the limit."""
        self.bound, self.needed, self.allowed = bound, needed, allowed
        what = {
            "anchors": f"has {needed} anchors",
            "work": f"may take {needed} units of work",
            "memory": f"may take {needed} bytes of memory",
        }[bound]
        origin = " by default for a URL" if default else ""
        super().__init__(f"it {what}, but --max-{bound} allows {allowed}{origin}; this is not a verdict on the file")


@dataclass(frozen=True)
class Limits:
    """What a caller allows for a file: in a command --max-anchors, --max-work and --max-memory. None allows everything.

    anchors: N, the anchors of the file. work: units of SPEC 13.1. memory: the bytes that the process takes, which is
    4 GiB for a URL if it is None. program: the bytes of them that the program itself takes. They are an estimate, and 0
    leaves the program out of account. Raises UsageError for anything but integers of at least 0.
    """

    anchors: int | None = None
    work: int | None = None
    memory: int | None = None
    program: int = PROGRAM

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            right = isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 0
            if not (right or (value is None and name != "program")):
                raise UsageError(f"limits.{name} must be an integer of at least 0, not {value!r}")

    def of_url(self) -> Limits:
        """Returns the limits for a file behind a URL."""
        return self if self.memory is not None else _OfURL(self.anchors, self.work, URL_MEMORY, self.program)

    def beside(self, held: int) -> Limits:
        """Returns the limits that remain while the program takes some more bytes, such as those of more packages."""
        return replace(self, program=self.program + held)

    def check(
        self,
        header: Header,
        at_once: int = GROUP_ANCHORS,
        *,
        copies: int = 0,
        gaussians: int = 0,
        size: int | None = None,
        keep_ancillary: bool = True,
    ) -> None:
        """Raises BoundPassedError for anchors, work or memory that exceed a limit by the header.

        Args:
            header: of the file.
            at_once: the anchors that are decoded at the same time.
            copies: of the scene that are held while the file is. 0 for an operation that holds some chunks at a time.
            gaussians: copies of the Gaussians of a static scene that are held.
            size: the bytes of the file, if it is held. None for those that the header states, if copies are held.
            keep_ancillary: whether ancillary sections are kept.
        """
        count = header.anchor_count
        for bound, needed, allowed in (("anchors", count, self.anchors), ("work", all_work(header), self.work)):
            if allowed is not None and needed > allowed:
                raise BoundPassedError(bound, needed, allowed)
        if copies:
            # Any part of the file may be decoded at once.
            more = (1 + READING) * (header.sections[-1].end if size is None else size)
        else:
            more = section_bytes(header, keep_ancillary) + (size or 0)
        self.check_memory(memory_needed(header, min(count, at_once), copies * count, more, gaussians * count))

    def check_memory(self, needed: int) -> None:
        """Raises BoundPassedError if more bytes of memory are needed, in addition to the program, than allowed."""
        if self.memory is not None and needed + self.program > self.memory:
            raise BoundPassedError("memory", needed + self.program, self.memory, isinstance(self, _OfURL))

    def check_cloud(self, count: int, properties: int, size: int, copies: int) -> None:
        """Raises BoundPassedError for the point cloud of a scene folder that exceeds a limit by its header.

        count: of its anchors. properties: of each. size: its bytes. copies: of the scene that are held.
        """
        if self.anchors is not None and count > self.anchors:
            raise BoundPassedError("anchors", count, self.anchors)
        values = min(count, GROUP_ANCHORS) * DECODING + copies * count * HOLDING
        self.check_memory(properties * values + 2 * size)


class _OfURL(Limits):
    """Limits whose memory is the default for a URL."""


def all_work(header: Header) -> int:
    """SPEC 13.1: returns the most units of work for decoding, including weights, positions, masks and Gaussians."""
    d, n = header.dimensions, header.anchor_count
    symbols = 2 * CELL_LEVELS + d.offset_count
    if header.render.render_model == STATIC:
        symbols += d.offset_count * (HARMONICS.start + d.colour_outputs)
    return work(d, n) + 96 * weight_count(d) + 16 * n * symbols


def memory_needed(header: Header, at_once: int, held: int = 0, more: int = 0, gaussians: int = 0) -> int:
    """SPEC 13.1: returns an estimate of the bytes of memory that decoding needs in addition to the program.

    at_once: the anchors decoded at the same time. held: the anchors of a scene that is kept. more: further bytes, such
    as those of the file. gaussians: the anchors whose Gaussians are kept, if the scene is static.
    """
    d = header.dimensions
    values = d.attribute_width + d.offset_count
    planes = 5 * d.plane_channels * d.plane_size**2
    chunks = header.chunk_count * (CHUNK + (HELD_CHUNK if held else 0))
    anchors = values * (at_once * DECODING + held * HOLDING)
    if header.render.render_model == STATIC:
        # SPEC 9.4: the Gaussians as float32, those of a block twice.
        numbers = d.offset_count * (HARMONICS.start + d.colour_outputs)
        anchors += 4 * numbers * (2 * min(at_once, SPLAT_ANCHORS) + gaussians)
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
