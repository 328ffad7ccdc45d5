"""Splat files: every format gives what was written within its steps, and files of other programs are read."""

import gzip
import json
import math
import re
import struct
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

pytest.importorskip("PIL", reason="SOG has images")

from plyfile import PlyData

from benchmarks.peers.convert import as_read, convert, tool
from refcodec.bitstream.cameras import rotation_matrix
from refcodec.files.ply import names_of, parse_ply, ply_bytes
from refcodec.formats import packing, sog
from refcodec.formats.common import BITS_LEAST, BITS_MOST, Options
from refcodec.formats.glb import read_up
from refcodec.formats.harmonics import REST, ZERO, rest_harmonics
from refcodec.formats.splats import Splats, moved, rows_of
from refcodec.formats.table import FORMATS, model_splats, read_located, read_splats, splats_up, suffix_of, write_splats

FOREIGN = Path(__file__).with_name("foreign")
AXES = [sign * np.eye(3)[axis] for sign in (1, -1) for axis in range(3)]
SUFFIXES = pytest.mark.parametrize("suffix", FORMATS)
Steps = dict[str, Any]


def assert_near(restored: Splats, wanted: Splats, steps: Steps) -> None:
    """Both are the same Gaussians, up to half a step of each array, and of rotations as matrices."""
    for name, step in steps.items():
        pair: list[Any] = [getattr(each, name).astype(np.float64) for each in (restored, wanted)]
        if name == "opacity":
            pair = [packing.opacities(each) for each in (restored, wanted)]
        if name == "quaternion":
            # The axes are the same for both signs of a quaternion, and for both directions of an axis.
            turns = [rotation_matrix(each.unit_quaternions()) for each in (restored, wanted)]
            pair = [turn * (1, 2, 3) @ turn.transpose(0, 2, 1) for turn in turns]
        assert pair[0].shape == pair[1].shape, name
        error = np.abs(pair[0] - pair[1])
        assert (error <= 0.501 * np.asarray(step) + 2e-7 * (1 + np.abs(pair[1]))).all(), (name, error.max())


# --- what is written and read again -----------------------------------------------------------------------------------


def held(suffix: str, splats: Splats, options: Options, data: bytes) -> tuple[Splats, Steps]:
    """The Gaussians that a file can hold, in its order, and its steps."""
    if suffix == ".ply":
        return splats, dict.fromkeys(vars(splats), 0)
    if suffix == ".glb":
        # Lengths, opacities and unit quaternions are rounded once.
        with np.errstate(over="ignore", divide="ignore"):
            lengths = np.minimum(np.exp(splats.scale.astype(float)).astype("f4"), np.finfo("f4").max)
            opacity = packing.opacities(splats).astype("f4").astype(float)
            scale, logit = np.log(lengths.astype(float)), np.log(opacity / (1 - opacity))
        unit = splats.unit_quaternions().astype("f4")
        exact = replace(splats, scale=scale.astype("f4"), opacity=logit.astype("f4"), quaternion=unit)
        return exact, dict.fromkeys(vars(splats), 0)
    # The step of the smaller components of quaternions, times what one moves an axis at most.
    turn = 14 * np.sqrt(2)
    if suffix == ".spz":
        fraction = gzip.decompress(data)[13]
        axis = float(np.exp(np.quantile(splats.scale.max(axis=1), 0.1)))
        largest = 2.0 ** math.floor(math.log2(max(np.abs(splats.mean).max(), 1)))
        assert 2.0**-fraction <= max(axis / 64, 2.0**-20, largest * 2.0**-22)
        step = 2.0 ** (1 - options.spz_bits)
        # Values outside are cut, and the highest byte is 255 instead of 256.
        inside = replace(splats, base=splats.base.clip(-0.5 / 0.15, 0.5 / 0.15), rest=splats.rest.clip(-1, 127 / 128))
        steps: Steps = {"mean": 2.0**-fraction, "base": 1 / 0.15 / 255, "rest": step, "scale": 1 / 16}
        return inside, steps | {"opacity": 1 / 255, "quaternion": turn / 2 / 511}
    ordered = rows_of(splats, packing.along_curve(splats.mean))
    span = {name: np.ptp(getattr(ordered, name), axis=0) for name in ("mean", "base", "scale")}
    if suffix == ".sog":
        folded = np.sign(ordered.mean) * np.log1p(np.abs(ordered.mean.astype(float)))
        steps = {"mean": np.ptp(folded, axis=0) / 65535 * (1 + np.abs(ordered.mean)) * 1.01, "quaternion": turn / 255}
        # A table of 256 entries has one near each of few values.
        tables = {name: np.ptp(getattr(ordered, name)) / 32 for name in ("base", "rest", "scale") if splats.rest.size}
        return ordered, steps | tables | {"opacity": 1 / 255}
    assert suffix == ".compressed.ply"
    steps = {name: span[name] / (255 if name == "base" else 1023) for name in span}
    return ordered, steps | {"rest": 8 / 256, "opacity": 1 / 255, "quaternion": turn / 1023}


