"""Splat files: each format gives the written values up to its own rounding, or one line about the fault."""

from __future__ import annotations

import gzip
import random
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("PIL")

from memory import bounded
from writers import (
    RESTS,
    Arrays,
    change_glb,
    columns,
    made,
    sigmoid,
    sog_entries,
    table,
    write_glb,
    write_packed,
    write_plain,
    write_sog,
    write_spz,
    write_tables,
)

from refcodec.convert.splat_files import read_splats, splats_up
from refcodec.folder.layout import SceneFolderError

# Half a step of each kind: of positions, colours, harmonics, opacities, logarithms of lengths and rotations.
KINDS = ("mean", "base", "rest", "opacity", "scale", "quaternion")


def assert_read(file: Path, splats: Arrays, *steps: float) -> None:
    """The file has these Gaussians, to half of these steps."""
    found = read_splats(file)
    for name, step in zip(KINDS, steps, strict=True):
        wanted, values = splats[name], found[name].astype(np.float64)
        assert values.shape == wanted.shape, name
        if name == "opacity":
            wanted, values = sigmoid(wanted), sigmoid(values)
        if name == "quaternion":
            values = values / np.linalg.norm(values, axis=1, keepdims=True)
            values *= np.sign((values * wanted).sum(axis=1, keepdims=True))
        assert np.abs(values - wanted).max(initial=0) <= step * 0.501 + 1e-6, name


