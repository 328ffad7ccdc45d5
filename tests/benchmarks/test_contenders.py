"""`python -m benchmarks decode|encode`: who takes part, in which order, with which results."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks import __main__ as front
from benchmarks import contenders, results
from benchmarks.coding import coding, coding_lines
from benchmarks.contenders import DECODE, ENCODE, Contender, DisagreementError, Missing, compared, offered
from benchmarks.family import CODERS, Coded, Family
from benchmarks.floor import Floor, builds, layer_shapes, record
from benchmarks.large import TRAINED, large
from refcodec.bitstream.codec import parse
from refcodec.bitstream.reconstruction import digest
from refcodec.bitstream.scene import Scene

ANCHORS = 300
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def scene(kept: Path) -> Scene:
    return parse(large(TRAINED, ANCHORS, kept).path.read_bytes()).scene


@pytest.fixture(scope="module", params=[pytest.param(task, marks=pytest.mark.slow) for task in (DECODE, ENCODE)])
def figures(request: pytest.FixtureRequest, kept: Path) -> dict[str, Any]:
    """Of two rounds."""
    return coding(request.param, TRAINED, ANCHORS, 2, kept)


def test_all_contenders_are_measured_or_named(figures: dict[str, Any], scene: Scene) -> None:
    wanted, missing = contenders.contenders(figures["task"])
    names = [row["name"] for row in figures["contenders"]]
    left_out = [each["name"] for each in figures["missing"]]
    assert sorted(names + left_out) == sorted([each.name for each in wanted] + [each.name for each in missing])
    assert names[0] == "refcodec, numpy"
    assert all(each["why"] for each in figures["missing"])
    for row in figures["contenders"]:
        assert len(row["runs"]) == 2
        assert all(run["seconds"] > 0 and run["processor"] >= 0 for run in row["runs"])
        assert row["digest"] == (None if row["name"].startswith("floor") else digest(scene)[0])


@needs_compiler
def test_with_a_compiler(figures: dict[str, Any]) -> None:
    """The C decoder takes part in decoding, and so does the floor, of which all three parts have times."""
    names = {row["name"]: row for row in figures["contenders"]}
    decoding = figures["task"] == DECODE
    assert ("C decoder, with the digest" in names) == ("floor, native" in names) == decoding
    if decoding:
        assert list(names["floor, native"]["parts"]) == ["products", "rANS", "output"]


def test_contenders_take_turns(figures: dict[str, Any]) -> None:
    assert figures["order"] == [row["name"] for row in figures["contenders"]] * 2


def test_times_are_of_the_base(figures: dict[str, Any]) -> None:
    (base,) = (row for row in figures["contenders"] if row["name"] == figures["base"])
    assert base["times"] == {"seconds": 1, "processor": 1}


def test_machine_and_scene(figures: dict[str, Any]) -> None:
    assert {"model", "flags", "cores", "load", "versions", "compiler"} <= set(figures["machine"])
    assert figures["scene"]["anchors"] == ANCHORS
    assert figures["scene"]["planes"] == [5, 8, 14]
    assert json.loads(json.dumps(figures)) == figures


def test_lines_name_everybody(figures: dict[str, Any]) -> None:
    lines = coding_lines(figures)
    for row in figures["contenders"]:
        assert sum(line.startswith(f"| {row['name']} |") for line in lines) == 1
    for each in figures["missing"]:
        assert f"- {each['name']} is left out: {each['why']}." in lines


def test_without_a_compiler(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What needs one is named, and the others are measured."""
    monkeypatch.setenv("CC", "no-such-compiler")
    wanted = [Contender("refcodec, numpy", DECODE), Contender("C decoder", "c"), Contender("floor", "floor", "native")]
    monkeypatch.setattr(contenders, "contenders", lambda task: (wanted, [Missing("other", "it is away")]))
    found = compared(DECODE, large(TRAINED, ANCHORS, kept).path, 1, kept)
    assert [row["name"] for row in found["contenders"]] == found["order"] == ["refcodec, numpy"]
    assert [each["name"] for each in found["missing"]] == ["other", "C decoder", "floor"]
    assert "no-such-compiler" in found["missing"][1]["why"]


class _Fake:
    """A contender without a process."""

    def __init__(self, name: str, found: str) -> None:
        self.contender, self.hello = Contender(name, DECODE), {"digest": found, "says": "nothing"}


