"""The diagnosis: what is seen of a decoder, the table of fingerprints, and what failures are said to come from."""

from __future__ import annotations

import lzma
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from conformance.cli.main import main
from conformance.diagnosis import calibration, spectrum, table, words
from conformance.diagnosis.diagnose import Diagnostician
from conformance.diagnosis.likeness import Likeness
from conformance.diagnosis.seen import (
    CRASH,
    NO_OFFSET,
    OUTPUT_PARTS,
    RIGHT,
    Seen,
    Verdict,
    accepted,
    at_grade,
    of_entry,
    refused,
)
from conformance.diagnosis.table import Bug, Place, TableError
from conformance.manifest import VECTORS, load
from conformance.mutants import fingerprints, handwritten, places
from conformance.mutants.replay import OUTSIDE, Replay, SameError
from conformance.runner import divergence

SUITE = load(VECTORS / "manifest.json")
PURPOSES = {v.id: v.requirements for v in SUITE.vectors}
TABLE = table.read()
BY_ID = {bug.id: number for number, bug in enumerate(TABLE.bugs)}


# --- what is seen -----------------------------------------------------------------------------------------------------


def test_refusals() -> None:
    """Of a valid file, with another code, at another offset, with none, and the right one."""
    assert refused(None, 503, 40) == Seen(Verdict.REFUSED, 503, 40)
    assert refused((412, 8), 411, 9) == Seen(Verdict.CODE, 411, 9)
    assert refused((412, 8), 412, 9) == Seen(Verdict.OFFSET, 0, 9)
    assert refused((412, 8), 412, None) == refused((412, 8), 412, -1) == Seen(Verdict.OFFSET, 0, NO_OFFSET)
    assert refused((412, 8), 412, 8) == RIGHT


def test_outputs() -> None:
    assert accepted((412, 8), [], "") == Seen(Verdict.ACCEPTED)
    wrong = accepted(None, ["planes", "features"], "12ab" + "0" * 60)
    mask = sum(1 << OUTPUT_PARTS.index(name) for name in ("planes", "features"))
    assert wrong == Seen(Verdict.OUTPUT, mask, 0x12AB)
    assert accepted(None, [], "0" * 64) == RIGHT


@pytest.mark.parametrize(
    ("verdict", "right_below"), [(Verdict.OFFSET, 3), (Verdict.CODE, 2), (Verdict.STATUS, 2), (Verdict.ACCEPTED, 1)]
)
def test_what_a_grade_forgives(verdict: Verdict, right_below: int) -> None:
    for grade in (1, 2, 3):
        assert (at_grade(Seen(verdict), grade) == RIGHT) == (grade < right_below)


def entry(expected: dict[str, Any], found: dict[str, Any] | None, grade: int = 0) -> dict[str, Any]:
    said = None if found is None else {"code": None, "offset": None, "digest": None, "differing": [], **found}
    return {"expected": expected, "found": said, "grade": grade}


def test_entries_of_a_record() -> None:
    valid, bad = {"result": "accepted"}, {"result": "rejected", "code": 412, "offset": 8}
    assert of_entry(entry(valid, None), 3) is None
    assert of_entry(entry({"result": "gaussians"}, {"result": "accepted"}), 3) is None
    assert of_entry(entry(valid, {"result": "crashed"}), 3) == CRASH
    said = {"result": "accepted", "digest": "ff" * 32, "differing": ["masks"]}
    assert of_entry(entry(valid, said), 3) == Seen(Verdict.OUTPUT, 4, 0xFFFF)
    refusal = {"result": "rejected", "code": 412, "offset": 8}
    assert of_entry(entry(bad, refusal, grade=3), 3) == RIGHT
    assert of_entry(entry(bad, refusal, grade=1), 3) == Seen(Verdict.STATUS)
    assert of_entry(entry(bad, {**refusal, "offset": 9}), 3) == Seen(Verdict.OFFSET, 0, 9)
    assert of_entry(entry(bad, {**refusal, "offset": 9}), 2) == RIGHT


# --- the table --------------------------------------------------------------------------------------------------------


