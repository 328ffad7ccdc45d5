"""Explanations of bytes, codes and clauses."""

import dataclasses
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import refcodec
from conformance.manifest import Accepted, load
from refcodec.bitstream.errors import REGISTRY
from refcodec.bitstream.syntax import SYNTAX
from refcodec.cli.main import main
from refcodec.inspect import explain, meaning, specification
from refcodec.inspect.elements import outline_of, rows
from refcodec.inspect.trail import record
from refcodec.resources import find
from spec import meanings

ROOT = Path(__file__).resolve().parents[2]
VECTORS = ROOT / "vectors"
EXAMPLE, STATIC = VECTORS / "tiny-example.c3gs", VECTORS / "valid" / "static-degree-0.c3gs"
REQUIREMENTS = specification.own_requirements()
LARGEST = 30_000


def explained(*keys: str) -> str:
    return "\n".join(explain.explain(*keys))


def test_every_byte_of_the_vectors_has_a_meaning() -> None:
    """Each element stands under clauses and requirements, of damaged files too; what is not decoded may have none."""
    seen, manifest, meaning_of = set(), load(), cache(meaning.meaning)
    for vector in manifest.vectors:
        if vector.operation == "decode" and vector.input.size < LARGEST:
            data = manifest.path(vector).read_bytes()
            model = outline_of(data).render_model
            for row in rows(data):
                element = meaning_of(row.path, model)
                assert element.clauses, row.path
                assert element.requirements, row.path
                # Accepted files have unused bytes of later minor versions, and of broken metadata and cameras.
                used = not row.path.endswith((", unused", ", cut off"))
                used |= row.path.startswith(("header, ", "mETa", "cAMs"))
                assert used or not isinstance(vector.expectation, Accepted), (vector.id, row.path)
                seen |= set(element.requirements)
    assert {name for name in REQUIREMENTS if name.startswith("R")} <= seen
    assert {"D9.4-1", "G14.3-1", "G6.5-1"} <= seen


