"""The decoding process as a whole (SPEC.md 7.1), and its inverse: parse(bytes) -> Scene, emit(Scene) -> bytes."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from . import syntax
from .attributes import Attributes, EntropyModel, code_attributes, step_indices
from .container import (
    ANCHORS_OF_A_BYTE,
    ATTRIBUTES,
    CHUNK_TABLE,
    FRAME,
    MASKS,
    PLANES_SECTION,
    POSITION_BYTES,
    POSITIONS,
    WEIGHTS,
    Header,
    chunk_ranges,
    emit_container,
    entries_start,
    parse_container,
)
from .conventions import Int64
from .entropy import STATE_MIN, Decoder, Encoder, Substream, TraceRow, parse_substream
from .errors import BitstreamError
from .geometry import Frame, assemble_planes, context
from .masks import code_masks, context_count, mask_models
from .networks import BoundError, IntNetwork, Layer, derive_layer
from .planes import PLANE_NAMES, PLANES, code_planes
from .positions import (
    CELL_INDEX,
    F16,
    HALVES,
    PACKED,
    POSITION_MODELS,
    RAW,
    PositionModel,
    chunk_codes,
    code_cells,
    decode_cells,
    encode_positions,
    first_bad,
)
from .scene import Dimensions, Scene
from .tables import TOTAL
from .weights import ParsedWeights, emit_weights, layers_of, parse_weights

# SPEC 6.7
MATRIX_BOUND = 1 << 20
TRANSLATION_BOUND = 1 << 61
FRAME_SHIFT_MAX = 60
FRAME_RANGE_BOUND = 1 << 18
# Anchors and chunks decoded side by side: bounds of memory, without effect on the result.
GROUP_ANCHORS = 65536
GROUP_CHUNKS = 1024

Progress = Callable[[str, int, int], None]
Trace = Callable[[TraceRow], None]
T = TypeVar("T")


def _no_progress(stage: str, done: int, total: int) -> None:
    pass


@dataclass(frozen=True)
class Networks:
    """The integer side of the weights (SPEC 7.2), ready to run."""

    sarm: IntNetwork
    entropy: EntropyModel

    def contexts(self, scene: Scene | Header, frame: Frame, planes: tuple[Int64, Int64], shift: int, at: NDArray) -> NDArray:
        """SPEC 7.5 for the positions `at`."""
        return context(frame, planes, shift, scene.dimensions.frequency_count, at)


@dataclass(frozen=True, eq=False)
class Parsed:
    """A parsed file. damage: for each chunk that was dropped, its number and its first error (keep_going only)."""

    scene: Scene
    damage: dict[int, BitstreamError]


# --- sections ---------------------------------------------------------------------------------------------------------


def parse_frame(data: bytes, start: int) -> Frame:
    """SPEC 5.7 and 6.7. Raises BitstreamError frame.range."""
    f, _ = syntax.parse("Frame", data, start)

    def bad(name: str, found: object, allowed: object) -> BitstreamError:
        for element in syntax.parse_elements("Frame", data, start, "frame"):
            if element.path == f"frame.{name}":
                return BitstreamError("frame.range", element.start, element.path, found, allowed)
        raise AssertionError(name)

    for name, low, high in (
        ("matrix", 1 - MATRIX_BOUND, MATRIX_BOUND - 1),
        ("translation", 1 - TRANSLATION_BOUND, TRANSLATION_BOUND - 1),
        ("shift", 0, FRAME_SHIFT_MAX),
    ):
        for i, value in enumerate(f[name]):
            if not low <= value <= high:
                raise bad(f"{name}[{i}]", value, f"{low} to {high}")
    if f.reserved:
        raise bad("reserved", f.reserved, 0)
    for i, (low, high) in enumerate(zip(f.low, f.high, strict=True)):
        if not -FRAME_RANGE_BOUND <= low < FRAME_RANGE_BOUND:
            raise bad(f"low[{i}]", low, f"{-FRAME_RANGE_BOUND} to {FRAME_RANGE_BOUND - 1}")
        if not low < high <= FRAME_RANGE_BOUND:
            raise bad(f"high[{i}]", high, f"{low + 1} to {FRAME_RANGE_BOUND}")

    def array(values: list[int]) -> Int64:
        return np.array(values, dtype=np.int64)

    return Frame(array(f.matrix).reshape(3, 3), array(f.translation), array(f.shift), array(f.low), array(f.high))


def emit_frame(frame: Frame) -> bytes:
    """SPEC 5.7."""
    fields = {name: getattr(frame, name).reshape(-1).tolist() for name in ("matrix", "translation", "shift", "low", "high")}
    return syntax.build("Frame", {**fields, "reserved": 0})


def derive_networks(
    d: Dimensions,
    carm_shift: NDArray[np.uint8],
    networks: dict[str, list[Layer]],
    exact_float: bool | None = None,
    block: int | None = None,
) -> Networks:
    """SPEC 7.2 for F_h, SARM and CARM. Raises BoundError, which names the layer."""

    def derive(name: str) -> IntNetwork:
        layers = []
        for index, layer in enumerate(networks[name]):
            try:
                layers.append(derive_layer(*layer))
            except BoundError as error:
                raise BoundError(error.row, f"{name}.{index}") from None
        return IntNetwork(layers, exact_float, block)

    hyper, sarm = derive("hyper"), derive("sarm")
    carm = [derive(f"carm.{i}") for i in range(1, len(d.slices))]
    return Networks(sarm, EntropyModel(hyper, carm, carm_shift.astype(np.int64), d.slices))


def _checked_networks(header: Header, weights: ParsedWeights) -> Networks:
    """derive_networks, with a broken bound as BitstreamError weights.bound at the row's first weight, or at the layer's model."""
    try:
        return derive_networks(header.dimensions, weights.carm_shift, weights.networks)
    except BoundError as error:
        at = weights.starts[error.layer]
        if weights.scales is None:
            fan_in = next(fan_in for name, _, fan_in in layers_of(header.dimensions) if name == error.layer)
            at += 4 * fan_in * error.row
        raise BitstreamError("weights.bound", at, f"weights.{error.layer}", error.found, error.allowed) from None


def _parse_planes(data: bytes, header: Header, sarm: IntNetwork, trace: Trace | None) -> NDArray[np.int16]:
    """SPEC 5.9, 6.9 and 7.3. Raises the error of the first substream that has one."""
    section = header.sections[PLANES_SECTION]
    try:
        table, size = syntax.parse("PlaneTable", data[: section.end], section.start)
    except syntax.cs.ConstructError:
        raise BitstreamError(
            "planes.length", section.start, "planes", f"{section.end - section.start} bytes", "at least the table's 20"
        ) from None
    if size + sum(table.length) != section.end - section.start:
        found = f"a table that announces {size + sum(table.length)} bytes"
        raise BitstreamError("planes.length", section.start, "planes.length", found, section.end - section.start)
    bounds = section.start + size + np.concatenate([[0], np.cumsum(table.length, dtype=np.int64)])
    lanes = 1 << header.lanes.plane
    streams, errors = [], []
    for i in range(PLANES):
        stream, error = _substream(data, int(bounds[i]), int(bounds[i + 1]), lanes, f"planes.{PLANE_NAMES[i]}")
        streams.append(stream)
        errors.append(error)
    decoder = Decoder(streams, trace)
    d = header.dimensions
    planes = code_planes(decoder, sarm, d.plane_channels, d.plane_size)
    for parse_error, verdict in zip(errors, decoder.finish(), strict=True):
        if parse_error or verdict:
            raise parse_error or verdict  # type: ignore[misc]
    return planes


def _substream(data: bytes, start: int, end: int, lanes: int, path: str) -> tuple[Substream, BitstreamError | None]:
    """A substream, or an empty one and the error, so that its neighbours can still be decoded."""
    try:
        return parse_substream(data, start, end, lanes, path), None
    except BitstreamError as error:
        empty = np.empty(0, dtype=np.uint16)
        return Substream(0, np.full(lanes, STATE_MIN, dtype=np.uint32), empty, b"", start, path), error


# --- chunks -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """One of the three parts of each chunk: bounds int64 [chunks + 1] in the file, crc int64 [chunks]."""

    name: str
    bounds: Int64
    crc: Int64

    def check(self, data: bytes, chunk: int) -> BitstreamError | None:
        """SPEC 6.10: the CRC-32 of one chunk's part."""
        start, end = int(self.bounds[chunk]), int(self.bounds[chunk + 1])
        crc = zlib.crc32(memoryview(data)[start:end])
        if end <= len(data) and crc == self.crc[chunk]:
            return None
        return BitstreamError(
            "chunks.crc", min(start, len(data)), f"{self.name}[chunk {chunk}]", f"0x{int(self.crc[chunk]):08x}", f"0x{crc:08x}"
        )


