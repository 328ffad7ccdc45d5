"""Hypothesis strategies: structures of SPEC.md, whole scenes, faults, and changed files with right checksums."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from conformance.cases import faults
from conformance.cases.checksums import repair
from conformance.cases.fault import Draw, Fault, Refused
from conformance.cases.scenes import with_steps
from conformance.cases.target import Target
from refcodec.bitstream import frame, header, syntax, weights
from refcodec.bitstream.ancillary import TYPES, AncillaryType
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, Attributes
from refcodec.bitstream.dimensions import RENDER_MODELS, STATIC, Dimensions, mask_contexts
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import ALPHA_MOST, ORIGIN_BOUND, Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.limits import PROFILES, TINY
from refcodec.bitstream.networks import BoundError, derive_layer
from refcodec.bitstream.planes import PLANE_SYMBOL_MAX
from refcodec.bitstream.positions import CELL_INDEX, EMPTY_MODELS, HALVES, POSITION_MODELS, PositionModel, chunk_codes
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.bitstream.splat import derive_rendering
from refcodec.encoder.positions import frequencies, morton_order, position_model
from refcodec.encoder.weights import exact_networks, quantise_rendering, weight_scales

T = TypeVar("T")


def _within(bounds: tuple[int, int], most: int) -> st.SearchStrategy[int]:
    """Draws mostly small values, and sometimes the profile's limit."""
    low, high = bounds
    return st.one_of(st.integers(low, min(most, high)), st.sampled_from([low, high]))


# SPEC 6.5: view_inputs and colour_outputs of view-dependent and of static scenes.
(OF_MODEL_0,), OF_STATIC = (
    [(inputs, colours) for colours in outputs] for inputs, outputs in (RENDER_MODELS[0], RENDER_MODELS[STATIC])
)


@st.composite
def dimensions(draw: st.DrawFn) -> Dimensions:
    """Draws dimensions of profile Tiny, including its limits, but not all at once."""
    p = PROFILES[TINY]
    slices = draw(st.lists(_within(p.slice_width, 4), min_size=1, max_size=4))

    def widths(count: tuple[int, int], width: tuple[int, int]) -> tuple[int, ...]:
        return tuple(draw(st.lists(_within(width, 6), min_size=count[0], max_size=count[1])))

    channels, frequencies = draw(_within(p.plane_channels, 2)), draw(_within(p.frequency_count, 3))
    sizes = st.one_of(st.integers(2, 7), st.sampled_from([2, 32])) if len(slices) < 3 else st.integers(2, 7)
    return Dimensions(
        draw(_within(p.offset_count, 3)),
        tuple(slices),
        channels,
        frequencies,
        draw(sizes) if channels else 0,
        widths(p.hyper_layers, p.hyper_width) if channels + frequencies else (),
        widths(p.sarm_layers, p.sarm_width) if channels else (),
        widths(p.carm_layers, p.carm_width) if len(slices) > 1 else (),
        draw(_within(p.render_width, 3)),
        *draw(
            st.sampled_from([OF_MODEL_0, OF_MODEL_0, *OF_STATIC])
            | st.tuples(_within(p.view_inputs, 4), _within(p.colour_outputs, 12))
        ),
    )


def grids() -> st.SearchStrategy[PositionGrid]:
    origin = st.integers(1 - ORIGIN_BOUND, ORIGIN_BOUND - 1)
    return st.builds(PositionGrid, st.tuples(origin, origin, origin), st.integers(1, 65535), st.integers(-60, 60))


def render_infos(d: Dimensions, bounded: bool) -> st.SearchStrategy[RenderInfo]:
    """Render information of a render model that allows the dimensions.

    bounded: whether the rendering networks have exponents, as those of a static scene.
    """
    sizes, others = (d.view_inputs, d.colour_outputs), st.integers(2, 255)
    model = others
    if sizes == OF_MODEL_0:
        model = st.just(0) | others
    if sizes in OF_STATIC and bounded:
        model = st.just(1) | others
    positive = st.floats(2.0**-100, 2.0**100, width=32)
    byte = st.integers(0, 255)
    return st.builds(
        RenderInfo,
        st.tuples(byte, byte, byte),
        st.integers(0, 5),
        positive,
        positive,
        st.floats(2.0**-20, ALPHA_MOST, width=32),
        st.floats(0, 2.0**20, width=32),
        byte,
        byte,
        model,
    )