def test_the_rules_name_each_requirement(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rules of meaning.py are those of SPEC.md. One that forgets static scenes, or a clause, is named."""
    fields = {f"{t}.{f}" for t, known in SYNTAX.items() for f, kind in known if kind.partition("[")[0] not in SYNTAX}
    assert set(meaning.FIELDS) == fields
    titles = {table: specification.own_clauses()[number].title for table, number in meaning.TABLE_CLAUSES.items()}
    assert titles == {table: table for table in SYNTAX}
    assert list(meanings.check()) == []

    def faults(cited: str, models: tuple[int, ...]) -> list[str]:
        planted = [
            dataclasses.replace(rule, cited=cited, models=models) if rule.models == (0,) else rule
            for rule in meaning.PAYLOADS
        ]
        monkeypatch.setattr(meaning, "PAYLOADS", planted)
        messages = list(meanings.check())
        monkeypatch.undo()
        return messages

    assert "it cites 6.8, but not R6.8-4" in faults("5.8 6.8 14.3 R6.8-3 G14.3-1", ())[0]
    assert "it cites 14.3, but not G14.3-1" in faults("5.8 6.8 14.3 R6.8-3", (0,))[0]
    assert "9.99 is not in SPEC.md" in faults("5.8 6.8 9.99 R6.8-3", (0,))[0]
    monkeypatch.setattr(meaning, "DECODED", dict.fromkeys(meaning.DECODED, ""))
    assert "meaning.py: nothing cites D7.7-1" in list(meanings.check())


@pytest.mark.parametrize("kind", REGISTRY.values(), ids=REGISTRY)
def test_each_error_is_explained(kind) -> None:
    """By code and by name: its row, why and how, the requirement, code of each decoder, tests and vectors."""
    text_of_code, named = explained(str(kind.code)), explained(kind.name)
    assert named.startswith(text_of_code)
    # A name that is an element's too explains both.
    assert (named != text_of_code) == meaning.is_path(kind.name)
    for text in (f"{kind.code} {kind.name}", kind.requirement, "\n  why  ", "\n  how  ", "conformance/c/decoder.c:"):
        assert text in text_of_code
    assert f"test_fault[{kind.name}]" in text_of_code
    assert "refcodec/bitstream/" in text_of_code
    assert "  SPEC.md:" in text_of_code


def test_there_is_no_explanation_of_nothing() -> None:
    assert set(explain.reasons()) == set(REGISTRY)


UNKNOWN = (
    "R7.99-1", "999", "6.99", "frame.hue", "", "index.entry[0]", "weights..bias", "nonsense", "planes.r9.symbol_crc",
    "frame.low[3]", "header.profile[0]", "weights.opacity.2.bias", "9.4 nonsense",
)  # fmt: skip


@pytest.mark.parametrize("key", UNKNOWN)
def test_what_is_not_known_is_said(key: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", *(key.split() or [""])]) == 64
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "is not an error, requirement, clause, path" in message


# Keys, and what is among the lines of each: names of clauses, code, tests, vectors.
ANSWERS = {
    "weights": "the section WGTS|5.8 WeightScales|7.13 Packed weights|bitstream/weights.py:|weights.scale]|vectors ",
    "WGTS": "the section WGTS",
    "planes": "the section PLNS|7.3 Planes|bitstream/planes.py:|SPEC.md:|decoder.c:|tests/|vectors ",
    "index": "the section INDX|5.13 ChunkEntry|bitstream/index.py:",
    "data": "the section DATA|6.11 Chunks|bitstream/chunks.py:",
    "header": "a part of a file|5.2 Header|11.1 Profiles|bitstream/header.py:",
    "cAMs": "the section cAMs|5.17 Cameras|bitstream/cameras.py:|test_web_view.py:|vectors ",
    "mETa": "the section mETa|5.16 Metadata|bitstream/metadata.py:|test_web_view.py:|vectors ",
    "5.17": "count|cameras.py:|parse_cameras|tests/conformance/|vectors ",
    "6.15": "cameras.py:|parse_cameras|tests/conformance/|vectors ",
    "rotation": "a term of clause 3.2|9.4 Static scenes|splat.py:|Camera.rotation|5.17.1 Camera|cameras.py:",
    "quaternion": "a term of clause 3.2|9.4 Static scenes|14.6 Static scenes|splat.py:|test_splat.py:|valid-static-",
    "static": "9.4 Static scenes|splat.py:|SPLAT|test_splat.py:|valid-static-",
    "static rotation": "9.4 Static scenes|splat.py:|SPLAT|test_splat.py:|valid-static-",
    "low_pass": "RenderInfo.low_pass|14.4 Projection|R6.5-1|PROJECT|valid-render-info-least",
    "low pass": "RenderInfo.low_pass",
    "camera": "5.17.1 Camera|14.2 Camera|6.15 Cameras",
    "camera length": "bytes of the camera that follow this field|test_cameras_state_their_length|broken-length-odd",
    "length": "a field of 4 tables|explain Camera.length|explain ChunkEntry.length",
    "opacity": "9.4 Static scenes|14.3 Gaussians|5.8 WeightScales",
    "weights.opacity.0.weight[0]": "14.3 Gaussians|9.4 Static scenes|R6.8-4|D9.4-1|splat.py:",
    "frame": "the section FRAM|a term of clause 3.2",
    "STATE_MIN": "STATE_MIN = 2^16|8.3 Groups and lanes",
    "7.5.4": "7.5.4 Query|refcodec/bitstream/context.py:",
    "A": "A Tables",
    "[D7.6-1]": "D7.6-1, a requirement on decoders, clause 7.6 Masks",
    "CARM": "7.9 Channel-wise context|refcodec/bitstream/attributes.py:",
    "context": "7.5 Geometry to context|refcodec/bitstream/context.py:",
    "QUERY": "7.5.5 |refcodec/bitstream/context.py:",
    "Chunk.mask_length": "u32, ",
}


@pytest.mark.parametrize("key", ANSWERS)
def test_one_look_up_answers(key: str) -> None:
    answer = explained(*key.split())
    for text in ANSWERS[key].split("|"):
        assert text in answer, text


def test_every_path_of_a_file_is_explained() -> None:
    for row in rows(EXAMPLE.read_bytes()):
        assert row.path in explained(row.path)


def near(file: Path, path: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What inspect says of an element of a file."""
    place = next(row.start for row in rows(file.read_bytes()) if row.path == path)
    assert main(["inspect", str(file), "--near", str(place)]) == 0
    return capsys.readouterr().out


def test_near_a_byte(capsys: pytest.CaptureFixture[str]) -> None:
    """The element's clauses and requirements, and the command that tells more, which is one."""
    path = "index.entry[0].kept_count"
    printed = near(EXAMPLE, path, capsys)
    assert "clauses      5.13 ChunkEntry, 6.10 Index" in printed
    assert "requirements R6.10-5: " in printed
    assert f"more         refcodec explain '{path}'" in printed
    assert main(["inspect", str(EXAMPLE), "--near", "99999"]) == 0
    assert list(rows(EXAMPLE.read_bytes()))[-1].path in capsys.readouterr().out


def test_the_networks_of_static_scenes_are_named_by_their_clauses(capsys: pytest.CaptureFixture[str]) -> None:
    path = "weights.opacity.0.weight"
    static, view_dependent = near(STATIC, path, capsys), near(EXAMPLE, path, capsys)
    for text in ("7.2 Integer networks", "9.4 Static scenes", "R6.8-4: ", "D9.4-1: "):
        assert text in static
        assert text not in view_dependent
    for text in ("14.3 Gaussians", "G14.3-1: "):
        assert text not in static
        assert text in view_dependent
    # A later version states what draws other scenes.
    assert "6.5 RenderInfo" in near(VECTORS / "valid" / "render-model-2.c3gs", path, capsys)


def test_the_trail_leads_to_lines_that_are_there() -> None:
    """Each place of the trail is resolved to a line of its function, each vector is one of the suite."""
    vectors = {vector.id for vector in load().vectors}
    assert list(record().requirements) == list(REQUIREMENTS)
    assert {"5.16", "5.16.1", "5.17", "5.17.1", "6.14", "6.15"} <= set(record().clauses)
    for trail in (*record().requirements.values(), *record().clauses.values()):
        assert set(trail.vectors) <= vectors
        assert len(trail.vectors) <= trail.count
        for place in [*trail.tests, *(place for places in trail.code.values() for place in places)]:
            file, _, line = explain._place(place.path, place.name, "").partition(":")
            function = place.name.partition("[")[0].split(".")[-1]
            assert function in (ROOT / file).read_text(encoding="utf-8").splitlines()[int(line) - 1]


def test_it_works_away_from_the_checkout(tmp_path: Path) -> None:
    """A package with its data inside, as an installed one, explains the same. Without SPEC.md it says so in a line."""
    package = tmp_path / "site" / "refcodec"
    (package / "data").mkdir(parents=True)
    source = Path(refcodec.__file__).parent
    for path in source.rglob("*.py"):
        (package / path.relative_to(source)).parent.mkdir(parents=True, exist_ok=True)
        (package / path.relative_to(source)).write_bytes(path.read_bytes())
    for path in (*(source / "data").iterdir(), find("SPEC.md")):
        (package / "data" / path.name).write_bytes(path.read_bytes())

    def run() -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
        command = [sys.executable, "-P", "-m", "refcodec", "explain", "6.10", "432"]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    there = run()
    assert there.returncode == 0, there.stderr
    # The lines of code that is not here are left out.
    assert re.sub(r":\d+ ", " ", there.stdout) == re.sub(r":\d+ ", " ", explained("6.10", "432") + "\n")
    (package / "data" / "SPEC.md").unlink()
    gone = run()
    assert gone.returncode == 64
    assert gone.stderr == "refcodec: SPEC.md: it belongs to the project and is not there: install the package again\n"
