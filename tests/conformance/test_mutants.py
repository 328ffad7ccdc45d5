"""Tests of the suite: planted bugs, the grader, and the committed record of the vectors that catch each bug."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from conformance import cli
from conformance.manifest import VECTORS, load
from conformance.mutants import handwritten, loading, operators, record, selftest, trial
from conformance.mutants.equivalent import PROOFS
from conformance.mutants.mutant import Mutant, definitions
from conformance.mutants.trial import Case, Grade, Outcome, grade
from refcodec import statuses

ROOT = Path(__file__).resolve().parents[2]
SUITE = load(VECTORS / "manifest.json")
CASES = {case.id: case for case in selftest.cases(SUITE)}
# The equivalents are tried on every vector by `conformance selftest`, and here on files up to this size.
SMALL_BYTES = 1400


def small(accepts: bool) -> Case:
    """The smallest vector that is accepted, or the smallest of those that are refused in their sections."""
    fitting = [c for c in CASES.values() if (c.error is None if accepts else c.error is not None and c.error[0] > 400)]
    return min(fitting, key=lambda c: len(c.data))


PAIR = [small(True), small(False)]


def changed_text(place: str, old: str, new: str) -> Mutant:
    return handwritten.plant("a-mutant", place, old, new, "", [])


SAME = changed_text("DECODE_MASKS", "m.append(bit)", "m += [bit]")


# --- the bugs ---------------------------------------------------------------------------------------------------------


def test_there_are_enough_bugs_and_no_two_are_one() -> None:
    """At least 100 of each sort, and no two make the same decoder."""
    hand = [m for m in handwritten.bugs() if m.id not in PROOFS]
    nobody = [m for m in operators.sample() if m.id not in PROOFS]
    assert min(len(hand), len(nobody)) >= 100
    made = selftest.mutants()
    assert len({m.id for m in made}) == len(made)
    trees = [selftest.decoder(m) for m in made]
    assert len(set(trees)) == len(trees)
    # Nor does a bug leave the text as it is.
    unchanged = {place: ast.unparse(statement) for place, statement in definitions().items()}
    assert all(ast.unparse(ast.parse(m.statement)) != unchanged[m.place] for m in made)


def test_each_requirement_has_a_bug() -> None:
    """Of the decoding process, and of files."""
    text = (ROOT / "SPEC.md").read_text(encoding="utf-8")
    demanded = set(re.findall(r"^- \[(R[\d.]+-\d+|D[789][\d.]*-\d+)\]", text, re.MULTILINE))
    assert len(demanded) > 70
    bugs = [m for m in handwritten.bugs() if m.id not in PROOFS]
    broken = {name for m in bugs for name in m.requirements}
    assert demanded <= broken, sorted(demanded - broken)
    assert broken <= set(re.findall(r"^- \[([RD][\d.]+-\d+)\]", text, re.MULTILINE))
    assert all(m.requirements for m in handwritten.bugs())


def test_a_text_that_is_gone_is_noticed() -> None:
    with pytest.raises(handwritten.BugError, match="occurs 0 times in DECODE_MASKS"):
        changed_text("DECODE_MASKS", "no such text", "")
    with pytest.raises(handwritten.BugError, match=r"occurs [2-9]\d* times in DECODE_MASKS"):
        changed_text("DECODE_MASKS", "masks", "")
    with pytest.raises(handwritten.BugError, match="is not a function or constant that decodes"):
        changed_text("PIXEL", "", "")


def test_the_sample_is_chosen_by_nobody() -> None:
    """It takes from every function and constant that has room for a change, with every operator; always the same."""
    sample = operators.sample()
    assert {m.place for m in sample} == {place for place in definitions() if operators.points(place)}
    assert {m.id.rsplit("-", 2)[1] for m in sample} == {operator.__name__ for operator in operators.OPERATORS}
    operators.sample.cache_clear()
    assert operators.sample() == sample
    for m in sample:
        compile(m.statement, m.id, "exec")


@pytest.mark.parametrize(
    ("operator", "text", "made"),
    [
        (operators.compare, "a < b", {"a <= b", "a >= b"}),
        (operators.constant, "3", {"4", "2"}),
        (operators.constant, "True", {"False"}),
        (operators.arithmetic, "a + b", {"a - b"}),
        (operators.logic, "a and b", {"a or b", "a", "b"}),
        (operators.logic, "not a", {"a"}),
        (operators.condition, "a if b else c", {"c if b else a"}),
        (operators.arguments, "f(a, b, 'c')", {"f(b, a, 'c')"}),
        (operators.arguments, "(a, b)", {"(b, a)"}),
        (operators.arguments, "(a, a)", set()),
        (operators.bounds, "a[b:c]", {"a[:c]", "a[b:]"}),
        (operators.function, "min(a)", {"max(a)"}),
    ],
)
def test_operator(operator: object, text: str, made: set[str]) -> None:
    assert callable(operator)
    assert {ast.unparse(new) for _, new in operator(ast.parse(text, mode="eval").body)} == made


def test_operator_on_statements() -> None:
    for statement in ("f()", "a += 1", "raise E", "continue"):
        assert [ast.unparse(new) for _, new in operators.removal(ast.parse(statement).body[0])] == ["pass"]
    assert not list(operators.removal(ast.parse("'a docstring'").body[0]))


# --- loading and trials -----------------------------------------------------------------------------------------------


def test_a_loaded_decoder_is_new_and_the_right_one_is_left_alone() -> None:
    unchanged, wrong = loading.load(None), loading.load(changed_text("UNIT_BITS", "16", "15"))
    assert (unchanged["UNIT_BITS"], wrong["UNIT_BITS"]) == (16, 15)
    assert trial.decode(unchanged, PAIR[0].data) == Outcome("accepted", digests=PAIR[0].digests)


def test_what_a_change_reaches() -> None:
    assert loading.changed(changed_text("CONTRACT", "q <= unit * unit", "False")) == {"CONTRACT"}
    assert loading.changed(changed_text("UNIT_BITS", "16", "15")) is None
    calls, called = trial.visit(PAIR[0].data)
    assert calls > 100
    assert {"DECODE_FILE", "CHECK_HEADER"} <= called
    assert calls == trial.visit(PAIR[0].data)[0]


@pytest.fixture(scope="module")
def trials() -> Iterator[selftest.Trials]:
    with selftest.trials(PAIR, 1) as made:
        yield made


def outcome(trials: selftest.Trials, mutant: Mutant | None) -> list[str]:
    """What is wrong with a decoder, vector after vector of PAIR; nothing where it is right."""
    (wrong,) = trials.tries([(mutant, [case.id for case in PAIR])], "", seconds=selftest.FAKE_SECONDS)
    return [dict(wrong).get(case.id, "") for case in PAIR]


def test_an_unchanged_decoder_passes(trials: selftest.Trials) -> None:
    assert outcome(trials, None) == ["", ""]


def test_a_change_that_changes_nothing_survives(trials: selftest.Trials) -> None:
    assert outcome(trials, SAME) == ["", ""]
    result = selftest.score([SAME], {SAME.id: []})
    assert result.survivors == [SAME]
    assert not result.right


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("raises", "crash ValueError"),
        ("exits", "crash SystemExit"),
        ("ends", "crash status"),
        ("kills-itself", "crash status"),
        ("hangs", "hang"),
        ("takes-all-memory", "crash MemoryError"),
        ("refuses-without-code", "crash KeyError"),
        ("does-not-load", "crash SyntaxError"),
    ],
)
def test_what_is_no_decoder_is_caught(name: str, expected: str, trials: selftest.Trials) -> None:
    """On both vectors, and the time that it takes is bounded."""
    (fake,) = [fake for fake in selftest.fakes() if fake.id == name]
    assert all(wrong.startswith(expected) for wrong in outcome(trials, fake)), outcome(trials, fake)


def test_a_mutant_that_hangs_is_caught() -> None:
    loop = "while z <= ESCAPE_PREFIX_MAX and not READ_BITS(stream, 1):\n        z += 1"
    hangs = changed_text("READ_ESCAPE", loop, "while z == 0:\n        pass")
    escaping = next(case for case in CASES.values() if "READ_ESCAPE" in (trial.visit(case.data)[1] or ()))
    with selftest.trials([escaping], 1) as test:
        (wrong,) = test.tries([(hangs, [escaping.id])], "", seconds=selftest.FAKE_SECONDS)
    assert wrong == [(escaping.id, "hang")]


def test_the_first_catch_ends_a_trial() -> None:
    fake = selftest.fakes()[0]
    assert len(trial.outcomes(fake, PAIR)) == 2
    assert len(trial.outcomes(fake, PAIR, grade)) == 1
    assert len(trial.outcomes(None, PAIR, grade)) == 2


# --- wrong graders ----------------------------------------------------------------------------------------------------


def crash_is_refusal(case: Case, outcome: Outcome) -> str | None:
    """Takes a crash for a refusal."""
    return None if outcome.kind == "crash" and case.error else grade(case, outcome)


def hang_is_pass(case: Case, outcome: Outcome) -> str | None:
    """Takes a decoder that does not end for a right one."""
    return None if outcome.kind == "hang" else grade(case, outcome)


def no_digest(case: Case, outcome: Outcome) -> str | None:
    """Does not compare digests."""
    return None if outcome.kind == "accepted" and case.error is None else grade(case, outcome)


def no_offset(case: Case, outcome: Outcome) -> str | None:
    """Does not compare offsets."""
    return grade(case, replace(outcome, offset=case.error[1] if case.error else 0))


def no_code(case: Case, outcome: Outcome) -> str | None:
    """Does not compare codes."""
    return grade(case, replace(outcome, code=case.error[0] if case.error else 0))


def all_pass(case: Case, outcome: Outcome) -> str | None:
    """Lets everything pass."""
    return None


def none_passes(case: Case, outcome: Outcome) -> str | None:
    """Lets nothing pass."""
    return "wrong"


@pytest.mark.parametrize(
    "judge", [crash_is_refusal, hang_is_pass, no_digest, no_offset, no_code, all_pass, none_passes]
)
def test_a_wrong_grader_is_caught(judge: Grade) -> None:
    with pytest.raises(selftest.SelfTestError, match="the grader"):
        selftest.check_grader(list(CASES.values()), judge)


def test_the_grader_is_right() -> None:
    selftest.check_grader(list(CASES.values()), grade)


def test_trials_that_take_a_crash_for_a_refusal_are_caught(
    monkeypatch: pytest.MonkeyPatch, trials: selftest.Trials
) -> None:
    """The grader aside: if fakes passed, the self-test would say so."""
    monkeypatch.setattr(trials, "_judge", crash_is_refusal)
    with pytest.raises(selftest.SelfTestError, match="a decoder that raises passes"):
        trials.check_fakes()


def test_a_decoder_that_fails_a_vector_ends_the_test() -> None:
    wrong = replace(PAIR[0], digests={"whole": "1" * 64})
    with pytest.raises(selftest.SelfTestError, match="unchanged, fails"), selftest.trials([wrong, PAIR[1]], 1):
        pass


# --- the record -------------------------------------------------------------------------------------------------------


def test_the_record_is_of_these_bugs() -> None:
    """Every bug has a vector, or a proof that it is none; the table is what the record makes."""
    caught, made = record.read(), selftest.mutants()
    assert set(caught) | set(PROOFS) == {m.id for m in made}
    assert not set(caught) & set(PROOFS)
    assert {vector for vector, _ in caught.values()} <= set(CASES)
    assert record.table(made, caught).count("\n") == len(made) + 2


@pytest.mark.no_cover
@pytest.mark.slow
def test_each_bug_is_caught_by_its_vector() -> None:
    """Caught in another way than was recorded is caught too: a message may differ from one Python to the next."""
    assert selftest.run(VECTORS / "manifest.json", 2, True, False) == 0


@pytest.mark.no_cover
@pytest.mark.slow
def test_each_equivalent_has_a_proof_and_survives() -> None:
    few = [c for c in CASES.values() if len(c.data) <= SMALL_BYTES]
    right = [m for m in selftest.mutants() if m.id in PROOFS]
    assert all(len(PROOFS[m.id]) > 40 for m in right)
    with selftest.trials(few, 2) as test:
        order = test.order(right)
        for m, wrong in zip(right, test.tries([(m, order[m.id]) for m in right], "", first_only=True), strict=True):
            assert not wrong, f"{m.id} is caught by {wrong}"


def test_a_wrong_proof_and_a_survivor_are_told(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = selftest.mutants()[:2]
    monkeypatch.setitem(PROOFS, first.id, "a wrong proof")
    result = selftest.score([first, second], {first.id: [("a-vector", "crash")], second.id: []})
    selftest.show(result, [first, second])
    text = capsys.readouterr().out
    assert f"no equivalent: {first.id} is caught by a-vector" in text
    assert f"survivor: {second.id}" in text
    assert "0 caught, 0.0 %" in text


@pytest.mark.slow
def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Two bugs on two vectors: the record, the table, and the status if one survives."""
    caught = [m for m in selftest.mutants() if m.id in ("digest-order", "world-unit")]
    monkeypatch.setattr(selftest, "mutants", lambda: caught)
    monkeypatch.setattr(selftest, "cases", lambda manifest: PAIR)
    monkeypatch.setattr(record, "JSON", tmp_path / "caught.json")
    assert cli.main(["selftest", "--jobs", "1", "--write"]) == 0
    assert "2 caught, 100.0 %" in capsys.readouterr().out
    monkeypatch.setattr(record.read, "__defaults__", (tmp_path / "caught.json",))
    assert set(record.read()) == {m.id for m in caught}
    assert cli.main(["selftest", "--table"]) == 0
    assert "another digest" in capsys.readouterr().out
    monkeypatch.setattr(selftest, "mutants", lambda: [SAME])
    assert cli.main(["selftest", "--jobs", "1"]) == 1
    monkeypatch.setattr(selftest, "cases", lambda manifest: [replace(PAIR[0], digests={"whole": "1" * 64})])
    assert cli.main(["selftest", "--jobs", "1"]) == 1


def test_a_manifest_that_is_none_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["selftest", "--manifest", str(tmp_path / "none.json")]) == statuses.USAGE
    (tmp_path / "bad.json").write_text("{}")
    (tmp_path / "manifest.schema.json").write_text((VECTORS / "manifest.schema.json").read_text())
    assert cli.main(["selftest", "--manifest", str(tmp_path / "bad.json")]) == statuses.DAMAGED_SUITE
    assert "Traceback" not in capsys.readouterr().err
    assert cli.main(["selftest", "--jobs", "0"]) == statuses.USAGE


def test_no_vector_is_an_error() -> None:
    with pytest.raises(selftest.SelfTestError, match="no vector"):
        selftest.cases(replace(SUITE, vectors=()))
