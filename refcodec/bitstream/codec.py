"""Clauses 7.1 and 10.1: the order in which a file is decoded and checked, and in which it is made.

`parse` decodes a file and `emit` makes one. The modules of the other clauses do the steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from .attributes import Attributes, EntropyModel, code_attributes, join_attributes, step_indices
from .batches import GROUP_ANCHORS, Live, PartDecoder, Progress, each_group, no_progress, settle
from .chunks import chunk_ranges, emit_entry, entries_start, parse_entries
from .context import context
from .dimensions import mask_contexts
from .directory import CHUNK_TABLE, CHUNKED, FRAME, PLANES_SECTION, POSITIONS, WEIGHTS, parse_directory
from .entropy import Encoder, Trace
from .errors import BitstreamError
from .frame import emit_frame, parse_frame
from .header import PROLOGUE_BYTES, Header, emit_file, parse_header, parse_prologue
from .limits import PROFILES, minimal_level
from .masks import code_masks, mask_models, parse_mask_model
from .networks import BoundError, derive_networks
from .planes import assemble_planes, emit_planes, parse_planes
from .positions import emit_position_model, encode_positions, first_bad, parse_position_model, parse_positions
from .scene import Scene, check_shapes, take_anchors
from .weights import bound_error, emit_weights, parse_weights


@dataclass(frozen=True, eq=False)
class Parsed:
    """A parsed file. damage: the first error of each dropped chunk, by number. Only keep_going drops chunks."""

    scene: Scene
    damage: dict[int, BitstreamError]


def parse_container(data: bytes, keep_going: bool = False) -> Header:
    """SPEC 10.1, steps 1 to 3: checks the prologue, the header, the directory and the CRC-32s of the sections.

    keep_going: as in parse_directory. Raises BitstreamError 101 to 307.
    """
    header_length = parse_prologue(data)
    header, struct = parse_header(data, header_length)
    end = PROLOGUE_BYTES + header_length
    sections = parse_directory(struct, header.dimensions, header.chunk_count, data, end, keep_going)
    return replace(header, sections=sections)


def parse(
    data: bytes, *, keep_going: bool = False, progress: Progress = no_progress, trace: Trace | None = None
) -> Parsed:
    """SPEC 2.1, 7.1 and 10.1: decodes a file. Raises BitstreamError and nothing else, whatever the bytes are.

    keep_going: a chunk with an error is dropped and listed in damage. progress: told of the work. trace: told of each
    symbol.
    """
    with threadpool_limits(1, "blas"):
        return _parse(bytes(data), keep_going, progress, trace)


def _parse(data: bytes, keep_going: bool, progress: Progress, trace: Trace | None) -> Parsed:
    # SPEC 10.1, steps 1 to 3.
    header = parse_container(data, keep_going)
    sections, d, chunks, lanes = header.sections, header.dimensions, header.chunks, header.lanes
    # Step 4: the frame, then the weights.
    frame = parse_frame(data, sections[FRAME].start)
    section = sections[WEIGHTS]
    weights = parse_weights(data, section.start, section.end, section.mode, d, 1 << lanes.attribute, trace)
    try:
        networks = derive_networks(weights.networks)
    except BoundError as error:
        raise bound_error(weights, d, error) from None
    # Step 5: the planes.
    section = sections[PLANES_SECTION]
    progress("planes", 0, 1)
    planes = parse_planes(data, section.start, section.end, d, 1 << lanes.plane, networks["sarm"], trace)
    progress("planes", 1, 1)
    # Step 6: the chunk table.
    table, mode = sections[CHUNK_TABLE].start, sections[POSITIONS].mode
    mask_model = parse_mask_model(data, table, d.offset_count)
    position_model = parse_position_model(data, table + 2 * mask_contexts(d.offset_count)) if mode else None
    spans = {sections[kind].name: (sections[kind].start, sections[kind].end) for kind in CHUNKED}
    parts = parse_entries(data, table + entries_start(d.offset_count, mode), chunks, spans, mode)
    # Steps 7 to 9: the positions of all chunks, then their masks, then their attributes.
    damage: dict[int, BitstreamError] | None = {} if keep_going else None
    live = Live(list(range(len(chunks))), chunks)

    def position_group(group: list[int], rows: slice) -> tuple[NDArray[np.float16], dict[int, BitstreamError]]:
        ranges = live.ranges(group)
        return parse_positions(data, parts["positions"], group, ranges, position_model, 1 << lanes.mask, trace)

    found = settle(each_group(position_group, live, "positions", progress), damage)
    positions = np.concatenate([np.zeros((0, 3), np.float16), *found])
    live, _ = live.without(damage)
    models = mask_models(mask_model)

    def mask_group(group: list[int], rows: slice) -> tuple[NDArray[np.bool_], dict[int, BitstreamError]]:
        part = PartDecoder(data, parts["masks"], 1 << lanes.mask, group, trace)
        masks = code_masks(part.decoder, models, d.offset_count, live.ranges(group))
        return masks, part.verdicts()

    bits = settle(each_group(mask_group, live, "masks", progress), damage)
    masks = np.concatenate([np.zeros((0, d.offset_count), bool), *bits])
    live, kept = live.without(damage)
    positions, masks = positions[kept], masks[kept]
    model = EntropyModel.of(networks, weights.carm_shift, d.slices)
    joined = assemble_planes(planes)

    def attribute_group(group: list[int], rows: slice) -> tuple[Attributes, dict[int, BitstreamError]]:
        contexts = context(frame, joined, weights.plane_shift, d.frequency_count, positions[rows])
        part = PartDecoder(data, parts["attributes"], 1 << lanes.attribute, group, trace)
        attributes = code_attributes(part.decoder, model, contexts, masks[rows], live.ranges(group))
        return attributes, part.verdicts()

    attributes = join_attributes(settle(each_group(attribute_group, live, "attributes", progress), damage), d)
    _, kept = live.without(damage)
    # SPEC 12.1: ancillary sections are kept as they are. One that the file cuts off is dropped.
    ancillary = (s for s in sections.values() if s.type < FRAME and s.end <= len(data))
    scene = Scene(
        header.profile,
        d,
        header.chunk_size,
        lanes,
        header.base_step,
        header.grid,
        header.render,
        frame,
        weights.plane_shift,
        weights.carm_shift,
        weights.networks,
        planes,
        mask_model,
        positions,
        masks,
        attributes,
        tuple((s.type, s.mode, data[s.start : s.end]) for s in ancillary),
        position_model,
        weights.scales,
    )
    return Parsed(scene if kept.all() else take_anchors(scene, kept), damage or {})


class Coding:
    """What the symbols of a scene are coded with: SARM, the model of attributes, and the contexts of anchors."""

    def __init__(self, scene: Scene, exact_float: bool | None = None, block_rows: int | None = None) -> None:
        """exact_float, block_rows: as in IntNetwork. Raises BoundError."""
        networks = derive_networks(scene.networks, exact_float, block_rows)
        self.sarm = networks["sarm"]
        self.model = EntropyModel.of(networks, scene.carm_shift, scene.dimensions.slices)
        self._scene, self._planes = scene, assemble_planes(scene.planes)

    def contexts(self, rows: slice | NDArray = slice(None)) -> NDArray[np.int16]:
        """SPEC 7.5: returns the contexts of some anchors, int16 [n, inputs of F_h]."""
        s = self._scene
        return context(s.frame, self._planes, s.plane_shift, s.dimensions.frequency_count, s.positions[rows])


def emit(scene: Scene, *, progress: Progress = no_progress) -> bytes:
    """Returns the file of a scene. For each file b that is accepted, emit(parse(b).scene) == b (SPEC 4.3).

    Raises ValueError if the scene breaks a rule of SPEC.md. Its text is the error that a decoder would report.
    """
    check_shapes(scene)
    try:
        with threadpool_limits(1, "blas"):
            return _emit(scene, progress)
    except BitstreamError as error:
        raise ValueError(f"the scene cannot be written: {error}") from None


def _emit(scene: Scene, progress: Progress) -> bytes:
    d, lanes = scene.dimensions, scene.lanes
    modes = {WEIGHTS: int(scene.weight_scales is not None), POSITIONS: int(scene.position_model is not None)}
    # A scene that cannot be written is refused before any symbol is coded, as far as the decoder's checks allow it.
    frame = emit_frame(scene.frame)
    parse_frame(frame, 0)
    weights = emit_weights(
        scene.plane_shift, scene.carm_shift, scene.networks, scene.weight_scales, d, 1 << lanes.attribute
    )
    parse_weights(weights, 0, len(weights), modes[WEIGHTS], d, 1 << lanes.attribute)
    bad = first_bad(scene.positions.view(np.uint16).reshape(-1))
    if bad is not None:
        name, first = bad
        path, found = f"positions[{first // 3},{first % 3}]", scene.positions.reshape(-1)[first]
        raise BitstreamError(name, 0, path, found, "finite numbers but -0")
    position_model = b""
    if scene.position_model is not None:
        position_model = emit_position_model(scene.position_model)
        parse_position_model(position_model, 0)
    coding = Coding(scene)
    progress("planes", 0, 1)
    planes = emit_planes(scene.planes, coding.sarm, 1 << lanes.plane)
    progress("planes", 1, 1)
    chunks = chunk_ranges(scene.anchor_count, scene.chunk_size)
    coded = _emit_chunks(scene, coding, chunks, progress)
    table = scene.mask_model.astype("<u2").tobytes() + position_model + b"".join(map(emit_entry, coded))
    sections = [
        (FRAME, 0, frame),
        (WEIGHTS, modes[WEIGHTS], weights),
        (PLANES_SECTION, 0, planes),
        (CHUNK_TABLE, 0, table),
        *((kind, modes.get(kind, 0), b"".join(part[i] for part in coded)) for i, kind in enumerate(CHUNKED)),
        *scene.extensions,
    ]
    level = minimal_level(PROFILES[scene.profile], scene.anchor_count, d.plane_size)
    header = Header(
        scene.profile,
        0 if level is None else level,
        scene.anchor_count,
        scene.chunk_size,
        lanes,
        d,
        scene.base_step,
        scene.grid,
        scene.render,
        {},
    )
    data = emit_file(header, sections)
    # The header and the chunk table exist only now. The decoder's own checks say whether they are allowed.
    made = parse_container(data).sections
    parse_mask_model(data, made[CHUNK_TABLE].start, d.offset_count)
    spans = {made[kind].name: (made[kind].start, made[kind].end) for kind in CHUNKED}
    at = made[CHUNK_TABLE].start + entries_start(d.offset_count, modes[POSITIONS])
    parse_entries(data, at, chunks, spans, modes[POSITIONS])
    return data


def _emit_chunks(
    scene: Scene, coding: Coding, chunks: list[range], progress: Progress
) -> list[tuple[bytes, bytes, bytes]]:
    """Returns the three parts of each chunk, in the order of chunks.PARTS."""
    d, a, lanes = scene.dimensions, scene.attributes, scene.lanes
    models, live = mask_models(scene.mask_model), Live(list(range(len(chunks))), chunks)

    def encode_group(group: list[int], rows: slice) -> list[tuple[bytes, bytes, bytes]]:
        ranges = live.ranges(group)
        positions = encode_positions(scene.position_model, scene.positions[rows], ranges, 1 << lanes.mask)
        masks = Encoder(len(group), 1 << lanes.mask)
        code_masks(masks, models, d.offset_count, ranges, scene.masks[rows])
        given = Attributes(a.features[rows], a.scalings[rows], a.offsets[rows], a.steps[rows])
        attributes = Encoder(len(group), 1 << lanes.attribute)
        coded = code_attributes(attributes, coding.model, coding.contexts(rows), scene.masks[rows], ranges, given)
        if not np.array_equal(coded.steps, given.steps):
            raise ValueError("the scene's step indices are not those that its networks give (SPEC.md 7.8)")
        return list(zip(positions, masks.finish(), attributes.finish(), strict=True))

    return [chunk for group in each_group(encode_group, live, "chunks", progress) for chunk in group]


def derive_steps(scene: Scene) -> NDArray[np.uint8]:
    """SPEC 7.8: returns the step indices of all anchors, uint8 [N, 3]. The attributes of the scene are not read."""
    coding = Coding(scene)
    steps = [np.zeros((0, 3), np.uint8)]
    for group in chunk_ranges(scene.anchor_count, GROUP_ANCHORS):
        contexts = coding.contexts(slice(group.start, group.stop))
        steps.append(step_indices(coding.model.hyper(contexts).astype(np.int64)))
    return np.concatenate(steps)
