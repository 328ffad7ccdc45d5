"""Clauses 5.12, 6.11, 7.4 and 7.12: the positions, as raw fp16 numbers or as a tree of cells for each chunk.

The code of a cell is its place on the Morton curve. A node of the tree is the code of its cells without their low bits.
While the chunks of a batch are coded in parallel, the number of the chunk lies above the bits of a code.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import syntax
from .conventions import Int64
from .entropy import Decoder, Encoder, SymbolCoder, Trace, open_substream
from .errors import BitstreamError
from .source import Piece
from .tables import TOTAL, ModelSet, build_models

F16 = NDArray[np.float16]
# SPEC 7.12: the levels of the tree, the cell_shift of cells that are ranks of fp16 numbers, and the number of models.
CELL_LEVELS = 16
CELL_INDEX = 40
POSITION_MODELS = 18
# SPEC 5.12: the symbols of a model. A symbol states which of four children exist.
HALVES = 16
# SPEC 6.10: the models whose symbol 0 cannot occur.
EMPTY_MODELS = (1, 7, 13)
# SPEC 5.14: the forms of a chunk's positions, and the bytes of a raw position.
RAW, PACKED = 0, 1
POSITION_BYTES = 6
_MIDDLE = 1 << (CELL_LEVELS - 1)
_CODE_BITS = 3 * CELL_LEVELS
# The number of children of each symbol.
_CHILDREN = np.array([half.bit_count() for half in range(HALVES)])


def position_integers(positions: F16) -> Int64:
    """SPEC 7.4, POSITION_INTEGER: returns P, int64 [n, 3], with position = P * 2^-24 and |P| < 2^40.

    positions: float16 [n, 3], finite.
    """
    bits = positions.view(np.uint16).astype(np.int64)
    exponent, mantissa = (bits >> 10) & 31, bits & 1023
    magnitude = np.where(exponent == 0, mantissa, (mantissa + 1024) << np.maximum(exponent - 1, 0))
    return np.where(bits >> 15, -magnitude, magnitude)


# --- the model of positions -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PositionModel:
    """SPEC 5.12: the model of packed positions. cell_shift: 0 to 40. frequency: uint16 [18, 16]."""

    cell_shift: int
    frequency: NDArray[np.uint16]

    def fault(self) -> int | None:
        """SPEC 6.10: returns -1 if cell_shift is invalid, else the number of the first invalid model, or None."""
        if not 0 <= self.cell_shift <= CELL_INDEX:
            return -1
        never = np.zeros(self.frequency.shape, dtype=bool)
        never[list(EMPTY_MODELS), 0] = True
        right = ((self.frequency == 0) == never).all(axis=1) & (self.frequency.sum(axis=1, dtype=np.int64) == TOTAL)
        return None if right.all() else int(np.argmin(right))

    def models(self) -> ModelSet:
        """SPEC 7.12: returns the 18 models."""
        return build_models("cells", list(self.frequency.astype(np.int64)), [0] * POSITION_MODELS)


def parse_position_model(section: Piece, at: int) -> PositionModel:
    """SPEC 5.12, [R6.10-3] and [R6.10-4]: returns the model at byte `at` of the index.

    Raises BitstreamError index.reserved or index.position_model.
    """
    struct = syntax.Struct("PositionModel", section, at, "index.position_model")
    if any(struct.fields.reserved):
        raise struct.error("index.reserved", "reserved", list(struct.fields.reserved), 0)
    frequency = np.array(struct.fields.frequency, dtype=np.uint16).reshape(POSITION_MODELS, HALVES)
    model = PositionModel(struct.fields.cell_shift, frequency)
    fault = model.fault()
    if fault is not None:
        path, found, allowed = "cell_shift", str(model.cell_shift), f"0 to {CELL_INDEX}"
        if fault >= 0:
            path, found = f"frequency[{HALVES * fault}]", f"frequencies {model.frequency[fault].tolist()}"
            first = "the first one 0" if fault in EMPTY_MODELS else "the first one at least 1"
            allowed = f"{HALVES} frequencies that add up to {TOTAL}, {first} and the others at least 1"
        raise struct.error("index.position_model", path, found, allowed)
    return model


def emit_position_model(model: PositionModel) -> bytes:
    """SPEC 5.12: returns the bytes of the model."""
    fields = {"cell_shift": model.cell_shift, "reserved": [0, 0, 0], "frequency": model.frequency.reshape(-1).tolist()}
    return syntax.build("PositionModel", fields)


# --- cells ------------------------------------------------------------------------------------------------------------


def cells(positions: F16, cell_shift: int) -> Int64:
    """SPEC 7.12: returns the cells of positions, int64 [n, 3], with -1 on an axis without a cell.

    positions: float16 [n, 3], finite.
    """
    bits = positions.view(np.uint16).astype(np.int64)
    if cell_shift == CELL_INDEX:
        return _MIDDLE + np.where(bits >> 15, -(bits & 0x7FFF), bits)
    p = position_integers(positions)
    n = p >> cell_shift
    return np.where((n << cell_shift == p) & (n >= -_MIDDLE) & (n < _MIDDLE), n + _MIDDLE, -1)


def cell_positions(cell: Int64, cell_shift: int) -> tuple[F16, NDArray[np.bool_]]:
    """SPEC 7.12, CELL_NUMBER: returns positions, float16 [n, 3], and whether each anchor has one, bool [n].

    cell: int64 [n, 3]. An anchor has no position if fp16 cannot represent one of its coordinates; the result is then 0.
    """
    n = cell - _MIDDLE
    bits = np.abs(n)
    fits = np.ones(bits.shape, dtype=bool)
    if cell_shift < CELL_INDEX:
        # |n| is at most 2^15, so a float64 holds |n| * 2^cell_shift exactly.
        p = bits << cell_shift
        e = np.maximum(np.frexp(p.astype(np.float64))[1].astype(np.int64) - 11, 0)
        fits = (p >> e) << e == p
        bits = (e << 10) + (p >> e)
    fits &= bits < 0x7C00
    kept = np.asarray(fits.all(axis=1))
    pattern = np.where(n < 0, bits | 0x8000, bits)
    return np.where(kept[:, None], pattern, 0).astype(np.uint16).view(np.float16), kept


def morton(cell: Int64) -> Int64:
    """SPEC 7.12: returns the codes of cells, int64 [n]. cell: int64 [n, 3], each 0 to 2^16 - 1."""
    code = np.zeros(len(cell), dtype=np.int64)
    for bit in range(CELL_LEVELS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _cells_of_codes(code: Int64) -> Int64:
    """Returns the cells of codes, int64 [n, 3]: the reverse of morton."""
    cell = np.zeros((len(code), 3), dtype=np.int64)
    for bit in range(CELL_LEVELS):
        for axis in range(3):
            cell[:, axis] |= ((code >> (3 * bit + axis)) & 1) << bit
    return cell


def chunk_codes(positions: F16, cell_shift: int) -> Int64 | None:
    """SPEC 6.11: returns the codes of a chunk's cells, int64 [n], or None if the chunk cannot be packed."""
    cell = cells(positions, cell_shift)
    if (cell < 0).any():
        return None
    code = morton(cell)
    return code if (code[1:] > code[:-1]).all() else None


