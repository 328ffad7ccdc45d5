"""Cases of clause 11: profiles and levels."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.limits import MAIN, MAIN_SLICES, PROFILES
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .fault import Draw, Drawn, Edit, Whole, fault, wrong_value
from .header import label_of
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import MAIN_SMALLEST, TINY_DIMENSIONS, lattice, packed_weights, scene, silent, sparse
from .target import Target
from .targets import main_file, plain

# --- faults -----------------------------------------------------------------------------------------------------------

# Of a file of Tiny.
profile = wrong_value("header.profile", {"profile": [2, 3, 255]})
level = wrong_value("header.level", {"level": [1, 2, 255]})
chunk_size = wrong_value("header.chunk_size", {"chunk_size": [0, 65537, 0xFFFFFFFF]})
# SPEC 5.3: the lists of the dimensions, by the field that counts them.
LISTS = {
    "slice_count": "slice_width",
    "hyper_layers": "hyper_width",
    "sarm_layers": "sarm_width",
    "carm_layers": "carm_width",
}


@fault("header.dimension")
def dimension(t: Target, name: str, value: int) -> Edit:
    """A dimension outside the limits of the profile, or plane_size outside those of the level."""
    path = f"dimensions.{name}"
    return Edit(t.pack({path: value}), t.at(path))


@dimension.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = draw.choice([t, main_file()])
    before = "header.dimensions."
    names = [path.removeprefix(before) for path in t.elements if path.startswith(before)]
    name = draw.choice([name for name in names if name not in LISTS])
    low, high = getattr(PROFILES[t.header.profile], name.partition("[")[0])
    return t, name, draw.choice([low - 1, high + 1])


@fault("header.dimension")
def list_length(t: Target, counter: str, widths: list[int]) -> Whole:
    """A list of dimensions that is shorter or longer than it may be."""

    def change(fields: Any) -> None:
        fields.dimensions[counter] = len(widths)
        fields.dimensions[LISTS[counter]] = widths

    return Whole(t.with_header(change), t.at(f"dimensions.{counter}"))


@list_length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    counter = draw.choice(list(LISTS))
    low, high = getattr(PROFILES[t.header.profile], counter)
    counts = [high + 1] if low == 0 else [low - 1, high + 1]
    if counter == "carm_layers":
        # SPEC 11.1: a hidden layer exactly if there is a second slice.
        counts.append(0 if t.fields.dimensions.carm_layers else 1)
    return t, counter, [1] * draw.choice(counts)


@fault("header.dimension")
def slices_of_main(t: Target, *widths: int) -> Edit:
    """Slices that the limits of Main allow, but that are not those of Main."""
    paths = [f"dimensions.slice_width[{i}]" for i in range(len(widths))]
    return Edit(t.pack(dict(zip(paths, widths, strict=True))), t.at(paths[0]))


@slices_of_main.drawn
def _(draw: Draw, t: Target) -> Drawn:
    widths = tuple(draw.integer(5, 20) for _ in MAIN_SLICES)
    return None if widths == MAIN_SLICES else (main_file(), *widths)


@fault("header.anchor_count")
def too_many_anchors(t: Target, value: int, level: int | None = None) -> Edit:
    """More anchors than the level allows. level: another one."""
    values = {"anchor_count": value} | ({} if level is None else {"level": level})
    return Edit(t.pack(values), t.at("anchor_count"))


@too_many_anchors.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if draw.flag():
        return t, draw.integer(4097, 0xFFFFFFFF)
    number, most = draw.choice(list(PROFILES[MAIN].levels.items()))
    return main_file(), draw.integer(most.anchors + 1, 0xFFFFFFFF), number


@fault("header.level_not_minimal")
def level_too_high(t: Target, level: int, anchors: int, plane_size: int) -> Edit:
    """A level of Main whose lower one would do."""
    values = {"level": level, "anchor_count": anchors, "dimensions.plane_size": plane_size}
    return Edit(t.pack(values), t.at("level"))


@level_too_high.drawn
def _(draw: Draw, t: Target) -> Drawn:
    level = draw.integer(2, 3)
    lower = PROFILES[MAIN].levels[level - 1]
    return main_file(), level, draw.integer(0, lower.anchors), draw.integer(2, lower.plane_size)


@fault("directory.file_length")
def header_alone(t: Target, values: dict[str, int]) -> Whole:
    """A header with other fields, which are allowed, and nothing behind it."""
    return Whole(t.with_values(values)[: t.header_end], t.header_end)


# --- the suite's ------------------------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _refused_dimensions(book)
    _refused_levels(book)
    _main(book)


# Values just outside the limits.
OUTSIDE_TINY: list[tuple[str, list[int]]] = [
    ("offset_count", [0, 11]),
    ("slice_width[0]", [0]),
    ("slice_width[1]", [17]),
    ("plane_channels", [0, 9]),
    ("frequency_count", [0, 11]),
    ("plane_size", [1, 33, 258]),
    ("hyper_width[0]", [0, 65]),
    ("sarm_width[0]", [0]),
    ("sarm_width[1]", [17]),
    ("carm_width[0]", [0, 65]),
    ("render_width", [0, 65]),
]
OUTSIDE_MAIN: list[tuple[str, list[int]]] = [
    ("offset_count", [9, 11]),
    ("slice_width[0]", [4]),
    ("slice_width[1]", [4]),
    ("slice_width[3]", [21]),
    ("plane_channels", [7, 9]),
    ("frequency_count", [9, 11]),
    ("plane_size", [257]),
    ("hyper_width[0]", [15, 129]),
    ("sarm_width[0]", [15, 17]),
    ("carm_width[0]", [15, 129]),
    ("render_width", [49, 51]),
]
LISTS_OF_TINY: list[tuple[str, list[list[int]]]] = [
    ("slice_count", [[], [1] * 5]),
    ("hyper_layers", [[], [4] * 3]),
    ("sarm_layers", [[], [4] * 3]),
    ("carm_layers", [[], [4] * 3]),
]
LISTS_OF_MAIN: list[tuple[str, list[list[int]]]] = [
    ("slice_count", [[5, 10, 15], [5, 10, 15, 20, 5]]),
    ("hyper_layers", [[], [16, 16]]),
    ("sarm_layers", [[16], [16] * 3]),
    ("carm_layers", [[], [16, 16]]),
]


@cache
def _one_slice() -> Target:
    """A file whose features are one slice, so that there is no CARM."""
    d = replace(TINY_DIMENSIONS, slices=(3,), carm_width=())
    return Target(codec.emit(drawn("refused-one-slice", 2, d)))


def _refused_dimensions(book: Book) -> None:
    add = partial(book.add, features="dimensions")
    for base, name, before, outside, lists in (
        (plain, "Tiny", "", OUTSIDE_TINY, LISTS_OF_TINY),
        (main_file, "Main", "main-", OUTSIDE_MAIN, LISTS_OF_MAIN),
    ):
        for field, values in outside:
            for value in values:
                title, make = f"{field} {value} in {name}", dimension.of(base, field, value)
                add(f"invalid-dimension-{before}{label_of(field)}-{value}", title, make, flags="limit-off-by-one")
        for counter, choices in lists:
            for widths in choices:
                title, make = f"{counter} {len(widths)} in {name}", list_length.of(base, counter, widths)
                identifier = f"invalid-dimension-{before}{label_of(counter)}-{len(widths)}"
                add(identifier, title, make, flags="limit-off-by-one")
    add(
        "invalid-dimension-carm-for-nothing",
        "CARM has a hidden layer, though there is one slice",
        list_length.of(_one_slice, "carm_layers", [4]),
        flags="carm-slices",
    )
    title, make = "slices of Main in another order", slices_of_main.of(main_file, 5, 10, 20, 15)
    add("invalid-dimension-main-slices", title, make, flags="main-carm")
    title, make = "plane_size 129 at level 1", dimension.of(main_file, "plane_size", 129)
    add("invalid-dimension-main-plane-size-129", title, make, flags="level-limits")


def _refused_levels(book: Book) -> None:
    title, make = "profile 2", profile.of(plain, "profile", 2)
    book.add("unsupported-header-profile-2", title, make, features="header", flags="profile-unchecked")
    for base, name, before, levels in ((plain, "Tiny", "", [1]), (main_file, "Main", "main-", [0, 4])):
        for number in levels:
            title, make = f"level {number} of {name}", level.of(base, "level", number)
            identifier = f"unsupported-header-{before}level-{number}"
            book.add(identifier, title, make, features="header", flags="level-limits")
    for value in (4097, 0xFFFFFFFF):
        title, make = f"anchor_count {value} in Tiny", too_many_anchors.of(plain, value)
        flags = "level-limits buffer-too-small"
        book.add(f"invalid-anchor-count-{value}", title, make, features="header", flags=flags)
    for number, most in PROFILES[MAIN].levels.items():
        title = f"one anchor more than level {number} of Main allows"
        make = too_many_anchors.of(main_file, most.anchors + 1, number)
        book.add(f"invalid-anchor-count-main-{number}", title, make, features="main header", flags="level-limits")
    for number, anchors, size in ((2, 1 << 17, 128), (3, 1 << 20, 256)):
        book.add(
            f"invalid-level-{number}-of-{anchors}-{size}",
            f"level {number}, though level {number - 1} allows {anchors} anchors and planes of {size}",
            level_too_high.of(main_file, number, anchors, size),
            features="main header",
            flags="level-limits level-not-minimal",
        )
    for base, text, before, features, sizes in (
        (plain, "", "", "header", (0, 65537)),
        (main_file, " in Main", "main-", "main header", (255, 65537)),
    ):
        for size in sizes:
            title, make = f"chunk_size {size}{text}", chunk_size.of(base, "chunk_size", size)
            book.add(f"invalid-chunk-size-{before}{size}", title, make, features=features, flags="limit-off-by-one")
    values = {
        "level": 2,
        "dimensions.plane_size": 256,
        "dimensions.hyper_width[0]": 128,
        "dimensions.carm_width[0]": 128,
        "chunk_size": 65536,
    }
    book.add(
        "malformed-main-largest-cut",
        "a header of Main with the largest dimensions, of a level that its planes alone need, and nothing behind it",
        header_alone.of(main_file, values),
        features="header main dimensions",
        requirements="R11.1-2 R11.1-3 R11.2-2 R11.2-3",
        flags="level-limits level-not-minimal truncation",
    )


def _main(book: Book) -> None:
    book.valid(
        "main",
        "a small file of profile Main, in two chunks, positions and weights raw",
        partial(drawn, "main", 258, MAIN_SMALLEST, chunk_size=256),
        features="main chunks",
        requirements="R11.1-2 R11.1-3 D7.9-1 D7.10-1",
        flags="main-carm",
    )
    book.valid(
        "main-packed",
        "a file of profile Main in mode 1",
        _packed,
        features="main packed-positions packed-weights chunks",
        requirements="D7.12-1 D7.13-1 D7.9-1",
        flags="main-carm",
    )
    book.valid(
        "main-wide",
        "the widest networks of Main",
        _wide,
        features="main dimensions packed-weights",
        requirements="R11.1-2 D7.2-2",
        flags="buffer-too-small",
    )
    book.valid(
        "main-empty",
        "no anchors in Main",
        lambda: sparse(scene("main-empty", 0, replace(MAIN_SMALLEST, plane_size=4))),
        features="main empty packed-weights",
        requirements="R11.2-2",
    )
    book.valid(
        "main-level-2",
        "planes that only level 2 allows",
        _large_planes,
        features="main planes",
        requirements="R11.2-1 R11.2-3 D7.3-1 D7.3-2",
        flags="level-limits",
        seconds=60,
    )


def _packed() -> Scene:
    where = lattice(Numbers("main-packed"), 300)
    d = replace(MAIN_SMALLEST, plane_size=9, hyper_width=(20,), carm_width=(24,))
    made = sparse(scene("main-packed", 300, d, positions=where, chunk_size=256, lanes=Lanes(2, 3, 4)))
    made = sampled(made, Sampler(Numbers("main-packed/symbols")))
    return replace(made, position_model=position_model(where, 256))


def _wide() -> Scene:
    d = replace(MAIN_SMALLEST, plane_size=3, hyper_width=(128,), carm_width=(128,))
    return sampled(sparse(scene("main-wide", 5, d, lanes=Lanes(3, 1, 6))), Sampler(Numbers("main-wide/symbols")))


def _large_planes() -> Scene:
    made = sparse(scene("main-planes", 3, replace(MAIN_SMALLEST, plane_size=129), lanes=Lanes(6, 0, 6)))
    quiet = silent(made.networks["sarm"])
    # A scale so small that a symbol of 0 costs next to nothing.
    quiet[-1][1][:] = [0, -40]
    flat = np.zeros_like(made.planes)
    numbers = Numbers("main-planes/symbols")
    for at in numbers.integers(0, flat.size - 1, 60).tolist():
        flat.reshape(-1)[at] = numbers.integer(-2, 2)
    found = packed_weights(replace(made, networks={**made.networks, "sarm": quiet}, planes=flat))
    return sampled(found, Sampler(numbers), planes=False)