@pytest.mark.parametrize("degree", range(4))
def test_plain_ply(degree: int, tmp_path: Path) -> None:
    splats = made(degree=degree)
    write_plain(splats, tmp_path / "a.ply")
    assert_read(tmp_path / "a.ply", splats, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("degree", range(4))
def test_compressed_ply(degree: int, tmp_path: Path) -> None:
    splats = made(600, degree)
    write_packed(splats, tmp_path / "a.ply")
    span = {kind: np.ptp(splats[kind], axis=0).max() for kind in ("mean", "base", "scale")}
    # Three components of 10 bits make the largest.
    steps = (span["mean"] / 1023, span["base"] / 255, 8 / 256, 1 / 255, span["scale"] / 1023, 6 * np.sqrt(2) / 1023)
    assert_read(tmp_path / "a.ply", splats, *steps)


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_spz(version: int, degree: int, tmp_path: Path) -> None:
    if version == 4:
        pytest.importorskip("zstandard")
    splats = made(degree=degree)
    write_spz(splats, tmp_path / "a.spz", version)
    place = 2**-10 if version == 1 else 2**-12
    # Where w is left out, its error is that of the others over it.
    rotation = 0.3 if version < 3 else 6 * np.sqrt(0.5) / 511
    assert_read(tmp_path / "a.spz", splats, place, 1 / 255 / 0.15, 1 / 128, 1 / 255, 1 / 16, rotation)


def test_harmonics_of_spz_are_turned(tmp_path: Path) -> None:
    """A file's axes are others. What is seen from a direction is what its harmonics say of the turned direction."""
    torch = pytest.importorskip("torch")
    from refcodec.convert.harmonics import basis  # noqa: PLC0415 (torch)

    splats = made(degree=3)
    turned = np.array([1, -1, -1])
    write_spz({**splats, "rest": splats["rest"]}, tmp_path / "a.spz", 3)
    found = read_splats(tmp_path / "a.spz")["rest"]
    data = gzip.decompress((tmp_path / "a.spz").read_bytes())
    own = (np.frombuffer(data[-300 * 45 :], np.uint8).reshape(300, 15, 3) - 128.0) / 128
    direction = np.random.default_rng(1).normal(size=(300, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    seen, stated = (basis(torch.from_numpy(d), 3).numpy() for d in (direction, direction * turned))
    np.testing.assert_allclose(
        (seen[:, :, None] * found).sum(axis=1), (stated[:, :, None] * own).sum(axis=1), atol=1e-6
    )


@pytest.mark.parametrize("degree", range(4))
def test_sog(degree: int, tmp_path: Path) -> None:
    splats = made(degree=degree)
    splats["rest"] = splats["rest"][np.arange(300) % 50]
    write_sog(sog_entries(splats), tmp_path / "a.sog")
    folded = np.log1p(np.abs(splats["mean"]))
    place = 2 * folded.max() / 65535 * (1 + np.abs(splats["mean"]).max())
    span = {kind: np.ptp(splats[kind]) for kind in ("base", "scale")}
    steps = (place, span["base"] / 255, 2 / 255, 1 / 255, span["scale"] / 255, 6 * np.sqrt(2) / 255)
    assert_read(tmp_path / "a.sog", splats, *steps)


def test_a_folder_of_sog(tmp_path: Path) -> None:
    """The entries of the archive as files, as PlayCanvas's program writes them, too."""
    entries = sog_entries(made())
    for name, data in entries.items():
        (tmp_path / name).write_bytes(data)
    write_sog(entries, tmp_path / "a.sog")
    whole, parts = read_splats(tmp_path / "a.sog"), read_splats(tmp_path / "meta.json")
    for name, values in whole.items():
        assert np.array_equal(values, parts[name])
    for old, new, said in (
        (b'"means_l.webp"', b'"../means_l.webp"', "no file ../means_l.webp beside it"),
        (b'"means_l.webp"', b'".."', "a directory"),
        (b'"means_l.webp"', b'"/etc/passwd"', "no file /etc/passwd beside it"),
        (b'"means_l.webp"', b'""', "no file  beside it"),
        (b'"means_l.webp"', b'"other.webp"', "no file other.webp beside it"),
        (b'"count": 300', b'"count": 2000000', "2000000 Gaussians, but has"),
    ):
        assert old in entries["meta.json"]
        (tmp_path / "meta.json").write_bytes(entries["meta.json"].replace(old, new, 1))
        refused(tmp_path / "meta.json", said)
    (tmp_path / "meta.json").write_bytes(entries["meta.json"])
    (tmp_path / "means_l.webp").unlink()
    (tmp_path / "means_l.webp").symlink_to(tmp_path)
    refused(tmp_path / "meta.json", "a directory")


@pytest.mark.parametrize("degree", range(4))
def test_glb(degree: int, tmp_path: Path) -> None:
    splats = made(degree=degree)
    write_glb(splats, tmp_path / "a.glb")
    assert_read(tmp_path / "a.glb", splats, 0, 0, 0, 0, 0, 0)


def test_glb_of_other_programs(tmp_path: Path) -> None:
    """Rows that are apart, rotations and opacities in normalized integers, and meshes beside it."""
    splats, file = made(degree=0), tmp_path / "a.glb"
    write_glb(splats, file)
    data = file.read_bytes()
    body = bytearray(data[28 + struct.unpack("<I", data[12:16])[0] :])
    quaternion = np.rint(np.roll(splats["quaternion"], -1, axis=1) * 32767).astype("<i2")
    opacity = np.rint(sigmoid(splats["opacity"]) * 65535).astype("<u2")
    rows = np.concatenate([quaternion.view("u1").reshape(-1, 8), opacity.view("u1").reshape(-1, 2)], axis=1)
    start = len(body)
    body += np.pad(rows, ((0, 0), (0, 2))).tobytes()

    def change(root: dict[str, Any]) -> None:
        attributes = root["meshes"][0]["primitives"][0]["attributes"]
        root["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": 300 * 12, "byteStride": 12})
        common = {"bufferView": len(root["bufferViews"]) - 1, "count": 300, "normalized": True}
        for name, kind, form, at in (("ROTATION", 5122, "VEC4", 0), ("OPACITY", 5123, "SCALAR", 8)):
            attributes[f"KHR_gaussian_splatting:{name}"] = len(root["accessors"])
            root["accessors"].append({**common, "componentType": kind, "type": form, "byteOffset": at})
        root["meshes"].insert(0, {"primitives": [{"attributes": {"POSITION": 0}}]})
        root["nodes"] = [{"mesh": 0, "rotation": [1, 0, 0, 0]}, {"mesh": 1}]

    file.write_bytes(data[: len(data) - start - 8] + struct.pack("<I4s", len(body), b"BIN\0") + body)
    change_glb(file, change)
    # Bringing a rounded quaternion to length 1 moves it as much again.
    assert_read(file, splats, 0, 0, 0, 1 / 65535, 0, 2 / 32767)
    np.testing.assert_allclose(splats_up(file), [0, 1, 0])


def test_what_is_up(tmp_path: Path) -> None:
    """A node turns what is up to +y, which is up in glTF. The others say nothing."""
    for up in [*np.eye(3), *-np.eye(3), np.array([1.0, 2.0, -2.0]) / 3]:
        write_glb(made(20, 0), tmp_path / "a.glb", up)
        np.testing.assert_allclose(splats_up(tmp_path / "a.glb"), up, atol=1e-12)
    assert splats_up(tmp_path / "a.ply").tolist() == [0, -1, 0]


# --- what is refused --------------------------------------------------------------------------------------------------


def refused(file: Path, *said: str) -> None:
    with pytest.raises(SceneFolderError) as error:
        read_splats(file)
    for words in said:
        assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_are_finite(kind: str, tmp_path: Path) -> None:
    splats = made()
    splats[kind].reshape(-1)[7] = np.nan
    write_plain(splats, tmp_path / "a.ply")
    refused(tmp_path / "a.ply", f"a {kind} is NaN")


@pytest.mark.parametrize("kind", KINDS[:3])
def test_numbers_whose_squares_are_finite(kind: str, tmp_path: Path) -> None:
    splats = made()
    splats[kind].reshape(-1)[7] = -1e30
    write_plain(splats, tmp_path / "a.ply")
    refused(tmp_path / "a.ply", f"a {kind} is beyond 1e+09")


def test_opacities_of_programs_that_write_infinity(tmp_path: Path) -> None:
    splats = made()
    splats["opacity"][:2] = np.inf, -np.inf
    write_plain(splats, tmp_path / "a.ply")
    found = sigmoid(read_splats(tmp_path / "a.ply")["opacity"][:2].astype(float))
    assert found.tolist() == pytest.approx([1, 0], abs=1e-8)


def test_ply_without_what_is_needed(tmp_path: Path) -> None:
    file, whole = tmp_path / "a.ply", columns(made())
    for name in ("x", "f_dc_2", "opacity", "scale_0", "rot_3"):
        write_tables(file, table({n: c for n, c in whole.items() if n != name}))
        refused(file, f"no property {name}")
    write_tables(file, table({n: c for n, c in whole.items() if n != "f_rest_3"}))
    refused(file, "23 coefficients f_rest")
    write_tables(file, table(whole, "face"))
    refused(file, "no element vertex")
    write_tables(file, table({n: c[:0] for n, c in whole.items()}))
    refused(file, "no Gaussians")
    file.write_bytes(
        f"ply\nformat binary_little_endian 1.0\nelement vertex {1 << 40}\nproperty float x\nend_header\n".encode()
    )
    refused(file, "a count of at most")
    file.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nend_header\n")
    refused(file, "4000000000 Gaussians, but at most")
    refused(tmp_path / "none.ply", "the file does not exist")


def test_compressed_ply_without_its_parts(tmp_path: Path) -> None:
    splats, file = made(600, 1), tmp_path / "a.ply"
    write_packed(splats, file)
    whole = file.read_bytes()
    for old, new, said in (
        (b"element chunk 3", b"element chunc 3", "no element chunk"),
        (b"packed_scale", b"packed_scalf", "no property packed_scale"),
        (b"uint packed_color", b"float packed_color", "no property packed_color"),
        (b"property float max_scale_y", b"property float max_scale_v", "no property max_scale_y"),
    ):
        assert old in whole
        file.write_bytes(whole.replace(old, new))
        refused(file, said)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("low", "high", "said"), [(np.nan, 1, "NaN"), (-3e38, 3e38, "beyond 1e+09"), (3e38, 3e38, "beyond")]
)
def test_ranges_of_chunks(low: float, high: float, said: str, tmp_path: Path) -> None:
    """Ranges of any numbers are refused in a line, without a warning."""
    file = tmp_path / "a.ply"
    write_packed(made(600, 1), file)
    head, body = file.read_bytes().split(b"end_header\n", 1)
    file.write_bytes(head + b"end_header\n" + struct.pack("<6f", *[low] * 3, *[high] * 3) + body[24:])
    refused(file, "a mean is", said)


def spz(version: int = 2, count: int = 10, degree: int = 0, fraction: int = 12, more: bytes = b"") -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, fraction, 0, 0) + more