def code_cells(
    coder: SymbolCoder, models: ModelSet, numbers: list[int], counts: list[int], given: Int64 | None = None
) -> tuple[Int64, Int64]:
    """SPEC 7.12, DECODE_CELLS: codes the trees of some chunks, in either direction.

    Returns the codes of all cells, int64 [cells], and the number of cells of each chunk, int64 [chunks]. For a tree
    with more nodes than anchors on some level, that number is one above the number of anchors.

    numbers: the chunk numbers, for a trace. counts: the anchors of each chunk. given: the codes, for encoding.
    """
    chunk_bits = np.repeat(np.arange(len(counts), dtype=np.int64), counts) << _CODE_BITS
    full = None if given is None else given | chunk_bits
    most = np.array(counts, dtype=np.int64)
    nodes, held, past = (
        np.arange(len(counts), dtype=np.int64),
        np.ones(len(counts), dtype=np.int64),
        np.zeros(len(counts), dtype=bool),
    )
    for level in range(CELL_LEVELS - 1, -1, -1):
        known = None
        if full is not None:
            children = np.unique(full >> (3 * level))
            known = np.bincount(np.searchsorted(nodes, children >> 3), 1 << (children & 7), len(nodes)).astype(np.int64)
        first = 6 * min(level, 2)

        def name(stream: int, index: int, level: int = level, half: str = "low") -> str:
            return f"positions[chunk {numbers[stream]}].level[{level}].{half}[{index}]"

        def high_name(stream: int, index: int, level: int = level) -> str:
            return name(stream, index, level, "high")

        model = np.full(len(nodes), first)
        low = coder.plain(models, model, held.tolist(), name, None if known is None else known & 15)
        model = first + 1 + _CHILDREN[low]
        high = coder.plain(models, model, held.tolist(), high_name, None if known is None else known >> 4)
        parent, child = np.nonzero(((low | high << 4)[:, None] >> np.arange(8)) & 1)
        nodes = nodes[parent] << 3 | child
        # SPEC 7.12: nodes beyond the number of the chunk's anchors are dropped, which bounds the time.
        chunk = nodes >> (_CODE_BITS - 3 * level)
        held = np.bincount(chunk, minlength=len(counts))
        past |= held > most
        rank = np.arange(len(nodes)) - np.repeat(np.cumsum(held) - held, held)
        nodes, held = nodes[rank < most[chunk]], np.minimum(held, most)
    return nodes & ((1 << _CODE_BITS) - 1), held + past


