"""Cases of clause 13.1: small files that require or claim much memory or time. They test the budgets."""

import struct
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import RENDERING, Dimensions, layers_of
from refcodec.bitstream.directory import DATA, INDEX, SECTION_LENGTH_MAX
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.index import index_bytes
from refcodec.bitstream.limits import MAIN, PROFILES
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.encoder.positions import position_model

from .checksums import Depth, repair, resized
from .directory import long_sections
from .entropy_substreams import symbol_crc, word_count
from .fault import Edit, Whole, fault
from .numbers import Numbers
from .positions import overgrown
from .samplers import drawn
from .scenes import MIDDLE, SMALLEST, f16, of_cells, only_symbols, placed, scene, sharp_model, with_symbols
from .table import More, refused, valid
from .target import Target
from .targets import main_file, target_of
from .weights import ALL, QUIET_SARM, constant, set_weights

_ONE_LANE = Dimensions(10, (16, 16), 8, 1, 32, (16, 16), (16,), (16,), 16)
_LARGEST = Dimensions(10, (16, 16), 8, 1, 32, (4,), (4,), (2,), 1)
# SPEC [R6.10-5]: the smallest length of a chunk of 16,384 anchors.
FLOOR = 16 + 16384 // 16
# The number of anchors with a nonzero feature, which takes bytes, in the chunk of the smallest length.
COSTLY = 242

# --- faults -----------------------------------------------------------------------------------------------------------


@fault("directory.length")
def anchors_without_chunks(t: Target, values: dict[str, int]) -> Edit:
    """The header has more chunks than the index has entries. values: fields, within the limits of the level."""
    return Edit(t.pack(values), t.at(f"directory[{t.sections[INDEX].number}].length"))


@fault("section.truncated")
def index_beyond(t: Target, level: int) -> Whole:
    """There are as many anchors as a level of Main allows, each in its own chunk, and no entry of the index."""
    most = PROFILES[MAIN].levels[level].anchors
    length = index_bytes(t.header.dimensions.offset_count, t.sections[INDEX].mode, most)
    counts = {"anchor_count": most, "chunk_count": most, "chunk_size": 256, "level": level}
    data = t.with_values(counts | {f"directory[{t.sections[INDEX].number}].length": length}, Depth.HEADER)
    return Whole(data, len(data))


def announced(t: Target, level: int, chunks: int, length: int, content: bytes = b"") -> bytes:
    """Returns a file of Main with many chunks of 16,384 anchors, all of which have entries in the index.

    length: of each chunk. content: the present bytes of DATA.
    """
    data = resized(t.data, INDEX, t.content(INDEX) + struct.pack("<4I12x", length, 0, 16384, 0) * chunks)
    out = bytearray(data + content)
    counts = {"anchor_count": 16384 * chunks, "chunk_count": chunks, "chunk_size": 16384, "level": level}
    total = {f"directory[{t.sections[DATA].number}].length": chunks * length}
    for at, value in t.pack(counts | total).items():
        out[at : at + len(value)] = value
    return repair(bytes(out))


@fault("section.truncated")
def chunks_without_bytes(t: Target, level: int, chunks: int, length: int) -> Whole:
    """There are many entries with allowed lengths, but no chunks."""
    data = announced(t, level, chunks, length)
    return Whole(data, len(data))


@fault("index.chunk")
def crowded(t: Target, level: int, chunks: int, length: int) -> Whole:
    """The chunks have fewer bytes than their anchors need."""
    at = t.start(INDEX) + t.sections[INDEX].length
    return Whole(announced(t, level, chunks, length), at)


@fault("chunk.length")
def chunks_of_zeros(t: Target, level: int, chunks: int) -> Whole:
    """The chunks have the smallest length, and all bytes are zero."""
    data = announced(t, level, chunks, FLOOR, bytes(FLOOR * chunks))
    return Whole(data, len(data) - FLOOR * chunks)


# --- files of which most takes no bits --------------------------------------------------------------------------------