def small_table() -> table.Table:
    """Two bugs of two clauses on three vectors. The second one runs the second place alone."""
    bugs = [
        Bug("one", "a wrong sign", "context.f", 3, ("7.5.1",), ("D7.5.1-1",), 10, "a"),
        Bug("two", "a wrong order", "masks.g", 5, ("7.6",), ("D7.6-1",), 9, "b"),
    ]
    spots = [Place("context", 3, ("7.5.1",), ("D7.5.1-1",)), Place("masks", 5, ("7.6",), ("D7.6-1",))]
    seen = [{"v": Seen(Verdict.REFUSED, 509, 100), "w": CRASH}, {"x": Seen(Verdict.OUTPUT, 4, 77), "w": RIGHT}]
    runs = np.array([[True, False], [True, True], [False, True]])
    return table.build(bugs, [("v", "1"), ("w", "2"), ("x", "3")], spots, seen, runs, [9, 8, 7], ["4"], "d")


def test_a_table_comes_back() -> None:
    made = small_table()
    back = table.from_bytes(table.to_bytes(made))
    assert (back.bugs, back.vectors, back.places) == (made.bugs, made.vectors, made.places)
    assert np.array_equal(back.outcomes, made.outcomes)
    assert np.array_equal(back.cells, made.cells)
    assert np.array_equal(back.runs, made.runs)
    assert back.seen(0, 0) == Seen(Verdict.REFUSED, 509, 100)
    assert back.seen(1, 1) == back.seen(2, 0) == RIGHT
    assert table.to_bytes(back) == table.to_bytes(made)


def test_a_damaged_table_is_told() -> None:
    """Cut anywhere, of another kind, of another version, or with a cell that points nowhere."""
    content = lzma.decompress(table.to_bytes(small_table()))
    for end in range(0, len(content) - 1, 7):
        with pytest.raises(TableError):
            table.from_bytes(lzma.compress(content[:end]))
    bad = [
        b"", b"no table", table.to_bytes(small_table())[:-4], lzma.compress(b"X" + content[1:]),
        lzma.compress(content.replace(b'"version":1', b'"version":2')), bytes(table.FILE_BYTES + 1),
    ]  # fmt: skip
    for data in bad:
        with pytest.raises(TableError):
            table.from_bytes(data)


def test_the_table_is_of_these_bugs_and_vectors() -> None:
    """Who changes a bug, a vector or the second decoder runs `conformance fingerprints make`."""
    assert fingerprints.stale(SUITE, TABLE) == []


def test_what_has_changed_is_told() -> None:
    gone = replace(TABLE, bugs=TABLE.bugs[1:], vectors=((TABLE.names[0], "?"), *TABLE.vectors[1:]), decoder="?")
    wrong = fingerprints.stale(SUITE, gone)
    assert wrong == [
        f"the bug {TABLE.bugs[0].id} is not in the table",
        f"the vector {TABLE.names[0]} has changed or is gone",
        "the second decoder or the choice of vectors has changed",
    ]


@pytest.mark.no_cover
@pytest.mark.slow
def test_a_sample_of_the_table_made_anew() -> None:
    assert fingerprints.check(SUITE, TABLE, 1, 60, 1) == []


@pytest.mark.no_cover
@pytest.mark.slow
def test_a_wrong_cell_is_found() -> None:
    vector, bug = (int(i[0]) for i in np.nonzero(TABLE.cells >= 0))
    cells = np.full_like(TABLE.cells, -1)
    cells[:, bug] = TABLE.cells[vector, bug]
    wrong = replace(TABLE, cells=cells)
    assert fingerprints.check(SUITE, wrong, 1, 12, 1)


# --- where a bug is ---------------------------------------------------------------------------------------------------


def bug_of(module: str, old: str, new: str = "0", requirements: tuple[str, ...] = ()) -> Any:
    return handwritten.plant("a-bug", module, old, new, "", list(requirements))


@pytest.mark.parametrize(
    ("module", "old", "clause"),
    [
        ("context", "SINE_LENGTH // 4", "7.5.5"),
        ("frame", "abs(item) < MATRIX_BOUND", "6.7"),
        ("chunks", "bounds == (entry.low, entry.high)", "6.11"),
        ("conventions", "ESCAPE_PREFIX_MAX = 23", "8.7"),
        ("entropy", "self._taken = 0", "8.6"),
        ("errors", "431, ", "6.10"),
    ],
)
def test_the_clause_of_a_change(module: str, old: str, clause: str) -> None:
    """By the error that its statement names, by the comment above it, or by who uses it."""
    assert places.rules(bug_of(module, old))[0][0] == clause