# --- the positions of chunks ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CodedPositions:
    """SPEC 5.14: the encoded positions of a chunk.

    number: of the chunk. piece: the bytes. form: RAW or PACKED. anchors: the anchor numbers in the file.
    """

    number: int
    piece: Piece
    form: int
    anchors: range

    @property
    def path(self) -> str:
        """The name of the part in paths."""
        return f"positions[chunk {self.number}]"


def parse_positions(
    chunks: list[CodedPositions], model: PositionModel | None, lanes: int, trace: Trace | None
) -> list[F16 | BitstreamError]:
    """SPEC 5.14 and 6.11: returns the positions of each chunk, float16 [n, 3], or its first error.

    model: None in mode 0. lanes: the lanes of each substream.
    """
    packed = [chunk for chunk in chunks if chunk.form == PACKED]
    trees = iter(_packed(packed, model, lanes, trace) if packed and model is not None else ())
    return [next(trees) if chunk.form == PACKED else raw_numbers(chunk) for chunk in chunks]


def position_error(chunk: CodedPositions, name: str, number: int) -> BitstreamError:
    """SPEC [R6.11-8] and [R6.11-9]: returns the error of a tree whose substream has no error.

    number: for positions.count, the number of cells of the tree, or a number above that of the anchors if some level
    has more nodes. For positions.cell, the first anchor of the chunk whose cell represents no finite fp16.
    """
    if name == "positions.count":
        count = len(chunk.anchors)
        found, allowed = f"{number} cells" if number < count else "more cells", f"{count}, one for each anchor"
    else:
        found, allowed = (
            f"a cell of anchor {chunk.anchors.start + number} that is not a finite fp16",
            "cells that are finite fp16",
        )
    return chunk.piece.error(name, 0, chunk.path, found, allowed)


