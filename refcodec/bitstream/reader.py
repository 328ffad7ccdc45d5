"""Clauses 10.1 and 10.2: reading in file order, of a whole file, of bytes as they arrive, or of one chunk.

A new Reader reads the header. Its `open` reads the sections before the chunks and returns an Opened, whose `chunks`
reads the chunks and whose `close` reads the rest. Each check is here once, for all three ways of reading.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from ..native.library import KernelVerdict, kernel
from ..native.scene import Anchors, NativeScene
from .attributes import Attributes, EntropyModel, code_attributes, join_attributes
from .batches import GROUP_ANCHORS, GROUP_CHUNKS, PartDecoder, Progress, no_progress, one_thread
from .bounds import READING, Limits, memory_needed
from .chunks import PARTS, CodedChunk, read_chunk
from .context import JoinedPlanes, context
from .dimensions import STATIC
from .directory import DATA, INDEX, Section, check_end, is_critical, pass_section, read_section
from .entropy import Trace
from .errors import BitstreamError
from .frame import Frame, parse_frame
from .header import Header, read_header
from .index import ChunkEntry, Index, parse_index
from .kernel import chunk_bytes, error_name, native_scene, substream_error
from .masks import code_masks, mask_models
from .networks import BoundError, derive_networks
from .planes import assemble_planes, no_planes, parse_planes
from .positions import parse_positions, position_error, raw_numbers
from .scene import Ancillary, Scene
from .source import Held, Piece, Source
from .splat import derive_rendering
from .tables import ModelSet
from .weights import ParsedWeights, bound_error, parse_weights

# The most bytes of chunks in one read.
AHEAD_BYTES = 1 << 24


@dataclass(frozen=True, eq=False)
class Chunk:
    """A decoded chunk.

    positions: float16 [n, 3]. masks: bool [n, K]. form: of its positions.
    """

    entry: ChunkEntry
    form: int
    positions: NDArray[np.float16]
    masks: NDArray[np.bool_]
    attributes: Attributes


class Reader:
    """Reads a file from a Source.

    header: with its sections.
    ancillary: the ancillary sections that were kept.
    """

    source: Source
    trace: Trace | None

    def __init__(
        self,
        source: Source,
        *,
        keep_ancillary: bool = True,
        trace: Trace | None = None,
        limits: Limits | None = None,
        at_once: int = 0,
    ) -> None:
        """SPEC 10.1, PROLOGUE to DIRECTORY.

        Raises BitstreamError 101 to 305, BoundPassedError after them, and UsageError.

        keep_ancillary: whether ancillary sections are kept. Otherwise they are only checked. trace: called for each
        symbol, chunk by chunk. limits: the caller's, for a reader that holds some chunks at a time;
        BoundPassedError is raised before the bytes are read. at_once: the number of anchors decoded in parallel, if it
        is more than a chunk.
        """
        self.source, self.trace, self._keep = source, trace, keep_ancillary
        # The kernel does not report symbols to a trace.
        self._kernel = kernel() if trace is None else None
        self.header: Header = read_header(source)
        self._limits = limits
        if limits:
            limits.check(self.header, max(self.header.chunk_size, at_once), keep_ancillary=keep_ancillary)
        self.ancillary: list[Ancillary] = []
        # The number of critical sections read.
        self._before = 0

    def open(self, *, critical_only: bool = False, progress: Progress = no_progress) -> Opened:
        """SPEC 10.1, SECTIONS: reads and checks the sections before DATA.

        critical_only: whether ancillary sections are left unread, as a decoder of one chunk may. Raises BitstreamError
        311 to 313 and 401 to 436, or that of a substream.
        """
        with one_thread():
            return self._open(critical_only, progress)

    def _open(self, critical_only: bool, progress: Progress) -> Opened:
        h, d = self.header, self.header.dimensions
        # parse_directory has checked which critical sections there are, and their order.
        pieces = self._pieces(critical_only)
        frame = parse_frame(next(pieces)[1]) if d.has_frame else None
        section, piece = next(pieces)
        weights = parse_weights(piece, section.mode, d, 1 << h.lanes.attribute, self.trace, self._kernel)
        try:
            networks = derive_networks(weights.networks)
            # SPEC [R6.8-4]
            if h.render.render_model == STATIC:
                derive_rendering(weights.networks)
        except BoundError as error:
            raise bound_error(weights, d, error) from None
        shifts = weights.plane_shift, weights.carm_shift
        make_native = partial(native_scene, self._kernel, d, h.lanes, networks, *shifts)
        planes = no_planes()
        if d.plane_channels:
            section, piece = next(pieces)
            progress("planes", 0, 1)
            planes = parse_planes(piece, d, 1 << h.lanes.plane, networks["sarm"], self.trace, make_native())
            progress("planes", 1, 1)
        section, piece = next(pieces)
        data = h.section(DATA)
        index = parse_index(piece, section.mode, d, h.anchor_count, h.chunk_size, data.start, data.length)
        for _ in pieces:
            raise AssertionError("a critical section follows INDX before DATA")
        native = make_native(frame, planes, index.mask_model, index.position_model)
        model = EntropyModel.of(networks, weights.carm_shift, d.slices)
        return Opened(self, frame, weights, planes, index, mask_models(index.mask_model), model, native)

    def _pieces(self, critical_only: bool) -> Iterator[tuple[Section, Piece]]:
        """Yields the critical sections before DATA, and reads the ancillary sections between them."""
        for section in self.header.sections:
            if section.type == DATA:
                return
            if is_critical(section.type):
                piece = read_section(self.source, section)
                self._before += 1
                yield section, piece
            elif not critical_only:
                self._read_ancillary(section.number)

    def _read_ancillary(self, number: int) -> None:
        section = self.header.sections[number]
        if self._keep:
            content = read_section(self.source, section).data
            self.ancillary.append(Ancillary(section.type, section.mode, content, self._before))
        else:
            pass_section(self.source, section)

    def check_chunks(self, entries: list[ChunkEntry]) -> None:
        """Raises BoundPassedError, before any chunk is read, for chunks that exceed the caller's limits."""
        if self._limits is None:
            return
        anchors, length = (sum(sizes) for sizes in zip(*((len(e.anchors), e.length) for e in entries), strict=True))
        kept = sum(len(section.content) for section in self.ancillary)
        self._limits.check_memory(memory_needed(self.header, anchors, more=kept + READING * length))

    def close(self) -> None:
        """SPEC 10.1, CHUNKS to END: checks DATA's crc, the sections after it, and the end of the file.

        Raises BitstreamError 311 to 321.
        """
        behind = False
        for section in self.header.sections:
            if section.type == DATA:
                behind = True
                self._before += 1
                # SPEC [R6.6-7]
                if section.crc:
                    stated = f"0x{section.crc:08x}"
                    raise BitstreamError("section.crc", section.start, section.name, stated, "0x00000000")
            elif behind:
                self._read_ancillary(section.number)
        check_end(self.source, self.header.sections)