def _parse_position_model(data: bytes, start: int) -> PositionModel:
    """SPEC 5.15 and 6.10. Raises BitstreamError chunks.position_model."""
    fields, _ = syntax.parse("PositionModel", data, start)
    model = PositionModel(fields.cell_shift, np.array(fields.frequency, dtype=np.uint16).reshape(POSITION_MODELS, HALVES))
    fault = model.fault()
    if fault is not None:
        at, path, found = start, "cell_shift", str(model.cell_shift)
        if fault >= 0:
            at, path = start + 1 + 2 * HALVES * fault, f"frequency[{HALVES * fault}]"
            found = f"frequencies {model.frequency[fault].tolist()}"
        raise BitstreamError("chunks.position_model", at, f"chunk_table.position_model.{path}", found, "what 6.10 says")
    return model


def _parse_chunk_table(data: bytes, header: Header) -> tuple[NDArray[np.uint16], PositionModel | None, dict[int, _Part]]:
    """SPEC 5.10 and 6.10. Raises BitstreamError 431, 432 or 434."""
    section = header.sections[CHUNK_TABLE]
    contexts = context_count(header.dimensions.offset_count)
    model = np.frombuffer(data, "<u2", contexts, section.start).astype(np.uint16)
    bad = np.flatnonzero((model < 1) | (model >= TOTAL))
    if bad.size:
        at, path = section.start + 2 * int(bad[0]), f"chunk_table.mask_model[{bad[0]}]"
        raise BitstreamError("chunks.mask_model", at, path, model[bad[0]], f"1 to {TOTAL - 1}")
    chunks = header.chunks
    mode = header.sections[POSITIONS].mode
    position_model = _parse_position_model(data, section.start + 2 * contexts) if mode else None
    at = section.start + entries_start(header.dimensions.offset_count, mode)
    table = np.frombuffer(data, "<u4", 6 * len(chunks), at).astype(np.int64).reshape(-1, 6)
    parts = {}
    for column, kind in enumerate((POSITIONS, MASKS, ATTRIBUTES)):
        part = header.sections[kind]
        length = table[:, 2 * column]
        if kind == POSITIONS:
            anchors = np.array([len(c) for c in chunks], dtype=np.int64)
            wrong = np.flatnonzero(length * ANCHORS_OF_A_BYTE < anchors if mode else length != POSITION_BYTES * anchors)
            if wrong.size:
                chunk = int(wrong[0])
                right = f"at least a sixteenth of {anchors[chunk]}" if mode else str(POSITION_BYTES * anchors[chunk])
                path = f"chunk_table.entry[{chunk}].position_length"
                raise BitstreamError("chunks.length", at + 24 * chunk, path, length[chunk], right)
        if length.sum() != part.end - part.start:
            found = f"a chunk table that announces {int(length.sum())} bytes"
            raise BitstreamError("chunks.length", part.start, part.name, found, part.end - part.start)
        parts[kind] = _Part(part.name, part.start + np.concatenate([[0], np.cumsum(length)]), table[:, 2 * column + 1])
    return model, position_model, parts


