"""The bugs that no table has can be planted and are new, and a diagnosis is judged rightly by them."""

from __future__ import annotations

import ast
import json
import re
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from c_program import COMPILER

from conformance.manifest import VECTORS, Manifest, load
from conformance.mutants import fingerprints, selftest
from conformance.report import record as records
from conformance.unseen import __main__ as command
from conformance.unseen import drawing, judging
from conformance.unseen.bugs import SOURCES, Bug, BugError, Wrong, bugs, decoders, pairs
from conformance.unseen.records import Kept, collect, failing
from refcodec import statuses

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "SPEC.md").read_text(encoding="utf-8")
SECOND = [bug for bug in bugs() if bug.decoder == "independent"]
IN_C = [bug for bug in bugs() if bug.decoder == "c"]
SUITE = load(VECTORS / "manifest.json")


# --- the bugs ---------------------------------------------------------------------------------------------------------


def test_there_are_as_many_as_were_asked_for() -> None:
    assert (len(SECOND), len(IN_C), len(pairs())) == (70, 30, 30)
    assert len({wrong.id for wrong in decoders()}) == 130


@pytest.mark.parametrize("wrong", decoders(), ids=lambda wrong: wrong.id)
def test_it_can_be_planted(wrong: Wrong) -> None:
    """In the decoders of today, and the second decoder is a program then."""
    texts = wrong.texts()
    for name, text in texts.items():
        assert text != (SOURCES[wrong.decoder] / name).read_text(encoding="utf-8")
        if name.endswith(".py"):
            compile(text, name, "exec")


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")
def test_the_compiler_takes_them() -> None:
    assert COMPILER is not None
    for bug in IN_C:
        text = Wrong((bug,)).texts()["decoder.c"].encode()
        command = [COMPILER, "-std=c11", "-fsyntax-only", "-x", "c", "-"]
        ended = subprocess.run(command, input=text, capture_output=True, check=False)
        assert ended.returncode == 0, (bug.id, ended.stderr)


def test_a_text_that_is_gone_is_noticed() -> None:
    bug = replace(SECOND[0], old="no such text")
    with pytest.raises(BugError, match="occurs 0 times"):
        Wrong((bug,)).texts()
    with pytest.raises(BugError, match="occurs 0 times"):
        Wrong((SECOND[0], SECOND[0])).texts()
    with pytest.raises(BugError, match="No such file"):
        Wrong((replace(bug, file="nothing.py"),)).texts()


def test_none_is_a_planted_bug() -> None:
    """No two make one decoder, and none makes that of a planted bug."""
    planted = {selftest.decoder(mutant) for mutant in fingerprints.planted()}
    made = []
    for bug in SECOND:
        ((name, text),) = Wrong((bug,)).texts().items()
        made.append((name.removesuffix(".py"), ast.dump(ast.parse(text))))
    assert not set(made) & planted
    assert len(set(made)) == len(made)
    assert len({Wrong((bug,)).texts()["decoder.c"] for bug in IN_C}) == len(IN_C)


def test_clauses_and_requirements_are_those_of_the_specification() -> None:
    clauses = set(re.findall(r"^#+ (?:Annex )?([A-Z]?[\d.]*\d)[ .]", TEXT, re.MULTILINE))
    requirements = set(re.findall(r"^- \[([RD][\d.]+-\d+)\]", TEXT, re.MULTILINE))
    for bug in bugs():
        assert bug.clauses
        assert set(bug.clauses) <= clauses, bug.id
        assert set(bug.requirements) <= requirements, bug.id


def test_they_are_of_all_chapters() -> None:
    """Of the second decoder: syntax, semantics, decoding, entropy coder, reconstruction, errors, profiles."""
    assert {bug.clauses[0].partition(".")[0] for bug in SECOND} >= {"5", "6", "7", "8", "9", "10", "11"}