@dataclass(eq=False)
class Opened:
    """A file whose sections before DATA were read. It decodes the chunks.

    frame: None without planes and frequencies. planes: int16 [5, ch, B, B]. native: the kernel's scene, or None if
    NumPy decodes.
    """

    reader: Reader
    frame: Frame | None
    weights: ParsedWeights
    planes: NDArray[np.int16]
    index: Index
    masks: ModelSet
    model: EntropyModel
    native: NativeScene | None
    _whole: Anchors | None = None

    @property
    def header(self) -> Header:
        return self.reader.header

    @property
    def ancillary(self) -> list[Ancillary]:
        """The ancillary sections that were kept so far."""
        return self.reader.ancillary

    @cached_property
    def joined(self) -> JoinedPlanes:
        """The result of assemble_planes, which only NumPy needs."""
        return assemble_planes(self.planes)

    def hold_whole(self, most: int) -> None:
        """Preallocates the anchors of all chunks if they fit in `most` bytes, so `scene` need not concatenate chunks.

        Only the kernel uses this. Call it before any chunk is decoded, and keep no chunk that is decoded twice.
        """
        native, count = self.native, self.header.anchor_count
        if native is not None and count * native.anchor_bytes() <= most:
            self._whole = native.room(count)

    def close(self) -> None:
        self.reader.close()

    def chunks(self, *, side_by_side: bool = False) -> Iterator[Chunk | BitstreamError]:
        """SPEC 10.1, CHUNKS: yields each chunk in order, or its first error.

        side_by_side: whether many chunks are read and decoded at once, which is faster. Otherwise a chunk is yielded
        before the next one is read. The results are the same.
        """
        for entries in self.groups(side_by_side=side_by_side):
            yield from self.decode(entries)

    def groups(self, numbers: Iterable[int] | None = None, *, side_by_side: bool = True) -> Iterator[list[ChunkEntry]]:
        """Yields groups of entries of chunks to decode at once, in bounded memory.

        numbers: of the wanted chunks, ascending, or None for all. side_by_side: as for `chunks`.
        """
        index = self.index
        entries: list[ChunkEntry] = []
        anchors = 0
        for number in range(len(index)) if numbers is None else numbers:
            entry = index[number]
            full = len(entries) == GROUP_CHUNKS or anchors + len(entry.anchors) > GROUP_ANCHORS
            if entries and (full or self.reader.trace or not side_by_side):
                yield entries
                entries, anchors = [], 0
            entries.append(entry)
            anchors += len(entry.anchors)
        if entries:
            yield entries

    def decode(self, entries: list[ChunkEntry]) -> list[Chunk | BitstreamError]:
        """SPEC 10.1, CHUNKS: reads and decodes some chunks in parallel. Returns each chunk, or its first error.

        Raises BoundPassedError if the chunk lengths in the index need more memory than the caller allows.
        """
        self.reader.check_chunks(entries)
        section = self.header.section(INDEX)
        outcomes: dict[int, Chunk | BitstreamError] = {}
        live: list[CodedChunk] = []
        source = _ahead(self.reader.source, entries)
        for entry in entries:
            try:
                live.append(read_chunk(source, entry, section.mode))
            except BitstreamError as error:
                outcomes[entry.number] = error
        if self.native is None:
            with one_thread():
                outcomes.update(self._decode(live))
        else:
            outcomes.update(self._decode_native(self.native, live))
        return [outcomes[entry.number] for entry in entries]

    def _decode_native(self, native: NativeScene, chunks: list[CodedChunk]) -> dict[int, Chunk | BitstreamError]:
        """Decodes some chunks with the native kernel."""
        a, rows = self._whole, [chunk.entry.anchors.start for chunk in chunks]
        if a is None:
            *rows, count = accumulate((len(chunk.entry.anchors) for chunk in chunks), initial=0)
            a = native.room(count)
        verdicts = native.decode_chunks([chunk_bytes(chunk) for chunk in chunks], a, rows)
        outcomes: dict[int, Chunk | BitstreamError] = {}
        for chunk, first, verdict in zip(chunks, rows, verdicts, strict=True):
            own = slice(first, first + len(chunk.entry.anchors))
            attributes = Attributes(a.features[own], a.scalings[own], a.offsets[own], a.steps[own])
            outcomes[chunk.entry.number] = self._native_error(chunk, verdict, a.positions[own]) or Chunk(
                chunk.entry, chunk.form, a.positions[own], a.masks[own], attributes
            )
        return outcomes

    def _native_error(
        self, chunk: CodedChunk, verdict: KernelVerdict, positions: NDArray[np.float16]
    ) -> BitstreamError | None:
        """Returns the error of a chunk that the kernel refused, or None. positions: float16 [n, 3], as decoded."""
        name, lanes = error_name(verdict), self.header.lanes
        if name is None:
            return None
        error: object
        if name.startswith("substream."):
            part, log2 = getattr(chunk, PARTS[verdict.part]), (lanes.mask, lanes.mask, lanes.attribute)[verdict.part]
            error = substream_error(verdict, part, 1 << log2, f"{PARTS[verdict.part]}[chunk {chunk.entry.number}]")
        elif name == "chunk.bounds":
            error = _bounds_error(chunk, positions)
        elif name == "chunk.kept":
            error = _kept_error(chunk, verdict.number[0])
        elif name in ("positions.count", "positions.cell"):
            error = position_error(chunk.coded_positions, name, verdict.number[0])
        else:
            error = raw_numbers(chunk.coded_positions)
        if not isinstance(error, BitstreamError):
            raise RuntimeError(f"{chunk.entry.path}: the native kernel reports {name}, but Python finds no such error")
        return error

    def _decode(self, chunks: list[CodedChunk]) -> dict[int, Chunk | BitstreamError]:
        """Decodes some chunks with NumPy."""
        h, trace = self.header, self.reader.trace
        outcomes: dict[int, Chunk | BitstreamError] = {}
        live = list(chunks)

        def settle(errors: list[BitstreamError | None]) -> NDArray[np.bool_]:
            """Drops the chunks with an error. Returns which rows of anchors remain, bool [anchors]."""
            nonlocal live
            outcomes.update({c.entry.number: e for c, e in zip(live, errors, strict=True) if e is not None})
            rows = np.repeat([e is None for e in errors], [len(c.entry.anchors) for c in live])
            live = [c for c, e in zip(live, errors, strict=True) if e is None]
            return rows

        # The positions, and [R6.11-10].
        parsed = parse_positions(
            [chunk.coded_positions for chunk in live], self.index.position_model, 1 << h.lanes.mask, trace
        )
        good = [p for p in parsed if not isinstance(p, BitstreamError)]
        settle([p if isinstance(p, BitstreamError) else None for p in parsed])
        bounds = [_bounds_error(chunk, p) for chunk, p in zip(live, good, strict=True)]
        settle(bounds)
        good = [p for p, error in zip(good, bounds, strict=True) if error is None]
        if not live:
            return outcomes
        positions = np.concatenate(good)
        # The masks, and [R6.11-11].
        part = PartDecoder([(c.masks, f"masks[chunk {c.entry.number}]") for c in live], 1 << h.lanes.mask, trace)
        ranges = [chunk.entry.anchors for chunk in live]
        masks = code_masks(part.decoder, self.masks, h.dimensions.offset_count, ranges)
        counts = np.cumsum([0, *map(len, ranges)])
        rows = settle(
            [
                wrong or _kept_error(chunk, int(masks[first:end].sum()))
                for chunk, wrong, first, end in zip(live, part.verdicts(), counts[:-1], counts[1:], strict=True)
            ]
        )
        positions, masks = positions[rows], masks[rows]
        if not live:
            return outcomes
        # The attributes.
        ranges = [chunk.entry.anchors for chunk in live]
        contexts = context(self.frame, self.joined, self.weights.plane_shift, h.dimensions.frequency_count, positions)
        part = PartDecoder(
            [(c.attributes, f"attributes[chunk {c.entry.number}]") for c in live], 1 << h.lanes.attribute, trace
        )
        a = code_attributes(part.decoder, self.model, contexts, masks, ranges)
        at = 0
        for chunk, verdict in zip(live, part.verdicts(), strict=True):
            own = slice(at, at + len(chunk.entry.anchors))
            at = own.stop
            attributes = Attributes(a.features[own], a.scalings[own], a.offsets[own], a.steps[own])
            outcomes[chunk.entry.number] = verdict or Chunk(
                chunk.entry, chunk.form, positions[own], masks[own], attributes
            )
        return outcomes

    def scene(self, chunks: list[Chunk]) -> Scene:
        """Returns the scene with the anchors of some chunks, and with the ancillary sections read so far."""
        h, d = self.header, self.header.dimensions
        positions, masks, attributes = self._anchors(chunks)
        return Scene(
            profile=h.profile,
            dimensions=d,
            chunk_size=h.chunk_size,
            lanes=h.lanes,
            base_step=h.base_step,
            grid=h.grid,
            render=h.render,
            frame=self.frame,
            plane_shift=self.weights.plane_shift,
            carm_shift=self.weights.carm_shift,
            networks=self.weights.networks,
            planes=self.planes,
            mask_model=self.index.mask_model,
            positions=positions,
            masks=masks,
            attributes=attributes,
            ancillary=tuple(self.ancillary),
            position_model=self.index.position_model,
            weight_scales=self.weights.scales,
            chunk_anchors=tuple(len(chunk.entry.anchors) for chunk in chunks),
            position_forms=tuple(chunk.form for chunk in chunks),
            weight_forms=self.weights.forms,
            minor=h.minor,
            later=h.later,
        )

    def _anchors(self, chunks: list[Chunk]) -> tuple[NDArray[np.float16], NDArray[np.bool_], Attributes]:
        """Returns the positions, masks and attributes of some chunks together."""
        a, d = self._whole, self.header.dimensions
        if a is not None and [chunk.entry.number for chunk in chunks] == list(range(len(self.index))):
            return a.positions, a.masks, Attributes(a.features, a.scalings, a.offsets, a.steps)
        return (
            np.concatenate([np.zeros((0, 3), np.float16), *(chunk.positions for chunk in chunks)]),
            np.concatenate([np.zeros((0, d.offset_count), bool), *(chunk.masks for chunk in chunks)]),
            join_attributes((chunk.attributes for chunk in chunks), d),
        )