@dataclass(frozen=True)
class _Live:
    """The chunks that no error has taken yet. Arrays of anchors hold those of these chunks alone, in order: what a damaged file
    only claims to have costs nothing (SPEC 13.1)."""

    numbers: list[int]
    chunks: list[range]

    def groups(self) -> Iterator[tuple[list[int], slice]]:
        """Runs of chunks that are coded side by side, and the rows of their anchors."""
        group: list[int] = []
        first = row = 0
        for number in self.numbers:
            size = len(self.chunks[number])
            if group and (row + size - first > GROUP_ANCHORS or len(group) == GROUP_CHUNKS):
                yield group, slice(first, row)
                group, first = [], row
            group.append(number)
            row += size
        if group:
            yield group, slice(first, row)

    def ranges(self, group: list[int]) -> list[range]:
        """The anchors of some chunks, by their numbers in the file."""
        return [self.chunks[number] for number in group]

    def without(self, damage: Mapping[int, BitstreamError] | None) -> tuple[_Live, NDArray[np.bool_]]:
        """What is left, and which rows that are."""
        lost = damage or {}
        keep = [number not in lost for number in self.numbers]
        rows = np.repeat(np.array(keep, dtype=bool), [len(self.chunks[number]) for number in self.numbers])
        return _Live([number for number, kept in zip(self.numbers, keep, strict=True) if kept], self.chunks), rows


