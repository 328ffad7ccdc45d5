"""The command export: its outputs, its messages, and its errors."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_inputs import CALITERRA, TRAINED, Call

for package in ("numba", "PIL", "scipy"):
    pytest.importorskip(package, reason="exporting needs the packages of the extra render")

from plyfile import PlyData  # noqa: E402

from refcodec.bitstream.cameras import camera_sections  # noqa: E402
from refcodec.bitstream.codec import emit, parse  # noqa: E402
from refcodec.export import fit, views  # noqa: E402
from refcodec.formats.table import FORMATS, read_splats  # noqa: E402
from refcodec.rendering.camera import Camera, axis_direction, named_camera  # noqa: E402
from refcodec.rendering.rasterise import draw, settings_of  # noqa: E402
from refcodec.rendering.view import View  # noqa: E402


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder at hand with a scene, and few small views."""
    shutil.copy(TRAINED, tmp_path / "scene.c3gs")
    monkeypatch.setattr(views, "AROUND", 18)
    monkeypatch.setattr(views, "SIDE", 48)
    monkeypatch.chdir(tmp_path)
    return tmp_path


QUICK = ("--iterations", "0", "--degree", "1")


def test_export(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """All formats of one command are of one fit."""
    fits, whole = [], fit.fit

    def counted(*arguments: Any) -> fit.Fitted:
        fits.append(whole(*arguments))
        return fits[-1]

    monkeypatch.setattr(fit, "fit", counted)
    outputs = [place / f"scene.{suffix}" for suffix in ("ply", "spz", "sog", "glb")]
    words = ["export", "scene.c3gs", *(word for output in outputs for word in ("-o", output.name)), *QUICK]
    status, out, err = call(*words)
    assert (status, len(fits)) == (0, 1)
    lines = re.findall(
        r"(scene\.\w+): (\S+) of 6,120 Gaussians, degree 1, (\S+) bytes, scene\.c3gs has 53,052\n"
        r"(?:its harmonics have 7 bits; with 8 \(export --spz-bits\) it has \S+ bytes\n)?"
        r"PSNR to the scene, in viewers: (\S+) dB over 2 views, fitted to 16 cameras around the scene\n",
        out,
    )
    assert [name for name, *_ in lines] == [output.name for output in outputs], out
    assert [int(size.replace(",", "")) for *_, size, _ in lines] == [output.stat().st_size for output in outputs]
    assert all(float(near) > 25 for *_, near in lines)
    assert "--cameras PHOTOGRAPHS" in err
    table = PlyData.read(str(outputs[0]))["vertex"].data
    assert len(table) == int(lines[0][1].replace(",", ""))
    assert all(np.isfinite(table[name]).all() for name in table.dtype.names)
    # It replaces what it wrote, with the same bytes, and nothing else.
    before = [output.read_bytes() for output in outputs]
    assert call(*words)[0] == 0
    assert [output.read_bytes() for output in outputs] == before
    for output, data in zip(outputs, before, strict=True):
        output.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 0\nend_header\n")
        status, _, err = call(*words)
        assert (status, "refcodec wrote" in err) == (64, True)
        output.write_bytes(data)
    assert [output.read_bytes() for output in outputs] == before


def test_a_static_scene(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Export of a static scene is no fit, and decode writes the same files."""
    monkeypatch.setattr(fit, "fit", None)
    shutil.copy(TRAINED.with_name("static-degree-2.c3gs"), place / "static.c3gs")
    outputs = [f"static.{suffix}" for suffix in ("ply", "spz", "sog", "glb")]
    outcome = call("export", "static.c3gs", *(word for output in outputs for word in ("-o", output)))
    assert (outcome[0], outcome[2]) == (0, "")
    for output in outputs:
        size = (place / output).stat().st_size
        assert f"{output}: 9 Gaussians, degree 2, {size:,} bytes, static.c3gs has 4,040\n" in outcome[1]
    before = [(place / output).read_bytes() for output in outputs]
    assert call("decode", "static.c3gs", *(word for output in outputs for word in ("--splat", output))) == outcome
    assert [(place / output).read_bytes() for output in outputs] == before
    assert call("decode", "static.c3gs", "-o", "folder")[0] == call("export", "folder", "-o", "again.ply")[0] == 0
    assert (place / "again.ply").read_bytes() == before[0]
    # Viewers have another filter than such a scene.
    changed = parse((place / "static.c3gs").read_bytes()).scene
    changed = replace(changed, render=replace(changed.render, low_pass=0.1))
    (place / "static.c3gs").write_bytes(emit(changed))
    assert "this scene is made for 0.1:" in call("export", "static.c3gs", "-o", "own.ply")[2]


def seen(place: Path) -> tuple[View, list[Camera]]:
    """Writes static.c3gs, a scene with nine cameras around it, up +z, and returns its view and its cameras."""
    pytest.importorskip("torch", reason="convert needs the packages of the extra convert")
    scene = parse(TRAINED.with_name("static-degree-2.c3gs").read_bytes()).scene
    scene = replace(scene, render=replace(scene.render, up_axis=4))
    around = [replace(c.resized(60, 40), cx=33.0) for c in View(scene).orbit(9)]
    sections = camera_sections([named_camera(c, str(i)) for i, c in enumerate(around)])
    (place / "static.c3gs").write_bytes(emit(replace(scene, ancillary=tuple(sections))))
    return View(scene), around


@pytest.mark.parametrize("suffix", FORMATS)
def test_cameras_beside_splats(suffix: str, place: Path, call: Call) -> None:
    """Whatever the axes of a format are, what convert reads looks as the scene from where people stand."""
    view, around = seen(place)
    from refcodec.convert.pictures import stated_cameras, up_of  # noqa: PLC0415

    status, out, _ = call("export", "static.c3gs", "-o", f"a{suffix}")
    assert (status, f"cameras.json: {len(around)} cameras, from which `refcodec convert` measures" in out) == (0, True)
    splats, cameras = read_splats(Path(f"a{suffix}")), stated_cameras(Path(f"a{suffix}"), None)
    assert len(cameras) == len(around)
    wanted = np.stack([view.draw(camera) for camera in around])
    drawn = np.stack([np.minimum(draw(splats, camera, settings_of(view.info)).image, 1) for camera in cameras])
    same, neighbours = (float(np.mean((wanted - np.roll(drawn, turn, axis=0)) ** 2)) for turn in (0, 1))
    assert 10 * same < neighbours
    np.testing.assert_allclose(up_of(Path(f"a{suffix}"), None, cameras), axis_direction(view.info.up_axis), atol=0.05)


def test_cameras_replace_no_others(place: Path, call: Call) -> None:
    """Those of other programs and other splats stay, and convert does not take them for those of a splat."""
    seen(place)
    from refcodec.convert.pictures import stated_cameras  # noqa: PLC0415

    file, notes = Path("cameras.json"), list[str]()
    file.write_text("[]\n")
    assert "cameras.json exists and is not a cameras.json that" in call("export", "static.c3gs", "-o", "a.ply")[1]
    assert file.read_text() == "[]\n"
    file.unlink()
    for _ in range(2):
        assert "9 cameras, from which" in call("export", "static.c3gs", "-o", "a.ply", "-o", "a.spz")[1]
    before = file.read_bytes()
    out = call("export", "static.c3gs", "-o", "b.ply")[1]
    assert "cameras.json is not replaced (it is of a.ply, a.spz)" in out
    assert file.read_bytes() == before
    assert stated_cameras(Path("b.ply"), None, notes.append) == []
    assert "cameras.json is of a.ply, a.spz: --cameras cameras.json uses it for b.ply" in notes[0]
    assert len(stated_cameras(Path("b.ply"), "cameras.json")) == 9
    # A scene with few cameras does not show from where it is seen.
    assert "cameras.json" not in call("export", "scene.c3gs", "-o", "c.ply", *QUICK)[1]


def test_bits_of_spz(place: Path, call: Call) -> None:
    """Fewer bits take fewer bytes, and the output has the size with others."""
    sizes = {}
    for words in ([], ["--spz-bits", "4"], ["--spz-bits", "8"]):
        pattern = r"its harmonics have (\d) bits; with (\d) \(export --spz-bits\) it has (\S+) bytes"
        ((bits, other, size),) = re.findall(pattern, call("export", "scene.c3gs", "-o", "a.spz", *QUICK, *words)[1])
        sizes[bits] = (place / "a.spz").stat().st_size
        sizes.setdefault(f"said {other}", int(size.replace(",", "")))
    assert list(sizes) == ["7", "said 8", "4", "8", "said 7"]
    assert sizes["4"] < sizes["7"] < sizes["8"]
    assert (sizes["said 7"], sizes["said 8"]) == (sizes["7"], sizes["8"])


@pytest.mark.slow
def test_photographs_are_nearer(place: Path, call: Call) -> None:
    """Where the scene was trained, it depends less on the view than elsewhere."""
    around = call("export", "scene.c3gs", "-o", "a.ply", *QUICK)[1]
    trained = call("export", "scene.c3gs", "-o", "b.ply", *QUICK, "--cameras", CALITERRA, "--size", "48")[1]
    assert "cameras of photographs" in trained
    near = [float(re.search(r"(\S+) dB", text)[1]) for text in (around, trained)]  # type: ignore[index]
    assert near[1] > near[0] + 2


def test_a_scene_folder(place: Path, call: Call) -> None:
    assert call("decode", "scene.c3gs", "-o", "scene")[0] == 0
    for source, output in (("scene", "a.ply"), ("scene.c3gs", "b.ply")):
        assert call("export", source, "-o", output, *QUICK)[0] == 0
    assert (place / "a.ply").read_bytes() == (place / "b.ply").read_bytes()
    status, _, err = call("export", "scene", "-o", "scene/new.ply", *QUICK)
    assert (status, "files are read" in err) == (64, True)