def test_stated_requirements_come_first() -> None:
    clauses, named = places.rules(bug_of("context", "SINE_LENGTH // 4", requirements=("D10.2-3", "R6.8-4")))
    assert (clauses, named) == (("6.8", "10.2"), ("R6.8-4", "D10.2-3"))


def test_who_is_reached() -> None:
    """A change of a function reaches files that run its statement. One of a module's top reaches all."""
    reached = places.reach(bug_of("context", "SINE_LENGTH // 4"))
    assert reached is not None
    assert {module for module, _ in reached} == {"context"}
    assert places.reach(bug_of("conventions", "UNIT_BITS = 16")) is None
    right = Replay()
    kept = right.record(fingerprints.written, (VECTORS / "tiny-example.c3gs").read_bytes(), 100_000)
    assert kept is not None
    assert reached <= {spot for number, spot in enumerate(right.spots) if kept.ran[OUTSIDE] >> number & 1}
    assert right.record(fingerprints.written, (VECTORS / "tiny-example.c3gs").read_bytes(), 1000) is None


def test_a_bug_that_nothing_runs_ends_at_once() -> None:
    right, data = Replay(), (VECTORS / "tiny-example.c3gs").read_bytes()
    kept = right.record(fingerprints.written, data, 100_000)
    assert kept is not None
    number = next(n for n in range(len(right.spots)) if not kept.ran[OUTSIDE] >> n & 1)
    right.again(kept, 1 << number)
    with pytest.raises(SameError):
        fingerprints.written(right.package, data)
    # What is run is run again, and gives the same.
    right.again(kept, kept.ran[OUTSIDE])
    found = fingerprints.written(right.package, data)
    right.again(kept, kept.ran[OUTSIDE])
    assert fingerprints.written(right.package, data) == found


# --- likeness and spectra ---------------------------------------------------------------------------------------------


def test_each_bug_is_most_like_itself() -> None:
    likeness = Likeness(TABLE)
    for bug in range(0, len(TABLE.bugs), 40):
        if (TABLE.cells[:, bug] >= 0).any():
            found = likeness.compare(calibration.row(TABLE, bug)).likeness
            assert found[bug] == pytest.approx(1.0)
            assert found.max() == pytest.approx(1.0)


def test_likeness_falls_with_what_differs() -> None:
    """Another offset is no further away than another code, nor that than another verdict, nor that than a pass."""
    likeness, made = Likeness(small_table()), small_table()
    whole = calibration.row(made, 0)
    steps = [Seen(Verdict.REFUSED, 509, 100), Seen(Verdict.REFUSED, 509, 4), Seen(Verdict.REFUSED, 1, 4), CRASH, RIGHT]
    found = [likeness.compare(whole | {"v": step}).likeness[0] for step in steps]
    assert found == sorted(found, reverse=True)
    assert found[0] == pytest.approx(1.0)
    assert found[0] > found[1] > found[4]


def test_vectors_that_were_not_run_do_not_count() -> None:
    likeness, made = Likeness(small_table()), small_table()
    part = {"v": made.seen(0, 0)}
    assert likeness.compare(part).likeness[0] == pytest.approx(1.0)
    assert likeness.compare(part | {"w": RIGHT}).likeness[0] < 0.9


def test_ochiai() -> None:
    """By hand: of two failing vectors one element has both and one passing, the other has one."""
    exercised = np.array([[True, True], [True, False], [True, False], [False, False]])
    failing, run = np.array([True, True, False, False]), np.ones(4, bool)
    score, fails, passes = spectrum.ochiai(exercised, failing, run)
    assert score == pytest.approx([2 / np.sqrt(2 * 3), 1 / np.sqrt(2 * 1)])
    assert (fails.tolist(), passes.tolist()) == ([2, 1], [1, 0])


