"""Static scenes in splat files: the decoded Gaussians themselves, in files that give the same numbers again."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import refcodec
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.reconstruction import gaussians
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.splat import HARMONICS
from refcodec.cli.main import main
from refcodec.convert.glb import read_glb
from refcodec.convert.splat_arrays import Arrays
from refcodec.convert.splat_ply import read_splat_ply
from refcodec.export.formats import splat_file
from refcodec.export.splats import Splats, opacities, static_splats
from refcodec.rendering.camera import axis_direction
from refcodec.rendering.gaussians import RenderModelError
from refcodec.rendering.harmonics import REST
from refcodec.statuses import USAGE

VALID = Path(__file__).resolve().parents[2] / "vectors" / "valid"
SCENES = sorted(path.stem for path in VALID.glob("static-*.c3gs"))
UP = axis_direction(3)
READERS: dict[str, Callable[[Path], Arrays]] = {".ply": read_splat_ply, ".glb": read_glb}


def scene_of(name: str) -> Scene:
    return parse((VALID / f"{name}.c3gs").read_bytes()).scene


def read(splats: Splats, suffix: str, folder: Path) -> Splats:
    """The Gaussians that the project's reader finds in a file of Gaussians."""
    file = folder / f"a{suffix}"
    file.write_bytes(splat_file(splats, suffix, UP).data)
    return Splats(**READERS[suffix](file))


def assert_same_bits(found: Splats, wanted: Splats, *names: str) -> None:
    for name in names or [field.name for field in fields(Splats)]:
        a, b = getattr(found, name), getattr(wanted, name)
        assert a.dtype == b.dtype == np.float32
        np.testing.assert_array_equal(a.view(np.uint32), b.view(np.uint32), name)


def test_the_scenes_are_here() -> None:
    assert {f"static-degree-{degree}" for degree in range(4)} < set(SCENES)


@pytest.mark.parametrize("name", SCENES)
def test_the_numbers_of_9_4(name: str) -> None:
    """Each number of SPLAT is where Splats has it, with its bits."""
    scene = scene_of(name)
    splats, numbers = static_splats(scene), gaussians(scene)
    coefficients = np.concatenate([splats.base[:, None], splats.rest], axis=1).reshape(
        len(numbers), numbers.shape[1] - HARMONICS.start
    )
    parts = [splats.mean, splats.scale, splats.quaternion, splats.opacity[:, None], coefficients]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1).view(np.uint32), numbers.view(np.uint32))
    assert len(numbers) == scene.masks.sum()
    for values in vars(splats).values():
        assert values.flags.c_contiguous


def test_another_scene_has_no_plain_gaussians() -> None:
    with pytest.raises(RenderModelError, match="depend on the view: `refcodec export"):
        static_splats(scene_of("trained-caliterra"))
    scene = scene_of("static-degree-1")
    with pytest.raises(RenderModelError, match="render_model 7"):
        static_splats(replace(scene, render=replace(scene.render, render_model=7)))


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".sog", ".glb"])
def test_nothing_to_write(suffix: str) -> None:
    with pytest.raises(ValueError, match="it has no Gaussians"):
        splat_file(static_splats(scene_of("static-empty")), suffix, UP)


@pytest.mark.parametrize("name", [name for name in SCENES if name != "static-empty"])
def test_ply_is_exact(name: str, tmp_path: Path) -> None:
    splats = static_splats(scene_of(name))
    assert_same_bits(read(splats, ".ply", tmp_path), splats)


