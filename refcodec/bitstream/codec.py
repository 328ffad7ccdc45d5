"""Clauses 7.1, 10.1 and 15.4, and Annex H: decoding and encoding of a whole file.

`parse` decodes a file and `emit` encodes one. The modules of the other clauses implement the steps.
"""

import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..native.library import REFUSED_FORM, REFUSED_STEPS, kernel
from ..native.scene import Anchors, NativeScene
from .attributes import ATTRIBUTE_SYMBOL_MAX, KINDS, Attributes, EntropyModel, code_attributes, step_indices
from .batches import GROUP_ANCHORS, Progress, groups, no_progress, one_thread
from .bounds import Limits
from .chunks import chunk_ranges, emit_chunk
from .context import context
from .dimensions import STATIC
from .directory import DATA, FRAME, INDEX, PLANES_SECTION, WEIGHTS, critical_sections, is_critical, read_section
from .entropy import Encoder, Trace, require_limit
from .errors import BitstreamError
from .frame import emit_frame, parse_frame
from .header import Header, emit_file, parse_header, parse_prologue, read_header
from .index import chunk_floor, emit_entry, entries_start, parse_index
from .kernel import native_scene
from .limits import PROFILES, dimension_fault, minimal_level
from .masks import code_masks, mask_models
from .networks import IntNetwork, derive_networks
from .planes import assemble_planes, emit_planes
from .positions import RAW, emit_position_model, encode_positions, first_bad, form_error, raw_positions
from .reader import Chunk, Reader
from .scene import Ancillary, Scene, check_shapes, check_types
from .source import Piece, WholeFile, padded
from .splat import derive_rendering
from .weights import emit_weights, parse_weights

# Bytes allocated for anchors per byte of a file before any chunk is decoded. anchor_count is untrusted: without this
# limit, a tiny file could reserve gigabytes.
ROOM_OF_A_BYTE = 64


@dataclass(frozen=True, eq=False)
class Parsed:
    """A parsed file.

    damage: the first error of each dropped chunk, by number. Only keep_going drops chunks.
    lost: the number of anchors of each dropped chunk, by its number.
    error: the first error of the file, or None if it is accepted. Only keep_going returns a file with an error.
    """

    scene: Scene
    damage: dict[int, BitstreamError]
    error: BitstreamError | None = None
    lost: dict[int, int] = field(default_factory=dict)


def parse_container(data: bytes) -> Header:
    """SPEC 10.1, PROLOGUE to DIRECTORY: returns the header with its sections. Raises BitstreamError 101 to 305."""
    return read_header(WholeFile(data))


def parse_ancillary(data: bytes) -> list[Ancillary]:
    """SPEC 12.1: returns the intact ancillary sections of a file, without reading the other sections.

    Raises BitstreamError 101 to 305.
    """
    source, intact, after = WholeFile(data), [], 0
    for section in read_header(source).sections:
        if is_critical(section.type):
            after += 1
            continue
        with suppress(BitstreamError):
            intact.append(Ancillary(section.type, section.mode, read_section(source, section).data, after))
    return intact


def parse(
    data: bytes,
    *,
    keep_going: bool = False,
    progress: Progress = no_progress,
    trace: Trace | None = None,
    limits: Limits | None = None,
) -> Parsed:
    """SPEC 7.1, 10.1, 15.4 and Annex H: decodes a file. Raises BitstreamError and nothing else, whatever the bytes are.

    keep_going: drops each chunk with an error and lists it in damage, and continues after an error that follows the
    chunks. progress: called as work is done. trace: called for each symbol. limits: the caller's; if the file
    needs more, BoundPassedError is raised after the header checks and before any work.
    """
    reader = Reader(WholeFile(bytes(data)), trace=trace)
    if limits:
        limits.check(reader.header, copies=1, size=len(data))
    opened = reader.open(progress=progress)
    index = opened.index
    opened.hold_whole(ROOM_OF_A_BYTE * len(data))
    chunks: list[Chunk] = []
    damage: dict[int, BitstreamError] = {}
    progress("chunks", 0, len(index))
    for number, outcome in enumerate(opened.chunks(side_by_side=True)):
        if isinstance(outcome, Chunk):
            chunks.append(outcome)
        elif keep_going:
            damage[number] = outcome
        else:
            raise outcome
        progress("chunks", number + 1, len(index))
    first = next(iter(damage.values()), None)
    try:
        opened.close()
    except BitstreamError as error:
        if not keep_going:
            raise
        first = first or error
    lost = {number: len(index[number].anchors) for number in damage}
    return Parsed(opened.scene(chunks), damage, first, lost)