def assert_comes_back(suffix: str, splats: Splats, options: Options) -> None:
    """A file is read as what it can hold. The same Gaussians give the same bytes, which the output checks know."""
    data = write_splats(splats, suffix, options)
    restored = FORMATS[suffix].read(data)
    wanted, steps = held(suffix, splats, options, data)
    assert_near(restored, wanted, steps)
    for name in (*vars(splats),) if suffix == ".ply" else ("mean", "base", "rest") if suffix == ".glb" else ():
        assert np.array_equal(getattr(restored, name).view("u4"), getattr(wanted, name).view("u4")), name
    assert write_splats(splats, suffix, options) == data
    assert FORMATS[suffix].kind.begins.match(data[:4096])
    assert suffix != ".glb" or np.allclose(read_up(data), options.up, atol=1e-12)


@st.composite
def gaussians(draw: st.DrawFn, suffix: str) -> Splats:
    """A few plain Gaussians. Formats of floats get numbers of any size."""
    count, degree = draw(st.integers(1, 8)), draw(st.integers(0, 3))
    exact = suffix in (".ply", ".glb")

    def floats(most: float, *shape: int) -> np.ndarray:
        bound = 2.0**60 if exact else most
        return draw(arrays(np.float32, shape, elements=st.floats(-bound, bound, width=32)))

    quaternion = draw(arrays(np.float32, (count, 4), elements=st.integers(-(2**20), 2**20)))
    quaternion[~quaternion.any(axis=1), 0] = 1
    colours = floats(3, count, 3), floats(0.9375, count, REST[degree], 3)
    small = st.floats(-9, 5, width=32)
    opacity, scale = (draw(arrays(np.float32, shape, elements=small)) for shape in (count, (count, 3)))
    return Splats(floats(1000, count, 3), *colours, opacity, scale, quaternion)


@SUFFIXES
@given(st.data())
def test_written_and_read_again(suffix: str, data: st.DataObject) -> None:
    up = data.draw(st.sampled_from([*AXES, np.array([-0.36, -0.8, 0.48])]))
    bits = data.draw(st.integers(BITS_LEAST, BITS_MOST))
    assert_comes_back(suffix, data.draw(gaussians(suffix)), Options(up, spz_bits=bits))


def made(count: int, degree: int) -> Splats:
    """Gaussians of ordinary numbers, drawn at random."""
    rng = np.random.default_rng(100 * count + degree)
    shapes = {"mean": (count, 3), "base": (count, 3), "rest": (count, REST[degree], 3), "opacity": (count,)}
    spread = {"mean": 3, "base": 0.7, "rest": 0.15, "opacity": 2}
    parts = {name: spread[name] * rng.normal(size=shape) for name, shape in shapes.items()}
    parts |= {"scale": rng.normal(-4, 1, (count, 3)), "quaternion": rng.normal(size=(count, 4))}
    return Splats(**{name: values.astype(np.float32) for name, values in parts.items()})