def _ahead(source: Source, entries: list[ChunkEntry]) -> Source:
    """Returns the source, with the bytes of some chunks held if they are contiguous and not too many."""
    start, end = entries[0].start, entries[-1].start + entries[-1].length
    if len(entries) > 1 and sum(entry.length for entry in entries) == end - start <= AHEAD_BYTES:
        return Held(source, start, end - start)
    return source


def _bounds_error(chunk: CodedChunk, positions: NDArray[np.float16]) -> BitstreamError | None:
    """SPEC [R6.11-10]: returns the error of a chunk whose entry has wrong bounds, or None."""
    e = chunk.entry
    low, high = positions.min(axis=0), positions.max(axis=0)
    if np.array_equal(low, e.low) and np.array_equal(high, e.high):
        return None
    box = f"positions from {low.tolist()} to {high.tolist()}"
    return BitstreamError("chunk.bounds", e.start, e.path, box, f"{e.low.tolist()} to {e.high.tolist()}")


def _kept_error(chunk: CodedChunk, kept: int) -> BitstreamError | None:
    """SPEC [R6.11-11]: returns the error of a chunk with a wrong kept_count, or None."""
    e = chunk.entry
    return None if kept == e.kept else BitstreamError("chunk.kept", e.start, e.path, f"{kept} kept offsets", e.kept)


def decode_chunk(source: Source, number: int, *, limits: Limits | None = None) -> Scene:
    """SPEC 10.2: decodes one chunk from the fewest bytes: header, FRAM, WGTS, PLNS, INDX and the range of the chunk.

    Returns the scene with the anchors of that chunk. Raises BitstreamError for the first error in the checks for one
    chunk, BoundPassedError, and IndexError if the file has no such chunk.
    """
    opened = Reader(source, keep_ancillary=False, limits=limits).open(critical_only=True)
    index = opened.index
    if not 0 <= number < len(index):
        raise IndexError(f"there is no chunk {number}: the file has {len(index)}")
    chunk = opened.decode([index[number]])[0]
    if isinstance(chunk, BitstreamError):
        raise chunk
    return opened.scene([chunk])
