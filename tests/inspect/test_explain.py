"""Explanations of bytes, codes and clauses."""

from __future__ import annotations

import json
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
from refcodec.inspect.elements import rows
from refcodec.resources import find

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"
TEXT = specification.text()
CLAUSES, REQUIREMENTS = specification.clauses(TEXT), specification.requirements(TEXT)
LARGEST = 30_000
# Fields whose every value is valid, for decoders and renderers.
UNRESTRICTED = ("background", "colour_primaries", "transfer_characteristics")


def test_every_byte_of_the_vectors_has_a_meaning() -> None:
    """Each element stands under clauses and requirements, of damaged files too; what is not decoded may have none."""
    seen, manifest, meaning_of = set(), load(), cache(meaning.meaning)
    for vector in manifest.vectors:
        if vector.operation == "decode" and vector.input.size < LARGEST:
            for row in rows(manifest.path(vector).read_bytes()):
                found = meaning_of(row.path)
                assert found.clauses, row.path
                assert found.requirements or found.field in UNRESTRICTED, row.path
                # In a file that is accepted each byte is used, but for those of broken metadata and cameras.
                used = "no element" not in found.words and "cut off" not in found.words
                used |= row.path.startswith(("mETa", "cAMs"))
                assert used or not isinstance(vector.expectation, Accepted), (vector.id, row.path)
                seen |= set(found.requirements)
    assert {name for name in REQUIREMENTS if name.startswith("R")} <= seen


def test_the_meanings_are_those_of_the_text() -> None:
    """Tables, clauses and requirements exist; each field of each table has an entry, and no other."""
    structs = {kind.partition("[")[0] for fields in SYNTAX.values() for _, kind in fields}
    fields = {f"{t}.{f}" for t, known in SYNTAX.items() for f, kind in known if kind.partition("[")[0] not in SYNTAX}
    assert structs & set(SYNTAX) == {"Dimensions", "PositionGrid", "RenderInfo", "DirectoryEntry"}
    assert set(meaning.FIELDS) == fields
    assert {t: CLAUSES[n].title for t, n in meaning.TABLE_CLAUSES.items()} == {t: t for t in SYNTAX}
    named = [*meaning.FIELDS.values(), *meaning.DECODED.values(), *(names for *_, names in meaning.PAYLOADS)]
    for name in {name for names in named for name in names.split()}:
        assert name in CLAUSES or name in REQUIREMENTS, name


def test_a_requirement_has_one_error_and_an_error_one_requirement() -> None:
    assert {r.error: r.id for r in REQUIREMENTS.values() if r.error} == {
        kind.name: kind.requirement for kind in REGISTRY.values()
    }


@pytest.mark.parametrize("kind", REGISTRY.values(), ids=REGISTRY)
def test_each_error_is_explained(kind, capsys: pytest.CaptureFixture[str]) -> None:
    """By code and by name: its row, why and how, the requirement, code of each decoder, tests and vectors."""
    assert main(["explain", str(kind.code)]) == 0
    found = capsys.readouterr().out
    assert main(["explain", kind.name]) == 0
    named = capsys.readouterr().out
    assert named.startswith(found)
    # A name that is an element's too explains both.
    assert (named != found) == meaning.is_path(kind.name)
    for text in (f"{kind.code} {kind.name}", kind.requirement, "\n  why  ", "\n  how  ", "conformance/c/decoder.c:"):
        assert text in found
    assert f"test_fault[{kind.name}]" in found
    assert "refcodec/bitstream/" in found
    assert "  SPEC.md:" in found


def test_there_is_no_explanation_of_nothing() -> None:
    assert set(explain._reasons()) == set(REGISTRY)


@pytest.mark.parametrize(
    "key", ["R7.99-1", "999", "6.99", "frame.hue", "", "index.entry[0]", "weights..bias", "nonsense"]
)
def test_what_is_not_known_is_said(key: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", key]) == 64
    found = capsys.readouterr().err
    assert found.count("\n") == 1
    assert "is not an error, requirement, clause, path" in found


def test_a_clause_is_printed_with_its_requirements(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "7.5.4", "A", "[D7.6-1]"]) == 0
    found = capsys.readouterr().out
    assert "7.5.4 Query" in found
    assert "refcodec/bitstream/context.py:" in found
    assert "A Tables" in found
    assert "D7.6-1, a requirement on decoders, clause 7.6 Masks" in found


@pytest.mark.parametrize(
    ("key", "clause", "code"),
    [
        ("CARM", "7.9 Channel-wise context", "attributes.py:"),
        ("context", "7.5 Geometry to context", "context.py:"),
        ("QUERY", "7.5.5 ", "context.py:"),
    ],
)
def test_terms_and_functions_lead_to_clauses_and_code(key: str, clause: str, code: str) -> None:
    found = "\n".join(explain.explain(key))
    assert clause in found
    assert f"refcodec/bitstream/{code}" in found


def test_every_path_of_a_file_is_explained() -> None:
    for row in rows(EXAMPLE.read_bytes()):
        assert row.path in explain.explain(row.path)
    assert "u32, " in "\n".join(explain.explain("Chunk.mask_length"))


def test_near_a_byte(capsys: pytest.CaptureFixture[str]) -> None:
    """The element's clauses and requirements, and the command that tells more, which is one."""
    path = "index.entry[0].kept_count"
    place = next(row.start for row in rows(EXAMPLE.read_bytes()) if row.path == path)
    assert main(["inspect", str(EXAMPLE), "--near", str(place)]) == 0
    found = capsys.readouterr().out
    assert "clauses      5.13 ChunkEntry, 6.10 Index" in found
    assert "requirements R6.10-5: " in found
    assert f"more         refcodec explain '{path}'" in found
    assert main(["inspect", str(EXAMPLE), "--near", "99999"]) == 0
    assert list(rows(EXAMPLE.read_bytes()))[-1].path in capsys.readouterr().out


def test_a_verdict_names_the_requirement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damaged = bytearray(EXAMPLE.read_bytes())
    damaged[30] ^= 1
    (tmp_path / "damaged.c3gs").write_bytes(damaged)
    assert main(["validate", str(tmp_path / "damaged.c3gs")]) == 1
    words, verdict = capsys.readouterr().err.splitlines()
    assert "SPEC.md 6.2 [R6.2-2]" in words
    assert json.loads(verdict)["requirement"] == "R6.2-2"


def test_the_trail_leads_to_lines_that_are_there() -> None:
    """Each place of the trail is resolved to a line of its function, each vector is one of the suite."""
    vectors = {vector.id for vector in load().vectors}
    trail = json.loads(find("data/trail.json").read_text(encoding="utf-8"))
    assert list(trail) == list(REQUIREMENTS)
    for entry in trail.values():
        assert set(entry["vectors"]) <= vectors
        for path, name in [*entry["tests"], *(place for places in entry["code"].values() for place in places)]:
            file, _, line = explain._place(path, name, "").partition(":")
            function = name.partition("[")[0].split(".")[-1]
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
    wanted = "\n\n".join("\n".join(explain.explain(key)) for key in ("6.10", "432")) + "\n"
    # The lines of code that is not here are left out.
    assert re.sub(r":\d+ ", " ", there.stdout) == re.sub(r":\d+ ", " ", wanted)
    (package / "data" / "SPEC.md").unlink()
    gone = run()
    assert gone.returncode == 64
    assert gone.stderr == "refcodec: SPEC.md: it belongs to the project and is not there: install the package again\n"