def test_pairs_have_no_clause_in_common() -> None:
    for pair in pairs():
        assert pair.decoder == "independent"
        assert not set(pair.bugs[0].clauses) & set(pair.bugs[1].clauses)
    assert sum(pair.hides for pair in pairs()) == drawing.HIDING
    assert drawing.text(pairs(), command.SEED) == (ROOT / "conformance/unseen/pairs.toml").read_text(encoding="utf-8")


# --- records ----------------------------------------------------------------------------------------------------------


def some(*names: str) -> Manifest:
    """A suite of these vectors alone."""
    return replace(SUITE, vectors=tuple(v for v in SUITE.vectors if v.id in names))


def named(name: str) -> Wrong:
    return Wrong((next(bug for bug in bugs() if bug.id == name),))


@pytest.mark.parametrize(
    "name",
    ["encoding-from-the-highest", pytest.param("c-harmonics", marks=pytest.mark.skipif(not COMPILER, reason=""))],
)
def test_a_record_is_that_of_the_runner(name: str, tmp_path: Path) -> None:
    """It fails where the bug shows, says no word of the bug, and is not made twice."""
    kept = Kept(tmp_path, some("valid-encoding-10", "valid-planeless", "invalid-chunk-size-0"))
    ((_, record, new),) = collect(kept, [named(name)], 1)
    records.check(record)
    assert new
    assert "valid-encoding-10" in failing(record)
    assert "invalid-chunk-size-0" not in failing(record)
    assert len(record["vectors"]) == 3
    assert name not in json.dumps(record)
    ((_, again, new),) = collect(kept, [named(name)], 1)
    assert (again, new) == (record, False)


def test_a_record_is_of_its_suite_and_its_bug(tmp_path: Path) -> None:
    kept, wrong = Kept(tmp_path, SUITE), Wrong((SECOND[0],))
    other = Wrong((replace(SECOND[0], new="pass"),))
    assert kept.path(wrong) == kept.path(wrong)
    assert kept.path(wrong) != kept.path(other)
    assert kept.read(wrong) is None


@pytest.mark.parametrize(
    ("new", "text"),
    [
        ("raise ValueError", "exit status 70"),
        ("bytearray(1 << 40)", "exit status 70"),
        ("import os; os.kill(os.getpid(), 9)", "ended by SIGKILL"),
        ("while True: pass", "took too long"),
    ],
)
def test_a_crash_is_recorded_and_the_next_file_is_read(new: str, text: str, tmp_path: Path) -> None:
    wrong = Wrong((Bug("crash", "independent", "codec.py", "decoder.run()", new, "", ("7.1",), ()),))
    manifest = some("valid-worked-example", "invalid-chunk-size-0")
    short = tuple(replace(v, budget=replace(v.budget, seconds=1)) for v in manifest.vectors)
    first, second = Kept(tmp_path, replace(manifest, vectors=short)).make(wrong)["vectors"]
    assert (first["status"], second["status"]) == ("crashed", "passed")
    assert text in first["text"]


# --- judging ----------------------------------------------------------------------------------------------------------


def fails(clauses: Sequence[Sequence[str]], passing: int = 1) -> dict[str, Any]:
    """A record with failing vectors of these clauses, and some that pass."""
    vectors: list[dict[str, Any]] = [
        {"id": f"f{n}", "status": "crashed" if n else "failed", "clauses": list(names), "found": None}
        for n, names in enumerate(clauses)
    ]
    return {"vectors": vectors + [{"id": "p", "status": "passed", "clauses": ["1.1"], "found": None}] * passing}


def test_the_baseline_names_what_is_most_frequent() -> None:
    assert judging.frequent(fails([["7.5", "2.1"], ["7.5"]])) == [("7.5", True), ("2.1", False)]
    assert judging.frequent(fails([["7.5"], ["2.1"]])) == [("7.5", False), ("2.1", False)]
    assert judging.frequent(fails([["7.5"]])) == [("7.5", True)]
    assert judging.frequent(fails([])) == []