def test_a_contender_that_disagrees(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    @contextmanager
    def workers(wanted: Sequence[Contender], path: Path, kept: Path) -> Iterator[tuple[list[_Fake], list[Missing]]]:
        yield [_Fake("refcodec, numpy", "aa"), _Fake("C decoder", "bb")], []

    monkeypatch.setattr(contenders, "workers", workers)
    with pytest.raises(DisagreementError, match="C decoder gave bb, refcodec, numpy aa"):
        compared(DECODE, TRAINED, 1)


def test_a_contender_that_ends(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contenders, "contenders", lambda task: ([Contender("refcodec, numpy", DECODE)], []))
    broken = kept / "broken.c3gs"
    broken.write_bytes(b"no file")
    with pytest.raises(DisagreementError, match="refcodec, numpy ended with status 1"):
        compared(DECODE, broken, 1, kept)


def test_paths_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A path takes part if refcodec says its name. Others are named with what refcodec says."""

    def run(command: list[str], env: dict[str, str], **_: Any) -> SimpleNamespace:
        said = {"native": (0, "refcodec 1, native kernel avx2", ""), "avx2": (0, "refcodec 1, native kernel avx2", "")}
        status, out, error = said.get(env["REFCODEC_PATH"], (64, "", "no such path here"))
        return SimpleNamespace(returncode=status, stdout=out, stderr=error)

    monkeypatch.setattr(subprocess, "run", run)
    paths, missing = offered()
    assert paths == ["numpy", "native", "avx2"]
    assert [each.name for each in missing] == [
        f"refcodec, {path}" for path in ("avx512vnni", "avx512", "neon", "plain")
    ]
    assert "no such path here" in missing[0].why
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    monkeypatch.setattr("shutil.which", lambda name: None)
    found, _ = contenders.contenders(DECODE)
    (both,) = (each for each in found if each.name == "refcodec, native, 2 threads")
    assert both.environment == {"REFCODEC_PATH": "native", "REFCODEC_THREADS": "2"}


@needs_compiler
@pytest.mark.parametrize("build", [*builds(), "plain"])
def test_floor(build: str, scene: Scene, kept: Path) -> None:
    """Its rANS pass finds the symbols, which are all symbols of the scene."""
    least = Floor(scene, builds().get(build, []), kept)
    spent = least.run()
    assert np.array_equal(least.found, least.symbols)
    assert all(seconds >= 0 for seconds in spent.values())
    d = scene.dimensions
    planes, masks = 5 * d.plane_channels * d.plane_size**2, ANCHORS * d.offset_count
    attributes = ANCHORS * (d.features + 6) + 3 * int(scene.masks.sum())
    recorder = record(scene)
    assert list(recorder.sets) == ["laplace", "cells", "mask", "gauss"]
    first, _ = recorder.sets["cells"]
    end, _ = recorder.sets["mask"]
    model = np.concatenate(recorder.models)
    cells = int(((model >= first) & (model < end)).sum())
    # A tree has at least a node for each anchor on its lowest level, and two symbols for each node.
    assert cells >= 2 * ANCHORS / 8
    assert len(least.symbols) == planes + cells + masks + attributes


def test_layers_of_the_floor(scene: Scene) -> None:
    """F_h, SARM for each point of the planes, and CARM for all slices but the first."""
    points = 5 * 8 * 14 * 14
    sarm = [(points, 4, 16), (points, 16, 16), (points, 16, 2)]
    hyper = [(ANCHORS, 36, 100), (ANCHORS, 100, 175)]
    carm = [(ANCHORS, *each) for n, out in ((5, 20), (15, 30), (30, 40)) for each in ((n, 100), (100, out))]
    assert [tuple(row) for row in layer_shapes(scene).tolist()] == hyper + sarm + carm


class _Kept:
    """A coder that keeps symbols as they are. It checks that both directions compute the same distributions."""

    def encode(self, symbols: torch.Tensor, mean: torch.Tensor, deviation: torch.Tensor) -> Coded:
        return Coded((symbols.clone(), mean.clone(), deviation.clone()), 0, 0, len(symbols))

    def decode(self, coded: Coded, mean: torch.Tensor, deviation: torch.Tensor) -> torch.Tensor:
        symbols, *distribution = coded.content
        assert torch.equal(torch.stack(distribution), torch.stack([mean, deviation]))
        found: torch.Tensor = symbols
        return found


@pytest.mark.parametrize("name", ["kept", *CODERS])
def test_family(name: str, scene: Scene) -> None:
    """The symbols of all stages come back."""
    if name != "kept":
        pytest.importorskip(name, exc_type=ImportError)
    family = Family(scene, _Kept() if name == "kept" else CODERS[name]())
    family.encode()
    found = family.decode()
    for kind in ("features", "scalings", "offsets"):
        assert np.array_equal(getattr(found, kind), getattr(scene.attributes, kind))
    if name != "kept":
        # The distributions are about those of the integer networks, so the bytes are about as many.
        assert 60 < 8 * family.size() / ANCHORS < 160


def test_front(kept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """It prints a table or JSON, and writes a section if it is asked to."""
    place = kept / "RESULTS.md"
    monkeypatch.setattr(results, "RESULTS", place)
    monkeypatch.setattr(contenders, "contenders", lambda task: ([Contender("refcodec, numpy", task)], []))
    words = ["encode", "--anchors", str(ANCHORS), "--rounds", "1"]
    assert front.main(words, kept) == 0
    assert "| refcodec, numpy |" in capsys.readouterr().out
    assert not place.exists()
    assert front.main([*words, "--json", "--write"], kept) == 0
    assert json.loads(capsys.readouterr().out)["rounds"] == 1
    text = place.read_text()
    assert "<!-- encode: begin -->\n## Encoding a large scene\n\n`python -m benchmarks encode --anchors 300 " in text
    assert "| refcodec, numpy |" in text


def test_front_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert front.main(["decode", "--trained", str(tmp_path / "none.c3gs")], tmp_path) == 64
    assert "none.c3gs" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        front.main(["decode", "--rounds", "0"])