def _map_groups(work: Callable[[list[int], slice], T], live: _Live, threads: int, stage: str, progress: Progress) -> list[T]:
    """work on each group, results in order; the first group's error wins whatever the threads do."""
    groups = list(live.groups())
    done: list[T] = []
    progress(stage, 0, len(groups))
    with ThreadPoolExecutor(max(1, threads)) as pool:
        try:
            for result in (pool.map if threads > 1 else map)(work, *zip(*groups, strict=True)) if groups else ():
                done.append(result)
                progress(stage, len(done), len(groups))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return done


def _raw_positions(data: bytes, start: int, chunk: range) -> F16 | BitstreamError:
    """SPEC 6.11: a chunk's fp16 numbers, or what is wrong with the first that is not allowed."""
    bits = np.frombuffer(data, "<u2", 3 * len(chunk), start).astype(np.uint16)
    bad = first_bad(bits)
    if bad is None:
        return bits.view(np.float16).reshape(-1, 3)
    name, first = bad
    anchor, axis = chunk.start + first // 3, first % 3
    return BitstreamError(name, start + 2 * first, f"positions[{anchor},{axis}]", f"0x{bits[first]:04x}", "finite numbers but -0")


def _formed_positions(data: bytes, part: _Part, number: int, chunk: range, model: PositionModel) -> F16 | BitstreamError | None:
    """SPEC 6.11, mode 1: a raw chunk's positions, or an error; None for a packed chunk, whose substream is still to be decoded."""
    start, end = int(part.bounds[number]), int(part.bounds[number + 1])
    path = f"positions[chunk {number}]"
    form = data[start] if end > start else None
    if form == PACKED:
        return None
    if form != RAW or end - start != 1 + POSITION_BYTES * len(chunk):
        allowed = f"form {RAW} with {1 + POSITION_BYTES * len(chunk)} bytes, or form {PACKED}"
        return BitstreamError("positions.form", start, path, f"form {form} with {end - start} bytes", allowed)
    found = _raw_positions(data, start + 1, chunk)
    if not isinstance(found, BitstreamError) and chunk_codes(found, model.cell_shift) is not None:
        return BitstreamError("positions.raw", start, path, f"form {RAW}", f"form {PACKED}: the chunk can be packed")
    return found


