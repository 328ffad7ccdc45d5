"""Cases of clause 11: profiles and levels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import Dimensions, work
from refcodec.bitstream.directory import INDEX, WEIGHTS, critical_sections, section_lengths
from refcodec.bitstream.header import Header, Lanes, PositionGrid, RenderInfo, emit_file
from refcodec.bitstream.limits import FEATURES_MAX, MAIN, PROFILES
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .checksums import ENTRY_BYTES, Depth, layout, repair
from .fault import Draw, Drawn, Edit, Whole, fault, one_field, wrong_value
from .header import label_of
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import (
    MAIN_SMALLEST,
    SMALLEST,
    TINY_DIMENSIONS,
    lattice,
    packed_weights,
    scene,
    silent,
    sparse,
)
from .target import Target
from .targets import main_file, plain, planeless, unpredicted

# --- faults -----------------------------------------------------------------------------------------------------------

# Of a file of Tiny.
profile = wrong_value("header.profile", {"profile": [2, 3, 255]})
chunk_size = wrong_value("header.chunk_size", {"chunk_size": [0, 65537, 0xFFFFFFFF]})
# SPEC 5.3: the lists of the dimensions, by their count field.
LISTS = {
    "slice_count": "slice_width",
    "hyper_layers": "hyper_width",
    "sarm_layers": "sarm_width",
    "carm_layers": "carm_width",
}


@fault("header.level")
def level(t: Target, value: int) -> Edit:
    """The profile does not have the level."""
    return Edit(t.pack({"level": value}), t.at("level"))


@level.drawn
def _(draw: Draw, t: Target) -> Drawn:
    levels = PROFILES[t.header.profile].levels
    return t, draw.choice([value for value in range(256) if value not in levels])


@fault("header.dimension")
def dimension(t: Target, name: str, value: int) -> Edit:
    """A dimension is outside the limits of the profile or level, or contradicts others."""
    return one_field(t, f"dimensions.{name}", value)


@dimension.drawn
def _(draw: Draw, t: Target) -> Drawn:
    t = draw.choice([t, main_file()])
    before = "header.dimensions."
    names = [path.removeprefix(before) for path in t.elements if path.startswith(before)]
    name = draw.choice([name for name in names if name not in (*LISTS, "padding", "reserved")])
    low, high = getattr(PROFILES[t.header.profile], name.partition("[")[0])
    return t, name, draw.choice([value for value in (low - 1, high + 1) if value >= 0])


@fault("header.dimension")
def list_length(t: Target, counter: str, widths: list[int]) -> Whole:
    """A list of dimensions is too short or too long."""

    def change(fields: Any) -> None:
        fields.dimensions[counter] = len(widths)
        fields.dimensions[LISTS[counter]] = widths

    return Whole(t.with_header(change), t.at(f"dimensions.{counter}"))


@list_length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    counter = draw.choice(list(LISTS))
    d, (low, high) = t.header.dimensions, getattr(PROFILES[t.header.profile], counter)
    counts = [high + 1]
    # A scene without planes has no layers of SARM.
    if low and (counter != "sarm_layers" or d.plane_channels):
        counts.append(low - 1)
    if counter == "carm_layers" and len(d.slices) == 1:
        counts += [1, 2]
    if counter == "hyper_layers" and not d.has_frame:
        counts += [1, 2]
    if counter == "sarm_layers" and not d.plane_channels:
        counts += [1, 2]
    return t, counter, [1] * draw.choice(counts)


@fault("header.dimension")
def many_features(t: Target, *widths: int) -> Edit:
    """Slices are within the profile, but their sum exceeds FEATURES_MAX. widths: one for each slice of the file."""
    paths = [f"dimensions.slice_width[{i}]" for i in range(len(widths))]
    return Edit(t.pack(dict(zip(paths, widths, strict=True))), t.at(paths[0]))


@many_features.drawn
def _(draw: Draw, t: Target) -> Drawn:
    widths = [draw.integer(30, 64) for _ in main_file().header.dimensions.slices]
    return None if sum(widths) <= FEATURES_MAX else (main_file(), *widths)


@fault("header.anchor_count")
def too_many_anchors(t: Target, value: int, level: int | None = None) -> Edit:
    """There are more anchors than the level allows. level: another level."""
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
    """A lower level of Main would suffice."""
    values = {"level": level, "anchor_count": anchors, "dimensions.plane_size": plane_size}
    return Edit(t.pack(values), t.at("level"))


@level_too_high.drawn
def _(draw: Draw, t: Target) -> Drawn:
    level = draw.integer(2, HIGHEST)
    lower = PROFILES[MAIN].levels[level - 1]
    return main_file(), level, draw.integer(0, lower.anchors), draw.integer(2, lower.plane_size)


HIGHEST = max(PROFILES[MAIN].levels)
# SPEC 11.2: dimensions of Main with a work of 2^16 and of 2^17 per anchor, which levels 1 to 3 and 4 to 5 allow for
# their largest N, and dimensions with little more work.
_WORK_16 = Dimensions(10, (64, 64), 0, 16, 0, (115, 120), (), (26,), 32)
_WORK_17 = Dimensions(16, (16,) * 8, 0, 16, 0, (66, 109), (), (115,), 32)
WORK_AT_BOUND = {level: _WORK_16 if level < 4 else _WORK_17 for level in PROFILES[MAIN].levels}
WORK_BEYOND = {
    level: replace(d, hyper_width=(d.hyper_width[0], d.hyper_width[1] + 1)) for level, d in WORK_AT_BOUND.items()
}
# Dimensions whose planes are a fifth of the work of level 1.
WORK_OF_PLANES = Dimensions(10, (64, 64), 16, 16, 128, (115, 120), (32, 32), (26,), 32)
# Dimensions, and a number of anchors, whose work is one more than level 1 allows.
WORK_BEYOND_BY_ONE = Dimensions(10, (64, 64), 1, 16, 101, (92, 128), (7,), (26,), 32), 130906


def header_of(d: Dimensions, level: int, anchors: int, size: int = 16384) -> bytes:
    """Returns the header of a file of Main with the lengths that it implies, without the rest.

    size: chunk_size. There are as few chunks as possible.
    """
    chunks = -(-anchors // size)
    lengths = section_lengths(d, chunks, {WEIGHTS: 0, INDEX: 0})
    sections = [(kind, 0, b"") for kind in critical_sections(d)]
    header = Header(
        minor=0,
        profile=MAIN,
        level=level,
        anchor_count=anchors,
        chunk_count=chunks,
        chunk_size=size,
        lanes=Lanes(),
        base_step=(1.0, 1.0, 1.0),
        grid=PositionGrid(),
        render=RenderInfo(render_model=0 if d.view_inputs else 2),
        dimensions=d,
    )
    out = bytearray(emit_file(header, sections))
    fields, end = layout(bytes(out))
    for entry, e in enumerate(fields.directory):
        at = end - 4 - ENTRY_BYTES * (len(fields.directory) - entry)
        out[at + 8 : at + 16] = lengths.get(e.type, 0).to_bytes(8, "little")
    return repair(bytes(out), Depth.HEADER)


@fault("section.truncated")
def header_alone(t: Target, d: Dimensions, level: int, anchors: int, size: int = 16384) -> Whole:
    """A valid header of Main without the rest."""
    data = header_of(d, level, anchors, size)
    return Whole(data, len(data))


@header_alone.drawn
def _(draw: Draw, t: Target) -> Drawn:
    level = draw.integer(1, HIGHEST)
    lower, most = PROFILES[MAIN].levels.get(level - 1), PROFILES[MAIN].levels[level]
    return t, WORK_AT_BOUND[level], level, draw.integer(lower.anchors + 1 if lower else 0, most.anchors)


@fault("header.work")
def too_much_work(t: Target, d: Dimensions, level: int, anchors: int) -> Whole:
    """Anchors and planes are within the level, but their work exceeds it."""
    return Whole(header_of(d, level, anchors), t.at("anchor_count"))


@too_much_work.drawn
def _(draw: Draw, t: Target) -> Drawn:
    level = draw.integer(1, HIGHEST)
    return t, WORK_BEYOND[level], level, PROFILES[MAIN].levels[level].anchors - draw.integer(0, 9)


@fault("header.work")
def work_of_widths(t: Target, level: int = 1) -> Edit:
    """Widths and anchors are within the level, but their work exceeds it. For a file of four slices."""
    values = {"level": level, "anchor_count": PROFILES[MAIN].levels[level].anchors}
    widths = {"slice_width[0]": 64, "slice_width[3]": 34, "hyper_width[0]": 128, "carm_width[0]": 128}
    return Edit(t.pack(values | {f"dimensions.{name}": w for name, w in widths.items()}), t.at("anchor_count"))


@work_of_widths.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return main_file(), draw.integer(1, 3)


@fault("header.level_not_minimal")
def level_of_less_work(t: Target, d: Dimensions, level: int, anchors: int) -> Whole:
    """A lower level allows the anchors, the planes and their work."""
    return Whole(header_of(d, level, anchors), t.at("level"))


@level_of_less_work.drawn
def _(draw: Draw, t: Target) -> Drawn:
    level = draw.integer(2, HIGHEST)
    return t, WORK_AT_BOUND[level - 1], level, draw.integer(0, PROFILES[MAIN].levels[level - 1].anchors)


# --- the suite's ------------------------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _refused_dimensions(book)
    _refused_levels(book)
    _work(book)
    _main(book)


# Values just outside the limits.
OUTSIDE_TINY: list[tuple[str, list[int]]] = [
    ("offset_count", [0, 11]),
    ("slice_width[0]", [0]),
    ("slice_width[1]", [17]),
    ("plane_channels", [9]),
    ("frequency_count", [11]),
    ("view_inputs", [3, 5, 9]),
    ("colour_outputs", [0, 2, 4, 49]),
    ("plane_size", [0, 1, 33, 258]),
    ("render_width", [0, 65, 259]),
    ("hyper_width[0]", [0, 65, 262]),
    ("sarm_width[0]", [0, 260]),
    ("sarm_width[1]", [17]),
    ("carm_width[0]", [0, 65, 261]),
]
OUTSIDE_MAIN: list[tuple[str, list[int]]] = [
    ("offset_count", [0, 17]),
    ("slice_width[0]", [0, 65]),
    ("slice_width[3]", [0, 65]),
    ("plane_channels", [17]),
    ("frequency_count", [17]),
    ("view_inputs", [9]),
    ("colour_outputs", [0, 49]),
    ("plane_size", [0, 1, 1025, 65535]),
    ("render_width", [0, 129]),
    ("hyper_width[0]", [0, 129]),
    ("sarm_width[0]", [0, 33]),
    ("sarm_width[1]", [0, 33]),
    ("carm_width[0]", [0, 129]),
]
LISTS_OF_TINY: list[tuple[str, list[list[int]]]] = [
    ("slice_count", [[], [1] * 5]),
    ("hyper_layers", [[4] * 3]),
    ("sarm_layers", [[], [4] * 3]),
    ("carm_layers", [[4] * 3]),
]
LISTS_OF_MAIN: list[tuple[str, list[list[int]]]] = [
    ("slice_count", [[], [5] * 17]),
    ("hyper_layers", [[16] * 3]),
    ("sarm_layers", [[], [16] * 3]),
    ("carm_layers", [[16] * 3]),
]


@cache
def _one_slice() -> Target:
    """Returns a file with one slice, and thus without CARM."""
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
    for_nothing: list[tuple[str, str, Callable[[], Target], str]] = [
        ("carm-for-nothing", "CARM has a hidden layer, though there is one slice", _one_slice, "carm_layers"),
        ("hyper-for-nothing", "F_h has a hidden layer, but no inputs", unpredicted, "hyper_layers"),
        ("sarm-for-nothing", "SARM has a hidden layer, though there are no planes", planeless, "sarm_layers"),
    ]
    for name, title, small, counter in for_nothing:
        add(f"invalid-dimension-{name}", title, list_length.of(small, counter, [4]), flags="optional-parts")
    title, make = "plane_size 2, though there are no plane channels", dimension.of(planeless, "plane_size", 2)
    add("invalid-dimension-size-for-nothing", title, make, flags="optional-parts")
    title, make = "129 features", many_features.of(main_file, 64, 63, 1, 1)
    add("invalid-dimension-main-129-features", title, make, flags="limit-off-by-one")
    title, make = "256 features, which are 0 in eight bits", many_features.of(main_file, 64, 64, 64, 64)
    add("invalid-dimension-main-256-features", title, make, flags="limit-off-by-one sum-wraps")
    title, make = "plane_size 129 at level 1", dimension.of(main_file, "plane_size", 129)
    add("invalid-dimension-main-plane-size-129", title, make, flags="level-limits")


def _refused_levels(book: Book) -> None:
    title, make = "profile 2", profile.of(plain, "profile", 2)
    book.add("unsupported-header-profile-2", title, make, features="header", flags="profile-unchecked")
    for base, name, before, levels in ((plain, "Tiny", "", [1]), (main_file, "Main", "main-", [0, HIGHEST + 1])):
        for number in levels:
            title, make = f"level {number} of {name}", level.of(base, number)
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
    for number, anchors, size in ((2, 1 << 17, 128), (3, 1 << 20, 256), (4, 1 << 22, 256), (5, 1 << 24, 512)):
        book.add(
            f"invalid-level-{number}-of-{anchors}-{size}",
            f"level {number}, though level {number - 1} allows {anchors} anchors and planes of {size}",
            level_too_high.of(main_file, number, anchors, size),
            features="main header",
            flags="level-limits level-not-minimal",
        )
    for base, text, before, features, sizes in (
        (plain, "", "", "header", (0, 65537)),
        (main_file, " in Main", "main-", "main header", (255, 16385, 65536)),
    ):
        for size in sizes:
            title, make = f"chunk_size {size}{text}", chunk_size.of(base, "chunk_size", size)
            book.add(f"invalid-chunk-size-{before}{size}", title, make, features=features, flags="limit-off-by-one")


def _work(book: Book) -> None:
    """Adds headers on the work of the levels (11.2), without the rest of the file."""
    add = partial(book.add, features="header main dimensions", requirements="R11.1-2 R11.2-2 R11.2-3 R11.2-4")
    for number, level in PROFILES[MAIN].levels.items():
        title = f"as many anchors, and as much work, as level {number} allows, and nothing behind the header"
        make = header_alone.of(plain, WORK_AT_BOUND[number], number, level.anchors)
        add(f"malformed-work-at-bound-{number}", title, make, flags="level-limits level-not-minimal truncation")
        title = f"as many anchors as level {number} allows, and more work"
        make = too_much_work.of(plain, WORK_BEYOND[number], number, level.anchors)
        add(f"invalid-work-beyond-{number}", title, make, flags="level-limits work-bound")
        if number == 1:
            continue
        lower = PROFILES[MAIN].levels[number - 1].anchors
        title = f"level {number}, though level {number - 1} allows this work"
        make = level_of_less_work.of(plain, WORK_AT_BOUND[number - 1], number, lower)
        add(f"invalid-level-{number}-of-less-work", title, make, flags="level-not-minimal work-bound")
        title = f"level {number}, which the work alone needs, and nothing behind the header"
        make = header_alone.of(plain, WORK_BEYOND[number - 1], number, lower)
        add(f"malformed-work-needs-{number}", title, make, flags="level-not-minimal work-bound")
    d, bound = WORK_OF_PLANES, PROFILES[MAIN].levels[1].work
    most = (bound - work(d, 0)) // (work(d, 1) - work(d, 0))
    title = "as many anchors as the work of level 1 allows beside that of the planes, and nothing behind the header"
    make = header_alone.of(plain, d, 1, most)
    add("malformed-work-of-planes", title, make, flags="level-not-minimal work-bound")
    without = replace(_WORK_16, view_inputs=0)
    title, anchors = "rendering networks without view inputs, which count as work", PROFILES[MAIN].levels[1].anchors
    add("invalid-work-of-rendering", title, too_much_work.of(plain, without, 1, anchors), flags="work-bound")
    title, make = f"{title}, and nothing behind the header", header_alone.of(plain, without, 2, anchors)
    add("malformed-work-of-rendering", title, make, flags="level-not-minimal work-bound")
    title, make = "one anchor more than that", too_much_work.of(plain, d, 1, most + 1)
    add("invalid-work-of-planes", title, make, flags="work-bound")
    d_one, anchors = WORK_BEYOND_BY_ONE
    assert work(d_one, anchors) == bound + 1
    title, make = "work of 2^33 + 1 at level 1", too_much_work.of(plain, d_one, 1, anchors)
    add("invalid-work-beyond-by-one", title, make, flags="work-bound limit-off-by-one")
    title, flags = (
        "level 2, which a work of 2^33 + 1 needs, and nothing behind the header",
        "level-not-minimal work-bound",
    )
    add("malformed-work-needs-2-by-one", title, header_alone.of(plain, d_one, 2, anchors), flags=flags)
    anchors = PROFILES[MAIN].levels[1].anchors + 1
    title, flags = (
        f"level 2, which {anchors} anchors need, and nothing behind the header",
        "level-limits level-not-minimal",
    )
    make = header_alone.of(plain, SMALLEST, 2, anchors)
    add("malformed-level-2-by-one-anchor", title, make, flags=flags)
    for number, size in ((2, 256), (4, 512), (5, 1024)):
        title = f"planes of {size}, and no anchors: level {number}, which the planes alone need"
        make = header_alone.of(plain, replace(d, plane_size=size), number, 0)
        add(f"malformed-main-planes-{size}", title, make, flags="level-limits level-not-minimal truncation")


def _main(book: Book) -> None:
    book.valid(
        "main",
        "a small file of profile Main, in two chunks, positions and weights raw",
        partial(drawn, "main", 258, MAIN_SMALLEST, chunk_size=256),
        features="main chunks",
        requirements="R11.1-2 R11.1-3 D7.9-1 D7.10-1",
        flags="carm-slices",
    )
    book.valid(
        "main-packed",
        "a file of profile Main in mode 1",
        _packed,
        features="main packed-positions packed-weights chunks",
        requirements="D7.12-1 D7.13-1 D7.9-1",
        flags="carm-slices",
    )
    book.valid(
        "main-empty",
        "no anchors in Main",
        lambda: sparse(scene("main-empty", 0, replace(MAIN_SMALLEST, plane_size=4))),
        features="main empty packed-weights",
        requirements="R11.2-2",
    )
    for size in (256, 16384):
        book.valid(
            f"main-chunk-size-{size}",
            f"chunk_size {size} in Main, and chunks that are smaller",
            partial(drawn, "main-chunk-size", 6, SMALLEST, profile=MAIN, chunk_size=size, chunk_anchors=(1, 5)),
            features="main chunks",
            requirements="R11.1-3 R6.10-5",
            flags="limit-off-by-one chunk-sizes",
        )
    book.valid(
        "tiny-chunk-size-65536",
        "the largest chunk_size of Tiny",
        partial(drawn, "tiny-chunk-size", 6, SMALLEST, chunk_size=65536),
        features="header chunks",
        requirements="R11.1-3",
        flags="limit-off-by-one count-in-16-bits",
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


def _large_planes() -> Scene:
    made = sparse(scene("main-planes", 3, replace(MAIN_SMALLEST, plane_size=129), lanes=Lanes(6, 0, 6)))
    quiet = silent(made.networks["sarm"])
    # With this small scale, a symbol of 0 takes almost no bits.
    quiet[-1][1][:] = [0, -40]
    flat = np.zeros_like(made.planes)
    numbers = Numbers("main-planes/symbols")
    for at in numbers.integers(0, flat.size - 1, 60).tolist():
        flat.reshape(-1)[at] = numbers.integer(-2, 2)
    found = packed_weights(replace(made, networks={**made.networks, "sarm": quiet}, planes=flat))
    return sampled(found, Sampler(numbers), planes=False)