class Coding:
    """The networks, the attribute model and the anchor contexts that the symbols of a scene are coded with."""

    sarm: IntNetwork | None
    model: EntropyModel

    def __init__(self, scene: Scene) -> None:
        """Raises BoundError."""
        networks = derive_networks(scene.networks)
        if scene.render.render_model == STATIC:
            derive_rendering(scene.networks)
        self.networks = networks
        self.sarm = networks.get("sarm")
        self.model = EntropyModel.of(networks, scene.carm_shift, scene.dimensions.slices)
        self._scene, self._planes = scene, assemble_planes(scene.planes)

    def contexts(self, rows: slice | NDArray[Any] = slice(None)) -> NDArray[np.int16]:
        """SPEC 7.5: returns the contexts of some anchors, int16 [n, inputs of F_h]."""
        s = self._scene
        return context(s.frame, self._planes, s.plane_shift, s.dimensions.frequency_count, s.positions[rows])


def emit(scene: Scene, *, progress: Progress = no_progress) -> bytes:
    """Returns the file of a scene. For each accepted file b, emit(parse(b).scene) == b (SPEC 4.3, 15.2).

    Raises ValueError if the scene violates a rule of SPEC.md. The text is the error that a decoder would report, or
    names the field and its limits. Raises TypeError for a field whose type is not that of Scene.
    """
    check_types(scene)
    try:
        _check_header(scene)
        check_shapes(scene)
        with one_thread():
            return _emit(scene, progress)
    except BitstreamError as error:
        raise ValueError(f"the scene cannot be written: {error}") from None


def _emit(scene: Scene, progress: Progress) -> bytes:
    d, lanes = scene.dimensions, scene.lanes
    modes = {WEIGHTS: int(scene.weight_scales is not None), INDEX: int(scene.position_model is not None)}
    contents = {}
    # The decoder's checks refuse an invalid scene before any symbol is coded, as far as possible.
    if scene.frame is not None:
        contents[FRAME] = emit_frame(scene.frame)
        parse_frame(Piece(contents[FRAME], 0))
    contents[WEIGHTS] = emit_weights(
        scene.plane_shift,
        scene.carm_shift,
        scene.networks,
        scene.weight_scales,
        d,
        1 << lanes.attribute,
        scene.weight_forms,
    )
    used = kernel()
    parse_weights(Piece(contents[WEIGHTS], 0), modes[WEIGHTS], d, 1 << lanes.attribute, used=used)
    bad = first_bad(scene.positions.view(np.uint16).reshape(-1))
    if bad is not None:
        name, first = bad
        path, value = f"positions[{first // 3},{first % 3}]", scene.positions.reshape(-1)[first]
        raise BitstreamError(name, 0, path, value, "finite numbers but -0")
    coding = Coding(scene)
    make_native = partial(native_scene, used, d, lanes, coding.networks, scene.plane_shift, scene.carm_shift)
    if coding.sarm is not None:
        progress("planes", 0, 1)
        contents[PLANES_SECTION] = emit_planes(scene.planes, coding.sarm, 1 << lanes.plane, make_native())
        progress("planes", 1, 1)
    models = padded(scene.mask_model.astype("<u2").tobytes())
    if scene.position_model is not None:
        models += emit_position_model(scene.position_model)
    chunks = scene.chunks
    _check_models(scene, models)
    # The models are valid now, as the kernel requires.
    native = make_native(scene.frame, scene.planes, scene.mask_model, scene.position_model)
    coded = _emit_chunks(scene, coding, chunks, progress, native)
    entries = (
        emit_entry(
            content, zlib.crc32(content), scene.positions[c.start : c.stop], int(scene.masks[c.start : c.stop].sum())
        )
        for content, c in zip(coded, chunks, strict=True)
    )
    contents[INDEX] = models + b"".join(entries)
    contents[DATA] = b"".join(coded)
    order = critical_sections(d)
    sections: list[tuple[bytes, int, bytes]] = []
    for place in range(len(order) + 1):
        sections += [(a.type, a.mode, a.content) for a in scene.ancillary if min(a.after, len(order)) == place]
        if place < len(order):
            sections.append((order[place], modes.get(order[place], 0), contents[order[place]]))
    data = emit_file(_header(scene), sections)
    # The directory and the index exist only now, and are checked by the decoder's functions.
    made = parse_container(data)
    index, content = made.section(INDEX), made.section(DATA)
    piece = Piece(contents[INDEX], index.start)
    parse_index(piece, index.mode, d, made.anchor_count, made.chunk_size, content.start, content.length)
    return data