def _packed_positions(
    data: bytes, part: _Part, numbers: list[int], chunks: list[range], model: PositionModel, lanes: int, trace: Trace | None
) -> list[F16 | BitstreamError]:
    """SPEC 7.12: the positions of packed chunks, or the error of each."""
    streams, errors = [], []
    for number in numbers:
        start, end = int(part.bounds[number]) + 1, int(part.bounds[number + 1])
        stream, error = _substream(data, start, end, lanes, f"positions[chunk {number}]")
        streams.append(stream)
        errors.append(error)
    decoder = Decoder(streams, trace)
    code, held = code_cells(decoder, model.models(), numbers, [len(c) for c in chunks])
    rows = np.minimum(held, [len(c) for c in chunks])
    found: list[F16 | BitstreamError] = []
    for i, (before, after, first) in enumerate(zip(errors, decoder.finish(), np.cumsum(rows) - rows, strict=True)):
        at, path = int(part.bounds[numbers[i]]), f"positions[chunk {numbers[i]}]"
        error = before or after
        if error is None and held[i] != len(chunks[i]):
            cells = f"{held[i]} cells" if held[i] < len(chunks[i]) else "more cells"
            error = BitstreamError("positions.count", at, path, cells, f"{len(chunks[i])}, one for each anchor")
        positions, fits = decode_cells(code[first : first + rows[i]], model.cell_shift)
        if error is None and not fits.all():
            anchor = chunks[i].start + int(np.argmin(fits))
            error = BitstreamError("positions.cell", at, path, f"a cell of anchor {anchor} that no fp16 holds", "cells that fp16 holds")
        found.append(error or positions)
    return found


def _parse_positions(
    data: bytes,
    header: Header,
    part: _Part,
    model: PositionModel | None,
    live: _Live,
    damage: dict[int, BitstreamError] | None,
    trace: Trace | None,
) -> F16:
    """SPEC 6.11 and 7.12: chunk by chunk. With `damage`, errors go there and the chunk's anchors are left out."""
    found = [np.zeros((0, 3), dtype=np.float16)]
    for group, _ in live.groups():
        result: dict[int, F16 | BitstreamError | None] = {}
        for number in group:
            error = part.check(data, number)
            chunk, start = live.chunks[number], int(part.bounds[number])
            if error is not None:
                result[number] = error
            elif model is None:
                result[number] = _raw_positions(data, start, chunk)
            else:
                result[number] = _formed_positions(data, part, number, chunk, model)
        packed = [number for number in group if result[number] is None]
        if packed and model is not None:
            chunks = live.ranges(packed)
            result |= zip(packed, _packed_positions(data, part, packed, chunks, model, 1 << header.lanes.mask, trace), strict=True)
        for number, value in result.items():
            if not isinstance(value, BitstreamError):
                assert value is not None
                found.append(value)
            elif damage is None:
                raise value
            else:
                damage[number] = value
    return np.concatenate(found)


class _ChunkDecoder:
    """Decodes one part of a group of chunks, and merges the errors of each chunk into one verdict."""

    def __init__(self, data: bytes, part: _Part, lanes: int, group: list[int], trace: Trace | None) -> None:
        self.part, self.group = part, group
        self.errors: list[BitstreamError | None] = []
        streams = []
        for number in group:
            start, end = int(part.bounds[number]), int(part.bounds[number + 1])
            error = part.check(data, number)
            if error is not None:
                start = end = min(start, len(data))
            stream, syntax_error = _substream(data, start, end, lanes, f"{part.name}[chunk {number}]")
            self.errors.append(error or syntax_error)
            streams.append(stream)
        self.decoder = Decoder(streams, trace)

    def verdicts(self) -> dict[int, BitstreamError]:
        """The first error of each chunk that has one, by chunk."""
        found = {}
        for number, before, after in zip(self.group, self.errors, self.decoder.finish(), strict=True):
            error = before or after
            if error is not None:
                found[number] = error
        return found


def _settle(results: list[tuple[T, dict[int, BitstreamError]]], damage: dict[int, BitstreamError] | None) -> list[T]:
    """Raises the error of the lowest chunk, or notes all of them."""
    for _, errors in results:
        for number, error in errors.items():
            if damage is None:
                raise error
            damage.setdefault(number, error)
    return [value for value, _ in results]


# --- the whole --------------------------------------------------------------------------------------------------------


def parse(
    data: bytes, *, keep_going: bool = False, threads: int = 1, progress: Progress = _no_progress, trace: Trace | None = None
) -> Parsed:
    """Decodes a file, SPEC 2.1, 7.1 and 10.1. Raises BitstreamError and nothing else for whatever bytes.

    keep_going: chunks with errors are dropped and listed instead. threads: chunk groups decoded at once (1 with trace).
    """
    with threadpool_limits(1, "blas"):
        return _parse(bytes(data), keep_going, 1 if trace else threads, progress, trace)


