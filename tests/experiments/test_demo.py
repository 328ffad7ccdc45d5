"""The demo from end to end with a few steps of training, its page, and how it ends."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from refcodec.cli.main import main
from refcodec.experiments import demo
from refcodec.experiments.cells import Measures
from refcodec.experiments.page import difference, page, readable


@pytest.mark.slow
def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The page has all images and the digest, and needs nothing else. Options of train reach both training runs."""
    out = tmp_path / "out"
    given = ["--voxel", "0.5", "--holdout", "30", "--set", "masks.epsilon=0.02", "--set", "size=40"]
    command = ["demo", "-o", str(out), "--steps", "20", *given]
    assert main(command) == 0
    assert (out / "index.html").as_uri() in capsys.readouterr().out
    text = (out / "index.html").read_text()
    assert text.count("<img ") == text.count('src="data:image/jpeg;base64,') == 2 + 4 * 3
    # Three rates, and the uncompressed scene.
    assert re.findall(r"<tr><td>(0\.\d+|uncompressed)</td>", text) == ["0.016", "0.004", "0.001", "uncompressed"]
    digest = json.loads((out / "decoded" / "scene.json").read_text())["digest"]["whole"]
    for words in (digest, "Dennis Baldwin", "CC0 1.0"):
        assert words in text
    plain, coded = (json.loads((out / f"{name}.eval.json").read_text()) for name in ("uncompressed", "coded"))
    assert min(plain["mean"]["psnr"], coded["mean"]["psnr"]) > 10
    assert coded["bytes"] == (out / "scene.c3gs").stat().st_size < plain["bytes"]
    for name in ("uncompressed", "coded"):
        each = json.loads((out / name / "training.json").read_text())["settings"]
        assert (each["steps"], each["size"], each["holdout"], each["masks"]["epsilon"]) == (20, "40", 30, 0.02)
    # Again: nothing is done twice. After Ctrl-C in the trainings the page has what there is.
    assert main(command) == 0
    assert capsys.readouterr().err.count("done before") == 12
    ran, calls = demo._ran, list[bool]()
    monkeypatch.setattr(demo, "_ran", lambda jobs: calls.append(ran(jobs)) or len(calls) > 1)
    assert main(command) == 130
    # A decoder that disagrees is a fault.
    (out / "decoded" / "scene.json").write_text((out / "decoded" / "scene.json").read_text().replace(digest, "0" * 64))
    assert main(command) == 70
    assert "differs from" in capsys.readouterr().err


def result(**changes: Any) -> dict[str, Any]:
    grey = np.full((6, 8, 3), 100, np.uint8)
    measures, after = Measures(30.5, 0.91, 30.0, 0.9), Measures(29.75, 0.87, 29.0, 0.8)
    parts = [("positions", 12_000_000, 100_000), ("masks", 0, 20_000), ("headers", 0, 380_000)]
    view = {"name": "<0>.jpg", "before": measures, "after": after}
    return {
        **{"title": "A & B", "photographs": 16, "held_out": True, "mean_before": measures, "mean_after": after},
        **{"views": [view | dict.fromkeys(("photograph", "uncompressed", "decoded"), grey)]},
        "parts": [{"name": name, "text": name, "before": before, "after": after} for name, before, after in parts],
        **{
            "anchors": (1000, 900),
            "difference": -0.7,
            "rates": [(500_000, 0.004, after)],
            "trained": (50, 50),
            "steps_wanted": 50,
            "lambda_r": 0.004,
            "digest": "ab" * 32,
        },
        "steps": [("coded train", "refcodec train x", 100.0), ("coded decode", "refcodec decode <x>", 1.26)],
        **{"charts": {}, "files": [("scene.c3gs", "the file", 500_000)], "credits": "by <somebody>", **changes},
    }


def test_the_page() -> None:
    """Its figures, texts that are escaped, and what was not done."""
    text = page(result())
    for words in ("12.0 MB", "500 kB", "30.50 dB", "29.75 dB", "1 min 40 s", "1.3 s", "76.0 %", "A &amp; B"):
        assert words in text.replace("\N{NO-BREAK SPACE}", " ")
    assert "&lt;0&gt;.jpg" in text
    assert not re.search(r"//|url\(|@import|<link|<iframe", re.sub(r"base64,[^\"]*", "", text))
    assert "stopped early" not in text
    text = page(result(trained=(50, 1234), steps_wanted=2000, held_out=False, title="a\u202eb\x1b[31m"))
    assert not re.search(r"[\x00-\x09\x0b-\x1f\u202a-\u202e]", text)
    assert "uncompressed at step 50 and coded at step 1,234" in text
    assert "none were held out" in text
    sizes = [(999, "999 B"), (1000, "1.00 kB"), (99_960, "100 kB"), (999_600, "1.00 MB"), (1234e5, "123 MB")]
    assert [readable(size).replace("\N{NO-BREAK SPACE}", " ") for size, _ in sizes] == [words for _, words in sizes]
    a, b = np.array([[[0, 10, 255]]], np.uint8), np.array([[[3, 0, 0]]], np.uint8)
    assert difference(a, b).tolist() == difference(b, a).tolist() == [[[12, 40, 255]]]


def test_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(*arguments: str) -> str:
        assert main(["demo", *arguments]) == 64
        return capsys.readouterr().err

    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("x")
    out = str(tmp_path / "out")
    assert "choose another one" in refused("-o", str(tmp_path / "mine"))
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["letter.txt"]
    assert "no cameras" in refused("-o", out, "--photographs", str(tmp_path / "mine"))
    assert "rate.lambda_r" in refused("-o", out, "--set", "rate.lambda_r=1")
    monkeypatch.setattr(demo, "EXAMPLES", tmp_path)
    assert "--photographs" in refused("-o", out)
    assert not Path(out).exists()
    # A licence that cannot be read is said: a page without it would be wrong.
    (tmp_path / "LICENSE").symlink_to("nowhere")
    with pytest.raises(demo.RunError, match="LICENSE: it is a link that leads nowhere"):
        demo._credits(tmp_path)