def glb_attributes(data: bytes) -> dict[str, np.ndarray]:
    """The float32 attributes of a GLB file of refcodec, [n, parts], without the prefix of the extension."""
    (size,) = struct.unpack_from("<I", data, 12)
    document, body = json.loads(data[20 : 20 + size]), data[28 + size :]
    found = {}
    for name, number in document["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = document["accessors"][number]
        if accessor["componentType"] == 5126:
            parts = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
            start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
            values = np.frombuffer(body, "<f4", accessor["count"] * parts, start).reshape(-1, parts)
            found[name.removeprefix("KHR_gaussian_splatting:")] = values
    return found


@pytest.mark.parametrize("name", [name for name in SCENES if name != "static-empty"])
def test_glb_is_rounded_once(name: str, tmp_path: Path) -> None:
    """GLB has lengths, opacities and unit quaternions in float32, and all other numbers as they are."""
    splats = static_splats(scene_of(name))
    found = read(splats, ".glb", tmp_path)
    stored = glb_attributes((tmp_path / "a.glb").read_bytes())
    with np.errstate(over="ignore"):
        lengths = np.exp(splats.scale.astype(np.float64)).astype(np.float32)
        logits = splats.opacity.astype(np.float64)
        wanted = {
            "POSITION": splats.mean,
            "SCALE": np.minimum(lengths, np.finfo(np.float32).max),
            "OPACITY": (1 / (1 + np.exp(-logits))).astype(np.float32)[:, None],
            "ROTATION": splats.unit_quaternions()[:, [1, 2, 3, 0]].astype(np.float32),
            "SH_DEGREE_0_COEF_0": splats.base,
        }
    places = [f"SH_DEGREE_{d}_COEF_{number}" for d in range(1, splats.degree + 1) for number in range(2 * d + 1)]
    wanted |= dict(zip(places, splats.rest.swapaxes(0, 1), strict=True))
    assert set(stored) == set(wanted)
    for attribute, values in wanted.items():
        np.testing.assert_array_equal(stored[attribute], values, attribute)
    assert_same_bits(found, splats, "mean", "base", "rest")
    # Lengths that float32 can hold with all of its bits.
    held = np.abs(splats.scale) < 87
    np.testing.assert_allclose(found.scale[held], splats.scale[held], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(opacities(found), opacities(splats), atol=1e-7)
    np.testing.assert_array_equal(found.quaternion, splats.unit_quaternions().astype(np.float32))


FLOATS = st.floats(-(2.0**60), 2.0**60, width=32)


@given(st.data(), st.integers(0, 3))
def test_numbers_come_back(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, degree: int) -> None:
    """A PLY file has any numbers, and a GLB file any means and harmonics."""
    count = data.draw(st.integers(1, 3))

    def floats(*shape: int) -> np.ndarray:
        return data.draw(arrays(np.float32, shape, elements=FLOATS))

    quaternion = data.draw(arrays(np.float32, (count, 4), elements=st.integers(-(2**20), 2**20)))
    quaternion[~quaternion.any(axis=1), 0] = 1
    harmonics = floats(count, 3), floats(count, REST[degree], 3)
    splats = Splats(floats(count, 3), *harmonics, floats(count), floats(count, 3), quaternion)
    folder = tmp_path_factory.mktemp("files")
    assert_same_bits(read(splats, ".ply", folder), splats)
    found = read(splats, ".glb", folder)
    assert_same_bits(found, splats, "mean", "base", "rest")


@pytest.mark.parametrize("name", ["static-degree-0", "static-degree-3", "static-packed", "static-turned"])
@pytest.mark.parametrize(("suffix", "least"), [(".ply", 100.0), (".glb", 100.0)])
def test_pictures_are_the_same(name: str, suffix: str, least: float, tmp_path: Path) -> None:
    """The loss in dB of a file that is read again, from views around the scene: none that a picture of 8 bits shows."""
    pytest.importorskip("numba")
    pytest.importorskip("PIL")
    from refcodec.export.fit import render_settings  # noqa: PLC0415
    from refcodec.export.splats import draw  # noqa: PLC0415
    from refcodec.rendering.view import View  # noqa: PLC0415

    view = View(scene_of(name))
    found = read(static_splats(scene_of(name)), suffix, tmp_path)
    cameras = [camera.resized(60, 40) for camera in view.orbit(3)]
    images = [(view.draw(camera), draw(found, camera, render_settings(view)).image) for camera in cameras]
    assert max(float(np.ptp(right)) for right, _ in images) > 0.1
    # SPEC 14.6: the values of a pixel are limited to 1.
    error = np.mean([(a.astype(np.float64) - np.minimum(b, 1)) ** 2 for a, b in images])
    assert not error or -10 * math.log10(error) > least


def test_decode_splat(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command writes the Gaussians of refcodec.gaussians, and refuses other scenes."""
    file = VALID / "static-degree-2.c3gs"
    outputs = [tmp_path / f"a{suffix}" for suffix in (".ply", ".glb", ".spz")]
    assert main(["decode", str(file), *(word for each in outputs for word in ("--splat", str(each)))]) == 0
    assert all(f"{each.stat().st_size:,} bytes" in capsys.readouterr().out for each in outputs[:1])
    assert_same_bits(Splats(**read_splat_ply(outputs[0])), refcodec.gaussians(file))
    other = str(VALID / "trained-caliterra.c3gs")
    assert main(["decode", other, "--splat", str(tmp_path / "b.ply")]) == 64
    assert "refcodec export" in capsys.readouterr().err
    with pytest.raises(ValueError, match="depend on the view"):
        refcodec.gaussians(other)
    assert not (tmp_path / "b.ply").exists()


@pytest.mark.parametrize("option", ["--glb=plain", "--glb=c3gs"])
def test_glb_states_its_colour_space(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A GLB file can state sRGB, but not the colours of BT.2020. A PLY file states none."""
    scene = scene_of("static-degree-1")
    file = tmp_path / "a.c3gs"
    file.write_bytes(emit(replace(scene, render=replace(scene.render, colour_primaries=9))))
    assert main(["export", str(file), "-o", str(tmp_path / "a.glb"), option]) == USAGE
    assert (
        "primaries 9 and transfer characteristics 13 of ITU-T H.273, but must have 1 and 13" in capsys.readouterr().err
    )
    assert not (tmp_path / "a.glb").exists()
    assert main(["export", str(file), "-o", str(tmp_path / "a.ply")]) == 0