def _parse(data: bytes, keep_going: bool, threads: int, progress: Progress, trace: Trace | None) -> Parsed:
    header = parse_container(data, keep_going)
    sections, d, chunks = header.sections, header.dimensions, header.chunks
    frame = parse_frame(data, sections[FRAME].start)
    section = sections[WEIGHTS]
    weights = parse_weights(data, section.start, section.end, section.mode, d, 1 << header.lanes.attribute, trace)
    networks = _checked_networks(header, weights)
    progress("planes", 0, 1)
    planes = _parse_planes(data, header, networks.sarm, trace)
    progress("planes", 1, 1)
    mask_frequencies, position_model, parts = _parse_chunk_table(data, header)
    damage: dict[int, BitstreamError] | None = {} if keep_going else None
    live = _Live(list(range(len(chunks))), chunks)
    positions = _parse_positions(data, header, parts[POSITIONS], position_model, live, damage, trace)
    live, _ = live.without(damage)
    models = mask_models(mask_frequencies)

    def mask_group(group: list[int], rows: slice) -> tuple[NDArray[np.bool_], dict[int, BitstreamError]]:
        decoder = _ChunkDecoder(data, parts[MASKS], 1 << header.lanes.mask, group, trace)
        masks = code_masks(decoder.decoder, models, d.offset_count, live.ranges(group))
        return masks, decoder.verdicts()

    masks = np.zeros((0, d.offset_count), dtype=bool)
    masks = np.concatenate([masks, *_settle(_map_groups(mask_group, live, threads, "masks", progress), damage)])
    live, kept = live.without(damage)
    positions, masks = positions[kept], masks[kept]
    full = assemble_planes(planes)

    def attribute_group(group: list[int], rows: slice) -> tuple[Attributes, dict[int, BitstreamError]]:
        contexts = networks.contexts(header, frame, full, weights.plane_shift, positions[rows])
        decoder = _ChunkDecoder(data, parts[ATTRIBUTES], 1 << header.lanes.attribute, group, trace)
        attributes = code_attributes(decoder.decoder, networks.entropy, contexts, masks[rows], live.ranges(group))
        return attributes, decoder.verdicts()

    attributes = _join(_settle(_map_groups(attribute_group, live, threads, "attributes", progress), damage), d)
    _, kept = live.without(damage)
    scene = Scene(
        header.profile,
        d,
        header.chunk_size,
        header.lanes,
        header.base_step,
        header.grid,
        header.render,
        frame,
        weights.plane_shift,
        weights.carm_shift,
        weights.networks,
        planes,
        mask_frequencies,
        positions,
        masks,
        attributes,
        tuple((s.type, s.mode, data[s.start : s.end]) for s in sections.values() if s.type < FRAME and s.end <= len(data)),
        position_model,
        weights.scales,
    )
    return Parsed(scene if kept.all() else take_anchors(scene, kept), damage or {})


def _join(parts: list[Attributes], d: Dimensions) -> Attributes:
    """Attributes of all groups, in order."""
    empty = Attributes(
        np.zeros((0, d.features), np.int32),
        np.zeros((0, 6), np.int32),
        np.zeros((0, d.offset_count, 3), np.int32),
        np.zeros((0, 3), np.uint8),
    )
    return Attributes(*(np.concatenate([getattr(p, f) for p in [empty, *parts]]) for f in vars(empty)))


def take_anchors(scene: Scene, keep: NDArray) -> Scene:
    """The scene with the anchors that an index or a boolean array selects, in its order."""
    a = scene.attributes
    chosen = Attributes(a.features[keep], a.scalings[keep], a.offsets[keep], a.steps[keep])
    return replace(scene, positions=scene.positions[keep], masks=scene.masks[keep], attributes=chosen)


