"""Splat files, read by readers in this module that share no code with the writers, and by other programs."""

from __future__ import annotations

import gzip
import io
import json
import math
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

for package in ("numba", "PIL", "scipy"):
    pytest.importorskip(package, reason="exporting needs the packages of the extra render")

from PIL import Image  # noqa: E402
from plyfile import PlyData  # noqa: E402

from benchmarks.exports.clients import as_read  # noqa: E402
from benchmarks.peers.convert import convert, tool  # noqa: E402
from refcodec.bitstream.cameras import rotation_matrix  # noqa: E402
from refcodec.export.formats import FORMATS, splat_file  # noqa: E402
from refcodec.export.splats import Splats, opacities  # noqa: E402
from refcodec.export.spz import BITS_LEAST, BITS_MOST, spz_file  # noqa: E402
from refcodec.rendering.camera import axis_direction  # noqa: E402
from refcodec.rendering.harmonics import REST, rest_harmonics  # noqa: E402

UP = axis_direction(3)
ARRAYS = ("mean", "base", "rest", "opacity", "scale", "quaternion")
Read = Callable[[bytes], Splats]


def splats_of(count: int, degree: int, spread: float = 3.0) -> Splats:
    """Gaussians of ordinary numbers, drawn at random."""
    rng = np.random.default_rng(100 * count + degree)
    found = {
        "mean": spread * rng.normal(size=(count, 3)),
        "base": rng.normal(size=(count, 3)),
        "rest": 0.2 * rng.normal(size=(count, REST[degree], 3)),
        "opacity": 3 * rng.normal(size=count),
        "scale": rng.normal(-4, 1, size=(count, 3)),
        "quaternion": rng.normal(size=(count, 4)),
    }
    return Splats(**{name: values.astype(np.float32) for name, values in found.items()})


def stacked(rows: list[list[list[float]]], degree: int) -> Splats:
    """Gaussians of rows that have mean, base, rest, opacity, scale and quaternion each."""
    mean, base, rest, opacity, scale, quaternion = (np.array(part, np.float64) for part in zip(*rows, strict=True))
    count = len(rows)
    parts = mean, base, rest.reshape(count, REST[degree], 3), opacity.reshape(count), scale, quaternion
    return Splats(*(part.astype(np.float32) for part in parts))


def logit(value: float) -> float:
    value = min(max(value, 1e-6), 1 - 1e-6)
    return math.log(value / (1 - value))


# --- readers ----------------------------------------------------------------------------------------------------------


def read_ply(data: bytes) -> Splats:
    """By the lines of the header, a property at a time."""
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    # Viewers of 3DGS's authors count on the third line.
    count = int(lines[2].removeprefix("element vertex "))
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    assert len(names) + 4 == len(lines)
    assert len(body) == 4 * count * len(names)
    found: list[list[list[float]]] = []
    coefficients = sum(name.startswith("f_rest_") for name in names) // 3
    for i in range(count):
        row = dict(zip(names, struct.unpack_from(f"<{len(names)}f", body, 4 * i * len(names)), strict=True))
        assert row["nx"] == row["ny"] == row["nz"] == 0
        rest = [row[f"f_rest_{c * coefficients + k}"] for k in range(coefficients) for c in range(3)]
        found.append(
            [
                [row["x"], row["y"], row["z"]],
                [row[f"f_dc_{c}"] for c in range(3)],
                rest,
                [row["opacity"]],
                [row[f"scale_{c}"] for c in range(3)],
                [row[f"rot_{c}"] for c in range(4)],
            ]
        )
    return stacked(found, REST.index(coefficients))


