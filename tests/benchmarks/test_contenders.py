"""`python -m benchmarks decode`: the contenders, their order and their results."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as front
from benchmarks import contenders, results
from benchmarks.coding import coding, coding_lines
from benchmarks.contenders import Contender, DisagreementError, Missing, compared
from benchmarks.family import Family
from benchmarks.large import TRAINED, large
from refcodec.bitstream.codec import parse
from refcodec.bitstream.reconstruction import digest
from refcodec.bitstream.scene import Scene

ANCHORS = 300


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def scene(kept: Path) -> Scene:
    return parse(large(TRAINED, ANCHORS, kept).path.read_bytes()).scene


@pytest.mark.slow
def test_all_contenders_are_measured_or_named(kept: Path, scene: Scene) -> None:
    figures = coding(TRAINED, ANCHORS, 2, kept)
    wanted, missing = contenders.contenders()
    names = [row["name"] for row in figures["contenders"]]
    left_out = [each["name"] for each in figures["missing"]]
    assert sorted(names + left_out) == sorted([each.name for each in wanted] + [each.name for each in missing])
    assert names[0] == "refcodec, numpy"
    assert all(each["why"] for each in figures["missing"])
    for row in figures["contenders"]:
        assert len(row["runs"]) == 2
        assert all(run["seconds"] > 0 and run["processor"] >= 0 for run in row["runs"])
        assert json.loads(json.dumps(row)) == row
        assert row["digest"] == (None if row["name"].startswith("floor") else digest(scene)[0])
    lines = coding_lines(figures)
    for row in figures["contenders"]:
        assert sum(line.startswith(f"| {row['name']} |") for line in lines) == 1
    for each in figures["missing"]:
        assert f"- {each['name']} did not take part: {each['why']}." in lines


class _Fake:
    """A contender without a process."""

    def __init__(self, name: str, found: str) -> None:
        self.contender, self.hello = Contender(name, "decode"), {"digest": found, "says": "nothing"}


def test_a_contender_that_disagrees(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    @contextmanager
    def workers(wanted: Sequence[Contender], path: Path, kept: Path) -> Iterator[tuple[list[_Fake], list[Missing]]]:
        yield [_Fake("refcodec, numpy", "aa"), _Fake("C decoder", "bb")], []

    monkeypatch.setattr(contenders, "workers", workers)
    with pytest.raises(DisagreementError, match="C decoder gave bb, refcodec, numpy aa"):
        compared(TRAINED, 1)


def test_family(scene: Scene) -> None:
    """The symbols of all stages come back."""
    pytest.importorskip("constriction", exc_type=ImportError)
    found = Family(scene).decode()
    for kind in ("features", "scalings", "offsets"):
        assert np.array_equal(getattr(found, kind), getattr(scene.attributes, kind))


def test_front(kept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """It prints a table or JSON, and writes a section if it is asked to."""
    place = kept / "RESULTS.md"
    monkeypatch.setattr(results, "RESULTS", place)
    monkeypatch.setattr(contenders, "contenders", lambda: ([Contender("refcodec, numpy", "decode")], []))
    words = ["decode", "--anchors", str(ANCHORS), "--rounds", "1"]
    assert front.main(words, kept) == 0
    assert "| refcodec, numpy |" in capsys.readouterr().out
    assert not place.exists()
    assert front.main([*words, "--json", "--write"], kept) == 0
    assert json.loads(capsys.readouterr().out)["rounds"] == 1
    text = place.read_text()
    assert "<!-- decode: begin -->\n## Decoding a large scene\n\n`python -m benchmarks decode --anchors 300 " in text
    assert "| refcodec, numpy |" in text