def raw_numbers(chunk: CodedPositions) -> F16 | BitstreamError:
    """SPEC [R6.11-6] and [R6.11-7]: returns a chunk's fp16 numbers, or the error of the first invalid one."""
    bits = np.frombuffer(chunk.piece.data, "<u2").astype(np.uint16)
    bad = first_bad(bits)
    if bad is None:
        return bits.view(np.float16).reshape(-1, 3)
    name, first = bad
    path = f"positions[{chunk.anchors.start + first // 3},{first % 3}]"
    return chunk.piece.error(name, 2 * first, path, f"0x{bits[first]:04x}", "finite numbers but -0")


def _packed(
    chunks: list[CodedPositions], model: PositionModel, lanes: int, trace: Trace | None
) -> list[F16 | BitstreamError]:
    """SPEC 7.12, DECODE_POSITIONS: returns the positions or the error of each packed chunk."""
    opened = [open_substream(chunk.piece, lanes, chunk.path) for chunk in chunks]
    decoder = Decoder([stream for stream, _ in opened], trace)
    counts = [len(chunk.anchors) for chunk in chunks]
    code, held = code_cells(decoder, model.models(), [chunk.number for chunk in chunks], counts)
    rows = np.minimum(held, counts)
    firsts = np.cumsum(rows) - rows
    outcomes: list[F16 | BitstreamError] = []
    for i, (chunk, (_, before), after) in enumerate(zip(chunks, opened, decoder.finish(), strict=True)):
        error = before or after
        # SPEC [R6.11-8]
        if error is None and held[i] != counts[i]:
            error = position_error(chunk, "positions.count", int(held[i]))
        # SPEC [R6.11-9]
        own = code[firsts[i] : firsts[i] + rows[i]]
        positions, fits = cell_positions(_cells_of_codes(own), model.cell_shift)
        if error is None and not fits.all():
            error = position_error(chunk, "positions.cell", int(np.argmin(fits)))
        outcomes.append(error or positions)
    return outcomes


def first_bad(bits: NDArray[np.uint16]) -> tuple[str, int] | None:
    """SPEC 6.11: returns the error name and the index of the first invalid fp16 number, or None."""
    bad = np.flatnonzero(((bits & 0x7C00) == 0x7C00) | (bits == 0x8000))
    if not bad.size:
        return None
    first = int(bad[0])
    return ("positions.negative_zero" if bits[first] == 0x8000 else "positions.not_finite"), first


def raw_positions(positions: F16) -> bytes:
    """SPEC 5.14: returns the bytes of positions, float16 [n, 3], in form RAW."""
    return positions.astype("<f2").tobytes()


def form_error(number: int) -> ValueError:
    """Returns the error of a chunk, by its number, that cannot have the positions' form in the scene."""
    return ValueError(f"the positions of chunk {number} cannot be packed (SPEC.md 7.12)")


def encode_positions(
    model: PositionModel | None, positions: F16, counts: list[int], lanes: int, forms: list[int] | None = None
) -> list[tuple[int, bytes]]:
    """SPEC 5.14: returns the form and the bytes of the positions of each chunk.

    model: None in mode 0. positions: float16 [n, 3], of the chunks' anchors. counts: the anchors of each chunk. lanes:
    the lanes of each substream. forms: RAW or PACKED for each chunk, or None to pack every chunk that can be packed.
    Raises ValueError for a chunk that cannot have its form.
    """
    each = np.split(positions, np.cumsum(counts)[:-1]) if counts else []
    codes = [None if model is None else chunk_codes(p, model.cell_shift) for p in each]
    for number, (form, code) in enumerate(zip(forms or [RAW] * len(each), codes, strict=True)):
        if form == PACKED and code is None:
            raise form_error(number)
        if form == RAW and forms is not None:
            codes[number] = None
    packed = [code for code in codes if code is not None]
    streams: list[bytes] = []
    if packed and model is not None:
        encoder = Encoder(len(packed), lanes)
        code_cells(encoder, model.models(), [], [len(code) for code in packed], np.concatenate(packed))
        streams = encoder.finish()
    streams.reverse()
    return [
        (RAW, raw_positions(p)) if code is None else (PACKED, streams.pop())
        for p, code in zip(each, codes, strict=True)
    ]
