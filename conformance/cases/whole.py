"""Cases of several clauses: the worked example, an ordinary scene, trained scenes, and unusual ones."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX
from refcodec.bitstream.dimensions import Dimensions, layers_of, mask_contexts
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.networks import BoundError, derive_layer
from refcodec.bitstream.planes import PLANE_SYMBOL_MAX
from refcodec.bitstream.positions import CELL_INDEX, chunk_codes
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.bitstream.weights import packable

from .numbers import Int64, Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import any_model, drawn_symbols, lattice, positions, scene
from .table import More, valid
from .targets import BEHIND, stored
from .weights import Networks, dyadic


def _trained(name: str) -> Scene:
    """Encodes the scene of the vector again, which reveals changes of the encoder."""
    return codec.parse(stored(f"valid/trained-{name}.c3gs")).scene


def _widths(numbers: Numbers, count: tuple[int, int], most: int) -> tuple[int, ...]:
    return tuple(numbers.integers(1, most, numbers.integer(*count)).tolist())


def _weights(numbers: Numbers, d: Dimensions) -> Networks:
    """Draws networks: ordinary, zero, subnormal, at the bounds, and with different exponents of rows."""
    network_weights: Networks = {}
    for name, shapes in d.network_shapes().items():
        network_weights[name] = []
        for out, fan_in in shapes:
            kind = numbers.integer(0, 5)
            weight = dyadic(numbers.integers(-255, 255, out, fan_in), 9)
            bias = dyadic(numbers.integers(-3000, 3000, out), 6)
            if kind == 1:
                weight, bias = weight * 0, bias * 0 + dyadic(numbers.integers(-2, 2, out), 0)
            elif kind == 2:
                weight, bias = np.ldexp(weight, -140), np.ldexp(bias, -138)
            elif kind == 3:
                largest = min(1023, ((1 << 24) - 1) // (1023 * fan_in))
                weight, bias = dyadic(numbers.chosen([-largest, largest], out, fan_in), 0), bias * 0
            elif kind == 4:
                shift = -numbers.integers(0, 24, out)
                weight, bias = np.ldexp(weight, shift[:, None]), np.ldexp(bias, shift)
            try:
                derive_layer(weight, bias)
            except BoundError:
                weight, bias = np.ldexp(weight, -12), np.ldexp(bias, -12)
            network_weights[name].append((weight.astype(np.float32), bias.astype(np.float32)))
    return network_weights


def _symbols(numbers: Numbers, limit: int, *shape: int) -> Int64:
    """Draws small numbers, and sometimes one of any size."""
    small = numbers.centred(3, *shape)
    large = numbers.chosen([-1, 1], *shape) << numbers.integers(0, limit.bit_length() - 1, *shape)
    large += numbers.integers(-1, 1, *shape)
    return np.asarray(np.clip(np.where(numbers.integers(0, 11, *shape) == 0, large, small), -limit, limit))


def _render(numbers: Numbers) -> RenderInfo:
    def positive() -> float:
        return float(np.ldexp(np.float32(numbers.integer(1, (1 << 24) - 1)), numbers.integer(-120, 90)))

    background = tuple(numbers.integers(0, 255, 3).tolist())
    return RenderInfo(
        (background[0], background[1], background[2]),
        numbers.integer(0, 5),
        positive(),
        positive(),
        float(dyadic(numbers.integers(1, 253, 1), 8)[0]),
        float(dyadic(numbers.integers(0, 999, 1), 4)[0]),
    )


def _ancillary(numbers: Numbers) -> tuple[Ancillary, ...]:
    """Draws ancillary sections of any types at any places."""
    sections = []
    for _ in range(numbers.integer(0, 4)):
        letters = numbers.integers(0, 25, 4) + numbers.chosen([0x41, 0x61], 4)
        letters[0] |= 0x20
        kind, mode = bytes(letters.tolist()), numbers.integer(0, 255)
        sections.append(Ancillary(kind, mode, numbers.bytes(numbers.integer(0, 9)), numbers.integer(0, BEHIND)))
    return tuple(sorted(sections, key=lambda section: section.after))


def _chunks(numbers: Numbers, anchors: int, chunk_size: int) -> tuple[int, ...]:
    """Draws the number of anchors of each chunk."""
    sizes: list[int] = []
    while sum(sizes) < anchors:
        sizes.append(numbers.integer(1, min(chunk_size, anchors - sum(sizes))))
    return tuple(sizes)


def _places(numbers: Numbers, anchors: int) -> NDArray[np.float16]:
    """Draws positions without an order, or some outside of a lattice."""
    if numbers.integer(0, 1):
        return positions(numbers, anchors)
    places = lattice(numbers, anchors)
    if anchors and numbers.integer(0, 1):
        places[numbers.integer(0, anchors - 1)] = places[numbers.integer(0, anchors - 1)]
    return places


def _position_forms(numbers: Numbers, made: Scene) -> tuple[int, ...]:
    """Draws the form of each chunk, which is sometimes raw although it could be packed."""
    forms = []
    for chunk, wanted in zip(made.chunks, numbers.integers(0, 3, len(made.chunks)).tolist(), strict=True):
        shift = None if made.position_model is None else made.position_model.cell_shift
        fits = shift is not None and chunk_codes(made.positions[chunk.start : chunk.stop], shift) is not None
        forms.append(int(fits and wanted > 0))
    return tuple(forms)


def unusual(seed: int) -> Scene:
    """Returns a scene in which everything that the format leaves open is drawn."""
    numbers = Numbers("unusual", seed)
    slices, layers = _widths(numbers, (1, 4), 5), (0, 2)
    channels, frequencies = (int(numbers.chosen([0, 1, 2, 3, most], 1)[0]) for most in (4, 10))
    d = Dimensions(
        numbers.integer(1, 5),
        slices,
        channels,
        frequencies,
        numbers.integer(2, 9) if channels else 0,
        _widths(numbers, layers, 9) if channels + frequencies else (),
        _widths(numbers, (1, 2), 6) if channels else (),
        _widths(numbers, layers, 7) if len(slices) > 1 else (),
        numbers.integer(1, 5),
    )
    anchors = numbers.integer(0, 40)
    where = _places(numbers, anchors)
    low = numbers.integers(-(1 << 18), (1 << 18) - 1, 3)
    base_step = tuple(
        float(np.ldexp(np.float32(numbers.integer(1 << 23, (1 << 24) - 1)), numbers.integer(-83, 36))) for _ in range(3)
    )
    network_weights = _weights(numbers, d)
    weight_scales = weight_forms = None
    if numbers.integer(0, 1):
        # A layer that can be packed is sometimes raw.
        weight_forms = np.where(numbers.integers(0, 4, len(layers_of(d))) == 0, 0, packable(network_weights)).astype(
            np.uint8
        )
        drawn_scales = numbers.integers(0, 200, len(weight_forms), 3)
        weight_scales = np.where(weight_forms[:, None] == 0, 0, drawn_scales).astype(np.uint8)
    model = None
    if numbers.integer(0, 1):
        model = replace(any_model(numbers), cell_shift=int(numbers.chosen([CELL_INDEX, 22, 21, 20, 7], 1)[0]))
    chunk_size = int(numbers.chosen([1, 2, 3, 5, 7, 11, 64, 65536], 1)[0])
    chunks = _chunks(numbers, anchors, chunk_size)
    minor = numbers.integer(0, 1) * numbers.integer(1, 65535)
    origin = tuple(numbers.integers(1 - (1 << 62), (1 << 62) - 1, 3).tolist())
    made = scene(
        "unusual",
        anchors,
        d,
        seed,
        chunk_size=chunk_size,
        chunk_anchors=chunks,
        lanes=Lanes(*numbers.chosen([0, 1, 2, 3, 5], 3).tolist()),
        base_step=base_step,
        grid=PositionGrid((origin[0], origin[1], origin[2]), numbers.integer(1, 65535), numbers.integer(-60, 60)),
        render=_render(numbers),
        frame=Frame(
            numbers.integers(1 - (1 << 20), (1 << 20) - 1, 3, 3) >> numbers.integers(0, 12, 3, 3),
            numbers.integers(1 - (1 << 61), (1 << 61) - 1, 3) >> numbers.integers(0, 40, 3),
            numbers.integers(0, 60, 3),
            low,
            np.minimum(low + numbers.integers(1, 1 << 19, 3), 1 << 18),
        )
        if d.has_frame
        else None,
        plane_shift=numbers.integer(0, 10) if channels else 0,
        carm_shift=numbers.integers(0, 16, d.carm_inputs).astype(np.uint8) >> numbers.integer(0, 3),
        networks=network_weights,
        planes=_symbols(numbers, PLANE_SYMBOL_MAX, 5, d.plane_channels, d.plane_size, d.plane_size).astype(np.int16),
        mask_model=numbers.integers(1, (1 << 14) - 1, mask_contexts(d.offset_count)).astype(np.uint16),
        positions=where,
        position_model=model,
        weight_scales=weight_scales,
        weight_forms=weight_forms,
        ancillary=_ancillary(numbers),
        minor=minor,
        later=numbers.bytes(4 * numbers.integer(0, 3)) if minor else b"",
    )
    made = replace(made, position_forms=_position_forms(numbers, made))
    if seed % 2:
        return sampled(made, Sampler(numbers, 20), planes=numbers.integer(0, 1) == 1)
    return drawn_symbols(made, partial(_symbols, numbers, ATTRIBUTE_SYMBOL_MAX))


# fmt: off
_TRAINED = "D7.2-1 D7.2-2 D7.3-1 D7.5-1 D7.6-1 D7.9-1 D7.10-1 D9.1-1 D9.2-1"
CASES = [
    *valid("substream attributes", "", "D7.3-1 D7.6-1 D7.10-1 D8.2-1",
        ("worked-example", "the example of Annex D", stored, "tiny-example.c3gs")),
    *valid("substream attributes carm planes masks", "context-order carm-ignored stage-order",
        "D7.2-2 D7.3-1 D7.5-1 D7.6-1 D7.7-1 D7.9-1 D7.10-1 D8.2-1 D8.5-1",
        ("plain", "a small file of profile Tiny", drawn, "plain", 12)),
    *valid("trained main packed-positions packed-weights", "", _TRAINED,
        ("trained-caliterra", "a scene of 2,182 anchors learnt from aerial photographs, packed", _trained, "caliterra",
         More(seconds=120))),
    *valid("trained main raw-positions raw-weights", "", _TRAINED,
        ("trained-snowmiku", "a scene of 3,866 anchors learnt from photographs of a doll, raw", _trained, "snowmiku",
         More(seconds=120, licence="MIT"))),
    *valid("unusual", "", "D7.2-2 D7.3-1 D7.5-1 D7.6-1 D7.9-1 D7.10-1 D8.5-1 D8.6-1 D9.1-1 D9.2-1", *(
        (f"unusual-{seed}", "anything that the format allows", unusual, seed, More(seed=seed)) for seed in range(16))),
]
