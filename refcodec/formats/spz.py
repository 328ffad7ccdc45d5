"""SPZ files (Niantic): Gaussians in fixed point, attribute by attribute, in gzip (versions 1 to 3) or Zstandard (4).

Version 3 is written (https://github.com/nianticlabs/spz). The axes of a file point right, up and back. Those of PLY
files point right, down and forward. Thus y and z are negated, with the corresponding components of quaternions and
harmonics.
"""

import gzip
import re
import struct
import zlib
from dataclasses import dataclass

import numpy as np

from ..files.outputs import Kind
from . import packing
from .common import BITS_MOST, COMPENSATED, ContentError, Data, Options, check_count, cut_degree, remark
from .harmonics import REST
from .packing import U8, nearest_bytes
from .splats import Splats, moved, narrowed

GZIP, MAGIC = b"\x1f\x8b", b"NGSP"
WRITTEN, ZSTANDARD = 3, 4
# Magic, version, number of Gaussians, degree of harmonics, fractional bits of positions, flags, and a reserved byte,
# which is the number of streams in version 4.
HEADER = struct.Struct("<4sIIBBBB")
# Version 4: the offset of the stream table after the header. An entry has the compressed and the uncompressed size.
TABLE, STREAM = struct.Struct("<I"), struct.Struct("<QQ")
# The end of the offset and of 12 reserved bytes, where records of extensions begin: the kind, and the length.
TABLE_END, _RECORD, EXTENSIONS_MAX = 32, struct.Struct("<II"), 1 << 16
_ANTIALIASED, _EXTENDED, _DEGREE_MOST = 1, 2, 4
# Adobe's extensions: limits for cameras, and the axes of the file by the number of one of these conventions.
_ORBIT, _DECLARED = 0xADBE0002, 0xADBE0003
_CONVENTIONS = [
    *(x + y + z for z in "BF" for y in "DU" for x in "LR"),
    *(x + y + z for y in "FB" for z in "DU" for x in "LR"),
]
# Niantic's library (commit 21715c3b) turns these by half a turn more than their names say.
_AMBIGUOUS = ("LFD", "RFD", "LBU", "RBU")
# Left, right, up, down, back and front in PLY files.
_DIRECTIONS = dict(zip("RDFLUB", [*np.eye(3), *-np.eye(3)], strict=True))
# The gzip time marks the file as written by refcodec. It is unused otherwise, and constant for reproducible bytes.
_STAMP = b"C3GS"
KIND = Kind("an SPZ file that refcodec wrote", re.compile(rb"\x1f\x8b\x08\x00" + _STAMP))

# Positions have 24 bits. Steps below 2^-20 would exceed the precision of float32.
_POSITION_MOST, _FRACTION_MOST = (1 << 23) - 1, 20
# A step of positions is at most this share of the longest axis of nine in ten Gaussians. It loses nothing visible. In
# scenes of an ordinary size it is 2^-12, as in Niantic's library.
_STEP_SHARE, _QUANTILE = 1 / 64, 0.1
# Opacities o are stored as 255 o, coefficients c of degree 0 as 255 (0.15 c + 0.5), scales s as 16 (s + 10), and other
# coefficients c, from -1 to 1, as 128 c + 128. An encoder sets the lowest bits of these to 0, which gzip compresses.
_COLOUR, _SCALE, _SCALE_LEAST, _HARMONIC = 0.15, 16, -10, 128
# The components of quaternions, in the order x, y, z, w, have a sign and nine bits. All but the largest are at most the
# square root of 1/2.
_COMPONENT = 511
# The signs of x, y and z, and of the harmonics besides the first, when y and z are negated.
AXES = np.array([1, -1, -1])
HARMONIC_SIGNS = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])


@dataclass(frozen=True, eq=False)
class _Parts:
    """The bytes of each attribute, uint8 [n, bytes], in the order of the file."""

    position: U8
    opacity: U8
    colour: U8
    scale: U8
    rotation: U8
    rest: U8

    @staticmethod
    def widths(version: int, rest: int) -> tuple[int, ...]:
        """Returns the bytes of each part for a Gaussian with `rest` harmonics besides the first."""
        return (6 if version == 1 else 9, 1, 3, 3, 4 if version >= WRITTEN else 3, 3 * rest)