def read_spz(data: bytes) -> Splats:
    """By the description of the format, turned back to the axes of PLY files."""
    body = gzip.decompress(data)
    magic, version, count, degree, fraction, flags, reserved = struct.unpack_from("<4sIIBBBB", body)
    assert (magic, version, flags, reserved) == (b"NGSP", 3, 0, 0)
    at = 16

    def taken(size: int) -> list[bytes]:
        nonlocal at
        rows = [body[at + i * size : at + (i + 1) * size] for i in range(count)]
        at += count * size
        return rows

    sizes = 9, 1, 3, 3, 4, 3 * REST[degree]
    found: list[list[list[float]]] = []
    for position, alpha, colour, scale, turned, rest in zip(*map(taken, sizes), strict=True):
        fixed = [int.from_bytes(position[i : i + 3], "little", signed=True) / 2**fraction for i in (0, 3, 6)]
        bits = int.from_bytes(turned, "little")
        largest = bits >> 30
        q = [0.0] * 4
        for component in reversed([c for c in range(4) if c != largest]):
            q[component] = (bits & 511) / 511 * math.sqrt(0.5) * (-1 if bits & 512 else 1)
            bits >>= 10
        q[largest] = math.sqrt(max(1 - sum(v * v for v in q), 0))
        signs = [-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1]
        found.append(
            [
                [fixed[0], -fixed[1], -fixed[2]],
                [(v / 255 - 0.5) / 0.15 for v in colour],
                [signs[i // 3] * (v - 128) / 128 for i, v in enumerate(rest)],
                [logit(alpha[0] / 255)],
                [v / 16 - 10 for v in scale],
                [q[3], q[0], -q[1], -q[2]],
            ]
        )
    assert at == len(body)
    return stacked(found, degree)


def read_sog(data: bytes) -> Splats:
    """By the description of the format."""
    archive = zipfile.ZipFile(io.BytesIO(data))
    assert archive.testzip() is None
    meta = json.loads(archive.read("meta.json"))
    assert meta["version"] == 2

    def pixels(part: str, number: int = 0) -> list[tuple[int, ...]]:
        image = Image.open(io.BytesIO(archive.read(meta[part]["files"][number])))
        assert image.format == "WEBP"
        values = np.asarray(image.convert("RGBA")).reshape(-1, 4)
        return [tuple(map(int, row)) for row in values]

    low, high, scales, quats, base = pixels("means"), pixels("means", 1), *map(pixels, ("scales", "quats", "sh0"))
    degree = meta.get("shN", {"bands": 0})["bands"]
    found: list[list[list[float]]] = []
    entries = pixels("shN") if degree else []
    labels = pixels("shN", 1) if degree else []
    for i in range(meta["count"]):
        mean = []
        for axis in range(3):
            least, most = meta["means"]["mins"][axis], meta["means"]["maxs"][axis]
            v = least + (most - least) * (high[i][axis] * 256 + low[i][axis]) / 65535
            mean.append(math.copysign(math.exp(abs(v)) - 1, v))
        rest: list[float] = []
        if degree:
            label = labels[i][0] + 256 * labels[i][1]
            assert label < meta["shN"]["count"]
            width = 64 * REST[degree]
            for k in range(REST[degree]):
                entry = entries[label // 64 * width + label % 64 * REST[degree] + k]
                rest += [meta["shN"]["codebook"][v] for v in entry[:3]]
        largest = quats[i][3] - 252
        others = [(v / 255 - 0.5) * math.sqrt(2) for v in quats[i][:3]]
        others.insert(largest, math.sqrt(max(1 - sum(v * v for v in others), 0)))
        found.append(
            [
                mean,
                [meta["sh0"]["codebook"][v] for v in base[i][:3]],
                rest,
                [logit(base[i][3] / 255)],
                [meta["scales"]["codebook"][v] for v in scales[i][:3]],
                others,
            ]
        )
    return stacked(found, degree)


def glb_parts(data: bytes) -> tuple[dict, bytes]:
    """The document and the data of a GLB file."""
    magic, version, length, text, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    size, kind = struct.unpack_from("<I4s", data, 20 + text)
    assert (kind, len(data)) == (b"BIN\0", 28 + text + size)
    assert text % 4 == size % 4 == 0
    return json.loads(data[20 : 20 + text]), data[28 + text :]


def read_glb(data: bytes) -> Splats:
    """By the description of the extension."""
    document, body = glb_parts(data)
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"]["KHR_gaussian_splatting"]["kernel"] == "ellipse"
    assert document["buffers"] == [{"byteLength": len(body)}]
    read: dict[str, np.ndarray] = {}
    for name, number in primitive["attributes"].items():
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        parts = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        dtype = {5126: "<f4", 5121: "u1"}[accessor["componentType"]]
        values = np.frombuffer(body, dtype, accessor["count"] * parts, view["byteOffset"]).reshape(-1, parts)
        assert values.nbytes == view["byteLength"]
        read[name.removeprefix("KHR_gaussian_splatting:")] = values
    places = [f"SH_DEGREE_{d}_COEF_{n}" for d in range(1, 4) for n in range(2 * d + 1)]
    rest = [read[place] for place in places if place in read]
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == read["POSITION"].min(axis=0).tolist()
    assert position["max"] == read["POSITION"].max(axis=0).tolist()
    opacity = read["OPACITY"][:, 0].astype(np.float64)
    shown = np.clip(0.5 + 0.28209479 * read["SH_DEGREE_0_COEF_0"].astype(np.float64), 0, 1)
    # COLOR_0 is linear.
    shown = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    assert np.abs(read["COLOR_0"] / 255 - np.append(shown, opacity[:, None], axis=1)).max() < 0.51 / 255
    return Splats(
        read["POSITION"],
        read["SH_DEGREE_0_COEF_0"],
        np.stack(rest, axis=1) if rest else np.zeros((len(opacity), 0, 3), np.float32),
        np.log(opacity / (1 - opacity)).astype(np.float32),
        np.log(read["SCALE"]),
        read["ROTATION"][:, [3, 0, 1, 2]],
    )


READERS: dict[str, Read] = {".ply": read_ply, ".spz": read_spz, ".sog": read_sog, ".glb": read_glb}


# --- comparison -------------------------------------------------------------------------------------------------------


def assert_same(found: Splats, wanted: Splats, tolerance: float = 2e-6) -> None:
    """Both are the same Gaussians, to the rounding of float32."""
    for name in ARRAYS[:5]:
        if name == "opacity":
            np.testing.assert_allclose(opacities(found), opacities(wanted), atol=1e-5)
        else:
            np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=tolerance, atol=tolerance)
    # Both signs of a quaternion are one rotation.
    turned = rotation_matrix(found.unit_quaternions()), rotation_matrix(wanted.unit_quaternions())
    np.testing.assert_allclose(*turned, atol=1e-5)


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("count", [1, 5, 3000])
def test_a_file_holds_what_it_says(suffix: str, degree: int, count: int) -> None:
    splats = splats_of(count, degree)
    packed = splat_file(splats, suffix, UP)
    assert_same(READERS[suffix](packed.data), packed.splats)
    if suffix in (".ply", ".glb"):
        assert packed.splats is splats
    # The same Gaussians give the same bytes, and the file says who wrote it.
    assert splat_file(splats, suffix, UP).data == packed.data
    assert FORMATS[suffix].begins.match(packed.data[:4096])


@pytest.mark.parametrize("degree", range(4))
def test_spz_is_near(degree: int) -> None:
    """Each number is as near as its bits allow."""
    splats = splats_of(2000, degree)
    held = splat_file(splats, ".spz", UP).splats
    # A step of positions is at most a 64th of the short axes.
    axis = float(np.exp(np.quantile(splats.scale.max(axis=1), 0.1)))
    assert np.abs(held.mean - splats.mean).max() <= 0.51 * axis / 64
    for name, step, limit in (("base", 1 / 0.15 / 255, 0.5 / 0.15), ("rest", 1 / 64, 0.98), ("scale", 1 / 16, 99.0)):
        error = np.abs(getattr(held, name) - np.clip(getattr(splats, name), -limit, limit))
        assert error.max(initial=0) <= 0.51 * step, name
    assert np.abs(opacities(held) - opacities(splats)).max() <= 0.51 / 255
    turned = rotation_matrix(held.unit_quaternions()) - rotation_matrix(splats.unit_quaternions())
    assert np.abs(turned).max() < 0.01


@pytest.mark.parametrize("bits", range(BITS_LEAST, BITS_MOST + 1))
def test_bits_of_spz(bits: int) -> None:
    """Harmonics are multiples of the step of their bits, the nearest ones. Other numbers do not depend on the bits."""
    splats, step = splats_of(500, 3), 2.0 ** (1 - bits)
    packed, other = spz_file(splats, bits), spz_file(splats)
    assert_same(read_spz(packed.data), packed.splats)
    rest = packed.splats.rest
    # The highest byte is 255 instead of 256.
    np.testing.assert_array_equal(np.where(rest == 127 / 128, 0, rest) % step, 0)
    assert np.abs(rest - np.clip(splats.rest, -1, 127 / 128)).max() <= 0.501 * step
    for name in set(ARRAYS) - {"rest"}:
        np.testing.assert_array_equal(getattr(packed.splats, name), getattr(other.splats, name))


def test_positions_of_spz() -> None:
    """The step follows the size of the Gaussians, within what 24 bits hold."""
    splats = splats_of(100, 0)
    for grown, bits in ((0.0, 0), (-2.0, 2), (-40.0, 19), (40.0, 0)):
        sized = replace(splats, scale=np.full_like(splats.scale, grown * np.log(2) + 6 * np.log(2)))
        data = gzip.decompress(spz_file(sized).data)
        # Positions are below 16, which takes 4 of the 23 bits besides the sign.
        assert data[13] == bits


def test_sog_is_near() -> None:
    """With as many entries as Gaussians the palette loses nothing but the table's steps."""
    splats = splats_of(1000, 3)
    held = splat_file(splats, ".sog", UP).splats
    order = [int(np.abs(splats.mean - mean).sum(axis=1).argmin()) for mean in held.mean]
    assert sorted(order) == list(range(1000))
    assert np.abs(np.log1p(np.abs(held.mean)) - np.log1p(np.abs(splats.mean[order]))).max() < 4 / 65535
    for name, spread in (("base", 1.0), ("rest", 0.2), ("scale", 1.0)):
        error = getattr(held, name) - getattr(splats, name)[order]
        assert np.sqrt((error**2).mean()) < 0.01 * spread, name
    assert np.abs(opacities(held) - opacities(splats)[order]).max() <= 0.51 / 255
    turned = rotation_matrix(held.unit_quaternions()) - rotation_matrix(splats.unit_quaternions()[order])
    assert np.abs(turned).max() < 0.05


def test_a_palette_is_shared() -> None:
    """Gaussians of 20 kinds of harmonics keep them, though the palette has fewer entries than Gaussians."""
    splats = splats_of(5000, 2)
    kinds = splats_of(20, 2).rest
    splats = Splats(*(kinds[np.arange(5000) % 20] if n == "rest" else getattr(splats, n) for n in ARRAYS))
    packed = splat_file(splats, ".sog", UP)
    meta = json.loads(zipfile.ZipFile(io.BytesIO(packed.data)).read("meta.json"))
    assert meta["shN"]["count"] <= 4096
    errors = [np.abs(kinds - rest).max(axis=(1, 2)).min() for rest in packed.splats.rest]
    assert max(errors) < 0.02


@pytest.mark.parametrize("suffix", FORMATS)
def test_extreme_numbers(suffix: str) -> None:
    """All means in one place, or far away, transparent and opaque, large and small: files are whole and near."""
    mean = np.array([[4e6, -4e6, 0], [0, 0, 0], [0, 0, 0]], np.float32)
    splats = splats_of(3, 1)
    scale = np.array([[-40, -9, 5], [0, 0, 0], [-1, -1, -1]], np.float32)
    quaternion = np.array([[1, 1, 1, 1], [0, 0, 0, -2], [0, 1e-20, 0, 0]], np.float32)
    opacity = np.array([-13, 13, 0], np.float32)
    for means in (mean, 0 * mean + 7):
        wild = Splats(means, splats.base, splats.rest, opacity, scale, quaternion)
        packed = splat_file(wild, suffix, UP)
        assert_same(READERS[suffix](packed.data), packed.splats, 1e-5)
        found = packed.splats.mean[np.argsort(-np.abs(packed.splats.mean[:, 0]), kind="stable")]
        np.testing.assert_allclose(found, means, rtol=1e-4, atol=1e-4)


def test_spz_does_not_hold_everything() -> None:
    splats = splats_of(3, 0, spread=1e8)
    with pytest.raises(ValueError, match="positions are below 2\\^23"):
        splat_file(splats, ".spz", UP)


def test_other_programs_read_the_ply(tmp_path: Path) -> None:
    """plyfile sees the properties of 3DGS in their order."""
    splats = splats_of(7, 3)
    (tmp_path / "a.ply").write_bytes(splat_file(splats, ".ply", UP).data)
    vertex = PlyData.read(str(tmp_path / "a.ply"))["vertex"]
    wanted = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45))]
    wanted += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert [p.name for p in vertex.properties] == wanted
    np.testing.assert_array_equal(vertex["f_rest_17"], splats.rest[:, 2, 1])