def _header(scene: Scene) -> Header:
    """Returns the header of a scene, with unchecked fields."""
    d, n = scene.dimensions, scene.anchor_count
    profile = PROFILES.get(scene.profile)
    chunks = -(-n // max(scene.chunk_size, 1)) if scene.chunk_anchors is None else len(scene.chunk_anchors)
    # A scene that no level holds is refused at the highest level.
    level = max(profile.levels) if profile else 0
    if profile and dimension_fault(profile, d, scene.render.render_model) is None:
        lowest = minimal_level(profile, n, d)
        level = level if lowest is None else lowest
    return Header(
        minor=scene.minor,
        profile=scene.profile,
        level=level,
        anchor_count=n,
        chunk_count=chunks,
        chunk_size=scene.chunk_size,
        lanes=scene.lanes,
        base_step=scene.base_step,
        grid=scene.grid,
        render=scene.render,
        dimensions=d,
        later=scene.later,
    )


def _check_header(scene: Scene) -> None:
    """Raises BitstreamError for fields of the header that are not allowed, and ValueError for those that do not fit.

    Nothing else may use the fields before this check. The sections are empty here, but each has its entry.
    """
    sections = [(a.type, a.mode, b"") for a in scene.ancillary]
    data = emit_file(_header(scene), sections)
    minor, length = parse_prologue(data)
    parse_header(data, minor, length)


def _check_models(scene: Scene, models: bytes) -> None:
    """Raises BitstreamError for an invalid model of the index. models: the bytes before the entries."""
    mode = int(scene.position_model is not None)
    assert len(models) == entries_start(scene.dimensions.offset_count, mode)
    parse_index(Piece(models, 0), mode, scene.dimensions, 0, scene.chunk_size, 0, 0)


# Of a chunk: the form of its positions, and its three parts.
ChunkParts = tuple[int, tuple[bytes, bytes, bytes]]


def _emit_chunks(
    scene: Scene, coding: Coding, chunks: list[range], progress: Progress, native: NativeScene | None
) -> list[bytes]:
    """SPEC 5.14: returns the bytes of each chunk."""
    a, forms = scene.attributes, scene.position_forms
    coded: list[bytes] = []
    progress("chunks", 0, len(chunks))
    for group, rows in groups(chunks):
        ranges = [chunks[number] for number in group]
        wanted = None if forms is None else [forms[number] for number in group]
        given = Attributes(a.features[rows], a.scalings[rows], a.offsets[rows], a.steps[rows])
        for values in (given.scalings, given.offsets[scene.masks[rows]], given.features):
            require_limit(values, ATTRIBUTE_SYMBOL_MAX)
        if native is None:
            parts = _encode_group(scene, coding, ranges, rows, wanted, given)
        else:
            anchors = Anchors(scene.positions[rows], scene.masks[rows], *vars(given).values())
            parts, statuses = native.encode_chunks(anchors, [len(c) for c in ranges], wanted)
            if REFUSED_FORM in statuses:
                raise form_error(statuses.index(REFUSED_FORM))
            if REFUSED_STEPS in statuses:
                raise _steps_error()
        for chunk, (form, (where, bits, symbols)) in zip(ranges, parts, strict=True):
            content = emit_chunk(form, (where, bits, symbols))
            # SPEC [R6.10-5]: raw positions take six bytes an anchor, which is above the floor by themselves.
            if forms is None and len(content) < chunk_floor(len(chunk)):
                raw = raw_positions(scene.positions[chunk.start : chunk.stop])
                content = emit_chunk(RAW, (raw, bits, symbols))
            coded.append(content)
        progress("chunks", len(coded), len(chunks))
    return coded


def _encode_group(
    scene: Scene, coding: Coding, ranges: list[range], rows: slice, wanted: list[int] | None, given: Attributes
) -> list[ChunkParts]:
    """SPEC 7.6, 7.10 and 7.12: encodes some chunks in parallel with NumPy.

    ranges: the anchors of each chunk. rows: all of them. wanted: the forms of their positions, or None. given: their
    attributes. Raises ValueError for an invalid symbol, step index or form.
    """
    lanes = scene.lanes
    counts = [len(c) for c in ranges]
    positions = encode_positions(scene.position_model, scene.positions[rows], counts, 1 << lanes.mask, wanted)
    masks = Encoder(len(ranges), 1 << lanes.mask)
    code_masks(masks, mask_models(scene.mask_model), scene.dimensions.offset_count, ranges, scene.masks[rows])
    attributes = Encoder(len(ranges), 1 << lanes.attribute)
    own = code_attributes(attributes, coding.model, coding.contexts(rows), scene.masks[rows], ranges, given)
    if not np.array_equal(own.steps, given.steps):
        raise _steps_error()
    streams = zip(positions, masks.finish(), attributes.finish(), strict=True)
    return [(form, (where, bits, symbols)) for (form, where), bits, symbols in streams]


def _steps_error() -> ValueError:
    return ValueError("the step indices are not those that the networks give: take those of derive_steps (SPEC.md 7.8)")


def derive_steps(scene: Scene) -> NDArray[np.uint8]:
    """SPEC 7.8: returns the step indices of all anchors, uint8 [N, 3]. The attributes of the scene are not read."""
    coding, count = Coding(scene), scene.anchor_count
    # Without weights, they are those of any anchor.
    equal = count > 0 and not scene.networks["hyper"][-1][0][-len(KINDS) :].any()
    steps = [np.zeros((0, 3), np.uint8)]
    for group in chunk_ranges(1 if equal else count, GROUP_ANCHORS):
        contexts = coding.contexts(slice(group.start, group.stop))
        steps.append(step_indices(coding.model.hyper(contexts).astype(np.int64)))
    return np.repeat(np.concatenate(steps), count, axis=0) if equal else np.concatenate(steps)