def emit(scene: Scene, *, threads: int = 1, progress: Progress = _no_progress) -> bytes:
    """The file of a scene: for each accepted file b, emit(parse(b).scene) == b (SPEC 4.3).

    Raises ValueError if the scene breaks a rule of SPEC.md, with the error that a decoder would report.
    """
    _check_shapes(scene)
    try:
        with threadpool_limits(1, "blas"):
            return _emit(scene, threads, progress)
    except BitstreamError as error:
        raise ValueError(f"the scene cannot be written: {error}") from None


def _emit(scene: Scene, threads: int, progress: Progress) -> bytes:
    d = scene.dimensions
    modes = {WEIGHTS: int(scene.weight_scales is not None), POSITIONS: int(scene.position_model is not None)}
    # What can be refused before any symbol is coded is refused here; the header follows once the sections' lengths are known.
    frame, lanes = emit_frame(scene.frame), 1 << scene.lanes.attribute
    parse_frame(frame, 0)
    weights = emit_weights(scene.plane_shift, scene.carm_shift, scene.networks, scene.weight_scales, d, lanes)
    parse_weights(weights, 0, len(weights), modes[WEIGHTS], d, lanes)
    bad = first_bad(scene.positions.view(np.uint16).reshape(-1))
    if bad is not None:
        raise BitstreamError(
            bad[0], 0, f"positions[{bad[1] // 3},{bad[1] % 3}]", scene.positions.reshape(-1)[bad[1]], "finite numbers but -0"
        )
    position_model = b""
    if scene.position_model is not None:
        m = scene.position_model
        position_model = syntax.build("PositionModel", {"cell_shift": m.cell_shift, "frequency": m.frequency.reshape(-1).tolist()})
        _parse_position_model(position_model, 0)
    chunks = chunk_ranges(scene.anchor_count, scene.chunk_size)
    networks = derive_networks(d, scene.carm_shift, scene.networks)
    progress("planes", 0, 1)
    plane_encoder = Encoder(PLANES, 1 << scene.lanes.plane)
    code_planes(plane_encoder, networks.sarm, d.plane_channels, d.plane_size, scene.planes)
    plane_streams = plane_encoder.finish()
    progress("planes", 1, 1)
    models = mask_models(scene.mask_model)
    full = assemble_planes(scene.planes)
    a = scene.attributes

    live = _Live(list(range(len(chunks))), chunks)

    def encode_group(group: list[int], anchors: slice) -> list[tuple[bytes, bytes, bytes]]:
        ranges = live.ranges(group)
        masks = Encoder(len(group), 1 << scene.lanes.mask)
        code_masks(masks, models, d.offset_count, ranges, scene.masks[anchors])
        contexts = networks.contexts(scene, scene.frame, full, scene.plane_shift, scene.positions[anchors])
        given = Attributes(a.features[anchors], a.scalings[anchors], a.offsets[anchors], a.steps[anchors])
        encoder = Encoder(len(group), 1 << scene.lanes.attribute)
        coded = code_attributes(encoder, networks.entropy, contexts, scene.masks[anchors], ranges, given)
        if not np.array_equal(coded.steps, given.steps):
            raise ValueError("the scene's step indices are not those that its networks give (SPEC.md 7.8)")
        positions = encode_positions(scene.position_model, scene.positions[anchors], ranges, 1 << scene.lanes.mask)
        return list(zip(positions, masks.finish(), encoder.finish(), strict=True))

    coded = [chunk for group in _map_groups(encode_group, live, threads, "chunks", progress) for chunk in group]
    table = scene.mask_model.astype("<u2").tobytes() + position_model
    for parts in coded:
        names = ("position", "mask", "attribute")
        entry = {f"{n}_length": len(p) for n, p in zip(names, parts, strict=True)}
        entry |= {f"{n}_crc": zlib.crc32(p) for n, p in zip(names, parts, strict=True)}
        table += syntax.build("ChunkEntry", entry)
    planes = syntax.build("PlaneTable", {"length": [len(s) for s in plane_streams]}) + b"".join(plane_streams)
    sections = [
        (FRAME, 0, frame),
        (WEIGHTS, modes[WEIGHTS], weights),
        (PLANES_SECTION, 0, planes),
        (CHUNK_TABLE, 0, table),
        *((kind, modes.get(kind, 0), b"".join(parts[i] for parts in coded)) for i, kind in enumerate((POSITIONS, MASKS, ATTRIBUTES))),
        *scene.extensions,
    ]
    data = emit_container(scene, sections)
    header = parse_container(data)
    _parse_chunk_table(data, header)
    return data


