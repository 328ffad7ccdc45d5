"""Clauses 5.10, 6.9 and 7.3: the planes."""

import construct as cs
import numpy as np
from numpy.typing import NDArray

from . import syntax
from .context import JoinedPlanes
from .dimensions import Dimensions
from .entropy import Coder, Decoder, Encoder, Trace, ValueGroup, open_substream, require_limit
from .kernel import NativeScene, substream_error
from .networks import IntNetwork, activation
from .source import Piece, pad4, padded
from .tables import tables

# SPEC 7.3: the number of sub-planes: the plane with r = 1, and four quadrants of the plane with r = 2.
PLANES = 5
# SPEC 6.9: the largest magnitude of a plane symbol. Arrays hold it as int16, of which -32768 is not used.
PLANE_SYMBOL_MAX = (1 << 15) - 1
PLANE_NAMES = ("r1", "r2.top_left", "r2.top_right", "r2.bottom_left", "r2.bottom_right")


def wavefront(t: int, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """SPEC 7.3: returns the rows i and the columns j of wavefront t, int64 [points]. j + 2 i = t, and rows ascend."""
    i = np.arange(max(0, (t - size + 2) // 2), min(size - 1, t // 2) + 1)
    return i, t - 2 * i


def code_planes(
    coder: Coder, sarm: IntNetwork, channels: int, size: int, given: NDArray[np.int16] | None = None
) -> NDArray[np.int16]:
    """SPEC 7.3: codes the five sub-planes, in either direction, and returns them, int16 [5, ch, B, B].

    channels: ch. size: B. given: the sub-planes, for encoding.
    """
    # The border of zeros above, left and right represents the symbols outside the sub-plane.
    padded = np.zeros((PLANES, channels, size + 1, size + 2), dtype=np.int16)
    flat = padded.reshape(-1)
    width = size + 2
    block = np.arange(PLANES * channels)[:, None] * ((size + 1) * width)
    for t in range(3 * size - 2):
        i, j = wavefront(t, size)
        at = (block + ((i + 1) * width + j + 1)).reshape(-1)
        # SPEC 7.3: the context of (i, j) is (i-1, j-1), (i-1, j), (i-1, j+1) and (i, j-1).
        near = np.stack([flat[at - width - 1], flat[at - width], flat[at - width + 1], flat[at - 1]], axis=1)
        parameters = sarm(activation(near.astype(np.int64))).astype(np.int64)
        known = None if given is None else given[:, :, i, j].reshape(-1).astype(np.int64)

        def name(plane: int, index: int, i: list[int] = i.tolist(), j: list[int] = j.tolist()) -> str:  # noqa: B008
            channel, row = divmod(index, len(i))
            return f"planes.{PLANE_NAMES[plane]}[{channel},{i[row]},{j[row]}]"

        counts = [channels * len(i)] * PLANES
        models, mean, scale = tables().laplace, parameters[:, 0], parameters[:, 1]
        flat[at] = coder.values(ValueGroup(models, mean, scale, counts, PLANE_SYMBOL_MAX, name, known))
    return padded[:, :, 1:, 1:-1].copy()


def parse_planes(
    section: Piece, d: Dimensions, lanes: int, sarm: IntNetwork, trace: Trace | None, native: NativeScene | None = None
) -> NDArray[np.int16]:
    """SPEC 5.10, 6.9 and 7.3: returns the sub-planes of the section, int16 [5, ch, B, B].

    lanes: the lanes of each substream. native: decodes them instead of NumPy, without a trace. Raises BitstreamError
    planes.length, planes.padding, or the error of the first substream that has one.
    """
    # SPEC [R6.9-1]
    try:
        table, size = syntax.parse("PlaneTable", section.data)
    except cs.ConstructError:
        allowed = f"at least the table's {syntax.size_of('PlaneTable')}"
        raise section.error("planes.length", 0, "planes", f"{len(section)} bytes", allowed) from None
    starts = size + np.cumsum([0, *(pad4(length) for length in table.length)], dtype=np.int64)
    if starts[-1] != len(section):
        stated = f"a table that states {starts[-1]} bytes"
        raise section.error("planes.length", 0, "planes.length", stated, len(section))
    # SPEC [R6.9-2]
    spans = [(int(start), int(start) + length) for start, length in zip(starts, table.length, strict=False)]
    for name, (start, end) in zip(PLANE_NAMES, spans, strict=True):
        section.require_zero("planes.padding", end, start + pad4(end - start), f"planes.{name}")
    pieces = [section.cut(*span) for span in spans]
    if native is None:
        return _decode(pieces, d, lanes, sarm, trace)
    planes, verdicts = native.decode_planes([piece.data for piece in pieces])
    for name, piece, verdict in zip(PLANE_NAMES, pieces, verdicts, strict=True):
        if verdict.status:
            raise substream_error(verdict, piece, lanes, f"planes.{name}")
    return planes


def _decode(pieces: list[Piece], d: Dimensions, lanes: int, sarm: IntNetwork, trace: Trace | None) -> NDArray[np.int16]:
    """SPEC 7.3: decodes the substreams with NumPy. Raises BitstreamError."""
    opened = [open_substream(piece, lanes, f"planes.{name}") for name, piece in zip(PLANE_NAMES, pieces, strict=True)]
    decoder = Decoder([stream for stream, _ in opened], trace)
    planes = code_planes(decoder, sarm, d.plane_channels, d.plane_size)
    # SPEC 10.1, SECTIONS: all errors of a substream precede those of the next one.
    for (_, before), after in zip(opened, decoder.finish(), strict=True):
        error = before or after
        if error is not None:
            raise error
    return planes


def emit_planes(planes: NDArray[np.int16], sarm: IntNetwork, lanes: int, native: NativeScene | None = None) -> bytes:
    """SPEC 5.10: returns the bytes of the section. planes: int16 [5, ch, B, B]. lanes: the lanes of each substream.

    native: encodes them instead of NumPy. Raises ValueError for a symbol that exceeds its limit.
    """
    require_limit(planes, PLANE_SYMBOL_MAX)
    if native is None:
        encoder = Encoder(PLANES, lanes)
        code_planes(encoder, sarm, planes.shape[1], planes.shape[2], planes)
        streams = encoder.finish()
    else:
        streams = native.encode_planes(planes)
    return syntax.build("PlaneTable", {"length": [len(s) for s in streams]}) + b"".join(map(padded, streams))


def no_planes() -> NDArray[np.int16]:
    """Returns the sub-planes of a scene without planes, int16 [5, 0, 0, 0]."""
    return np.zeros((PLANES, 0, 0, 0), dtype=np.int16)


def assemble_planes(planes: NDArray[np.int16]) -> JoinedPlanes:
    """SPEC 7.3, JOIN_QUADRANTS: returns the planes with r = 1, int16 [ch, B, B], and r = 2, int16 [ch, 2 B, 2 B].

    planes: the sub-planes, int16 [5, ch, B, B].
    """
    first, *quadrants = planes
    top, bottom = (np.concatenate(quadrants[i : i + 2], axis=2) for i in (0, 2))
    return first, np.concatenate([top, bottom], axis=1)