@pytest.mark.parametrize("up", [*map(axis_direction, range(6)), np.array([-0.36, -0.8, 0.48])])
def test_glb_stands_upright(up: np.ndarray) -> None:
    document, _ = glb_parts(splat_file(splats_of(2, 0), ".glb", up).data)
    x, y, z, w = document["nodes"][0]["rotation"]
    turned = rotation_matrix(np.array([w, x, y, z])) @ up
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-12)


def test_harmonics_turn_with_the_axes() -> None:
    """A colour in SPZ's axes is that in PLY's axes: a coefficient's sign is that of its harmonic when y and z turn."""
    direction = np.random.default_rng(1).normal(size=3)
    direction /= np.linalg.norm(direction)
    before, after = (np.array(rest_harmonics(direction * signs, 3)) for signs in ((1, 1, 1), (1, -1, -1)))
    signs = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])
    np.testing.assert_allclose(after, signs * before)


@pytest.mark.slow
@pytest.mark.skipif(tool() is None, reason="splat-transform is missing: benchmarks.peers.convert says how to get it")
@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("suffix", [".ply", ".spz", ".sog"])
def test_splat_transform_reads_it(suffix: str, degree: int, tmp_path: Path) -> None:
    """PlayCanvas's program finds the Gaussians that the file is said to hold. It does not read GLB."""
    packed = splat_file(splats_of(2500, degree), suffix, UP)
    (tmp_path / f"a{suffix}").write_bytes(packed.data)
    convert(tmp_path / f"a{suffix}", tmp_path / "b.ply")
    table = PlyData.read(str(tmp_path / "b.ply"))["vertex"].data

    def columns(*names: str) -> np.ndarray:
        return np.stack([table[name] for name in names], axis=1)

    number = REST[degree]
    names = [f"f_rest_{c * number + k}" for k in range(number) for c in range(3)]
    found = Splats(
        columns("x", "y", "z"),
        columns("f_dc_0", "f_dc_1", "f_dc_2"),
        (columns(*names) if names else np.zeros((len(table), 0))).reshape(len(table), number, 3),
        table["opacity"],
        columns("scale_0", "scale_1", "scale_2"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"),
    )
    assert_same(found, as_read(packed.splats, suffix))