def read(data: Data) -> Splats:
    """Returns the Gaussians of a file. Raises ContentError."""
    packed = data[:2] == GZIP
    first = _gunzipped(data, HEADER.size, whole=False) if packed else data[: HEADER.size]
    if len(first) < HEADER.size or first[:4] != MAGIC:
        raise ContentError("it is not an SPZ file")
    _, version, count, stated, fraction, flags, streams = HEADER.unpack(first)
    if not (1 <= version < ZSTANDARD if packed else version == ZSTANDARD):
        raise ContentError(f"it is SPZ version {version}, but only versions 1 to 4 are supported")
    if stated > _DEGREE_MOST or fraction > 23:
        raise ContentError(
            f"it states harmonics of degree {stated} and {fraction} fractional bits; {_DEGREE_MOST} and 23 are the most"
        )
    check_count(count, len(data))
    widths = _Parts.widths(version, (stated + 1) ** 2 - 1)
    sizes = [count * width for width in widths]
    most = HEADER.size + sum(sizes) + EXTENSIONS_MAX
    body = _gunzipped(data, most, whole=True)[HEADER.size :] if packed else _unpacked(data, streams, sizes)
    if len(body) < sum(sizes):
        raise ContentError(f"it has fewer bytes than its {count} Gaussians need")
    parts = np.split(np.frombuffer(body, np.uint8, sum(sizes)), np.cumsum(sizes)[:-1])
    shaped = [part.reshape(count, width) for part, width in zip(parts, widths, strict=True)]
    shaped[-1] = shaped[-1][:, : 3 * REST[cut_degree(stated)]]
    splats = _splats(version, fraction, _Parts(*shaped))
    if flags & _ANTIALIASED:
        remark(COMPENSATED)
    if unknown := flags & ~(_ANTIALIASED | _EXTENDED):
        remark(f"its flags {unknown:#04x} are unknown: they are ignored")
    if not flags & _EXTENDED:
        return splats
    # The records are behind the header in version 4, and at the end before.
    return _extended(
        splats,
        body[sum(sizes) :] if packed else data[TABLE_END : TABLE.unpack_from(data, HEADER.size)[0]][:EXTENSIONS_MAX],
    )


def _extended(splats: Splats, records: bytes) -> Splats:
    """Returns Gaussians with what the records of extensions say about them. Raises ContentError."""
    place, unknown = 0, set[str]()
    while place + _RECORD.size <= len(records):
        kind, length = _RECORD.unpack_from(records, place)
        own = records[place + _RECORD.size : place + _RECORD.size + length]
        place += _RECORD.size + length
        if len(own) < length:
            raise ContentError(f"its extension {kind:#010x} is truncated")
        if kind == _DECLARED:
            number = int.from_bytes(own, "little") if length == 4 else 0
            if not 1 <= number <= len(_CONVENTIONS):
                raise ContentError(f"it declares axes by {own[:8].hex()}, which is none of Niantic's 16 conventions")
            name = _CONVENTIONS[number - 1]
            if name in _AMBIGUOUS:
                raise ContentError(f"its axes are {name}, which programs understand differently", "export it as RUB")
            # The axes of a file are the columns.
            turn = np.stack([_DIRECTIONS[axis] for axis in name], axis=1)
            splats = moved(splats, turn * AXES, np.zeros(3))
        elif kind != _ORBIT:
            unknown.add(f"{kind:#010x}")
    if unknown:
        remark(f"its extensions {', '.join(sorted(unknown)[:9])} are unknown: they are ignored")
    return splats


def _gunzipped(data: Data, most: int, whole: bool) -> bytes:
    """Returns a bounded number of first bytes of gzip data. whole: they are all, and checked. Raises ContentError."""
    unpacker = zlib.decompressobj(wbits=31)
    try:
        # The checksum is read behind the last byte.
        plain = unpacker.decompress(data, most + whole)
    except zlib.error as error:
        raise ContentError(f"its gzip stream is damaged ({error})") from None
    if whole and len(plain) > most:
        raise ContentError(f"it has more bytes than its Gaussians need, and {EXTENSIONS_MAX} for extensions")
    if whole and not unpacker.eof:
        raise ContentError("its gzip stream has no end, as if it were cut", "copy or export it again")
    return plain


def _unpacked(data: Data, count: int, sizes: list[int]) -> bytes:
    """Returns the concatenated streams of version 4. Raises ContentError."""
    try:
        import zstandard  # noqa: PLC0415 (an extra)
    except ModuleNotFoundError:
        advice = "pip install 'refcodec[convert]', or convert it to PLY"
        raise ContentError("it is SPZ version 4, which requires zstandard", advice) from None
    wanted = [size for size in sizes if size]
    start = TABLE.unpack_from(data, HEADER.size)[0] if len(data) >= HEADER.size + TABLE.size else len(data)
    place, streams = start + count * STREAM.size, []
    if count != len(wanted) or place > len(data):
        raise ContentError(f"it has {count} streams, but must have {len(wanted)} complete ones")
    for number, plain in enumerate(wanted):
        size, stated = STREAM.unpack_from(data, start + number * STREAM.size)
        packed, stream = data[place : place + size], b""
        try:
            # A frame may state any size, which is allocated.
            if stated == plain and len(packed) == size and zstandard.frame_content_size(packed) in (-1, plain):
                decompressor = zstandard.ZstdDecompressor(max_window_size=1 << 27)
                stream = decompressor.decompress(packed, max_output_size=plain, allow_extra_data=False)
        except zstandard.ZstdError as error:
            raise ContentError(f"its stream {number} is damaged ({error})") from None
        if len(stream) != plain:
            raise ContentError(f"its stream {number} does not have {plain} bytes")
        streams.append(stream)
        place += size
    return b"".join(streams)