@SUFFIXES
@pytest.mark.parametrize("place", ["one", "far"])
def test_extreme_numbers(suffix: str, place: str) -> None:
    """All means in one place, or far apart; transparent and opaque, large and small Gaussians."""
    mean = np.array([[4e6, -4e6, 0], [0, 0, 0], [0, 0, 0]], np.float32) if place == "far" else np.full((3, 3), 7, "f4")
    scale = np.array([[-9.5, -9, 5], [0, 0, 0], [-1, -1, -1]], np.float32)
    quaternion = np.array([[1, 1, 1, 1], [0, 0, 0, -2], [0, 1e-20, 0, 0]], np.float32)
    opacity = np.array([-13, 13, 0], np.float32)
    wild = replace(made(3, 1), mean=mean, scale=scale, quaternion=quaternion, opacity=opacity)
    assert_comes_back(suffix, wild, Options())


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_sky_sets_no_steps(suffix: str) -> None:
    """Some Gaussians a million units away leave the others where they are, and are seen in the same direction."""
    splats = made(1000, 0)
    far = splats.mean.copy()
    far[::200] *= np.float32(1e6) / np.linalg.norm(far[::200], axis=1, keepdims=True)
    read, near = (
        FORMATS[suffix].read(write_splats(replace(splats, mean=far), suffix)),
        np.delete(far, slice(None, None, 200), 0),
    )
    # Formats sort.
    away = np.linalg.norm(read.mean, axis=1) > 1.5 * np.linalg.norm(near, axis=1).max()
    assert away.sum() == 5
    assert np.abs(np.sort(near, axis=0) - np.sort(read.mean[~away], axis=0)).max() < 0.02
    sky = read.mean[away]
    cosines = sky @ far[::200].T / np.linalg.norm(sky, axis=1)[:, None] / 1e6
    assert (cosines.max(axis=1) > 0.9999).all()


@pytest.mark.parametrize("degree", [0, 2])
def test_several_chunks(degree: int) -> None:
    """Chunks of a compressed PLY file have ranges of their own, which are smaller than those of all Gaussians."""
    splats = made(600, degree)
    assert_comes_back(".compressed.ply", splats, Options())
    restored = FORMATS[".compressed.ply"].read(write_splats(splats, ".compressed.ply"))
    errors = np.abs(restored.mean - splats.mean[packing.along_curve(splats.mean)])
    assert np.sqrt((errors**2).mean()) < 0.2 * np.ptp(splats.mean) / 1023


def test_a_palette_is_shared() -> None:
    """Gaussians of 20 kinds of harmonics keep them, though the palette has fewer entries than there are Gaussians."""
    pytest.importorskip("scipy")
    kinds = made(20, 2).rest
    splats = replace(made(5000, 2), rest=kinds[np.arange(5000) % 20])
    data = write_splats(splats, ".sog")
    match = re.search(rb'"shN":{"count":([0-9]+)', data)
    assert match
    assert int(match[1]) <= 4096
    errors = [np.abs(kinds - rest).max(axis=(1, 2)).min() for rest in FORMATS[".sog"].read(data).rest]
    assert max(errors) < 0.02
    restored, wanted = (each.base for each in (FORMATS[".sog"].read(data), splats))
    assert np.abs(np.sort(restored, axis=0) - np.sort(wanted, axis=0)).mean() < 0.01


def test_what_a_format_does_not_hold() -> None:
    with pytest.raises(ValueError, match="positions are below 2\\^23"):
        write_splats(replace(made(3, 0), mean=np.full((3, 3), 1e8, "f4")), ".spz")
    with pytest.raises(ValueError, match="it has no Gaussians"):
        write_splats(rows_of(made(3, 0), np.zeros(3, bool)), ".ply")


# --- files of other programs ------------------------------------------------------------------------------------------


