"""The demo: its page, and the files of finished, interrupted and failed commands. Its training is simulated."""

from __future__ import annotations

import base64
import io
import json
import re
import signal
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

for package in ("numba", "PIL", "skimage", "scipy"):
    pytest.importorskip(package, reason="the demo needs the packages of the extra demo")

from PIL import Image  # noqa: E402

from refcodec.cli.main import main  # noqa: E402
from refcodec.experiments import demo, runs  # noqa: E402
from refcodec.experiments.page import difference, page, readable  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
FAKE = (sys.executable, str(ROOT / "tests" / "experiments" / "fake_refcodec.py"))
# Elements that have no end.
VOID = {"meta", "img", "br", "input"}


class Reader(HTMLParser):
    """Every element of a page. Fails where one ends that did not begin."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] not in (["style"], ["script"]):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def images(self) -> list[np.ndarray]:
        found = []
        for tag, attributes in self.elements:
            if tag == "img":
                head, data = str(attributes["src"]).split(",")
                assert head == "data:image/jpeg;base64"
                found.append(np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))))
        return found


def small_result() -> dict[str, Any]:
    def grey(value: int) -> np.ndarray:
        return np.full((6, 8, 3), value, np.uint8)

    views = [
        {
            "name": f"<{i}>.jpg",
            "photograph": grey(100),
            "uncompressed": grey(110),
            "decoded": grey(90),
            "before": {"psnr": 30.0 + i, "ssim": 0.91},
            "after": {"psnr": 29.25 + i, "ssim": 0.87},
        }
        for i in range(2)
    ]
    parts = [("positions", 12_000_000, 100_000), ("masks", 0, 20_000), ("headers", 0, 380_000)]
    return {
        "title": "A & B",
        "photographs": 16,
        "held_out": True,
        "views": views,
        "mean_before": {"psnr": 30.5, "ssim": 0.91},
        "mean_after": {"psnr": 29.75, "ssim": 0.87},
        "parts": [{"name": name, "text": name, "before": before, "after": after} for name, before, after in parts],
        "anchors": (1000, 900),
        "trained": (50, 50),
        "steps_wanted": 50,
        "rate": 0.004,
        "digest": "ab" * 32,
        "steps": [("coded train", "refcodec train x", 100.0), ("coded decode", "refcodec decode <x>", 1.26)],
        "charts": {
            "uncompressed": [(0.0, 10.0), (60.0, 30.0)],
            "coded": [(0.0, 10.0), (60.0, float("inf")), (70.0, 29.9)],
        },
        "files": [("scene.c3gs", "the file", 500_000)],
        "credits": "Photographs by <somebody>",
    }


def test_the_page_holds_everything() -> None:
    result = small_result()
    text = page(result)
    found = Reader(text)
    images = found.images()
    assert [image.shape for image in images] == [(6, 8, 3)] * 10
    # The slider's, then photograph, uncompressed, decoded and difference of each view; JPEG changes greys by little.
    means = [round(float(image.mean())) for image in images]
    assert means == pytest.approx([90, 110, *([100, 110, 90, 40] * 2)], abs=2)
    # 12 MB to 0.5 MB.
    for words in (
        "12.0 MB",
        "500 kB",
        "24",
        "30.50 dB",
        "29.75 dB",
        "29.25 dB, SSIM 0.870",
        "1 min 40 s",
        "1.3 s",
        "76.0 %",
        "900",
        "ab" * 32,
    ):
        assert words.replace(" ", "\N{NO-BREAK SPACE}") in text or words in found.text, words
    for words in ("A & B", "<0>.jpg", "refcodec decode <x>", "Photographs by <somebody>"):
        assert words in found.text
    assert "stopped early" not in text


def test_the_page_needs_nothing_else() -> None:
    text = page(small_result())
    assert "//" not in re.sub(r"base64,[^\"]*", "", text)
    assert "url(" not in text
    assert "@import" not in text
    for tag, attributes in Reader(text).elements:
        assert tag not in ("link", "iframe", "object")
        if tag == "a":
            assert attributes["href"] == "scene.c3gs"
        if tag == "script":
            assert not attributes


def test_texts_that_cannot_be_shown() -> None:
    """Names of folders and photographs and the words of their authors steer neither the page nor its window."""
    steering, result = "a\u202eb\x1b[31m", small_result()
    views = [{**view, "name": steering} for view in result["views"]]
    text = page({**result, "title": steering, "views": views, "credits": f"{steering}\n{steering}"})
    assert not re.search(r"[\x00-\x09\x0b-\x1f\u202a-\u202e]", text)
    assert text.count(r"a\u202eb\x1b[31m") >= 5


def test_the_page_says_what_was_not_done() -> None:
    result = {**small_result(), "trained": (50, 1234), "steps_wanted": 2000, "held_out": False, "charts": {}}
    found = Reader(page(result)).text
    assert "stopped early: uncompressed at step 50 and coded at step 1,234 of 2,000" in found
    assert "none were held out" in found


@pytest.mark.parametrize(
    ("size", "text"),
    [(0, "0 B"), (999, "999 B"), (1000, "1.00 kB"), (99_960, "100 kB"), (999_600, "1.00 MB"), (1234e5, "123 MB")],
)
def test_readable(size: float, text: str) -> None:
    assert readable(size).replace("\N{NO-BREAK SPACE}", " ") == text


def test_difference() -> None:
    a, b = np.array([[[0, 10, 255]]], np.uint8), np.array([[[3, 0, 0]]], np.uint8)
    assert difference(a, b).tolist() == difference(b, a).tolist() == [[[12, 40, 255]]]


def test_the_size_of_each_part() -> None:
    parts = demo.sizes(
        {"positions": 12, "attributes": 100}, {"prologue": 1, "positions": 3, "chunk_table": 2, "attributes": 5}
    )
    assert [(p["name"], p["before"], p["after"]) for p in parts if p["before"] or p["after"]] == [
        ("positions", 12, 3),
        ("attributes", 100, 5),
        ("headers", 0, 3),
    ]


def test_the_demo_needs_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("refcodec.experiments.demo", "refcodec.experiments.page", "PIL"):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert main(["demo", "-o", str(tmp_path / "out")]) == 64
    assert "demo needs PIL: pip install 'refcodec[demo]'" in capsys.readouterr().err


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "PROGRAM", FAKE)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


@pytest.mark.usefixtures("fake")
def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ["demo", "-o", str(out), "--steps", "3"]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert (out / "index.html").as_uri() in printed.out
    found = Reader((out / "index.html").read_text())
    assert len(found.images()) == 2 + 4 * 10
    scene = json.loads((out / "decoded" / "scene.json").read_text())
    assert scene["digest"]["whole"] in found.text
    assert "Dennis Baldwin" in found.text
    assert "CC0 1.0" in found.text
    assert "done before" not in printed.err
    # Again: nothing is done twice, but for what is missing and what is made of it.
    assert main(command) == 0
    assert capsys.readouterr().err.count("done before") == 6
    (out / "scene.c3gs").unlink()
    assert main(command) == 0
    assert capsys.readouterr().err.count("done before") == 3
    # A decoder that disagrees is no detail.
    (out / "decoded" / "scene.json").write_text(
        (out / "decoded" / "scene.json").read_text().replace(scene["digest"]["whole"], "0" * 64)
    )
    assert main(command) == 70
    assert "differs from" in capsys.readouterr().err


@pytest.mark.usefixtures("fake")
def test_options_of_train_are_passed_on(tmp_path: Path) -> None:
    """Both training runs get them, and the page shows the photographs that were held out."""
    out = tmp_path / "out"
    given = ["--voxel", "0.5", "--holdout", "30", "--set", "masks.epsilon=0.02", "--set", "size=40"]
    assert main(["demo", "-o", str(out), "--steps", "3", *given]) == 0
    notes = json.loads((out / "demo.json").read_text())["commands"]
    for name in ("uncompressed", "coded"):
        train, evaluated = (notes[f"{name} {command}"]["arguments"] for command in ("train", "eval"))
        words = "--steps 3 --holdout 30 --voxel 0.5 --set masks.epsilon=0.02 --set size=40 --size 40 --threads 1"
        assert words in " ".join(train)
        assert "--size 40 --holdout 30 --images" in " ".join(evaluated)
    assert len(Reader((out / "index.html").read_text()).images()) == 2 + 4 * 3


@pytest.mark.slow
@pytest.mark.usefixtures("fake")
def test_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C once: both training runs save their scenes, and the page shows them. The tests of rd resume."""
    out = tmp_path / "out"
    arguments = ["demo", "-o", str(out), "--steps", "400"]
    program = f"import sys; from refcodec.experiments import runs; runs.PROGRAM = {FAKE!r}\n"
    program += f"from refcodec.cli.main import main; sys.exit(main({arguments!r}))"
    monkeypatch.setenv("FAKE_STEP", "20")
    with subprocess.Popen(
        [sys.executable, "-c", program], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        seen: set[str] = set()
        while len(seen) < 2:
            seen.add(process.stderr.readline().split()[0])
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "index.html" in printed
    assert "stopped early" in (out / "index.html").read_text()


@pytest.mark.usefixtures("fake")
def test_a_command_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FAKE_FAIL", f"{demo.RATE:g}")
    monkeypatch.setenv("FAKE_STEP", "10")
    # The other training would take minutes: it is stopped.
    assert main(["demo", "-o", str(tmp_path / "out"), "--steps", "100000"]) == 70
    printed = capsys.readouterr().err
    assert "it went wrong" in printed
    assert "this command failed: refcodec train" in printed


def test_what_is_wrong_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(*arguments: str) -> str:
        assert main(["demo", *arguments]) == 64
        return capsys.readouterr().err

    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "letter.txt").write_text("x")
    assert "choose another one" in refused("-o", str(mine))
    assert [p.name for p in mine.iterdir()] == ["letter.txt"]
    for text in ("{", "[]", '{"format": "another", "commands": {}}'):
        (mine / "demo.json").write_text(text)
        assert "choose another one" in refused("-o", str(mine))
    assert "Not a directory" in refused("-o", str(mine / "letter.txt" / "x"))
    out = str(tmp_path / "out")
    assert "no cameras" in refused("-o", out, "--photographs", str(mine))
    assert "not allowed with" in refused("--scene", "snowmiku", "--photographs", "x")
    assert "at least 1" in refused("--steps", "0")
    assert "no setting masks.epsilom" in refused("-o", out, "--set", "masks.epsilom=1")
    assert "rate.lambda_r" in refused("-o", out, "--set", "rate.lambda_r=1")
    assert "R,G,B" in refused("-o", out, "--background", "grey")
    monkeypatch.setattr(demo, "EXAMPLES", tmp_path)
    assert "--photographs" in refused("-o", out)
    assert not Path(out).exists()