@np.errstate(invalid="ignore")
def _splats(version: int, fraction: int, parts: _Parts) -> Splats:
    """Returns the Gaussians of the bytes of their parts."""
    count = len(parts.position)
    if version == 1:
        mean = parts.position.copy().view("<f2").astype(np.float64)
    else:
        wide = np.zeros((count, 3, 4), np.uint8)
        wide[:, :, 1:] = parts.position.reshape(count, 3, 3)
        # In the upper bytes of 32 bits, so that the sign bit is correct.
        mean = (wide.reshape(count, 12).view("<i4") >> 8) / 2.0**fraction
    if version >= WRITTEN:
        word = parts.rotation.copy().view("<u4")[:, 0].astype(np.int64)
        fields = np.stack([word >> shift & 1023 for shift in (20, 10, 0)], axis=1)
        others = (fields & 511) / _COMPONENT * np.sqrt(0.5) * np.where(fields & 512, -1, 1)
        quaternion = np.roll(packing.with_largest(word >> 30, others), 1, axis=1)
    else:
        vector = parts.rotation / 127.5 - 1
        scalar = np.sqrt(np.maximum(1 - (vector**2).sum(axis=1), 0))
        quaternion = np.concatenate([scalar[:, None], vector], axis=1)
    # The coefficients are most of a file, and exact in float32.
    rest = parts.rest.reshape(count, parts.rest.shape[1] // 3, 3).astype(np.float32)
    rest -= _HARMONIC
    rest *= HARMONIC_SIGNS[: rest.shape[1], None].astype(np.float32) / _HARMONIC
    return narrowed(
        mean=mean * AXES,
        base=(parts.colour / 255 - 0.5) / _COLOUR,
        rest=rest,
        opacity=packing.logits(parts.opacity[:, 0] / 255, packing.BYTE_OPACITY_LEAST),
        scale=parts.scale / _SCALE + _SCALE_LEAST,
        quaternion=quaternion * (1, *AXES),
    )


def write(splats: Splats, options: Options) -> bytes:
    """Returns a file. Raises ValueError for positions of 2^23 or more, which the format cannot hold.

    A few Gaussians far out, which fine steps do not reach, are drawn in.
    """
    count, fraction = len(splats.mean), _fraction(splats)
    splats = packing.drawn_in(splats, _POSITION_MOST / 2.0**fraction)
    fixed = np.rint(splats.mean.astype(np.float64) * AXES * 2.0**fraction).clip(-_POSITION_MOST, _POSITION_MOST)
    position = np.ascontiguousarray(fixed, "<i4").view(np.uint8).reshape(count, 3, 4)
    largest, others = packing.smaller_components(splats.unit_quaternions()[:, [1, 2, 3, 0]] * (*AXES, 1))
    magnitude = np.minimum(np.floor(_COMPONENT * np.sqrt(2) * np.abs(others) + 0.5), 511).astype("<u4")
    word = largest.astype("<u4")
    for sign, value in zip((others < 0).T, magnitude.T, strict=True):
        word = (word << np.uint32(10)) | (sign.astype("<u4") << np.uint32(9)) | value
    step = 1 << (BITS_MOST - options.spz_bits)
    signs = HARMONIC_SIGNS[: splats.rest.shape[1], None]
    rest = nearest_bytes(step * np.rint(_HARMONIC / step * splats.rest * signs) + _HARMONIC)
    parts = _Parts(
        # The lowest three bytes of each position, the lowest first.
        position[:, :, :3].reshape(count, 9),
        nearest_bytes(packing.opacities(splats)[:, None] * 255),
        nearest_bytes((_COLOUR * splats.base + 0.5) * 255),
        nearest_bytes((splats.scale - _SCALE_LEAST) * _SCALE),
        word.astype("<u4").view(np.uint8).reshape(count, 4),
        rest.reshape(count, rest.shape[1] * 3),
    )
    head = HEADER.pack(MAGIC, WRITTEN, count, splats.degree, fraction, 0, 0)
    body = b"".join(part.tobytes() for part in vars(parts).values())
    return gzip.compress(head + body, mtime=int.from_bytes(_STAMP, "little"))


def _fraction(splats: Splats) -> int:
    """Returns the number of fractional bits of positions: those of a fine step, or fewer if the largest has no more."""
    largest = float(np.abs(splats.mean[packing.bulk(splats.mean)]).max())
    if (farthest := float(np.abs(splats.mean).max())) > _POSITION_MOST:
        raise ValueError(f"a position is at {farthest:.6g}, but SPZ positions are below 2^23")
    most = min(_FRACTION_MOST, 22 - int(np.floor(np.log2(max(largest, 1.0)))))
    axis = float(np.quantile(splats.scale.max(axis=1), _QUANTILE)) / np.log(2)
    return int(np.clip(np.ceil(-np.log2(_STEP_SHARE) - axis), 0, most))