def zipped(data: bytes) -> bytes:
    """A gzip stream of no time: each process of a run must find the same tests, which are named after their bytes."""
    return gzip.compress(data, mtime=0)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "not an SPZ"),
        (b"NGS", "not an SPZ"),
        (zipped(b"NGSP"), "not an SPZ"),
        (zipped(b"PSGN" + spz()[4:]), "not an SPZ"),
        (zipped(spz(5)), "version 5"),
        (zipped(spz(4)), "version 4"),
        (spz(3), "version 3"),
        (zipped(spz(degree=4)), "degree 4"),
        (zipped(spz(fraction=24)), "24 fractional"),
        (zipped(spz(count=(1 << 32) - 1)), "at most 16777216"),
        (zipped(spz(count=1 << 24)), "16777216 Gaussians, but has"),
        (zipped(spz(count=1 << 20)), "fewer bytes"),
        (zipped(spz(count=10, more=bytes(189))), "fewer bytes"),
        (zipped(spz(count=0)), "no Gaussians"),
        (zipped(spz(more=bytes(range(190))))[:-40], "fewer bytes"),
        (b"\x1f\x8b" + bytes(50), "gzip stream is damaged"),
    ],
)
def test_spz_headers(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.spz").write_bytes(data)
    refused(tmp_path / "a.spz", said)


@pytest.mark.parametrize("change", ["streams", "size", "table", "cut", "bytes"])
def test_streams_of_spz(change: str, tmp_path: Path) -> None:
    pytest.importorskip("zstandard")
    file = tmp_path / "a.spz"
    write_spz(made(), file, 4)
    data = bytearray(file.read_bytes())
    if change == "streams":
        data[15] = 200
    if change == "size":
        data[40:48] = (1 << 40).to_bytes(8, "little")
    if change == "table":
        data[16:20] = b"\xff\xff\xff\xff"
    if change == "bytes":
        data[140:160] = bytes(20)
    file.write_bytes(data[:-20] if change == "cut" else data)
    refused(file, "stream")


def test_a_gzip_bomb_is_unpacked_no_further_than_it_states(tmp_path: Path) -> None:
    """A hundred Gaussians, and behind them 300 megabytes."""
    (tmp_path / "a.spz").write_bytes(gzip.compress(spz(2, 100, more=bytes(300 << 20)), 9))
    with bounded(5):
        assert len(read_splats(tmp_path / "a.spz")["mean"]) == 100


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"version": 2', '"version": 3', "version 3"),
        ('"count": 300', '"count": 17000000', "17000000 Gaussians"),
        ('"count": 300', '"count": 9000000', "9000000 Gaussians, but has"),
        ('"count": 300', '"count": 900000', "pixels for 900000"),
        ('"count": 300', '"count": "a"', "count in its meta.json"),
        ('"count": 300', '"count": -1', "count in its meta.json"),
        ('"means_l.webp"', '"other.webp"', "no entry other.webp"),
        ('"means_l.webp"', "7", "means.files"),
        ('"bands": 2', '"bands": 4', "shN.bands"),
        ('"bands": 2', '"bands": 3', "pixels"),
        ('"count": 50', '"count": 20', "beyond the 20 of the palette"),
        ('"quats"', '"quads"', "quats.files"),
        ('"mins": [', '"mins": [0, ', "means.mins"),
        ('{"version"', '{"a" "version"', "not JSON"),
    ],
)
def test_sog_of_other_values(old: str, new: str, said: str, tmp_path: Path) -> None:
    entries = sog_entries(made())
    text = entries["meta.json"].decode()
    assert old in text
    write_sog(entries | {"meta.json": text.replace(old, new, 1).encode()}, tmp_path / "a.sog")
    refused(tmp_path / "a.sog", said)


