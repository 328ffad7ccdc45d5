"""Cases of clauses 5.10, 6.9 and 7.3: sub-planes. The faults of their substreams are in entropy_substreams.py."""

from dataclasses import replace

import numpy as np

from refcodec.bitstream.directory import PLANES_SECTION
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.planes import PLANE_NAMES, PLANES
from refcodec.bitstream.scene import Scene

from .checksums import resized
from .fault import Draw, Edit, Whole, fault, padding
from .numbers import Numbers
from .samplers import Sampler, sampled
from .scenes import SMALLEST, TINY_DIMENSIONS, scene, settled
from .table import More, refused, valid
from .target import Target
from .targets import target_of
from .weights import networks


def _ends(draw: Draw, t: Target) -> int:
    """Draws the end of the section: in or after its table, or before its last padding."""
    last = t.elements.get(LAST_PADDING)
    places = [*range(4 * PLANES + 1)] if PLANES_SECTION in t.sections else []
    return draw.choice(places if last is None or draw.flag() else [*range(last.start - last.end, 0)])


@fault("planes.length", _ends)
def cut(t: Target, length: int) -> Whole:
    """The section ends within or after its table, or, if length is negative, within the padding at its end."""
    return Whole(resized(t.data, PLANES_SECTION, t.content(PLANES_SECTION)[:length]), t.start(PLANES_SECTION))


def _changes(draw: Draw, t: Target) -> dict[int, int]:
    plane = draw.choice(range(PLANES) if PLANES_SECTION in t.sections else [])
    # In the second case the sum is right modulo 2^32.
    one, two = {plane: draw.choice([4, -4, 1 << 31])}, {plane: 1 << 31, (plane + 1) % PLANES: 1 << 31}
    return one if draw.flag() else two


@fault("planes.length", _changes)
def sub_plane_lengths(t: Target, changes: dict[int, int]) -> Edit:
    """The sum of the lengths is not that of the section. changes: numbers to add modulo 2^32, by sub-plane.

    With padding, lengths are multiples of four bytes.
    """
    values = {f"planes.length[{n}]": (t.value(f"planes.length[{n}]") + more) % (1 << 32) for n, more in changes.items()}
    return Edit(t.pack(values), t.start(PLANES_SECTION))


@fault("substream.length")
def of_nothing(t: Target) -> Whole:
    """Each substream has no bytes. The first one is reported, behind the table of lengths."""
    return Whole(resized(t.data, PLANES_SECTION, bytes(4 * PLANES)), t.start(PLANES_SECTION) + 4 * PLANES)


LAST_PADDING = f"planes.{PLANE_NAMES[-1]}, padding"
padding_byte = padding("planes.padding", r"planes\..*, padding")


def _neighbours(name: str, size: int, channels: int) -> Scene:
    d = replace(TINY_DIMENSIONS, plane_size=size, plane_channels=channels, sarm_width=(8,))
    numbers = Numbers(name)
    network_weights = networks(d, numbers)
    # Each neighbour has a different weight, with both signs.
    first = np.concatenate([np.eye(4), -np.eye(4)]).astype(np.float32)
    last = np.array([[5, 7, -3, 4, -5, -7, 3, -4], [0.5, 0.25, -0.5, 0.75, 0.25, 0.5, 0.5, 0.25]], np.float32)
    network_weights["sarm"] = [(first, np.zeros(8, np.float32)), (last, np.array([3, -9], np.float32))]
    return sampled(scene(name, 2, d, networks=network_weights, lanes=Lanes(2, 0, 0)), Sampler(numbers, 0))


# fmt: off
_ENDS = [32767, -32767, 1023, 1024, -1023, -1024, 0, 1, -1, 16384]
_FAR = Numbers("planes-far").chosen(_ENDS, 5, 2, 6, 6).astype(np.int16)
CASES = [
    *refused("planes", "truncation",
        ("planes-cut", "a section of planes that ends within its table", cut, 19),
        ("planes-of-3-bytes", "three bytes of planes, and few bytes behind them",
         target_of(lambda: scene("planted-empty", 0, SMALLEST)), cut, 3, More(features="empty")),
        ("planes-of-table", "a section of planes of the table's length", cut, 20, More("lengths-trusted"))),
    *refused("planes", "lengths-trusted", (sub_plane_lengths,),
        ("planes-length-0-four-more", "the length of sub-plane 0 is four more", {0: 4}),
        ("planes-length-4-four-less", "the length of sub-plane 4 is four less", {4: -4}),
        ("planes-length-2-huge", "the length of sub-plane 2 is huge", {2: 1 << 31}),
        ("planes-length-0-one-more", "the length of sub-plane 0 is one more", {0: 1}),
        ("planes-length-wraps", "lengths that add up modulo 2^32", {0: 1 << 31, 1: 1 << 31}, More("sum-wraps")),
        ("planes-padding-wraps", "lengths that add up modulo 2^32 with their padding",
         lambda t: {0: -t.value("planes.length[0]") - 1, 1: t.value("planes.length[0]")}, More("sum-wraps"))),
    *refused("planes", "padding-unchecked canonical-form lengths-trusted",
        ("planes-without-last-padding", "a section that ends before the padding of its last substream", cut, -2)),
    *refused("planes", "padding-unchecked", *(
        (f"planes-padding-{name}", f"padding behind sub-plane {plane} that is not zero", padding_byte,
         f"planes.{PLANE_NAMES[plane]}, padding", at, 1)
        for plane, at, name in ((1, 0, "second"), (2, 0, "one-byte"), (4, 1, "last")))),
    *valid("planes", "wavefront-order context-order", "D7.3-1 D7.3-2",
        ("planes-context", "a context of four neighbours that all count", _neighbours, "planes-context", 9, 2),
        ("planes-square", "many channels", _neighbours, "planes-square", 6, 8)),
    *valid("planes escapes", "activation-clamp symbol-limit", "D7.3-1 R8.5-1 D8.7-1",
        ("planes-far", "the largest symbols, and neighbours about the largest activation",
         lambda: scene("planes-far", 3, replace(TINY_DIMENSIONS, plane_size=6), planes=_FAR, plane_shift=0))),
    *valid("planes", "", "D7.3-1", ("planes-zero", "planes of zeros",
         lambda: settled(replace(scene("planes-zero", 3), planes=np.zeros((5, 2, 4, 4), np.int16))))),
]