@pytest.mark.slow
def test_the_whole_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is made up here: twenty steps of training."""
    pytest.importorskip("torch", reason="training needs the extra train")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    out = tmp_path / "out"
    assert main(["demo", "-o", str(out), "--steps", "20"]) == 0
    found = Reader((out / "index.html").read_text())
    assert len(found.images()) == 2 + 4 * 10
    assert json.loads((out / "decoded" / "scene.json").read_text())["digest"]["whole"] in found.text
    figures = {name: json.loads((out / f"{name}.eval.json").read_text()) for name in ("uncompressed", "coded")}
    assert all(figure["mean"]["psnr"] > 10 for figure in figures.values())
    assert figures["coded"]["bytes"] == (out / "scene.c3gs").stat().st_size < figures["uncompressed"]["bytes"]


def test_notes(tmp_path: Path) -> None:
    """What is made from something that is made anew is no longer done."""
    out = tmp_path / "out"
    notes = runs.Notes.open(out, "notes.json", "a format")
    commands = [
        runs.Command("x", (verb,), out / verb, after)
        for verb, after in (("a", ()), ("b", ("x a",)), ("c", ("x b",)), ("d", ()))
    ]
    for command in commands:
        command.output.write_text("")
        notes.begin(command)
        notes.end(command, 1.5, True)
    assert all(notes.is_done(command) for command in commands)
    assert notes.seconds("x c") == 1.5
    assert not notes.is_done(replace(commands[0], arguments=("a", "more")))
    commands[3].output.unlink()
    assert not notes.is_done(commands[3])
    first = replace(commands[0], state=out / "state")
    notes.begin(first)
    notes.end(first, 2.0, False)
    again = runs.Notes.open(out, "notes.json", "a format")
    assert not any(again.is_done(command) for command in commands)
    assert not again.can_resume(first)
    (out / "state").write_text("")
    assert again.can_resume(first)
    again.begin(first)
    again.end(first, 3.0, True)
    assert again.seconds("x a") == 5