def test_images_of_sog_are_bounded(tmp_path: Path) -> None:
    """An image of many more pixels than there are Gaussians is not read, nor an entry that unpacks to very much."""
    from writers import rgba, webp  # noqa: PLC0415

    entries = sog_entries(made())
    write_sog(entries | {"scales.webp": b"GIF89a" + bytes(99)}, tmp_path / "f.sog")
    refused(tmp_path / "f.sog", "scales.webp is neither WebP nor PNG")
    large = webp(rgba(np.zeros((4000 * 4000, 3), np.uint8)), 4000)
    write_sog(entries | {"scales.webp": large}, tmp_path / "a.sog")
    refused(tmp_path / "a.sog", "4000 x 4000 pixels for 300")
    with zipfile.ZipFile(tmp_path / "b.sog", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", b" " * (64 << 20))
    with bounded(8):
        refused(tmp_path / "b.sog", "meta.json has more than")
    with zipfile.ZipFile(tmp_path / "d.sog", "w") as archive:
        for number in range(3000):
            archive.writestr(f"{number:0100}", b"")
    refused(tmp_path / "d.sog", "directory has more than")
    with zipfile.ZipFile(tmp_path / "e.sog", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("meta.json", entries["meta.json"])
    refused(tmp_path / "e.sog", "neither stored nor deflated")
    (tmp_path / "c.sog").write_bytes(b"PK\x03\x04 and nothing")
    refused(tmp_path / "c.sog", "not a zip archive")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "not a GLB"),
        (b"glTF\x01" + bytes(30), "not a GLB"),
        (b"glTF\x02" + bytes(7), "chunk JSON is missing"),
        (b"glTF\x02" + bytes(7) + struct.pack("<I4s", 5000, b"JSON") + bytes(99), "is missing or truncated"),
        (b"glTF\x02" + bytes(7) + struct.pack("<I4s", 2 << 20, b"JSON") + bytes(2 << 20), "JSON has more than"),
        (b"glTF\x02" + bytes(7) + struct.pack("<I4s2s", 2, b"JSON", b"[]"), "chunk BIN is missing"),
        (b"glTF\x02" + bytes(7) + struct.pack("<I4s2sI4s", 2, b"JSON", b"[]", 0, b"BIN\0"), "meshes is not a list"),
        (b"glTF\x02" + bytes(7) + struct.pack("<I4s2sI4s", 2, b"JSON", b"{]", 0, b"BIN\0"), "is not JSON"),
    ],
    ids=range(8),
)
def test_glb_chunks(data: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(data)
    refused(tmp_path / "a.glb", said)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("meshes", [], "0 primitives with KHR_gaussian_splatting"),
        ("meshes/0/primitives", 7, "0 primitives"),
        ("meshes/0/primitives/0/extensions/KHR_gaussian_splatting/kernel", "cube", "its kernel is 'cube'"),
        ("meshes/0/primitives/0/extensions/KHR_gaussian_splatting/extensions", {"spz": {}}, "another extension"),
        ("meshes/0/primitives/0/attributes", None, "no attributes"),
        ("meshes/0/primitives/0/attributes/KHR_gaussian_splatting:SCALE", 2, "SCALE does not have 3 numbers"),
        ("meshes/0/primitives/0/attributes/KHR_gaussian_splatting:SCALE", 99, "its list accessors has no entry 99"),
        ("meshes/0/primitives/0/attributes/POSITION", True, "its list accessors has no entry True"),
        ("meshes/0/primitives/0/attributes", {"POSITION": 0}, "no attribute KHR_gaussian_splatting:OPACITY"),
        ("accessors/0/count", 1 << 40, "a count is 1099511627776"),
        ("accessors/0/count", 900_000, "POSITION lies outside"),
        ("accessors/0/count", 0, "no Gaussians"),
        ("accessors/4/count", 9, "9 rows for 300"),
        ("accessors/0/componentType", 5125, "POSITION does not have 3 numbers"),
        ("accessors/0/componentType", 5122, "not normalized"),
        ("accessors/0/sparse", {}, "sparse"),
        ("accessors/0/byteOffset", 8, "POSITION lies outside"),
        ("bufferViews/0/buffer", 1, "a buffer is 1"),
        ("bufferViews/0/byteOffset", -1, "a byteOffset is -1"),
        ("bufferViews/0/byteLength", 1e9, "a byteLength is 1000000000.0"),
        ("bufferViews/0/byteLength", 1 << 31, "lies outside"),
        ("bufferViews/0/byteStride", 4, "a byteStride is 4"),
        ("accessors", {}, "accessors is not a list"),
    ],
)
def test_glb_of_other_values(path: str, value: Any, said: str, tmp_path: Path) -> None:
    file = tmp_path / "a.glb"
    write_glb(made(degree=1), file)

    def change(root: Any) -> None:
        *above, last = path.split("/")
        for key in above:
            root = root[int(key) if isinstance(root, list) else key]
        root[last] = value

    change_glb(file, change)
    refused(file, said)