def _quiet(name: str, anchors: int, d: Dimensions, chunk_size: int, **changes: Any) -> Scene:
    """Returns a scene with positions of few bits, and symbols of 0, which take almost no bits.

    changes: as of scene.
    """
    quiet = (*QUIET_SARM, *((network, ALL, 0, 0) for network in RENDERING))
    side, n = 16 if anchors <= 4096 else 32, np.arange(anchors)
    fields = {
        "networks": set_weights(constant(d, Numbers(name)), *quiet),
        "positions": of_cells(MIDDLE + np.stack([n % side, n // side % side, n // side**2], axis=1), 20),
        "masks": np.zeros((anchors, d.offset_count), bool),
        "mask_model": np.ones(d.offset_count * (d.offset_count + 1) // 2, np.uint16),
        "weight_scales": np.zeros((len(layers_of(d)), 3), np.uint8),
        "planes": np.zeros((5, d.plane_channels, d.plane_size, d.plane_size), np.int16),
        "lanes": Lanes(3, 0, 3 if chunk_size > 9 else 0),
    }
    return only_symbols(scene(name, anchors, d, chunk_size=chunk_size, **{**fields, **changes}))


def _packed(made: Scene, chunk_size: int, costly: int = 0) -> Scene:
    """Returns the scene with packed positions. costly: anchors with large features, so that a chunk is long enough."""
    features = np.zeros_like(made.attributes.features)
    features[:costly] = 1
    return with_symbols(replace(made, position_model=position_model(made.positions, chunk_size)), features=features)


def _at_floor() -> bytes:
    made = _quiet("resource-floor", 16384, SMALLEST, 16384, profile=MAIN, lanes=Lanes(0, 5, 7))
    data = codec.emit(_packed(made, 16384, COSTLY))
    assert Target(data).value("index.entry[0].length") == FLOOR
    return data


_large_chunks = target_of(lambda: _quiet("resource-chunks", 4096, SMALLEST, 2048))
_one_lane = target_of(
    lambda: _packed(_quiet("resource-one-lane", 1024, _ONE_LANE, 1024, lanes=Lanes(0, 0, 0)), 1024, costly=4)
)
_one_tree = target_of(
    lambda: placed("resource-tree", f16(np.arange(192).reshape(64, 3)), sharp_model(), lanes=Lanes(0, 0, 0))
)

# fmt: off
_many = partial(refused, requirements="D13.1-1", klass="resource")
_accepted = partial(valid, klass="resource")
CASES = [
    *_many("many", "allocates-first lengths-trusted",
        *((f"anchors-of-level-{level}", f"a file of a few kilobytes with {most.anchors} anchors, each of them a chunk",
           main_file, index_beyond, level) for level, most in PROFILES[MAIN].levels.items()),
        ("anchors-in-large-chunks", "16,777,216 anchors in 1,024 chunks, of which there is the index alone", main_file,
         chunks_without_bytes, 40, 1024, FLOOR),
        ("anchors-in-few-bytes", "16,777,216 anchors in chunks with fewer bytes than these need", main_file, crowded,
         40, 1024, FLOOR - 4),
        ("anchors-of-zeros", "524,288 anchors in 32 chunks of zeros, as few bytes as these can have", main_file,
         chunks_of_zeros, 20, 32),
        ("lengths-of-gigabytes", "an index that announces terabytes", main_file, chunks_without_bytes, 40, 1024,
         0xFFFFFFFC),
        ("section-of-4-gigabytes", "an ancillary section of four gigabytes", long_sections, {6: 0xFFFFFFFF}),
        ("section-of-256-terabytes", "an ancillary section of 256 terabytes", long_sections, {6: SECTION_LENGTH_MAX}),
        ("words-of-4-gigabytes", "a substream of two thousand million words", word_count, "attributes[chunk 1]",
         0x7FFFFFFF),
        ("chunks-of-one", "4,096 anchors in as many chunks, in a file that has two", _large_chunks,
         anchors_without_chunks, {"chunk_size": 1, "chunk_count": 4096})),
    # There would be 8^16 cells without a limit.
    *_many("many", "tree-dropped allocates-first",
        ("tree-of-all-cells", "a tree all of whose nodes have all their children", _one_tree, overgrown, 16)),
    # The last check of a substream, after all of its symbols.
    *_many("many", "symbol-crc", *(
        (f"one-lane-{path.partition('[')[0].replace('.', '-')}", f"one lane, and a wrong symbol_crc of {path}",
         _one_lane, symbol_crc, path, 0, 1, More(seconds=120))
        for path in ("weights", "planes.r1", "positions[chunk 0]", "masks[chunk 0]", "attributes[chunk 0]"))),
    *_accepted("many", "buffer-too-small", "D13.1-1",
        ("largest-tiny", "as many anchors and planes as Tiny allows, most of them predicted",
         lambda: _packed(_quiet("resource-largest", 4096, _LARGEST, 192), 192), More(seconds=120)),
        ("many-chunks", "1,000 chunks of one anchor", _quiet, "resource-chunks", 1000, SMALLEST, 1,
         More(features="chunks", seconds=60)),
        ("chunk-at-the-floor", "a chunk of 16,384 anchors in 1,040 bytes, as few as these can have", _at_floor,
         More(features="main", seconds=120)),
        ("one-lane", "one lane in each substream, and symbols that take next to no bytes", lambda: _one_lane().data,
         More(features="lanes", seconds=120)),
        ("many-sections", "3,000 ancillary sections without bytes",
         lambda: replace(drawn("sections", 1, SMALLEST), ancillary=(Ancillary(b"noTE", 0, b""),) * 3000),
         More(features="ancillary"))),
]