def test_the_requirement_whose_vectors_fail_is_first() -> None:
    of = [v.id for v in SUITE.vectors if "R6.10-5" in v.requirements and v.id in TABLE.names]
    failing = {name: name in of for name in TABLE.names}
    best = spectrum.suspects(TABLE, PURPOSES, failing)
    assert best[0].requirement == "R6.10-5"
    assert (best[0].score, best[0].failing, best[0].passing) == (pytest.approx(1.0), len(of), 0)


# --- diagnoses --------------------------------------------------------------------------------------------------------


def test_a_decoder_that_passes_has_no_diagnosis() -> None:
    assert Diagnostician(Likeness(TABLE), PURPOSES).diagnose(dict.fromkeys(TABLE.names, RIGHT)) is None


def test_requirements_tell_of_vectors_that_the_table_has_not() -> None:
    """Those made for one requirement fail. The table does not have them."""
    of = [v.id for v in SUITE.vectors if "R6.10-5" in v.requirements]
    small = replace(TABLE, vectors=tuple((name + "?" if name in of else name, key) for name, key in TABLE.vectors))
    seen = {v.id: CRASH if v.id in of else RIGHT for v in SUITE.vectors}
    found = Diagnostician(Likeness(small), PURPOSES).diagnose(seen)
    assert found is not None
    assert (found.failing, found.clear, found.together) == (0, False, ())
    assert found.clauses[0].number == "6.10"
    assert "no known bug of it does the same" in "".join(words.sentences(found))


def test_parts_of_valid_files_that_are_refused_are_counted() -> None:
    """By the mark in the annotated bytes. A refusal that is asked for, and one without a mark, do not count."""

    def refused(name: str, result: str, *lines: str) -> dict[str, Any]:
        expected = {"result": result, "code": 412, "offset": 8}
        said = entry(expected, {"result": "rejected", "code": 503, "offset": 4})
        return said | {"id": name, "status": "failed", "hex": list(lines), "probe": None, "requirements": []}

    spot = "> 00000c1c  41 37 1f de              masks[chunk 0].symbol_crc     u32    0xde1f3741"
    other = "> 00000c0c  41 37                    weights.lanes    u8    1"
    names = [v.id for v in SUITE.vectors if v.klass == "valid"][:4]
    entries = [
        refused(names[0], "accepted", "  00000c18  01 02    masks[chunk 0].words    u16    2", spot),
        refused(names[1], "accepted", spot),
        refused(names[2], "accepted", other),
        refused(names[3], "rejected", spot),
    ]
    said = words.of_record(SUITE, entries, 3)
    assert said is not None
    assert said["text"][-1] == "  you refuse 3 valid files, in their masks (2), weights (1)"


def test_the_mark_of_any_byte_names_its_part() -> None:
    """As the runner annotates a file, which is what the counts of parts are read from."""
    (vector,) = (v for v in SUITE.vectors if v.id == "valid-worked-example")
    data, parts = SUITE.path(vector).read_bytes(), set()
    for offset in range(0, len(data), 7):
        (mark,) = (line for line in divergence.annotated(data, offset) if line.startswith(">"))
        found = words.SPOT.match(mark)
        assert found, mark
        parts.add(found[1])
    assert {"prologue", "header", "weights", "masks", "attributes"} <= parts


def test_nothing_is_clear_of_failures_without_a_pattern() -> None:
    """A tenth of the vectors crash, whatever they are for."""
    chosen = np.random.default_rng(1).random(len(TABLE.names)) < 0.1
    seen = {name: CRASH if crash else RIGHT for name, crash in zip(TABLE.names, chosen, strict=True)}
    found = Diagnostician(Likeness(TABLE), PURPOSES).diagnose(seen)
    assert found is not None
    assert not found.clear
    assert "no clause is certain" in words.sentences(found)[0]


@pytest.mark.slow
def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    """It compares a sample of the table, and counts what the diagnosis makes of bugs that are held out."""
    assert main(["fingerprints", "check", "--sample", "4"]) == 0
    assert "4 cells of the table made anew, 0 differences" in capsys.readouterr().out
    assert main(["fingerprints", "judge", "--sample", "3", "--pairs", "1"]) == 0
    told = capsys.readouterr().out
    assert "right" in told
    assert "pair" in told