@pytest.mark.parametrize("rotation", [[0, 0, 0], [0, 0, 0, 0], [1e200, 0, 0, 0], "up", [True, 0, 0, 1]])
def test_nodes_that_do_not_turn(rotation: Any, tmp_path: Path) -> None:
    write_glb(made(20, 0), tmp_path / "a.glb")
    change_glb(tmp_path / "a.glb", lambda root: root["nodes"][0].update(rotation=rotation))
    with pytest.raises(SceneFolderError, match="rotation of a node"):
        splats_up(tmp_path / "a.glb")


def _sog(splats: Arrays, path: Path) -> None:
    write_sog(sog_entries(splats), path)


def _spz(splats: Arrays, path: Path) -> None:
    write_spz(splats, path, 2)


@pytest.mark.parametrize(
    ("suffix", "write"),
    [(".ply", write_plain), (".ply", write_packed), (".spz", _spz), (".sog", _sog), (".glb", write_glb)],
)
def test_cut_and_changed_files(suffix: str, write: Callable[[Arrays, Path], None], tmp_path: Path) -> None:
    """Whatever the bytes are, the outcome is finite Gaussians or one SceneFolderError."""
    file = tmp_path / f"a{suffix}"
    write(made(60, 1), file)
    whole, rng, outcomes = file.read_bytes(), random.Random(3), set()
    for number in range(120):
        data = bytearray(whole)
        for _ in range(rng.randrange(1, 5)):
            # Headers and directories are at the ends.
            place = rng.choice([rng.randrange(len(data)), rng.randrange(min(len(data), 900)), -1 - rng.randrange(300)])
            data[place] = rng.randrange(256)
        file.write_bytes(data[: rng.randrange(len(data))] if number % 4 == 0 else data)
        try:
            found = read_splats(file)
        except SceneFolderError:
            outcomes.add("refused")
        else:
            assert all(np.isfinite(values).all() for values in found.values())
            assert found["rest"].shape[1] in RESTS
            outcomes.add("read")
    assert "refused" in outcomes