def _check_shapes(scene: Scene) -> None:
    """Raises ValueError for an array whose shape or dtype is not what Scene says."""
    d, n, a = scene.dimensions, scene.anchor_count, scene.attributes
    wanted: dict[str, tuple[NDArray, tuple[int, ...], type]] = {
        "planes": (scene.planes, (PLANES, d.plane_channels, d.plane_size, d.plane_size), np.int16),
        "carm_shift": (scene.carm_shift, (d.carm_inputs,), np.uint8),
        "mask_model": (scene.mask_model, (context_count(d.offset_count),), np.uint16),
        "positions": (scene.positions, (n, 3), np.float16),
        "masks": (scene.masks, (n, d.offset_count), np.bool_),
        "features": (a.features, (n, d.features), np.int32),
        "scalings": (a.scalings, (n, 6), np.int32),
        "offsets": (a.offsets, (n, d.offset_count, 3), np.int32),
        "steps": (a.steps, (n, 3), np.uint8),
    }
    if scene.weight_scales is not None:
        wanted["weight_scales"] = (scene.weight_scales, (len(layers_of(d)), 3), np.uint8)
    if scene.position_model is not None:
        wanted["position_model"] = (scene.position_model.frequency, (POSITION_MODELS, HALVES), np.uint16)
    if list(scene.networks) != list(d.network_shapes()):
        raise ValueError(f"networks are {list(scene.networks)}, the dimensions require {list(d.network_shapes())}")
    for name, shapes in d.network_shapes().items():
        if len(scene.networks[name]) != len(shapes):
            raise ValueError(f"network {name} has {len(scene.networks[name])} layers, the dimensions require {len(shapes)}")
        for i, ((weight, bias), (out, fan_in)) in enumerate(zip(scene.networks[name], shapes, strict=True)):
            wanted[f"{name}.{i}.weight"] = (weight, (out, fan_in), np.float32)
            wanted[f"{name}.{i}.bias"] = (bias, (out,), np.float32)
    for name, (array, shape, dtype) in wanted.items():
        if array.shape != shape or array.dtype != dtype:
            raise ValueError(f"{name} is {array.dtype}{list(array.shape)}, {np.dtype(dtype)}{list(shape)} is required")
    if scene.position_model is not None and not 0 <= scene.position_model.cell_shift <= CELL_INDEX:
        raise ValueError(f"cell_shift is {scene.position_model.cell_shift}, 0 to {CELL_INDEX} is required (SPEC.md 6.10)")
    if scene.chunk_size < 1:
        raise ValueError(f"chunk_size is {scene.chunk_size}, at least 1 is required (SPEC.md 11.1)")
    if np.abs(scene.planes.astype(np.int32)).max(initial=0) > (1 << 15) - 1:
        raise ValueError("a plane symbol is -32768 (SPEC.md 6.9)")
    if a.offsets[~scene.masks].any():
        raise ValueError("an offset that its mask drops is not 0 (SPEC.md 6.13)")


def derive_steps(scene: Scene) -> NDArray[np.uint8]:
    """SPEC 7.8 for every anchor of a scene whose attributes need not be there yet: uint8 [N, 3]."""
    networks = derive_networks(scene.dimensions, scene.carm_shift, scene.networks)
    full = assemble_planes(scene.planes)
    steps = [np.zeros((0, 3), np.uint8)]
    for group in chunk_ranges(scene.anchor_count, GROUP_ANCHORS):
        contexts = networks.contexts(scene, scene.frame, full, scene.plane_shift, scene.positions[group.start : group.stop])
        steps.append(step_indices(networks.entropy.hyper(contexts).astype(np.int64)))
    return np.concatenate(steps)
