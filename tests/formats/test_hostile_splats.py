"""Damaged and hostile splat files: the outcome is finite Gaussians or one line, in bounded memory."""

import base64
import gzip
import io
import json
import os
import random
import re
import struct
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("PIL", reason="SOG has images")

from PIL import Image

from refcodec.folder.layout import SceneFolderError
from refcodec.formats.table import FORMATS, read_located, read_splats, splats_up, write_splats

FOREIGN = Path(__file__).with_name("foreign")
SPLATS = read_splats(FOREIGN / "playbot.ply")
COUNT = len(SPLATS.mean)
# The bytes that a file may make Python allocate, beside some times its own length, as far as Gaussians account for it.
MEMORY = 16 << 20

Repack = Callable[[bytes], bytes]


def outcome(file: Path, data: bytes, read: Callable[[Path], Any] = read_splats) -> str:
    """Reads bytes as a file. Returns the line of the refusal, or an empty string. What is read is finite."""
    file.write_bytes(data)
    tracemalloc.start()
    line = ""
    try:
        splats = read(file)
    except SceneFolderError as error:
        line = str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < MEMORY + 4 * len(data)
    if line:
        assert line.startswith(f"{file}: ")
        assert "\n" not in line
    elif read is read_splats:
        assert len(splats.mean)
        assert all(np.isfinite(values).all() for values in vars(splats).values())
    return line


# --- layers of files: what a change of bytes would not reach ----------------------------------------------------------