def _bounded(network: dict) -> bool:
    """Whether the rendering networks have exponents (SPEC 7.2)."""
    try:
        derive_rendering(network)
    except BoundError:
        return False
    return True


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Draws frames up to their limits."""
    matrix = draw(hnp.arrays(np.int64, (3, 3), elements=st.integers(1 - frame.MATRIX_BOUND, frame.MATRIX_BOUND - 1)))
    translation = draw(
        hnp.arrays(np.int64, 3, elements=st.integers(1 - frame.TRANSLATION_BOUND, frame.TRANSLATION_BOUND - 1))
    )
    shift = draw(hnp.arrays(np.int64, 3, elements=st.integers(0, frame.FRAME_SHIFT_MAX)))
    low = draw(hnp.arrays(np.int64, 3, elements=st.integers(-frame.FRAME_RANGE_BOUND, frame.FRAME_RANGE_BOUND - 1)))
    span = draw(hnp.arrays(np.int64, 3, elements=st.integers(1, 2 * frame.FRAME_RANGE_BOUND)))
    return Frame(matrix, translation, shift, low, np.minimum(low + span, frame.FRAME_RANGE_BOUND))


@st.composite
def networks(draw: st.DrawFn, d: Dimensions) -> dict:
    """Draws weights within the accumulator bound: random, zero, subnormal, and as large as possible."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    out = {}
    for name, shapes in d.network_shapes().items():
        layers = []
        for rows, fan_in in shapes:
            kind = draw(st.sampled_from(["random", "random", "zero", "subnormal", "extreme"]))
            scale = {"random": 0.5, "zero": 0.0, "subnormal": 1e-41, "extreme": 1.0}[kind]
            weight = (rng.normal(0, 1, (rows, fan_in)) * scale).astype(np.float32)
            bias = (rng.normal(0, 40, rows) * min(scale * 2, 1)).astype(np.float32)
            if kind == "extreme":
                # Just inside the bound at exponent 0: sum |w| * 1023 + |b| < 2^24.
                weight = np.sign(weight) * np.float32(min(1023, ((1 << 24) - 1) // (1023 * max(fan_in, 1))))
                bias = np.zeros(rows, np.float32)
            try:
                derive_layer(weight, bias)
            except BoundError:
                weight, bias = np.zeros_like(weight), np.zeros_like(bias)
            layers.append((weight.astype(np.float32), bias))
        out[name] = layers
    return out


def positions(count: int) -> st.SearchStrategy[np.ndarray]:
    """Draws finite fp16 numbers except -0: subnormals, extremes and duplicates."""
    bits = st.one_of(
        st.integers(0, 0x7BFF), st.integers(0x8001, 0xFBFF), st.sampled_from([0, 1, 0x03FF, 0x7BFF, 0x8001, 0xFBFF])
    )
    return hnp.arrays(np.uint16, (count, 3), elements=bits).map(lambda a: a.view(np.float16))


@st.composite
def position_models(draw: st.DrawFn, positions: np.ndarray, chunk_size: int) -> PositionModel | None:
    """Draws None, the encoder's choice, or any model."""
    kind = draw(st.sampled_from(["raw", "chosen", "any"]))
    if kind == "raw":
        return None
    chosen = position_model(positions, chunk_size)
    if kind == "chosen":
        return chosen
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    counts = rng.integers(0, 1 << draw(st.integers(0, 20)), (POSITION_MODELS, HALVES)) + 1
    frequency = [frequencies(c, int(model in EMPTY_MODELS)) for model, c in enumerate(counts)]
    return PositionModel(
        draw(st.one_of(st.just(chosen.cell_shift), st.integers(0, CELL_INDEX))), np.array(frequency, np.uint16)
    )


@st.composite
def weight_codings(draw: st.DrawFn, networks: dict) -> tuple[dict, np.ndarray | None, np.ndarray | None]:
    """Draws networks in mode 0; or in mode 1, changed by the encoder or not, with its scales or any, in any forms."""
    kind = draw(st.sampled_from(["raw", "chosen", "any"]))
    if kind == "raw":
        return networks, None, None
    if draw(st.booleans()):
        networks = exact_networks(networks)
    if draw(st.booleans()):
        networks = quantise_rendering(networks, draw(st.integers(2, 24)))
    scales = weight_scales(networks)
    if kind == "any":
        rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        grids = [weights.to_grid(layer) for layers in networks.values() for layer in layers]
        scales = rng.integers(0, 256, scales.shape).astype(np.uint8) * np.array(
            [[grid is not None] for grid in grids], np.uint8
        )
    if draw(st.booleans()):
        return networks, scales, None
    # A layer that can be packed may also be raw, without scales.
    forms = weights.packable(networks) * draw(hnp.arrays(np.uint8, len(scales), elements=st.integers(0, 1)))
    return networks, scales * forms[:, None], forms


@st.composite
def chunkings(draw: st.DrawFn, anchors: int, chunk_size: int) -> tuple[int, ...] | None:
    """Draws None for the fewest chunks, or a number of anchors for each chunk."""
    if draw(st.booleans()):
        return None
    sizes: list[int] = []
    while sum(sizes) < anchors:
        sizes.append(draw(st.integers(1, min(chunk_size, anchors - sum(sizes)))))
    return tuple(sizes)


_FIELDS = {"u16": st.integers(0, 3), "u32": st.integers(0, 3), "f32": st.floats(width=32)}


@st.composite
def _struct(draw: st.DrawFn, table: str, **fields: int) -> bytes:
    """Draws a struct of SYNTAX with any field values. fields: given values."""
    values: dict[str, object] = {}
    for name, kind in syntax.SYNTAX[table]:
        base, _, count = kind.rstrip("]").partition("[")
        if base == "bytes":
            values[name] = draw(st.binary(max_size=5))
            values[count] = len(values[name])  # type: ignore[arg-type]
        elif base in _FIELDS:
            one = _FIELDS[base]
            values[name] = draw(st.tuples(*[one] * int(count)) if count else one)
    return syntax.build(table, values | fields)


@st.composite
def _content(draw: st.DrawFn, kind: AncillaryType) -> bytes:
    """Draws the content of a section of a known type, by its syntax tables."""
    items = draw(st.lists(_struct(kind.items), max_size=2))
    return draw(_struct(kind.head, count=len(items))) + b"".join(items)


@st.composite
def ancillary(draw: st.DrawFn) -> tuple[Ancillary, ...]:
    """Draws ancillary sections of any type, possibly repeated, at any places."""
    letter = st.sampled_from("aZ")
    kind = st.builds("{}{}{}{}".format, st.sampled_from("bz"), letter, letter, letter).map(str.encode)
    known, modes, places = st.sampled_from([*TYPES]), st.integers(0, 255), st.integers(0, 3)
    one = st.one_of(
        st.builds(Ancillary, st.one_of(kind, known), modes, st.binary(max_size=9), places),
        *(st.builds(Ancillary, st.just(t), st.just(0), _content(entry), places) for t, entry in TYPES.items()),
    )
    return tuple(sorted(draw(st.lists(one, max_size=3)), key=lambda a: a.after))


@st.composite
def some_positions(draw: st.DrawFn, count: int) -> np.ndarray:
    """Draws positions on a lattice near 0 or anywhere, in any order or in that of their cells."""
    drawn = draw(positions(count))
    if draw(st.booleans()):
        spread = draw(st.sampled_from([3, 40, 2048]))
        lattice = draw(hnp.arrays(np.int64, (count, 3), elements=st.integers(-spread, spread)))
        drawn = (lattice * 2.0 ** draw(st.integers(-24, 4))).astype(np.float16)
        drawn[drawn == 0] = 0
    return drawn[morton_order(drawn)] if draw(st.booleans()) else drawn


def spread_symbols(shape: tuple[int, ...], limit: int) -> st.SearchStrategy[np.ndarray]:
    """Draws integers up to a limit: small ones, one large one, or any."""
    small = hnp.arrays(np.int32, shape, elements=st.integers(-3, 3))
    wide = hnp.arrays(np.int32, shape, elements=st.integers(-limit, limit), fill=st.just(0))
    powers = st.integers(0, limit.bit_length()).flatmap(
        lambda b: st.sampled_from([-1, 1]).map(lambda s: s * min(limit, (1 << b)))
    )
    return st.one_of(small, hnp.arrays(np.int32, shape, elements=powers, fill=st.just(0)), wide)


@st.composite
def scenes(draw: st.DrawFn, max_anchors: int = 12) -> Scene:
    """Draws a scene of profile Tiny with at most max_anchors anchors."""
    d = draw(dimensions())
    n = draw(st.integers(0, max_anchors))
    masks = draw(
        st.one_of(
            hnp.arrays(np.bool_, (n, d.offset_count)),
            st.just(np.ones((n, d.offset_count), bool)),
            st.just(np.zeros((n, d.offset_count), bool)),
            st.just(np.arange(n * d.offset_count).reshape(n, d.offset_count) == 0),
        )
    )
    offsets = draw(spread_symbols((n, d.offset_count, 3), ATTRIBUTE_SYMBOL_MAX)).copy()
    offsets[~masks] = 0
    size = d.plane_size
    plane = draw(spread_symbols((5, d.plane_channels, size, size), PLANE_SYMBOL_MAX))
    lane = st.integers(0, 8)
    step = st.floats(2.0**-60, 2.0**60, width=32)
    chunk_size = draw(st.one_of(st.integers(1, 15), st.just(65536)))
    where = draw(some_positions(n))
    chosen, scales, forms = draw(weight_codings(draw(networks(d))))
    chunks, model = draw(chunkings(n, chunk_size)), draw(position_models(where, chunk_size))
    minor = draw(st.sampled_from([0, 0, 1]))
    scene = Scene(
        profile=TINY,
        dimensions=d,
        chunk_size=chunk_size,
        lanes=Lanes(draw(lane), draw(lane), draw(lane)),
        base_step=draw(st.tuples(step, step, step)),
        grid=draw(grids()),
        render=draw(render_infos(d, _bounded(chosen))),
        frame=draw(frames()) if d.has_frame else None,
        plane_shift=draw(st.integers(0, weights.PLANE_SHIFT_MAX)) if d.plane_channels else 0,
        carm_shift=draw(hnp.arrays(np.uint8, d.carm_inputs, elements=st.integers(0, weights.CARM_SHIFT_MAX))),
        networks=chosen,
        planes=plane.astype(np.int16),
        mask_model=draw(hnp.arrays(np.uint16, mask_contexts(d.offset_count), elements=st.integers(1, (1 << 14) - 1))),
        positions=where,
        masks=masks,
        attributes=Attributes(
            draw(spread_symbols((n, d.features), ATTRIBUTE_SYMBOL_MAX)),
            draw(spread_symbols((n, 6), ATTRIBUTE_SYMBOL_MAX)),
            offsets,
            np.zeros((n, 3), np.uint8),
        ),
        ancillary=draw(ancillary()),
        position_model=model,
        weight_scales=scales,
        chunk_anchors=chunks,
        weight_forms=forms,
        minor=minor,
        later=draw(st.sampled_from([b"", b"\1\2\3\4"])) if minor else b"",
    )
    if model is not None and draw(st.booleans()):
        packed = [chunk_codes(where[c.start : c.stop], model.cell_shift) is not None for c in scene.chunks]
        scene = replace(scene, position_forms=tuple(int(p and draw(st.booleans())) for p in packed))
    return with_steps(scene)


class NoPlaceError(Exception):
    """There is nothing to choose: the file has no place for the drawn fault."""


class Drawer(Draw):
    """Draws the parameters of faults by hypothesis's strategies."""

    def __init__(self, draw: st.DrawFn) -> None:
        self._draw = draw

    def integer(self, low: int, high: int) -> int:
        return self._draw(st.integers(low, high))

    def flag(self) -> bool:
        return self._draw(st.booleans())

    def choice(self, items: Sequence[T]) -> T:
        if not items:
            raise NoPlaceError
        return self._draw(st.sampled_from(items))

    def content(self, low: int, high: int) -> bytes:
        return self._draw(st.binary(min_size=low, max_size=high))


def drawable() -> dict[str, Fault[...]]:
    """Returns the faults whose parameters can be drawn, by name. Only the suite has the others."""
    return {name: fault for name, fault in faults().items() if fault.draw is not None}


def draw_fault(draw: st.DrawFn, target: Target, name: str) -> Refused | None:
    """Returns a file with the named fault, from a valid file of Tiny, or None if it has no place for the fault."""
    fault = faults()[name]
    assert fault.draw is not None
    try:
        arguments = fault.draw(Drawer(draw), target)
    except NoPlaceError:
        return None
    return None if arguments is None else fault(*arguments)


def draw_mutation(draw: st.DrawFn, data: bytes) -> bytes:
    """Draws a file with a few changed bytes after the prologue, and repaired checksums if they can be found."""
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(header.PROLOGUE_BYTES, len(out) - 1))
        out[at] = draw(st.one_of(st.integers(0, 255), st.sampled_from([0, 1, 127, 128, 255]), st.just(out[at] ^ 1)))
    return repair(bytes(out))


mutations = st.composite(draw_mutation)


def draw_splice(draw: st.DrawFn, data: bytes) -> bytes:
    """Draws a file with a few bytes of one substream removed, inserted or changed.

    Lengths and checksums are right. The word count may also change. A file without substreams is mutated instead.
    """
    target = Target(data)
    if not target.substreams:
        return draw_mutation(draw, data)
    s = draw(st.sampled_from(list(target.substreams.values())))
    part = bytearray(data[s.start : s.end])
    at = draw(st.integers(0, len(part)))
    out = draw(st.integers(0, min(8, len(part) - at)))
    part[at : at + out] = draw(st.binary(max_size=8))
    if len(part) >= 8 and draw(st.booleans()):
        words = int.from_bytes(part[4:8], "little") + draw(st.integers(-4, 4))
        part[4:8] = min(max(words, 0), 0xFFFFFFFF).to_bytes(4, "little")
    return target.with_substream(s.path, bytes(part))


splices = st.composite(draw_splice)
