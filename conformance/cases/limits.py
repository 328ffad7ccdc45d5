"""Cases of clause 11: profiles and levels."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from refcodec.bitstream.dimensions import STATIC, Dimensions, work
from refcodec.bitstream.directory import INDEX, WEIGHTS, critical_sections, section_lengths
from refcodec.bitstream.header import Header, Lanes, PositionGrid, RenderInfo, emit_file
from refcodec.bitstream.limits import FEATURES_MAX, MAIN, PROFILES, TINY
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .checksums import ENTRY_BYTES, Depth, layout, repair
from .fault import Draw, Drawn, Edit, Fault, Whole, element, fault
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import MAIN_SMALLEST, SMALLEST, TINY_DIMENSIONS, lattice, scene
from .table import More, label_of, refused, valid
from .target import Target
from .targets import main_file, plain, planeless, target_of, unpredicted
from .weights import QUIET_SARM, packed_weights, sparse, with_weights

LEVELS = PROFILES[MAIN].levels
LOWEST, HIGHEST = min(LEVELS), max(LEVELS)
# The next lower level of each but the lowest.
LOWER = {number: lower for lower, number in pairwise(LEVELS)}
# SPEC 5.3: the lists of the dimensions, by their count field.
LISTS = {
    "slice_count": "slice_width",
    "hyper_layers": "hyper_width",
    "sarm_layers": "sarm_width",
    "carm_layers": "carm_width",
}

# --- faults of fields -------------------------------------------------------------------------------------------------


def _dimensions(draw: Draw, t: Target) -> Drawn:
    """Draws a dimension, and a value that is outside the limits of the profile."""
    before = "header.dimensions."
    names = [path.removeprefix(before) for path in t.elements if path.startswith(before)]
    name = draw.choice([name for name in names if name not in (*LISTS, "padding", "reserved")])
    low, high = getattr(PROFILES[t.header.profile], name.partition("[")[0])
    return name, draw.choice([value for value in (low - 1, high + 1) if value >= 0])


def _widths(draw: Draw, t: Target, counter: str) -> list[int]:
    """Draws widths of 1, too few or too many."""
    d, (low, high) = t.header.dimensions, getattr(PROFILES[t.header.profile], counter)
    counts = [high + 1]
    # A scene without planes has no layers of SARM.
    if low and (counter != "sarm_layers" or d.plane_channels):
        counts.append(low - 1)
    useless = {"carm_layers": len(d.slices) == 1, "hyper_layers": not d.has_frame, "sarm_layers": not d.plane_channels}
    return [1] * draw.choice(counts + [1, 2] * useless.get(counter, False))


def _many(draw: Draw, t: Target) -> Drawn:
    widths = tuple(draw.integer(30, 64) for _ in t.header.dimensions.slices)
    return draw.choice([widths] if sum(widths) > FEATURES_MAX else [])


def _anchors(draw: Draw, t: Target) -> Drawn:
    if t.header.profile == TINY:
        return (draw.integer(4097, 0xFFFFFFFF),)
    number = draw.choice(list(LEVELS))
    return draw.integer(LEVELS[number].anchors + 1, 0xFFFFFFFF), number


def _either(draw: Draw, t: Target) -> Target:
    """Draws the file of Tiny, or one of Main."""
    return draw.choice([t, main_file()])


def _main(draw: Draw, t: Target) -> Target:
    return main_file()


# Of a file of Tiny.
profile = element("header.profile", "profile", [2, 3, 255])
chunk_size = element("header.chunk_size", "chunk_size", [0, 65537, 0xFFFFFFFF])
level = element(
    "header.level",
    "level",
    lambda d, t: d.choice([value for value in range(256) if value not in PROFILES[t.header.profile].levels]),
)
dimension = element("header.dimension", "dimensions.{}", _dimensions, base=_either)


@fault("header.dimension", list(LISTS), _widths)
def list_length(t: Target, counter: str, widths: list[int]) -> Whole:
    """A list of dimensions is too short or too long."""

    def change(fields: Any) -> None:
        fields.dimensions[counter] = len(widths)
        fields.dimensions[LISTS[counter]] = widths

    return Whole(t.with_header(change), t.at(f"dimensions.{counter}"))


_NONE = {"plane_channels": 0, "frequency_count": 0, "plane_size": 0}
# Several wrong dimensions of main_file: a title, the field of the first check, fields, and lists by their counters.
AT_ONCE: dict[str, tuple[str, str, dict[str, int], dict[str, list[int]]]] = {
    "no-plane-size-and-no-sarm": ("planes without a size and without layers of SARM", "plane_size",
        {"plane_size": 0}, {"sarm_layers": []}),
    "size-and-sarm-for-nothing": ("plane_size and layers of SARM, though there are no planes", "plane_size",
        {"plane_channels": 0, "plane_size": 2}, {}),
    "size-and-hyper-for-nothing": ("plane_size and layers of F_h, though there are no planes and inputs", "plane_size",
        {**_NONE, "plane_size": 2}, {"sarm_layers": [], "hyper_layers": [4]}),
    "sarm-and-hyper-for-nothing": ("layers of SARM and F_h, though there are no planes and inputs", "sarm_layers",
        _NONE, {"sarm_layers": [4], "hyper_layers": [4]}),
    "hyper-and-carm-for-nothing": ("layers of F_h without inputs, and of CARM for one slice", "hyper_layers", _NONE,
        {"sarm_layers": [], "hyper_layers": [4], "slice_count": [5], "carm_layers": [4]}),
    "carm-and-view-inputs": ("layers of CARM for one slice, and view_inputs", "carm_layers", {"view_inputs": 1},
        {"slice_count": [5], "carm_layers": [4]}),
    "carm-and-level": ("layers of CARM for one slice, and a plane_size that the level does not allow", "carm_layers",
        {"plane_size": 129}, {"slice_count": [5], "carm_layers": [4]}),
    "hyper-width-and-slice-width": ("an item of hyper_width, and one of slice_width", "hyper_width[0]", {},
        {"hyper_layers": [129], "slice_count": [65, 5]}),
    "static-view-and-colour": ("view_inputs and colour_outputs of a static scene", "view_inputs",
        {"view_inputs": 1, "colour_outputs": 4, "render_model": STATIC}, {}),
    "static-view-and-level": ("view_inputs of a static scene, and a plane_size that its level does not allow",
        "view_inputs", {"plane_size": 129, "render_model": STATIC}, {}),
    "carm-and-static-view": ("layers of CARM for one slice, and view_inputs of a static scene", "carm_layers",
        {"view_inputs": 1, "render_model": STATIC}, {"slice_count": [5], "carm_layers": [4]}),
    "static-colour-and-level": ("colour_outputs of a static scene, and a plane_size that its level does not allow",
        "colour_outputs", {"view_inputs": 0, "colour_outputs": 4, "plane_size": 129, "render_model": STATIC}, {}),
    "colour-and-level": ("colour_outputs, and a plane_size that the level does not allow", "colour_outputs",
        {"colour_outputs": 4, "plane_size": 129}, {}),
}  # fmt: skip


@fault("header.dimension", list(AT_ONCE), base=_main)
def dimensions_at_once(t: Target, name: str) -> Whole:
    """Several dimensions are wrong, or one is for two reasons. name: in AT_ONCE."""
    _, reported, values, lists = AT_ONCE[name]

    def change(fields: Any) -> None:
        fields.render_info.render_model = values.get("render_model", 0)
        fields.dimensions.update({field: value for field, value in values.items() if field != "render_model"})
        for counter, widths in lists.items():
            fields.dimensions[counter], fields.dimensions[LISTS[counter]] = len(widths), widths

    return Whole(t.with_header(change), t.at(f"dimensions.{reported}"))


@fault("header.dimension", _many, base=_main)
def many_features(t: Target, *widths: int) -> Edit:
    """Slices are within the profile, but their sum exceeds FEATURES_MAX. widths: one for each slice of the file."""
    values = {f"dimensions.slice_width[{i}]": width for i, width in enumerate(widths)}
    return Edit(t.pack(values), t.at("dimensions.slice_width[0]"))


@fault("header.anchor_count", _anchors, base=_either)
def too_many_anchors(t: Target, value: int, level: int | None = None) -> Edit:
    """There are more anchors than the level allows. level: another level."""
    values = {"anchor_count": value} | ({} if level is None else {"level": level})
    return Edit(t.pack(values), t.at("anchor_count"))


@fault(
    "header.level_not_minimal",
    list(LOWER),
    lambda d, t, level: d.integer(0, LEVELS[LOWER[level]].anchors),
    lambda d, t, level, _: d.integer(2, LEVELS[LOWER[level]].plane_size),
    base=_main,
)
def level_too_high(t: Target, level: int, anchors: int, plane_size: int) -> Edit:
    """A lower level of Main would suffice."""
    values = {"level": level, "anchor_count": anchors, "dimensions.plane_size": plane_size}
    return Edit(t.pack(values), t.at("level"))


@fault("header.work", list(LEVELS)[:3], base=_main)
def work_of_widths(t: Target, level: int = LOWEST) -> Edit:
    """Widths and anchors are within the level, but their work exceeds it. For a file of four slices."""
    values = {"level": level, "anchor_count": LEVELS[level].anchors}
    widths = {"slice_width[0]": 64, "slice_width[3]": 34, "hyper_width[0]": 128, "carm_width[0]": 128}
    return Edit(t.pack(values | {f"dimensions.{name}": w for name, w in widths.items()}), t.at("anchor_count"))


# --- headers alone ----------------------------------------------------------------------------------------------------

# SPEC 11.2: dimensions of Main with a work of 2^16 and of 2^17 per anchor, which the first three levels and the
# others allow for their largest N, and dimensions with little more work.
_WORK_16 = Dimensions(10, (64, 64), 0, 16, 0, (115, 120), (), (26,), 32)
_WORK_17 = Dimensions(16, (16,) * 8, 0, 16, 0, (66, 109), (), (115,), 32)
WORK_AT_BOUND = {level: _WORK_16 if most.anchors < 1 << 24 else _WORK_17 for level, most in LEVELS.items()}
WORK_BEYOND = {
    level: replace(d, hyper_width=(d.hyper_width[0], d.hyper_width[1] + 1)) for level, d in WORK_AT_BOUND.items()
}
# Dimensions whose planes are a fifth of the work of the lowest level, and the most anchors that it allows with them.
WORK_OF_PLANES = Dimensions(10, (64, 64), 16, 16, 128, (115, 120), (32, 32), (26,), 32)
BESIDE_PLANES = (LEVELS[LOWEST].work - work(WORK_OF_PLANES, 0)) // (work(WORK_OF_PLANES, 1) - work(WORK_OF_PLANES, 0))
# Dimensions without view inputs, whose rendering networks are above the work of the lowest level.
WORK_OF_RENDERING = replace(_WORK_16, view_inputs=0)
# Dimensions, and a number of anchors, whose work is one more than the lowest level allows.
_MORE = Dimensions(10, (64, 64), 1, 16, 101, (92, 128), (7,), (26,), 32), 130906
assert work(*_MORE) == LEVELS[LOWEST].work + 1


def header_of(d: Dimensions, level: int, anchors: int, size: int = 16384) -> bytes:
    """Returns the header of a file of Main with the lengths that it implies, without the rest.

    size: chunk_size. There are as few chunks as possible.
    """
    chunks = -(-anchors // size)
    lengths = section_lengths(d, chunks, {WEIGHTS: 0, INDEX: 0})
    sections = [(kind, 0, b"") for kind in critical_sections(d)]
    values: dict[str, Any] = {"level": level, "anchor_count": anchors, "chunk_count": chunks, "chunk_size": size}
    values |= {"lanes": Lanes(), "base_step": (1.0, 1.0, 1.0), "grid": PositionGrid()}
    render = RenderInfo(render_model=0 if d.view_inputs else 2)
    header = Header(minor=0, profile=MAIN, render=render, dimensions=d, **values)
    out = bytearray(emit_file(header, sections))
    fields, end = layout(bytes(out))
    for entry, e in enumerate(fields.directory):
        at = end - 4 - ENTRY_BYTES * (len(fields.directory) - entry)
        out[at + 8 : at + 16] = lengths.get(e.type, 0).to_bytes(8, "little")
    return repair(bytes(out), Depth.HEADER)


def _of_header(
    error: str, reported: str | None, dimensions: dict[int, Dimensions], anchors: Callable[[int], tuple[int, int]]
) -> Fault[...]:
    """Returns the fault of a header of Main without the rest. Its arguments are dimensions, a level and anchors.

    reported: an element; None is the end of the file. dimensions: those that are drawn, by level. anchors: drawn for a
    level.
    """

    def drawn(draw: Draw, t: Target) -> Drawn:
        level = draw.choice(list(dimensions))
        return dimensions[level], level, draw.integer(*anchors(level))

    def header_alone(t: Target, d: Dimensions, level: int, anchors: int) -> Whole:
        data = header_of(d, level, anchors)
        return Whole(data, len(data) if reported is None else t.at(reported))

    return Fault(error, "header_alone", header_alone, [drawn])


def _below(level: int) -> int:
    """Returns the most anchors of a lower level, or -1."""
    return LEVELS[LOWER[level]].anchors if level in LOWER else -1


# A valid header; one with anchors and planes within the level, but more work; and one for which a lower level would do.
header_alone = _of_header(
    "section.truncated", None, WORK_AT_BOUND, lambda level: (_below(level) + 1, LEVELS[level].anchors)
)
too_much_work = _of_header(
    "header.work", "anchor_count", WORK_BEYOND, lambda level: (LEVELS[level].anchors - 9, LEVELS[level].anchors)
)
level_of_less_work = _of_header(
    "header.level_not_minimal",
    "level",
    {number: WORK_AT_BOUND[lower] for number, lower in LOWER.items()},
    lambda level: (0, _below(level)),
)

# A file with one slice, and thus without CARM.
_one_slice = target_of(lambda: drawn("refused-one-slice", 2, replace(TINY_DIMENSIONS, slices=(3,), carm_width=())))


def _packed() -> Scene:
    where = lattice(Numbers("main-packed"), 300)
    d = replace(MAIN_SMALLEST, plane_size=9, hyper_width=(20,), carm_width=(24,))
    made = sparse(scene("main-packed", 300, d, positions=where, chunk_size=256, lanes=Lanes(2, 3, 4)))
    made = sampled(made, Sampler(Numbers("main-packed/symbols")))
    return replace(made, position_model=position_model(where, 256))


def _large_planes(size: int, channels: int) -> Scene:
    d = replace(MAIN_SMALLEST, plane_size=size, plane_channels=channels)
    made = sparse(scene("main-planes", 3, d, lanes=Lanes(6, 0, 6)))
    flat, numbers = np.zeros_like(made.planes), Numbers("main-planes/symbols")
    for at in numbers.integers(0, flat.size - 1, 60).tolist():
        flat.reshape(-1)[at] = numbers.integer(-2, 2)
    packed = packed_weights(replace(with_weights(made, *QUIET_SARM), planes=flat))
    return sampled(packed, Sampler(numbers), planes=False)


# fmt: off
# Values just outside the limits, and lists that are too short or too long, of Tiny and of Main.
_OUTSIDE: dict[str, dict[str, list[int]]] = {
    "Tiny": {
        "offset_count": [0, 11], "slice_width[0]": [0], "slice_width[1]": [17], "plane_channels": [9],
        "frequency_count": [11], "view_inputs": [3, 5, 9], "colour_outputs": [0, 2, 4, 49],
        "plane_size": [0, 1, 33, 258], "render_width": [0, 65, 259], "hyper_width[0]": [0, 65, 262],
        "sarm_width[0]": [0, 260], "sarm_width[1]": [17], "carm_width[0]": [0, 65, 261],
    },
    "Main": {
        "offset_count": [0, 17], "slice_width[0]": [0, 65], "slice_width[3]": [0, 65], "plane_channels": [17],
        "frequency_count": [17], "view_inputs": [9], "colour_outputs": [0, 49], "plane_size": [0, 1, 1025, 65535],
        "render_width": [0, 129], "hyper_width[0]": [0, 129], "sarm_width[0]": [0, 33], "sarm_width[1]": [0, 33],
        "carm_width[0]": [0, 129],
    },
}
_LISTS: dict[str, list[tuple[str, list[int]]]] = {
    name: [("slice_count", []), ("slice_count", slices), ("hyper_layers", [width] * 3), ("sarm_layers", []),
           ("sarm_layers", [width] * 3), ("carm_layers", [width] * 3)]
    for name, slices, width in (("Tiny", [1] * 5, 4), ("Main", [5] * 17, 16))
}
# The profiles: a file, and a part of identifiers.
_FILES = {"Tiny": (plain, ""), "Main": (main_file, "main-")}
_REST = "and nothing behind the header"
_work = partial(refused, "header main dimensions", requirements="R11.1-2 R11.2-2 R11.2-3 R11.2-4")

CASES = [
    # Dimensions.
    *refused("dimensions", "limit-off-by-one",
        *((f"dimension-{_FILES[name][1]}{label_of(field)}-{value}", f"{field} {value} in {name}", _FILES[name][0],
           dimension, field, value)
          for name, outside in _OUTSIDE.items() for field, values in outside.items() for value in values),
        *((f"dimension-{_FILES[name][1]}{label_of(counter)}-{len(widths)}", f"{counter} {len(widths)} in {name}",
           _FILES[name][0], list_length, counter, widths)
          for name, lists in _LISTS.items() for counter, widths in lists),
        ("dimension-main-129-features", "129 features", main_file, many_features, 64, 63, 1, 1),
        ("dimension-main-256-features", "256 features, which are 0 in eight bits", main_file, many_features, 64, 64, 64,
         64, More("sum-wraps"))),
    *refused("dimensions", "optional-parts",
        ("dimension-carm-for-nothing", "CARM has a hidden layer, though there is one slice", _one_slice, list_length,
         "carm_layers", [4]),
        ("dimension-hyper-for-nothing", "F_h has a hidden layer, but no inputs", unpredicted, list_length,
         "hyper_layers", [4]),
        ("dimension-sarm-for-nothing", "SARM has a hidden layer, though there are no planes", planeless, list_length,
         "sarm_layers", [4]),
        ("dimension-size-for-nothing", "plane_size 2, though there are no plane channels", planeless, dimension,
         "plane_size", 2)),
    *refused("dimensions", "level-limits",
        ("dimension-main-plane-size-129", f"plane_size 129 at level {LOWEST}", main_file, dimension,
         "plane_size", 129)),

    # Profile, level, anchors and chunk_size.
    *refused("header", "profile-unchecked", ("header-profile-2", "profile 2", profile, 2)),
    *refused("header", "level-limits",
        ("header-level-1", "level 1 of Tiny", level, 1),
        *((f"header-main-level-{number}", f"level {number} of Main", main_file, level, number)
          for number in (0, LOWEST - 1, LOWEST + 1, HIGHEST + 1))),
    *refused("header", "level-limits buffer-too-small", *(
        (f"anchor-count-{value}", f"anchor_count {value} in Tiny", too_many_anchors, value)
        for value in (4097, 0xFFFFFFFF))),
    *refused("main header", "level-limits", *(
        (f"anchor-count-main-{number}", f"one anchor more than level {number} of Main allows", main_file,
         too_many_anchors, most.anchors + 1, number)
        for number, most in LEVELS.items())),
    *refused("main header", "level-limits level-not-minimal", *(
        (f"level-{number}-of-{anchors}-{size}",
         f"level {number}, though level {LOWER[number]} allows {anchors} anchors and planes of {size}", main_file,
         level_too_high, number, anchors, size)
        for number, anchors, size in ((20, 1 << 17, 128), (30, 1 << 20, 256), (40, 1 << 22, 256), (50, 1 << 24, 512)))),
    *refused("header", "limit-off-by-one", *(
        (f"chunk-size-{size}", f"chunk_size {size}", chunk_size, size) for size in (0, 65537))),
    *refused("main header", "limit-off-by-one", *(
        (f"chunk-size-main-{size}", f"chunk_size {size} in Main", main_file, chunk_size, size)
        for size in (255, 16385, 65536))),

    # The work of the levels (11.2).
    *_work("level-limits level-not-minimal truncation",
        *((f"work-at-bound-{number}", f"as many anchors, and as much work, as level {number} allows, {_REST}",
           header_alone, WORK_AT_BOUND[number], number, most.anchors) for number, most in LEVELS.items()),
        *((f"main-planes-{size}", f"planes of {size}, and no anchors: level {number}, which the planes alone need",
           header_alone, replace(WORK_OF_PLANES, plane_size=size), number, 0)
          for number, size in ((20, 256), (40, 512), (50, 1024)))),
    *_work("level-limits work-bound", *(
        (f"work-beyond-{number}", f"as many anchors as level {number} allows, and more work", too_much_work,
         WORK_BEYOND[number], number, most.anchors) for number, most in LEVELS.items())),
    *_work("level-not-minimal work-bound",
        *((f"level-{number}-of-less-work", f"level {number}, though level {lower} allows this work",
           level_of_less_work, WORK_AT_BOUND[lower], number, LEVELS[lower].anchors)
          for number, lower in LOWER.items()),
        *((f"work-needs-{number}", f"level {number}, which the work alone needs, {_REST}", header_alone,
           WORK_BEYOND[lower], number, LEVELS[lower].anchors) for number, lower in LOWER.items()),
        ("work-of-planes", f"as many anchors as the work of level 10 allows beside that of the planes, {_REST}",
         header_alone, WORK_OF_PLANES, LOWEST, BESIDE_PLANES),
        ("work-of-rendering", f"rendering networks without view inputs, which count as work, {_REST}", header_alone,
         WORK_OF_RENDERING, LOWEST + 10, LEVELS[LOWEST].anchors),
        ("work-needs-20-by-one", f"level 20, which a work of 2^33 + 1 needs, {_REST}", header_alone, _MORE[0], 20,
         _MORE[1])),
    *_work("work-bound", (too_much_work,),
        ("work-of-rendering", "rendering networks without view inputs, which count as work", WORK_OF_RENDERING, LOWEST,
         LEVELS[LOWEST].anchors),
        ("work-of-planes", "one anchor more than that", WORK_OF_PLANES, LOWEST, BESIDE_PLANES + 1),
        ("work-beyond-by-one", "work of 2^33 + 1 at level 10", _MORE[0], LOWEST, _MORE[1], More("limit-off-by-one"))),
    *_work("level-limits level-not-minimal",
        ("level-20-by-one-anchor", f"level 20, which {LEVELS[LOWEST].anchors + 1} anchors need, {_REST}", header_alone,
         SMALLEST, 20, LEVELS[LOWEST].anchors + 1)),

    # Files of Main.
    *valid("main chunks", "carm-slices", "R11.1-2 R11.1-3 D7.9-1 D7.10-1",
        ("main", "a small file of profile Main, in two chunks, positions and weights raw",
         partial(drawn, "main", 258, MAIN_SMALLEST, chunk_size=256))),
    *valid("main packed-positions packed-weights chunks", "carm-slices", "D7.12-1 D7.13-1 D7.9-1",
        ("main-packed", "a file of profile Main in mode 1", _packed)),
    *valid("main empty packed-weights", "", "R11.2-2",
        ("main-empty", "no anchors in Main",
         lambda: sparse(scene("main-empty", 0, replace(MAIN_SMALLEST, plane_size=4))))),
    *valid("main chunks", "limit-off-by-one chunk-sizes", "R11.1-3 R6.10-5", *(
        (f"main-chunk-size-{size}", f"chunk_size {size} in Main, and chunks that are smaller",
         partial(drawn, "main-chunk-size", 6, SMALLEST, profile=MAIN, chunk_size=size, chunk_anchors=(1, 5)))
        for size in (256, 16384))),
    *valid("header chunks", "limit-off-by-one count-in-16-bits", "R11.1-3",
        ("tiny-chunk-size-65536", "the largest chunk_size of Tiny",
         partial(drawn, "tiny-chunk-size", 6, SMALLEST, chunk_size=65536))),
    *valid("main planes", "level-limits", "R11.2-1 R11.2-3 D7.3-1 D7.3-2",
        ("main-level-20", "planes that only level 20 allows", _large_planes, 129, 8, More(seconds=60)),
        ("main-level-40", "planes that only level 40 allows", _large_planes, 257, 1, More(seconds=60)),
        ("main-level-50", "planes that only level 50 allows", _large_planes, 513, 1, More(seconds=60))),
]