def zipped(entries: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", method) as out:
        for name, data in entries.items():
            out.writestr(zipfile.ZipInfo(name), data, method)
    return archive.getvalue()


def entries_of(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def glb(text: bytes, body: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body


def layer(suffix: str, data: bytes) -> tuple[bytes, Repack]:
    """Returns the bytes within a file that it compresses or whose length it states, and what puts changed ones back."""
    if suffix == ".spz" and data[:2] == b"\x1f\x8b":
        return gzip.decompress(data), partial(gzip.compress, mtime=0)
    if suffix == ".sog":
        entries = entries_of(data)
        return entries["meta.json"], lambda text: zipped(entries | {"meta.json": text})
    if suffix == ".glb":
        length = struct.unpack_from("<I", data, 12)[0]
        return data[20 : 20 + length], lambda text: glb(text, data[28 + length :])
    return data, lambda inner: inner


def json_(path: str, value: Any) -> Callable[[bytes], bytes]:
    """Replaces a value of a JSON text."""

    def change(text: bytes) -> bytes:
        root = json.loads(text)
        *above, last = path.split("/")
        node = root
        if path == "nodes":
            del root["scenes"]
        for key in above:
            node = node[int(key) if isinstance(node, list) else key]
        node[int(last) if isinstance(node, list) else last] = value
        return json.dumps(root).encode()

    return change


def own(suffix: str) -> bytes:
    return write_splats(SPLATS, suffix)


def as_text(data: bytes) -> bytes:
    """A GLB file as a .gltf file, with its numbers within."""
    text, repack = layer(".glb", data)
    uri = "data:application/octet-stream;base64," + base64.b64encode(repack(b"")[28:]).decode()
    return json_("buffers/0/uri", uri)(text)


SOURCES: dict[str, tuple[str, bytes]] = {suffix: (suffix, own(suffix)) for suffix in FORMATS} | {
    name: (Path(name).suffix, (FOREIGN / name).read_bytes())
    for name in ("playbot-plyfile.ply", "playbot-splat-transform.spz", "playbot-pygltflib.glb")
}
SOURCES[".gltf"] = (".gltf", as_text(own(".glb")))


# --- the matrix -------------------------------------------------------------------------------------------------------


def cut(_: str, data: bytes, rng: random.Random) -> Iterator[bytes]:
    for _number in range(30):
        yield data[: rng.randrange(len(data))]


def changed(_: str, data: bytes, rng: random.Random) -> Iterator[bytes]:
    for _number in range(90):
        some = bytearray(data)
        for _change in range(rng.randrange(1, 5)):
            # Headers and directories are at the ends.
            place = rng.choice([rng.randrange(len(some)), rng.randrange(min(len(some), 900)), -1 - rng.randrange(300)])
            some[place] = rng.randrange(256)
        yield bytes(some)


def lengths(suffix: str, data: bytes, _: random.Random) -> Iterator[bytes]:
    """Each number of the text, and each word of the first bytes, asks for much."""
    inner, repack = layer(suffix, data)
    for match in [*re.finditer(rb"[0-9]+", inner[:6000])][:30]:
        for large in (b"4294967295", b"16777216", b"1048576", b"9" * 30):
            yield repack(inner[: match.start()] + large + inner[match.end() :])
    for outer, put in ((data, lambda changed: changed), (inner, repack)):
        for place in range(0, min(len(outer), 120), 2):
            yield put(outer[:place] + b"\xff\xff\xff\xff" + outer[place + 4 :])


def not_finite(suffix: str, data: bytes, rng: random.Random) -> Iterator[bytes]:
    """Numbers of the text, and words of the rest, that are NaN, infinite or nearly so."""
    inner, repack = layer(suffix, data)
    for match in rng.sample([*re.finditer(rb"-?[0-9]+\.[0-9e-]+|[0-9]+", inner)], 12) if suffix != ".spz" else []:
        for text in (b"NaN", b"1e999", b"-1e38"):
            yield repack(inner[: match.start()] + text + inner[match.end() :])
    for form, number in product((">f", "<f"), (np.nan, np.inf, -3e38)):
        for _number in range(10):
            place = rng.randrange(len(data) // 2, len(data) - 4)
            yield data[:place] + struct.pack(form, number) + data[place + 4 :]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("harm", [cut, changed, lengths, not_finite])
@pytest.mark.parametrize("source", SOURCES)
def test_harm(source: str, harm: Callable[[str, bytes, random.Random], Iterator[bytes]], tmp_path: Path) -> None:
    suffix, data = SOURCES[source]
    if data[:4] == b"NGSP":
        pytest.importorskip("zstandard")
    refusals = [outcome(tmp_path / f"a{suffix}", bad) for bad in harm(suffix, data, random.Random(3))]
    # Gaussians with numbers that are not finite are left out.
    assert any(refusals) or harm is not_finite
    assert outcome(tmp_path / f"a{suffix}", data) == ""


# --- what is refused, with its line -----------------------------------------------------------------------------------


def bytes_(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    """Replaces bytes that are there."""

    def change(data: bytes) -> bytes:
        assert old in data
        return data.replace(old, new)

    return change


def at(place: int, new: bytes) -> Callable[[bytes], bytes]:
    return lambda data: data[:place] + new + data[place + len(new) :]


PLY, PACKED, PRIMITIVE = ".ply", ".compressed.ply", "meshes/0/primitives/0"
OWN, SPLATTING = f"{PRIMITIVE}/extensions/KHR_gaussian_splatting", "KHR_gaussian_splatting"
# A suffix, the change of what its file has within, and the refusal.
REFUSED: list[tuple[str, Callable[[bytes], bytes], str]] = [
    *((PLY, bytes_(f"float {name}\n".encode(), b"float u\n"), f"no property {name}") for name in ("x", "f_dc_2")),
    *((PLY, bytes_(f"{name}\n".encode(), b"u\n"), f"no property {name}") for name in ("opacity", "scale_0", "rot_3")),
    (PLY, bytes_(b"f_rest_3\n", b"g_rest_3\n"), "23 coefficients f_rest, but must have 0 or 9 or 24 or 45"),
    (PLY, bytes_(b"element vertex", b"element face"), "no element vertex"),
    (PLY, bytes_(b"float rot_0\n", b"float rut_0\n"), "it is a point cloud, not a splat"),
    (PLY, bytes_(b"float scale_2\n", b"float scale_9\n"), "which have no third axis"),
    (PLY, bytes_(b"float nx\n", b"float f_offset_0\n"), "a model of Scaffold-GS"),
    (PLY, bytes_(b"vertex 40", b"vertex 0"), "no Gaussians"),
    (PLY, bytes_(b"vertex 40", b"vertex 1099511627776"), "a count of at most"),
    (PLY, lambda _: b"ply\nformat ascii 1.0\nelement vertex 4000000000\nend_header\n", "4000000000 Gaussians, but at"),
    (PACKED, bytes_(b"element chunk 1", b"element chunc 1"), "no element chunk"),
    (PACKED, bytes_(b"packed_scale", b"packed_scalf"), "no property packed_scale"),
    (PACKED, bytes_(b"uint packed_color", b"float packed_color"), "no property packed_color"),
    (PACKED, bytes_(b"float max_scale_y", b"float max_scale_v"), "no property max_scale_y"),
    (PACKED, bytes_(b"uchar f_rest_0\n", b"uchar g_rest_0\n"), "23 coefficients f_rest"),
    (".spz", lambda _: b"", "not an SPZ"),
    (".spz", lambda data: data[:4], "not an SPZ"),
    (".spz", at(0, b"PSGN"), "not an SPZ"),
    (".spz", at(4, b"\x05"), "version 5, but only versions 1 to 4"),
    (".spz", at(4, b"\x04"), "version 4"),
    (".spz", at(8, b"\xff\xff\xff\xff"), "at most 16777216"),
    (".spz", at(8, b"\0\0\0\1"), "16777216 Gaussians, but has only"),
    (".spz", at(8, b"\0\0\x10\0"), "fewer bytes than its 1048576"),
    (".spz", at(8, b"\0\0\0\0"), "no Gaussians"),
    (".spz", at(12, b"\x05"), "degree 5"),
    (".spz", lambda data: at(14, b"\2")(data) + struct.pack("<III", 0xADBE0003, 4, 9), "its axes are LFD, which"),
    (".spz", lambda data: at(14, b"\2")(data) + struct.pack("<III", 0xADBE0003, 4, 17), "none of Niantic's 16"),
    (".spz", lambda data: at(14, b"\2")(data) + struct.pack("<III", 0xADBE0003, 5, 6), "0xadbe0003 is truncated"),
    (".spz", at(13, b"\x18"), "24 fractional"),
    (".spz", lambda data: data[:-1], "fewer bytes"),
    (".sog", json_("version", 3), "version 3, but only version 2"),
    (".sog", bytes_(b'"version":2,', b""), "version 1, but only version 2 is supported; `splat-transform meta.json"),
    (".sog", json_("count", 17_000_000), "17000000 Gaussians"),
    (".sog", json_("count", 9_000_000), "9000000 Gaussians, but has only"),
    (".sog", json_("count", 900_000), "pixels for 900000"),
    (".sog", json_("count", "a"), "count in its meta.json is 'a': an integer is required"),
    (".sog", json_("means/files/0", "other.webp"), "no entry other.webp"),
    (".sog", json_("shN/bands", 4), "shN/bands in its meta.json is 4: an integer <= 3 is required"),
    (".sog", json_("shN/bands", 3), "pixels"),
    (".sog", json_("shN/bands", 1), "does not have 40 entries in rows of 64"),
    (".sog", json_("shN/count", 20), "beyond the 20 of the palette"),
    (".sog", json_("shN/codebook", [0.5] * 255), "length >= 256"),
    (".sog", json_("quats", {}), "has no quats/files/0"),
    (".sog", bytes_(b'{"version"', b'{"a" "version"'), "not JSON"),
    (".glb", lambda text: b"{]", "chunk JSON is not JSON"),
    (".glb", lambda text: b"[]", "0 primitives with KHR_gaussian_splatting"),
    (".glb", json_("meshes", []), "0 primitives"),
    (".glb", json_(f"{PRIMITIVE}/extensions", [0]), "0 primitives with KHR_gaussian_splatting, so it is no splat"),
    (".glb", json_("nodes/0/scale", [1, 1.01, 1]), "its nodes shear meshes/0, or scale its axes differently"),
    (".glb", json_("nodes/0/scale", [0, 0, 0]), "its nodes shear"),
    (".glb", json_("nodes/0/matrix", [1, 0.1, *[0] * 13, 1]), "its nodes shear"),
    (".glb", json_("nodes/0/translation", [1e300, 0, 0]), "nodes/0/translation/[0] in its chunk JSON is 1e+300"),
    (".glb", json_("nodes/0/skin", 0), "its node 0 has skin, which is not supported"),
    (".glb", json_("nodes/0/extensions", {"EXT_mesh_gpu_instancing": {}}), "node 0 has extensions/EXT_mesh_gpu_inst"),
    (".glb", json_("nodes/0/children", [0]), "its nodes are not trees: node 0"),
    (".glb", json_("scenes/0/nodes", [4]), "its nodes are not trees: node 4 is missing"),
    (".glb", json_("scenes/0/nodes", [0] * 9), "its nodes are not trees: node 0"),
    (".glb", json_("nodes", [{"mesh": 0}] * 5000), "its nodes show splats 5000 times, but 4096 are the most"),
    (".glb", json_(f"{PRIMITIVE}/targets", [{}]), "targets of morphing"),
    (".glb", json_("extensionsRequired", ["EXT_a"]), "it requires EXT_a, which is not supported"),
    (".glb", json_("bufferViews/0/extensions", {"EXT_meshopt_compression": {}}), "compressed by EXT_meshopt_compress"),
    (".glb", json_(f"{OWN}/kernel", "cube"), "its kernel is 'cube', but only 'ellipse'"),
    (".glb", json_(f"{OWN}/extensions", {"spz": {}}), "compressed by spz, which is not supported"),
    (".glb", json_(f"{PRIMITIVE}/attributes/{SPLATTING}:SCALE", 2), "SCALE does not have 3 numbers"),
    (".glb", json_(f"{PRIMITIVE}/attributes/{SPLATTING}:SCALE", 99), "no accessors/99/componentType"),
    (".glb", json_(f"{PRIMITIVE}/attributes", {"POSITION": 0}), "no attribute KHR_gaussian_splatting:OPACITY"),
    (".glb", json_("accessors/0/count", 1 << 40), "count in its chunk JSON is 1099511627776: an integer <="),
    (".glb", json_("accessors/0/count", 900_000), "POSITION lies outside"),
    (".glb", json_("accessors/0/count", 0), "no Gaussians"),
    (".glb", json_("accessors/4/count", 9), "9 rows for 40"),
    (".glb", json_("accessors/0/componentType", 5125), "POSITION does not have 3 numbers"),
    (".glb", json_("accessors/0/componentType", 5122), "POSITION has integers that are not normalized"),
    (".glb", json_("accessors/0/sparse", {}), "sparse"),
    (".glb", json_("accessors/0/byteOffset", 8), "POSITION lies outside"),
    (".glb", json_("bufferViews/0/buffer", 1), "in another file"),
    (".glb", json_("buffers/0/uri", "a.bin"), "in another file"),
    (".glb", json_("bufferViews/0/byteOffset", -1), "byteOffset in its chunk JSON is -1: an integer >= 0"),
    (".glb", json_("bufferViews/0/byteLength", 1 << 31), "outside the binary chunk"),
    (".glb", json_("bufferViews/0/byteStride", 4), "its rows overlap"),
]


@pytest.mark.parametrize(("suffix", "change", "reason"), REFUSED, ids=[row[2][:40] for row in REFUSED])
def test_refused(suffix: str, change: Callable[[bytes], bytes], reason: str, tmp_path: Path) -> None:
    inner, repack = layer(suffix, own(suffix))
    assert reason in outcome(tmp_path / f"a{suffix}", repack(change(inner)))


PIXEL = io.BytesIO()
Image.new("RGBA", (4000, 4000)).save(PIXEL, "WEBP", lossless=True)
STREAMS, SOG_ENTRIES = SOURCES["playbot-splat-transform.spz"][1], entries_of(own(".sog"))
# A suffix, a whole file, and the refusal; empty for none.
FILES: list[tuple[str, bytes, str]] = [
    (".spz", b"\x1f\x8b" + bytes(50), "gzip stream is damaged"),
    (".spz", gzip.decompress(own(".spz")), "version 3"),
    # A gzip bomb is not unpacked further than it states.
    (".spz", gzip.compress(gzip.decompress(own(".spz")) + bytes(300 << 20), 1), "more bytes than its Gaussians need"),
    (".spz", own(".spz")[:-8] + bytes(8), "incorrect data check"),
    *((".spz", own(".spz")[:-cut], "no end, as if it were cut") for cut in (1, 8, 12)),
    (".spz", at(112, b"\xa4")(STREAMS[:-1]), "stream 5 is damaged"),
    (".glb", at(8, b"\xff" * 4)(own(".glb")), "it states 4294967295 bytes"),
    (".spz", at(15, b"\xc8")(STREAMS), "it has 200 streams"),
    (".spz", at(40, (1 << 40).to_bytes(8, "little"))(STREAMS), "stream 0 does not have"),
    (".spz", at(16, b"\xff\xff\xff\xff")(STREAMS), "complete ones"),
    (".spz", at(200, bytes(20))(STREAMS), "stream"),
    (".spz", STREAMS[:-20], "stream"),
    (".sog", b"PK\x03\x04 and nothing", "not a zip archive"),
    (".sog", zipped(SOG_ENTRIES | {"scales.webp": b"GIF89a" + bytes(99)}), "scales.webp is neither WebP nor PNG"),
    (".sog", zipped(SOG_ENTRIES | {"scales.webp": PIXEL.getvalue()}), "4000 x 4000 pixels for 40"),
    (".sog", zipped(SOG_ENTRIES | {"scales.webp": SOG_ENTRIES["scales.webp"][:90]}), "scales.webp cannot be read"),
    (".sog", zipped({"meta.json": b" " * (64 << 20)}, zipfile.ZIP_DEFLATED), "meta.json has more than"),
    (".sog", zipped({f"{number:0100}": b"" for number in range(3000)}), "directory has more than"),
    (".sog", zipped(SOG_ENTRIES, zipfile.ZIP_LZMA), "neither stored nor deflated"),
    (".glb", b"", "it is an empty file"),
    (".splat", bytes(33), "33 bytes, but a .splat file has 32 for each"),
    (".gltf", b"{}", "no buffers/0/uri"),
    (".gltf", b'{"buffers":[{"uri":"../a.bin"}]}', "no file ../a.bin beside it"),
    (".gltf", b'{"buffers":[{"uri":"data:;base64,@"}]}', "not base64"),
    (".ply", b"\x1f\x8b" + bytes(9), "compressed by gzip; unpack it"),
    (".ply", b"ply\nformat ascii 1.0\nelement face 1\nproperty list int int a\nend_header\n0\n", "a mesh is no splat"),
    (".spz", own(".ply"), "a file of the kind .ply; give it this suffix"),
    (".ply", b" <!DOCTYPE html><p>", "it is a web page; download"),
    (".ply", b"version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS, not the file; run `git lfs pull`"),
    (".sogs", b"1", "a splat of another format; export PLY"),
    (".ksplat", bytes(4096), "`splat-transform a.ksplat scene.ply`"),
    (".spx", b"1", "`gsbox spx2ply -i a.spx"),
    (".usdz", b"1", "it is a scene of USD"),
    (".bin", zipped({"archive/data.pkl": b""}), "it is a checkpoint of a training; export PLY"),
    (".bin", zipped({"a.ply": b""}), "it is an archive; unpack it"),
    (".jpg", b"1", "it is an image; give the folder of photographs to `refcodec train`"),
    (".txt", b"1", "it is neither a model folder nor a splat file; give one of .ply"),
    (".glb", b"glTF\x01" + bytes(30), "not a GLB"),
    (".glb", b"glTF\x02" + bytes(7), "chunk JSON is missing"),
    (".glb", b"glTF\x02" + bytes(7) + struct.pack("<I4s", 5000, b"JSON") + bytes(99), "is missing or truncated"),
    (".glb", glb(bytes(2 << 20), b""), "JSON has more than"),
    (".glb", b"glTF\x02" + bytes(7) + struct.pack("<I4s2s", 2, b"JSON", b"[]"), "chunk BIN is missing"),
]


@pytest.mark.parametrize(("suffix", "data", "reason"), FILES, ids=[row[2][:40] for row in FILES])
def test_files(suffix: str, data: bytes, reason: str, tmp_path: Path) -> None:
    if data[:4] == b"NGSP":
        pytest.importorskip("zstandard")
    line = outcome(tmp_path / f"a{suffix}", data)
    assert reason in line
    assert bool(line) == bool(reason)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", vars(SPLATS))
@pytest.mark.parametrize("number", [np.nan, np.inf, -1e30])
def test_numbers_out_of_range(name: str, number: float, tmp_path: Path) -> None:
    """A Gaussian without a place or a shape is left out, and so is one with too large a number."""
    values = getattr(SPLATS, name).copy()
    values.reshape(-1)[7] = number
    file, notes = tmp_path / "a.ply", list[str]()
    line = outcome(file, write_splats(replace(SPLATS, **{name: values}), ".ply"))
    assert not line
    large = name in ("mean", "base", "rest") or (np.isinf(number) and name == "quaternion")
    left = int(np.isnan(number) or large)
    splats, _ = read_located(file, None, notes.append)
    assert len(SPLATS.mean) - len(splats.mean) == left
    assert ["1 Gaussian with a number that is NaN" in note for note in notes] == [True] * left


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("low", "high", "reason"), [(np.nan, 1, "each of its Gaussians"), (-3e38, 3e38, ""), (3e38, 3e38, "beyond 1e+09")]
)
def test_ranges_of_chunks(low: float, high: float, reason: str, tmp_path: Path) -> None:
    head, body = own(PACKED).split(b"end_header\n", 1)
    data = head + b"end_header\n" + struct.pack("<6f", *[low] * 3, *[high] * 3) + body[24:]
    assert reason in outcome(tmp_path / "a.ply", data)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (json_("means/files/0", "../means_l.webp"), "no file ../means_l.webp beside it"),
        (json_("means/files/0", "/etc/passwd"), "no file /etc/passwd beside it"),
        (json_("means/files/0", ".."), ".. beside it is not a file: it is a directory"),
        (json_("means/files/0", ""), "no file  beside it"),
        (json_("means/files/0", "other.webp"), "no file other.webp beside it"),
        (json_("means/files/0", "link.webp"), "link.webp beside it is not a file"),
        (json_("count", 2_000_000), "2000000 Gaussians, but has only"),
    ],
)
def test_folders_of_sog(change: Callable[[bytes], bytes], reason: str, tmp_path: Path) -> None:
    for name, data in SOG_ENTRIES.items():
        (tmp_path / name).write_bytes(data)
    (tmp_path / "link.webp").symlink_to(tmp_path)
    assert outcome(tmp_path / "meta.json", SOG_ENTRIES["meta.json"]) == ""
    assert reason in outcome(tmp_path / "meta.json", change(SOG_ENTRIES["meta.json"]))


@pytest.mark.parametrize(
    ("name", "head", "reason"),
    [
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "a point cloud"),
        ("a.sog", b"", "it is not a zip archive"),
    ],
)
def test_what_follows_is_not_copied(name: str, head: bytes, reason: str, tmp_path: Path) -> None:
    """A file system can say that a file has many bytes, of which none are on the disk."""
    file = tmp_path / name
    file.write_bytes(head)
    os.truncate(file, 200 << 20)
    tracemalloc.start()
    try:
        with pytest.raises(SceneFolderError, match=reason):
            read_splats(file)
        assert tracemalloc.get_traced_memory()[1] < 4 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("rotation", [[0, 0, 0], [0, 0, 0, 0], [1e200, 0, 0, 0], "up", [True, 0, 0, 1]])
def test_nodes_that_do_not_turn(rotation: Any, tmp_path: Path) -> None:
    inner, repack = layer(".glb", own(".glb"))
    data = repack(json_("nodes/0/rotation", rotation)(inner))
    assert "rotation" in outcome(tmp_path / "a.glb", data, splats_up)


@pytest.mark.parametrize(
    ("name", "inside", "reason"),
    [
        ("none.ply", "", "the file does not exist; give one of .ply"),
        ("n", "nerfstudio_models", "it is a training of nerfstudio; `ns-export gaussian-splat --load-config .*/n/conf"),
        ("p", "images", "it is a folder of photographs; `refcodec train .*/p` makes a scene of it"),
    ],
)
def test_what_is_no_file(name: str, inside: str, reason: str, tmp_path: Path) -> None:
    if inside:
        (tmp_path / name / inside).mkdir(parents=True)
    with pytest.raises(SceneFolderError, match=reason):
        read_splats(tmp_path / name)