# Of each file: the half turn that its program did not make or made, the degree, the steps, and the up axis.
SAME, HALF = (1, 1, 1), {"mean": 2.0**-12, "base": 0.04, "scale": 1 / 16, "opacity": 2 / 255}
FILES: dict[str, tuple[tuple[int, int, int], int, Steps, int]] = {
    "playbot.ply": (SAME, 2, dict.fromkeys((*HALF, "quaternion"), 0), 4),
    "playbot-plyfile.ply": (SAME, 2, dict.fromkeys((*HALF, "quaternion"), 0), 4),
    "playbot-splat-transform.compressed.ply": (
        SAME,
        2,
        {"mean": 2.1 / 1023, "base": 6 / 255, "scale": 6 / 1023, "opacity": 1 / 255, "quaternion": 20 / 1023},
        4,
    ),
    # splat-transform and GaussForge do not turn the axes of SPZ files.
    "playbot-splat-transform.spz": ((1, -1, -1), 2, HALF | {"quaternion": 10 / 511}, 4),
    "playbot-gaussforge.spz": ((1, -1, -1), 2, HALF | {"quaternion": 10 / 511}, 4),
    "playbot-splat-transform.sog": (SAME, 2, HALF | {"quaternion": 20 / 255}, 4),
    "playbot-gaussforge.sog": (SAME, 2, HALF | {"quaternion": 20 / 255}, 4),
    # glTF is upright.
    "playbot-splat-transform.glb": ((-1, -1, 1), 2, dict.fromkeys((*HALF, "quaternion"), 0), 1),
    "playbot-pygltflib.glb": (SAME, 1, dict.fromkeys(HALF, 0) | {"opacity": 1 / 65535, "quaternion": 20 / 32767}, 4),
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_other_programs(name: str) -> None:
    """They have the Gaussians of playbot.ply (foreign/SOURCE.md), whatever their order."""
    if name == "playbot-splat-transform.spz":
        pytest.importorskip("zstandard", reason="version 4")
    signs, degree, steps, up = FILES[name]
    restored, source = read_splats(FOREIGN / name), read_splats(FOREIGN / "playbot.ply")
    turn = np.array([1, *signs], "f4")
    wanted = replace(source, mean=source.mean * turn[1:], quaternion=source.quaternion * turn)
    order = [int(np.abs(restored.mean - mean).sum(axis=1).argmin()) for mean in wanted.mean]
    assert sorted(order) == list(range(40))
    restored = rows_of(restored, np.array(order))
    assert restored.degree == degree
    assert_near(restored, wanted, steps)
    # A colour from a direction is that of the source from the direction before the turn.
    direction = np.array([0.6, -0.48, 0.64])
    rest = source.rest[:, : REST[degree]]
    colours = [
        np.einsum("k,nkc->nc", np.array(rest_harmonics(seen, degree)), values)
        for seen, values in ((direction * signs, restored.rest), (direction, rest))
    ]
    assert np.abs(colours[0] - colours[1]).max() < (0.08 if suffix_of(name) not in (".ply", ".glb") else 1e-6)
    assert np.ptp(colours[1]) > 0.3
    np.testing.assert_allclose(splats_up(FOREIGN / name), AXES[up], atol=1e-12)


def test_a_compressed_file_of_supersplat() -> None:
    """It is what splat-transform reads of it."""
    restored, wanted = (read_splats(FOREIGN / f"guitar{suffix}") for suffix in (".compressed.ply", ".ply"))
    assert_near(restored, wanted, dict.fromkeys(vars(restored), 0))


@pytest.mark.parametrize("version", [1, 2])
def test_earlier_versions_of_spz(version: int, tmp_path: Path) -> None:
    """They have half floats for positions, or three components of rotations in bytes."""
    splats = made(50, 1)
    body = gzip.decompress(write_splats(splats, ".spz"))
    fixed, others, harmonics = body[16 : 16 + 450], body[16 + 450 : 16 + 800], body[16 + 1000 :]
    unit = splats.unit_quaternions() * (1, 1, -1, -1)
    rotation = np.rint((unit[:, 1:] * np.sign(unit[:, :1]) + 1) * 127.5).astype("u1").tobytes()
    if version == 1:
        fixed = (splats.mean * np.array([1, -1, -1], "f4")).astype("<f2").tobytes()
    head = struct.pack("<4sI", b"NGSP", version) + body[8:16]
    (tmp_path / "a.spz").write_bytes(gzip.compress(head + fixed + others + rotation + harmonics))
    restored, steps = read_splats(tmp_path / "a.spz"), {"mean": 2.0**-8, "base": 0.03, "rest": 1 / 64, "scale": 1 / 16}
    assert_near(restored, splats, steps | {"opacity": 1 / 255})
    # Where w is left out, its error is that of the others over it.
    turns = [rotation_matrix(each.unit_quaternions()) for each in (restored, splats)]
    assert np.abs(turns[0] - turns[1]).mean() < 0.02


@pytest.mark.parametrize("kind", ["equal", "outliers", "few", "random"])
def test_no_group_of_a_palette_is_large(kind: str) -> None:
    """k-means takes memory for each pair of a row and a cluster: equal or strange rows must not come together."""
    pytest.importorskip("scipy")
    number = np.arange(20_000.0)[:, None]
    rows = {
        "equal": np.zeros((20_000, 3)),
        "outliers": np.exp(number * (1, 0.5, 0.25) / 100),
        "few": number * (number < 20_000 // 100) * np.ones(3),
        "random": np.random.default_rng(0).normal(size=(20_000, 3)),
    }[kind]
    groups = sog._groups(rows, np.arange(20_000))
    assert sorted(np.concatenate(groups)) == list(range(20_000))
    assert max(map(len, groups)) <= sog._CLUSTER
    assert len(groups) < 100


def test_a_folder_of_sog(tmp_path: Path) -> None:
    file = FOREIGN / "playbot-splat-transform.sog"
    zipfile.ZipFile(file).extractall(tmp_path)
    whole, parts = read_splats(file), read_splats(tmp_path / "meta.json")
    assert all(np.array_equal(values, getattr(parts, name)) for name, values in vars(whole).items())


def test_opacities_of_programs_that_write_infinity(tmp_path: Path) -> None:
    splats = replace(made(2, 0), opacity=np.array([np.inf, -np.inf], "f4"))
    (tmp_path / "a.ply").write_bytes(write_splats(splats, ".ply"))
    assert packing.opacities(read_splats(tmp_path / "a.ply")).tolist() == pytest.approx([1, 0], abs=1e-8)


# --- other programs as readers ----------------------------------------------------------------------------------------


def from_plyfile(file: Path) -> Splats:
    """What plyfile reads of a file of 3DGS."""
    table = PlyData.read(str(file))["vertex"].data
    rest = sum(name.startswith("f_rest_") for name in table.dtype.names) // 3

    def columns(*names: str) -> np.ndarray:
        return np.stack([table[name] for name in names], axis=1) if names else np.zeros((len(table), 0), "f4")

    return Splats(
        columns("x", "y", "z"),
        columns("f_dc_0", "f_dc_1", "f_dc_2"),
        columns(*(f"f_rest_{c * rest + k}" for k in range(rest) for c in range(3))).reshape(len(table), rest, 3),
        table["opacity"],
        columns("scale_0", "scale_1", "scale_2"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"),
    )


def test_plyfile_reads_it(tmp_path: Path) -> None:
    """The properties are those of 3DGS in their order."""
    splats = made(7, 3)
    (tmp_path / "a.ply").write_bytes(write_splats(splats, ".ply"))
    assert_near(from_plyfile(tmp_path / "a.ply"), splats, dict.fromkeys(vars(splats), 0))
    names = PlyData.read(str(tmp_path / "a.ply"))["vertex"].data.dtype.names
    wanted = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45))]
    assert [*names] == [*wanted, "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


@pytest.mark.slow
@pytest.mark.skipif(tool() is None, reason="splat-transform is missing: benchmarks.peers.convert says how to get it")
@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("suffix", [suffix for suffix in FORMATS if suffix != ".glb"])
def test_splat_transform_reads_it(suffix: str, degree: int, tmp_path: Path) -> None:
    """PlayCanvas's program finds the Gaussians that this reader finds. It does not read GLB."""
    data = write_splats(made(2500, degree), suffix)
    (tmp_path / f"a{suffix}").write_bytes(data)
    convert(tmp_path / f"a{suffix}", tmp_path / "b.ply")
    restored, wanted = from_plyfile(tmp_path / "b.ply"), as_read(FORMATS[suffix].read(data), suffix)
    if suffix != ".ply":
        # This reader takes bytes of 0 and 255 for a bit more and less.
        most = packing.logits(np.ones(1), packing.BYTE_OPACITY_LEAST).astype("f4")[0]
        restored = replace(restored, opacity=restored.opacity.clip(-most, most))
    assert_near(restored, wanted, dict.fromkeys(vars(restored), 4e-6) | {"opacity": 2e-5, "quaternion": 2e-5})


# --- what files state besides Gaussians, and where they are -----------------------------------------------------------


@st.composite
def maps(draw: st.DrawFn, offset: bool = True) -> NDArray[np.float64]:
    """A turn or a mirror, a scale and an offset, float64 [4, 4]."""
    quaternion = draw(arrays(np.float64, 4, elements=st.integers(-3, 3)).filter(np.any))
    turn = rotation_matrix(quaternion / np.linalg.norm(quaternion)) * draw(st.sampled_from([1, -1, 0.5, -3]))
    shift = draw(arrays(np.float64, 3, elements=st.integers(-9, 9))) * offset
    return np.block([[turn, shift[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def seen(splats: Splats, direction: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """What a change of the world changes: means, covariances, and colours from a direction of length 1, [3]."""
    turn = rotation_matrix(splats.unit_quaternions()) * np.exp(splats.scale.astype(np.float64))[:, None]
    basis = np.array([ZERO, *rest_harmonics(direction, splats.degree)])
    return [splats.mean, turn @ turn.transpose(0, 2, 1), np.einsum("k,nkc->nc", basis, splats.coefficients)]


@given(maps(), st.integers(0, 3))
def test_the_world_moves(world: NDArray[np.float64], degree: int) -> None:
    splats, direction = made(9, degree), np.array([0.6, -0.48, 0.64])
    linear, offset = world[:3, :3], world[:3, 3]
    size = np.cbrt(abs(np.linalg.det(linear)))
    mean, covariance, colour = seen(splats, direction)
    restored = seen(moved(splats, linear, offset), linear @ direction / size)
    for after, wanted in zip(restored, (mean @ linear.T + offset, linear @ covariance @ linear.T, colour), strict=True):
        np.testing.assert_allclose(after, wanted, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["LDB", "RUB", "RDF", "LUF", "RUF", "LFU", "RFU", "LBD", "RBD"])
def test_axes_that_spz_files_declare(name: str, tmp_path: Path) -> None:
    """Axes point left or right, up or down, and back or front. The library of Niantic gives the same numbers."""
    pytest.importorskip("zstandard")
    names = "LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU".split()  # noqa: SIM905
    record = struct.pack("<II", 0x12345678, 0) + struct.pack("<III", 0xADBE0003, 4, 1 + names.index(name))
    # In PLY files, x points right, y down and z front.
    axis = np.array(["RDFLUB".index(letter) for letter in name])
    turn = (axis % 3 == np.arange(3)[:, None]) * np.where(axis < 3, 1, -1)
    file, notes = FOREIGN / "playbot-splat-transform.spz", list[str]()
    data = bytearray(file.read_bytes())
    data[14], data[16] = data[14] | 3, data[16] + len(record)
    (tmp_path / "a.spz").write_bytes(data[:32] + record + data[32:])
    restored, _ = read_located(tmp_path / "a.spz", None, notes.append)
    wanted = moved(read_splats(file), turn @ np.diag([1.0, -1, -1]), np.zeros(3))
    assert_near(restored, wanted, dict.fromkeys(vars(wanted), 0))
    words = ["trained for antialiasing", "extensions 0x12345678 are unknown"]
    assert [word in note for word, note in zip(words, notes, strict=True)] == [True, True]


def glb_with(data: bytes, **values: Any) -> bytes:
    """A GLB file with other values in its JSON."""
    length = struct.unpack_from("<I", data, 12)[0]
    text = json.dumps(json.loads(data[20 : 20 + length]) | values).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, len(data) - length + len(text))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :]


@given(st.lists(maps(), min_size=2, max_size=2), maps())
def test_nodes_of_gltf(own: list[NDArray[np.float64]], above: NDArray[np.float64]) -> None:
    """Each node with the mesh shows it, moved by its matrix and by those above. Up is +y of the whole."""
    splats = made(5, 3)
    nodes = [{"mesh": 0, "matrix": matrix.T.ravel().tolist()} for matrix in own]
    nodes += [{"children": [0, 1], "matrix": above.T.ravel().tolist()}, {"mesh": 0}]
    data = glb_with(write_splats(splats, ".glb"), nodes=nodes, scenes=[{"nodes": [2]}])
    restored, up, direction = FORMATS[".glb"].read(data), read_up(data), np.array([0.6, -0.48, 0.64])
    wanted = [moved(splats, (above @ matrix)[:3, :3], (above @ matrix)[:3, 3]) for matrix in own]
    # The result is the scene, turned so that the first mesh keeps its axes.
    first = (above @ own[0])[:3, :3]
    turn = first / np.cbrt(np.linalg.det(first))
    np.testing.assert_allclose(turn @ up, [0, 1, 0], atol=1e-9)
    after = seen(moved(restored, turn, np.zeros(3)), direction)
    for number, part in enumerate(zip(*(seen(each, direction) for each in wanted), strict=True)):
        np.testing.assert_allclose(after[number], np.concatenate(part), rtol=1e-4, atol=1e-4)


def test_lengths_of_earlier_drafts_of_gltf(tmp_path: Path) -> None:
    """They are logarithms, and may be integers that are not normalised."""
    splats = replace(made(5, 0), scale=np.tile(np.array([-3, -2, 1], np.float32), (5, 1)))
    data = write_splats(splats, ".glb")
    lengths = np.exp(splats.scale.astype(float)).astype("f4").tobytes()
    accessors = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])["accessors"]
    accessors[3]["componentType"] = 5120
    whole = glb_with(data, accessors=accessors).replace(lengths, splats.scale.astype("i1").tobytes() + bytes(45))
    for each in (data.replace(lengths, splats.scale.tobytes()), whole):
        (tmp_path / "a.glb").write_bytes(each)
        notes: list[str] = []
        assert read_located(tmp_path / "a.glb", None, notes.append)[0].scale.tolist() == splats.scale.tolist()
        assert "read as logarithms" in notes[0]


def test_gltf_in_two_files(tmp_path: Path) -> None:
    data = write_splats(made(5, 1), ".glb")
    length = struct.unpack_from("<I", data, 12)[0]
    root = json.loads(data[20 : 20 + length])
    root["buffers"][0]["uri"] = "num%20bers.bin"
    (tmp_path / "num bers.bin").write_bytes(data[28 + length :])
    (tmp_path / "a.gltf").write_text(json.dumps(root))
    assert_near(read_splats(tmp_path / "a.gltf"), FORMATS[".glb"].read(data), dict.fromkeys(vars(made(1, 0)), 0))
    np.testing.assert_allclose(splats_up(tmp_path / "a.gltf"), [0, -1, 0], atol=1e-12)


def test_rows_of_32_bytes(tmp_path: Path) -> None:
    """Files of antimatter15's viewer."""
    splats = made(99, 0)
    rows = np.zeros(99, [("mean", "<f4", 3), ("size", "<f4", 3), ("colour", "u1", 4), ("turn", "u1", 4)])
    rows["mean"], rows["size"] = splats.mean, np.exp(splats.scale)
    colour = np.column_stack([0.5 + ZERO * splats.base, packing.opacities(splats)])
    rows["colour"] = (colour * 255).clip(0, 255).round()
    rows["turn"] = (splats.unit_quaternions() * 128 + 128).clip(0, 255).round()
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    steps = {"mean": 0, "scale": 1e-6, "base": 1 / 255 / ZERO, "opacity": 1 / 255, "quaternion": 20 / 128}
    inside = replace(splats, base=splats.base.clip(-0.5 / ZERO, 0.5 / ZERO))
    assert_near(read_splats(tmp_path / "a.splat"), inside, steps)


@pytest.mark.parametrize(
    ("suffix", "old", "new", "noted"),
    [
        (".ply", b"comment", b"comment SplatRenderMode: mip\ncomment", True),
        (".ply", b"comment", b"comment antialiased 1\ncomment", True),
        (".compressed.ply", b"comment", b"comment splatrendermode: Mip\ncomment", True),
        (".ply", b"comment", b"comment antialiased 1\ncomment SplatRenderMode: default\ncomment", False),
    ],
)
def test_splats_for_other_filters(suffix: str, old: bytes, new: bytes, noted: bool, tmp_path: Path) -> None:
    (tmp_path / f"a{suffix}").write_bytes(write_splats(made(5, 0), suffix).replace(old, new, 1))
    notes: list[str] = []
    read_located(tmp_path / f"a{suffix}", None, notes.append)
    assert [note.startswith(f"refcodec: {tmp_path / 'a'}{suffix}: trained for anti") for note in notes] == [
        True
    ] * noted


def ply_with(splats: Splats, *without: str, **more: NDArray[Any]) -> bytes:
    """A PLY file of Gaussians without the properties of some stems, and with others."""
    table = parse_ply(write_splats(splats, ".ply"))["vertex"]
    columns = {name: table[name] for name in names_of(table) if not name.startswith(without or "-")} | more
    made = np.empty(len(table), [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        made[name] = values
    return ply_bytes({"vertex": made})


def test_ply_files_of_other_programs(tmp_path: Path) -> None:
    """What a file has instead of 3DGS's properties, or besides them, is used, and said."""
    file, splats, notes = tmp_path / "a.ply", made(20, 3), list[str]()

    def located(data: bytes, note: str) -> tuple[Splats, list[float]]:
        file.write_bytes(data)
        notes.clear()
        read, offset = read_located(file, None, notes.append)
        assert len(notes) == 1
        assert note in notes[0]
        return read, offset.tolist()

    red = np.arange(20, dtype=np.uint8)
    coloured, _ = located(ply_with(splats, "f_", red=red, green=red, blue=red), "colours are integers")
    np.testing.assert_allclose(0.5 + ZERO * coloured.base[:, 1], red / 255, atol=1e-6)
    words = {name: red.astype(np.uint16) * 257 for name in ("red", "green", "blue", "alpha")}
    coloured, _ = located(ply_with(splats, "f_", "opacity", **words), "colours are integers")
    np.testing.assert_allclose(0.5 + ZERO * coloured.base[:, 1], red / 255, atol=1e-6)
    np.testing.assert_allclose(packing.opacities(coloured), red / 255, atol=2e-3)
    # Mip-Splatting: a ball gets the squares of both lengths, and the opacity the quotient of the volumes.
    ball = replace(splats, scale=np.zeros_like(splats.scale), opacity=np.zeros_like(splats.opacity))
    filtered, _ = located(ply_with(ball, filter_3D=np.full(20, 2, np.float32)), "filter_3D is applied")
    np.testing.assert_allclose(filtered.scale, np.log(5) / 2, rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-filtered.opacity)), 0.5 / 5**1.5, rtol=1e-5)
    # Lengths of quaternions have no meaning, though they may be beyond float32.
    far = {f"rot_{i}": splats.quaternion[:, i].astype(np.float64) * 1e250 for i in range(4)}
    file.write_bytes(ply_with(splats, **far))
    assert_near(read_splats(file), splats, {"quaternion": 1e-6, "mean": 0})
    # Of 72 coefficients, each channel has 24. Those of degree 3 are the first 15.
    rest = {f"f_rest_{i}": np.full(20, i, np.float32) for i in range(72)}
    cut, _ = located(ply_with(splats, "f_rest", **rest), "degree 4 are cut to degree 3")
    assert cut.rest[0, :, 1].tolist() == list(range(24, 39))
    # UTM, 0.25 m and a map's origin in whole metres.
    there = {name: 5e6 + 0.25 + splats.mean[:, i].astype(np.float64) for i, name in enumerate("xyz")}
    near, offset = located(ply_with(splats, **there), "is subtracted")
    np.testing.assert_allclose(near.mean + np.array(offset) - 5e6, splats.mean + 0.25, atol=1e-6)
    assert np.abs(near.mean).max() < 10
    moved, _ = read_located(file, np.array([5e6, 5e6, 5e6]))
    np.testing.assert_allclose(moved.mean, splats.mean + 0.25, atol=1e-6)


def test_the_folder_of_a_model(tmp_path: Path) -> None:
    """Its splat is that of the last iteration. Models of Scaffold-GS have none."""
    for name, more in (("7000", {}), ("30000", {}), ("100000", {"f_offset_0": np.zeros(3, np.float32)})):
        folder = tmp_path / "point_cloud" / f"iteration_{name}"
        folder.mkdir(parents=True)
        (folder / "point_cloud.ply").write_bytes(ply_with(made(3, 0), **more))
    assert model_splats(tmp_path) is None
    (folder / "point_cloud.ply").unlink()
    assert model_splats(tmp_path) == tmp_path / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    assert model_splats(folder) is None
