"""Static scenes in splat files: the decoded Gaussians themselves, in files that give the same numbers again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import refcodec
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.reconstruction import gaussians
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.splat import HARMONICS
from refcodec.cli.main import main
from refcodec.formats.common import Options
from refcodec.formats.table import FORMATS, write_splats
from refcodec.rendering.gaussians import RenderModelError, static_splats
from refcodec.statuses import USAGE

VALID = Path(__file__).resolve().parents[2] / "vectors" / "valid"
SCENES = sorted(path.stem for path in VALID.glob("static-*.c3gs"))


def scene_of(name: str) -> Scene:
    return parse((VALID / f"{name}.c3gs").read_bytes()).scene


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
    for field, values in vars(splats).items():
        # The coefficients are in one array, which is not copied.
        assert values.flags.c_contiguous or field in ("base", "rest")


def test_another_scene_has_no_plain_gaussians() -> None:
    with pytest.raises(RenderModelError, match="depend on the view: `refcodec export"):
        static_splats(scene_of("trained-caliterra"))
    scene = scene_of("static-degree-1")
    with pytest.raises(RenderModelError, match="render_model 7"):
        static_splats(replace(scene, render=replace(scene.render, render_model=7)))


@pytest.mark.parametrize("name", [name for name in SCENES if name != "static-empty"])
def test_ply_is_exact(name: str) -> None:
    """The decoded Gaussians come back from the file with their bits."""
    splats = static_splats(scene_of(name))
    restored = FORMATS[".ply"].read(write_splats(splats, ".ply"))
    for kind, values in vars(splats).items():
        np.testing.assert_array_equal(getattr(restored, kind).view(np.uint32), values.view(np.uint32), kind)


@pytest.mark.parametrize("name", ["static-degree-0", "static-degree-3", "static-packed", "static-turned"])
def test_pictures_are_the_same(name: str) -> None:
    """The plain Gaussians of a scene are drawn as the scene, from views around it."""
    pytest.importorskip("numba")
    pytest.importorskip("PIL")
    from refcodec.rendering.rasterise import draw, settings_of  # noqa: PLC0415
    from refcodec.rendering.view import View  # noqa: PLC0415

    view = View(scene_of(name))
    images = [(view.draw(camera), camera) for camera in (camera.resized(60, 40) for camera in view.orbit(3))]
    assert max(float(np.ptp(image)) for image, _ in images) > 0.1
    for image, camera in images:
        drawn = draw(static_splats(scene_of(name)), camera, settings_of(view.info)).image
        # SPEC 14.6: the values of a pixel are limited to 1.
        np.testing.assert_array_equal(np.minimum(drawn, 1), image)


def test_decode_splat(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command writes the Gaussians of refcodec.splats, and refuses other scenes."""
    pytest.importorskip("PIL")
    file = VALID / "static-degree-2.c3gs"
    outputs = [tmp_path / f"a{suffix}" for suffix in FORMATS]
    assert main(["decode", str(file), *(word for each in outputs for word in ("--splat", str(each)))]) == 0
    printed = capsys.readouterr().out
    assert all(f"{each.stat().st_size:,} bytes" in printed for each in outputs)
    for output, (suffix, row) in zip(outputs, FORMATS.items(), strict=True):
        assert output.read_bytes() == write_splats(refcodec.splats(file), suffix, Options(refcodec.decode(file).up))
        assert row.kind.begins.match(output.read_bytes())
    restored, wanted = FORMATS[".ply"].read(outputs[0].read_bytes()), refcodec.splats(file)
    assert all(np.array_equal(values, getattr(restored, kind)) for kind, values in vars(wanted).items())


@pytest.mark.parametrize("suffix", [*FORMATS, ".glb --glb=c3gs", ".html"])
def test_other_colours_are_refused(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Other programs take colours for sRGB, so those of BT.2020 and linear light are for no splat. A page has both."""
    scene = scene_of("static-degree-1")
    file, (end, *words) = tmp_path / "a.c3gs", suffix.split()
    for primaries, transfer in ((9, 13), (1, 8), (1, 16)):
        render = replace(scene.render, colour_primaries=primaries, transfer_characteristics=transfer)
        file.write_bytes(emit(replace(scene, render=render)))
        shown = suffix == ".html" and transfer == 8
        status = main(["export", str(file), "-o", str(tmp_path / f"b{end}"), *words])
        assert (status == 0, (tmp_path / f"b{end}").exists()) == (shown, shown)
        stated = f"primaries {primaries} and transfer characteristics {transfer} of ITU-T H.273, but must have 1 and 13"
        assert (stated in capsys.readouterr().err) != shown
        (tmp_path / f"b{end}").unlink(missing_ok=True)
        if end in FORMATS and not words:
            assert main(["decode", str(file), "--splat", str(tmp_path / f"b{end}")]) == USAGE