def test_the_spectrum_weighs_what_passes() -> None:
    """7.5 is in all failing vectors and 9.3 in one of two, but 9.3 is in no other one."""
    record = fails([["2.1", "7.5", "9.3"], ["2.1", "7.5"]], passing=0)
    record["vectors"] += [{"id": f"p{n}", "status": "passed", "clauses": ["2.1"], "found": None} for n in range(6)]
    assert judging.spectrum(record) == [("7.5", True), ("9.3", False), ("2.1", False)]
    assert judging.spectrum(fails([])) == []


def bug(*clauses: str, decoder: str = "independent") -> Bug:
    return Bug(f"bug-{clauses[0]}", decoder, "x.py", "", "", "", clauses, ())


def test_answers_are_counted() -> None:
    answers = {1: [("7.4", True)], 2: [("8.1", True), ("7.4", False)], 3: [("1", False), ("2", False), ("3", False)]}
    found = [(Wrong((bug("7.4", "7.5"),)), fails([["1"]] * n)) for n in (1, 2, 3)]
    found[2] = (Wrong((bug("7.4", decoder="c"),)), found[2][1])
    rows = judging.judged(found, lambda record: answers[len(record["vectors"]) - 1])
    assert [(row.first, row.among, row.misled, row.sure, row.failing) for row in rows] == [
        (True, True, False, True, 1),
        (False, True, True, True, 2),
        (False, False, False, False, 3),
    ]
    lines = list(judging.table(rows))
    assert "| bug-7.4 | 7.4, 7.5 | 2 | 8.1!, 7.4 | among three, misled |" in lines
    assert "| second decoder | 2 | 1 (50 %) | 2 (100 %) | 2 (100 %) | 1 (50 %) |" in lines
    assert "| decoder in C | 1 | 0 (0 %) | 0 (0 %) | 0 (0 %) | 0 (0 %) |" in lines


def test_of_a_pair_either_is_right() -> None:
    pair = Wrong((bug("7.4"), bug("9.1")), hides=True)
    (row,) = judging.judged([(pair, fails([["9.1"]]))], judging.frequent)
    assert row.first
    assert any(line.startswith("| pairs, one hidden | 1 | 1 (100 %)") for line in judging.table([row]))


# --- pairs ------------------------------------------------------------------------------------------------------------


def test_pairs_are_drawn_so_that_one_hides_the_other() -> None:
    """Bug n fails the vectors below n: each is hidden by those with larger numbers."""
    found = [(Wrong((one,)), fails([["1"]] * (n + 1))) for n, one in enumerate(SECOND)]
    drawn = drawing.draw(found, 7)
    assert drawn == drawing.draw(found, 7)
    assert drawn != drawing.draw(found, 8)
    assert [pair.hides for pair in drawn] == [False] * drawing.AT_RANDOM + [True] * drawing.HIDING
    assert len({frozenset(pair.bugs) for pair in drawn}) == len(drawn)
    for pair in drawn[drawing.AT_RANDOM :]:
        assert SECOND.index(pair.bugs[0]) > SECOND.index(pair.bugs[1])


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(command, "suite", lambda _: some("valid-encoding-10", "invalid-chunk-size-0"))
    place = ["--records", str(tmp_path)]
    assert command.main(["judge", *place, "encoding-from-the-highest"]) == statuses.USAGE
    assert "was not run" in capsys.readouterr().err
    assert command.main(["run", *place, "encoding-from-the-highest"]) == statuses.DONE
    assert "1 of 2 vectors fail" in capsys.readouterr().out
    assert command.main(["run", *place, "scale-before-origin"]) == statuses.REJECTED
    assert "no vector catches scale-before-origin" in capsys.readouterr().err
    assert command.main(["judge", *place, "encoding-from-the-highest"]) == statuses.DONE
    assert "| encoding-from-the-highest | 7.5.5 | 1 |" in capsys.readouterr().out
    assert command.main(["judge", *place, "--diagnosis", "no.such:thing"]) == statuses.USAGE
    assert command.main(["run", *place, "no-such-bug"]) == statuses.USAGE
    assert command.main(["draw", *place]) == statuses.USAGE
    assert command.main([]) == statuses.USAGE
