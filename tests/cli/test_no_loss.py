"""No command overwrites its input, or files that it did not make: tests of past and similar faults."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_scenes import random_scene

from conformance.cli import main as suite_main
from conformance.manifest import VECTORS
from conformance.spec_decoder.__main__ import main as second_main
from refcodec.bitstream.codec import emit, parse
from refcodec.cli.main import main
from refcodec.folder.write import write_folder

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a file, a scene folder, and a camera, in which the commands run."""
    scene = random_scene(21, 6, chunk_size=4)
    scene.networks["opacity"][-1][1][:] = 5
    (tmp_path / "scene.c3gs").write_bytes(emit(scene))
    (tmp_path / "bad.c3gs").write_bytes(emit(scene)[:-1])
    write_folder(parse(emit(scene)).scene, tmp_path / "scene")
    (tmp_path / "letter.txt").write_text("precious\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[Path, bytes]:
    return {p: p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture
def refused(place: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that is to be refused: status 64, one line, and nothing changed. Returns the line."""

    def run(*words: str, program: Callable[[list[str]], int] = main) -> str:
        before = contents(place)
        assert program(list(words)) == 64, words
        said = capsys.readouterr().err
        assert len(said.splitlines()) == 1, said
        assert contents(place) == before
        return said

    return run


def test_a_trace_is_an_output_like_any_other(place: Path, refused: Callable[..., str], capsys: Any) -> None:
    """The input was lost, and a refused file left its trace empty."""
    assert "is not a symbol trace" in refused("reconstruct", "scene.c3gs", "out", "--trace", "scene.c3gs")
    assert "is not a symbol trace" in refused("reconstruct", "scene.c3gs", "out", "--trace", "letter.txt")
    assert "are one file" in refused("reconstruct", "scene.c3gs", "out", "--trace", "./out")
    assert main(["reconstruct", "scene.c3gs", "out", "--trace", "trace"]) == 0
    lines = (place / "trace").read_text().splitlines()
    assert len(lines) > 100
    assert main(["reconstruct", "bad.c3gs", "out", "--trace", "trace"]) == 1
    assert (place / "trace").read_text().splitlines() == lines
    assert main(["reconstruct", "scene.c3gs", "out", "--trace", "trace"]) == 0
    assert main(["reconstruct", "bad.c3gs", "out2", "--trace", "trace2"]) == 1
    assert not (place / "out2").exists()
    assert not (place / "trace2").exists()
    # A trace that is a file as C3GS knows it, and a link to it.
    shutil.copy("trace", "scene.c3gs")
    os.link("trace", "hard")
    capsys.readouterr()
    assert "is read" in refused("reconstruct", "trace", "out", "--trace", "hard")


def test_a_link_to_the_input(place: Path, refused: Callable[..., str]) -> None:
    """An empty file may be replaced, but not if it is read."""
    (place / "empty").write_bytes(b"")
    (place / "link").symlink_to("empty")
    assert "is read" in refused("reconstruct", "empty", "link")
    assert "is read" in refused("gaussians", "scene.c3gs", "empty", "link")
    assert "is read" in refused("gaussians", "empty", "camera.json", "./empty")
    os.link("scene/scene.json", "hard")
    assert "not a C3GS file" in refused("encode", "scene", "-o", "hard")
    assert "are read" in refused("encode", "scene", "-o", "scene/new.c3gs")


def test_a_scene_folder_that_is_read(place: Path, refused: Callable[..., str]) -> None:
    shutil.move("scene.c3gs", "scene/ancillary_0_noTE.bin")
    assert "is read" in refused("decode", "scene/ancillary_0_noTE.bin", "-o", "scene")
    pytest.importorskip("torch")
    assert "read" in refused("fit", "scene", "-o", "scene")
    assert "read" in refused("fit", "scene/point_cloud.ply", "-o", "scene")
    (place / "new.fit-state").write_text("precious")
    assert "saved state" in refused("fit", "scene", "-o", "new")
    (place / "new.train-state").write_text("precious")
    assert "saved state" in refused("train", "scene", "-o", "new")


@pytest.mark.parametrize("what", ["dangling", "circle", "pipe", "directory"])
def test_something_else_in_the_place_of_a_file(what: str, place: Path, refused: Callable[..., str]) -> None:
    """coded.safetensors counted as absent, and encode quantised anew silently."""

    def put(path: Path) -> None:
        path.unlink(missing_ok=True)
        if what in ("dangling", "circle"):
            path.symlink_to("nowhere" if what == "dangling" else path.name)
        elif what == "pipe":
            os.mkfifo(path)
        else:
            path.mkdir()

    put(place / "scene" / "coded.safetensors")
    assert "not a file" in refused("encode", "scene", "-o", "out")
    # Nor does an uncompressed scene count as none.
    put(place / "scene" / "render.json")
    assert "render.json" in refused("render", "scene", "-o", "images")
    pytest.importorskip("torch")
    assert "render.json" in refused("fit", "scene", "-o", "new")


def test_a_missing_file_may_be_missing(place: Path) -> None:
    (place / "scene" / "coded.safetensors").unlink()
    assert main(["encode", "scene", "-o", "out"]) == 0


# --- images -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def photographs(place: Path) -> Path:
    """Photographs l/0.png and r/0.png, and two that differ in their endings, in NeRF's format."""
    for package in ("numba", "PIL", "skimage", "scipy"):
        pytest.importorskip(package)
    from PIL import Image  # noqa: PLC0415

    frames = []
    for number, name in enumerate(("l/0.png", "r/0.png", "r/1.png", "r/1.bmp")):
        path = place / "photos" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((12, 16, 3), 60 * number, np.uint8)).save(path)
        c, s = np.cos(number / 3), np.sin(number / 3)
        pose = [[c, 0, s, 4 * s], [0, 1, 0, 0], [-s, 0, c, 4 * c], [0, 0, 0, 1]]
        frames.append({"file_path": name, "transform_matrix": pose})
    document = {"camera_angle_x": 0.7, "frames": frames}
    (place / "photos" / "transforms.json").write_text(json.dumps(document))
    return place / "photos"


def test_photographs_are_not_replaced(photographs: Path, refused: Callable[..., str], capsys: Any) -> None:
    render = ("render", "scene.c3gs", "--cameras", "photos", "-o")
    assert "photos" in refused(*render, "photos")
    assert "is read" in refused(*render, "photos/l/..")
    assert "photos" in refused("eval", "scene.c3gs", "photos", "--images", "photos")
    Path("way").symlink_to("photos")
    assert "photos" in refused(*render, "way")
    # What is not a photograph of this run is still not refcodec's.
    Path("album/l").mkdir(parents=True)
    shutil.copy(photographs / "l" / "0.png", "album/l/0.png")
    assert "refcodec wrote" in refused(*render, "album")
    Path("album/l/0.png").unlink()
    assert main([*render, "album"]) == 0
    assert main([*render, "album"]) == 0
    capsys.readouterr()
    os.link("album/l/0.png", "photos/l/2.png")
    assert "read" in refused(*render, "album")


def test_images_keep_apart(photographs: Path, capsys: Any) -> None:
    assert main(["render", "scene.c3gs", "--cameras", "photos", "-o", "out"]) == 0
    assert "4 images" in capsys.readouterr().out
    names = {p.relative_to("out").as_posix() for p in Path("out").rglob("*") if p.is_file()}
    assert names == {"l/0.png", "r/0.png", "r/1.png", "r/1.png.png"}
    assert len({p.read_bytes() for p in Path("out").rglob("*.png")}) == 4


def test_names_of_images() -> None:
    pytest.importorskip("PIL")
    from refcodec.rendering.images import image_names  # noqa: PLC0415

    assert image_names(["l/0.png", "r/0.png", "plain"]) == ["l/0.png", "r/0.png", "plain.png"]
    assert image_names(["0.jpg", "0.tif", "0.jpg", "0.jpg"]) == ["0.png", "0.tif.png", "0.jpg.png", "0.jpg-2.png"]
    # A system may take these for one name.
    assert image_names(["a.jpg", "A.jpg"]) == ["a.png", "A.jpg.png"]
    # A name cannot be that of a file and of a folder.
    assert image_names(["a.jpg", "a.png/b.jpg"]) == ["a.png", "a.png_b.jpg-2.png"]
    assert image_names(["a.png/b.jpg", "a.jpg"]) == ["a.png/b.png", "a.jpg.png"]
    # None leads out of the folder.
    assert image_names(["/x/../../y.jpg", "", ".."]) == ["x/y.png", "image.png", "image-2.png"]


def test_an_animation_is_replaced_only_if_it_is_ours(photographs: Path, refused: Callable[..., str]) -> None:
    orbit = ("render", "scene.c3gs", "--cameras", "orbit", "--frames", "2", "-o", "out")
    assert main(list(orbit)) == 0
    assert main(list(orbit)) == 0
    Path("out/orbit.gif").write_bytes(b"GIF89a of somebody else")
    assert "animation" in refused(*orbit)


# --- runs at once -----------------------------------------------------------------------------------------------------


def together(count: int, *words: str) -> list[tuple[int, str]]:
    """The exit status and stderr of some processes with one command."""
    command = [sys.executable, "-m", "refcodec", *words]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(count)]
    return [(p.returncode, said) for p in processes for said in [p.communicate(timeout=120)[1]]]


def test_decodes_at_once(place: Path) -> None:
    """They shared a folder for what is not whole yet, and most failed."""
    found = together(9, "decode", "scene.c3gs", "-o", "new")
    assert found == [(0, "new: 6 anchors of scene.c3gs\n")] * 9
    new, old = ({p.name: p.read_bytes() for p in (place / name).iterdir()} for name in ("new", "scene"))
    assert new == old


def test_a_killed_decode_is_no_hindrance(place: Path) -> None:
    """It left its folder behind, with files in it, and the scene in between."""
    new = place / "new"
    shutil.copytree("scene", new)
    (new / ".refcodec-incoming" / "old").mkdir(parents=True)
    (new / "scene.json").rename(new / ".refcodec-incoming" / "old" / "scene.json")
    assert main(["decode", "scene.c3gs", "-o", "new"]) == 0
    assert {p.name for p in new.iterdir()} == {p.name for p in (place / "scene").iterdir()}


@pytest.mark.slow
def test_one_fit_at_a_time(place: Path) -> None:
    """They share the state that is saved."""
    pytest.importorskip("torch")
    points = "".join(f"{i} {i % 5} {i // 5} {i % 3} 90 90 200 0.5\n" for i in range(60))
    (place / "points3D.txt").write_text(points)
    found = together(3, "fit", "points3D.txt", "-o", "new", "--steps", "300")
    assert min(status for status, _ in found) == 0, found
    for status, said in found:
        assert status in (0, 64)
        assert status == 0 or ("another run" in said and len(said.splitlines()) == 1)
    assert not list(place.glob("*.lock"))


# --- the suite's commands ---------------------------------------------------------------------------------------------


def test_the_suite_s_commands(place: Path, refused: Callable[..., str], capsys: Any) -> None:
    # It removed folders with the names of classes.
    Path("valid").mkdir()
    Path("valid/thesis.txt").write_text("precious")
    assert "not a conformance suite" in refused("generate", "-o", ".", program=suite_main)
    decoder = ("--select", "id:valid-plain", "--", sys.executable, "{input}", "{output}")
    for name in ("report.json", "report.xml", "report.html"):
        Path(name).write_text("mine")
        assert "not a report" in refused("run", "--report", ".", *decoder, program=suite_main)
        Path(name).unlink()
    assert "are read" in refused("run", "--report", str(VECTORS), *decoder, program=suite_main)


def test_the_second_decoder(place: Path, refused: Callable[..., str]) -> None:
    for words in (("scene.c3gs",), ("./scene.c3gs",), ("out", "--trace", "scene.c3gs"), ("out", "--trace", "out")):
        refused("decode", "scene.c3gs", *words, program=second_main)
    os.link("scene.c3gs", "hard")
    refused("decode", "scene.c3gs", "hard", program=second_main)
    assert second_main(["decode", "scene.c3gs", "out", "--trace", "trace"]) == 0


def test_a_link_in_the_place_of_a_training_s_report(tmp_path: Path, capsys: Any) -> None:
    pytest.importorskip("numba")
    scene = tmp_path / "scene"
    assert main(["decode", str(ROOT / "vectors" / "tiny-example.c3gs"), "-o", str(scene)]) == 0
    (scene / "training.json").symlink_to("nowhere")
    photographs = str(ROOT / "examples" / "photographs" / "caliterra")
    assert main(["eval", str(scene), photographs]) == 64
    assert "a link that leads nowhere" in capsys.readouterr().err
