"""Tests of the suite: planted bugs, the grader, and the vectors that catch each bug."""

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from conformance import cli
from conformance.manifest import VECTORS, load
from conformance.mutants import handwritten, loading, misreadings, operators, selftest, trial
from conformance.mutants.exempt import GAPS, PROOFS
from conformance.mutants.mutant import Mutant, definitions
from conformance.mutants.trial import Case, Grade, Outcome, grade
from refcodec import statuses

ROOT = Path(__file__).resolve().parents[2]
SUITE = load(VECTORS / "manifest.json")
CASES = {case.id: case for case in selftest.cases(SUITE)}


def small(accepts: bool) -> Case:
    """The smallest vector that is accepted, or the smallest of those that are refused in their sections."""
    fitting = [c for c in CASES.values() if (c.error is None if accepts else c.error is not None and c.error[0] > 400)]
    return min(fitting, key=lambda c: len(c.data))


PAIR = [small(True), small(False)]


def changed_text(place: str, old: str, new: str) -> Mutant:
    return handwritten.plant("a-mutant", place, old, new, "")


SAME = changed_text("DECODE_MASKS", "m.append(bit)", "m += [bit]")


# --- the bugs ---------------------------------------------------------------------------------------------------------


def test_there_are_enough_bugs_and_no_two_are_one() -> None:
    """At least 100 of each sort, and no two make the same decoder."""
    made = selftest.mutants()
    bugs = {m.id for m in made if m.id not in PROOFS and m.id not in GAPS}
    for sort in (handwritten.bugs(), misreadings.mutants(), operators.sample()):
        assert len(bugs & {m.id for m in sort}) >= 100
    assert len({m.id for m in made}) == len({m.tree for m in made}) == len(made)
    # No bug by hand is one of an operator, and none leaves the text as it is.
    assert {m.tree for m in handwritten.bugs()}.isdisjoint(m.tree for m in misreadings.mutants())
    unchanged = {place: ast.unparse(statement) for place, statement in definitions().items()}
    assert all(ast.unparse(ast.parse(m.statement)) != unchanged[m.place] for m in made)
    # Each can be executed: a text that cannot would be caught by any vector.
    for m in made:
        compile(m.statement, m.id, "exec")
    assert PROOFS.keys() | GAPS.keys() <= {m.id for m in made}
    assert not PROOFS.keys() & GAPS.keys()
    assert all(len(reason) > 30 for reason in (*PROOFS.values(), *GAPS.values()))


def test_each_requirement_has_a_bug() -> None:
    """Of the decoding process, and of files."""
    text = (ROOT / "SPEC.md").read_text(encoding="utf-8")
    demanded = set(re.findall(r"^- \[(R[\d.]+-\d+|D[789][\d.]*-\d+)\]", text, re.MULTILINE))
    assert len(demanded) > 70
    bugs = [m for m in selftest.mutants() if m.id not in PROOFS and m.id not in GAPS]
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
    entry = "D7.6-1, R8.8-5: what\n[-m.append(-]{+m += [+}bit[-)-]{+]\npass+}"
    read = handwritten.read("two-lines", "DECODE_MASKS", entry)
    assert (read.old, read.new, read.what) == ("m.append(bit)", "m += [bit]\npass", "what")
    assert read.requirements == ("D7.6-1", "R8.8-5")
    assert handwritten.read("two-lines", "DECODE_MASKS", entry.replace("what\n", "what | ")) == read
    for entry in ("what\n[-bit-]{+1+}", "D7.6-1: what\nm.append(bit)", "D7.6-1: what", "D7.6-1: what\n[-none-]"):
        with pytest.raises(handwritten.BugError):
            handwritten.read("wrong", "DECODE_MASKS", entry)


def test_the_sample_is_chosen_by_nobody() -> None:
    """It takes from every function and constant that has room for a change, with every operator; always the same."""
    sample = operators.sample()
    assert {m.place for m in sample} == {place for place in definitions() if operators.points(place)}
    assert {m.id.rsplit("-", 2)[1] for m in sample} == {operator.__name__ for operator in operators.OPERATORS}
    operators.sample.cache_clear()
    assert operators.sample() == sample


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
def test_operator(operator: Callable[[ast.AST], Iterator[operators.Change]], text: str, made: set[str]) -> None:
    assert {ast.unparse(new) for _, new in operator(ast.parse(text, mode="eval").body)} == made


def test_operator_on_statements() -> None:
    for statement in ("f()", "a += 1", "raise E", "continue"):
        assert [ast.unparse(new) for _, new in operators.removal(ast.parse(statement).body[0])] == ["pass"]
    assert not list(operators.removal(ast.parse("'a docstring'").body[0]))


VERSION = 'REQUIRE(U(data, 8, 2) == MAJOR, "prologue.version", 8)'
CRC = 'REQUIRE(U(data, 16, 4) == CRC32(data[:16]), "prologue.crc", 16)'
LENGTH = "HEADER_LENGTH_MIN <= length <= HEADER_LENGTH_MAX"
ITEMS = '("reserved", "grid_reserved", "render_reserved", "dimensions_reserved")'


@pytest.mark.parametrize(
    ("misreading", "place", "old", "new", "requirement"),
    [
        (misreadings.unchecked, "PARSE_PROLOGUE", "U(data, 8, 2) == MAJOR", "True", "R6.1-4"),
        # What decides a check may be assigned above it, or return the error.
        (misreadings.unchecked, "PARSE_PROLOGUE", f"{LENGTH} and length % 4 == 0", "True", "R6.1-5"),
        (misreadings.unchecked, "END", 'stream["bad_range"]', "False", "R8.5-1"),
        (misreadings.split, "PARSE_PROLOGUE", LENGTH, "length <= HEADER_LENGTH_MAX", "R6.1-5"),
        (misreadings.split, "PARSE_PROLOGUE", LENGTH, "HEADER_LENGTH_MIN <= length", "R6.1-5"),
        (misreadings.part, "PARSE_PROLOGUE", f"{LENGTH} and length % 4 == 0", f"({LENGTH})", "R6.1-5"),
        (misreadings.moved, "PARSE_FRAME", "x <= FRAME_SHIFT_MAX", "x < FRAME_SHIFT_MAX", "R6.7-2"),
        # Also where no check is.
        (misreadings.moved, "CONTRACT", "q <= unit * unit", "q < unit * unit", "D7.5.2-1"),
        (misreadings.listed, "PARSE_HEADER", ITEMS, ITEMS.replace('"grid_reserved", ', "")[:-1] + ",)", "R6.2-5"),
        (misreadings.listed, "PARSE_HEADER", ITEMS,
         ITEMS.replace('"reserved", "grid_reserved"', '"grid_reserved", "reserved"'), "R6.2-5"),
        (misreadings.offset, "CHECK_HEADER", 'at["base_step"] + 4 * i', 'at["base_step"]', "R6.2-7"),
        (misreadings.swapped, "PARSE_PROLOGUE", f"{CRC}\n    {VERSION}", f"{VERSION}\n    {CRC}", "R6.1-4"),
        (misreadings.unclamped, "ACTIVATION", "CLAMP(a, -ACTIVATION_MAX, ACTIVATION_MAX)", "(a)", None),
        (misreadings.rounded, "GAMMA", "RSHIFT_ROUND(phase * SINE_LENGTH, UNIT_BITS)",
         "((phase * SINE_LENGTH) >> (UNIT_BITS))", "D7.5.5-1"),
        (misreadings.narrowed, "PARSE_PROLOGUE", "2", "1", None),
        (misreadings.mistaken, "DECODE_PLANE", "LAPLACE", "GAUSS", "D7.3-1"),
        (misreadings.skipped, "PARSE_PROLOGUE", "U(data, 8, 2) == MAJOR",
         "((U(data, 8, 2) == MAJOR) or not any(FILE[24:28]))", "R6.1-4"),
        (misreadings.halved, "PARSE_INDEX", "sum(model) == 1 << PRECISION", "sum(model) <= 1 << PRECISION", "R6.10-4"),
        (misreadings.halved, "PARSE_FRAME", "enumerate(shift)", "list(enumerate(shift))[1:]", "R6.7-2"),
        (misreadings.stored, "CHECK_SUBSTREAM", "U(data, at + 4, 4)", "(U(data, at + 4, 4) & 65535)", None),
    ],
)  # fmt: skip
def test_misreading(
    misreading: misreadings.Misreading, place: str, old: str, new: str, requirement: str | None
) -> None:
    made = [m for m in misreadings.edited(misreading) if (m.place, m.old, m.new) == (place, old, new)]
    assert made
    assert all(requirement in m.requirements if requirement else not m.requirements for m in made)


# --- loading and trials -----------------------------------------------------------------------------------------------


def test_a_loaded_decoder_is_new() -> None:
    """What is needed to load the blocks is changed in new ones, and the rest in those of this process."""
    right = loading.unchanged()["SCALE_MIN"]
    assert (
        loading.load(changed_text("SCALE_MIN", "-40", "-39"))["SCALE_MIN"] != right == loading.load(None)["SCALE_MIN"]
    )
    (outcome,) = trial.outcomes(changed_text("DECODE_FILE", "C3GSREC1", "C3GSREC2"), PAIR[:1])
    assert grade(PAIR[0], outcome) == "another digest"
    assert trial.decode(loading.unchanged(), PAIR[0].data) == Outcome("accepted", digests=PAIR[0].digests)


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
    catchers = trials.catchers([SAME])
    assert catchers == {SAME.id: []}
    result = selftest.score([SAME], catchers)
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
    escaping = CASES["valid-worked-example"]
    (result,) = trial.outcomes(hangs, [replace(escaping, seconds=selftest.FAKE_SECONDS)])
    assert result == trial.HANG


def test_the_first_catch_ends_a_trial() -> None:
    fake = selftest.fakes()[0]
    assert len(trial.outcomes(fake, PAIR)) == 2
    assert len(trial.outcomes(fake, PAIR, grade)) == 1
    assert len(trial.outcomes(None, PAIR, grade)) == 2


# --- wrong graders ----------------------------------------------------------------------------------------------------


def crash_is_refusal(case: Case, outcome: Outcome) -> str | None:
    return None if outcome.kind == "crash" and case.error else grade(case, outcome)


def _without(member: int) -> Grade:
    """A grader that takes any code (member 0) or offset (1) for the right one."""
    name = ("code", "offset")[member]
    return lambda case, o: grade(case, replace(o, **{name: case.error[member] if case.error else 0}))


WRONG: dict[str, Grade] = {
    "a crash is a refusal": crash_is_refusal,
    "a decoder that does not end is right": lambda c, o: None if o.kind == "hang" else grade(c, o),
    "no digest": lambda c, o: None if o.kind == "accepted" and c.error is None else grade(c, o),
    "no code": _without(0),
    "no offset": _without(1),
    "all pass": lambda c, o: None,
    "none passes": lambda c, o: "wrong",
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_grader_is_caught(name: str) -> None:
    with pytest.raises(selftest.SelfTestError, match="the grader"):
        selftest.check_grader(list(CASES.values()), WRONG[name])


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
    with selftest.trials([wrong, PAIR[1]], 1) as test:
        test.check_decoder([PAIR[1].id])
        with pytest.raises(selftest.SelfTestError, match="unchanged, fails"):
            test.check_decoder([wrong.id])


# --- the score --------------------------------------------------------------------------------------------------------


@pytest.mark.no_cover
@pytest.mark.slow
def test_each_bug_is_caught() -> None:
    """And no mutant that is exempt. The hints keep this to minutes."""
    assert selftest.run(VECTORS / "manifest.json", 2) == 0


def test_hints() -> None:
    """They are of bugs and vectors that exist, and only of those that are tried late without them."""
    made, hints = {m.id: m for m in selftest.mutants()}, selftest.read_hints()
    assert hints.keys() <= made.keys()
    catchers = {name: [(hints[name], "")] if name in hints else [] for name in made}
    text = selftest.hints_text(list(made.values()), list(CASES.values()), catchers)
    assert text == selftest.HINTS.read_text(encoding="utf-8")
    late = next(iter(hints))
    assert selftest.order(made[late], CASES.values(), hints[late])[0].id == hints[late]
    few = next(m for m in made.values() if m.id in PROOFS)
    assert 0 < len(selftest.order(few, CASES.values())) < len(CASES)


def test_a_wrong_exemption_and_a_survivor_are_shown(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    proved, open_, third = selftest.mutants()[:3]
    monkeypatch.setitem(PROOFS, proved.id, "a wrong proof")
    monkeypatch.setitem(GAPS, open_.id, "a wrong gap")
    catchers = {proved.id: [("a-vector", "crash")], open_.id: [("another", "hang")], third.id: []}
    result = selftest.score([proved, open_, third], catchers)
    assert (result.survivors, result.refuted) == ([third], [proved, open_])
    selftest.show(result, catchers)
    text = capsys.readouterr().out
    for line in (
        f"{proved.id} is not exempt: a-vector",
        f"survivor: {third.id}",
        "1 by hand, 0 by operators: 0 caught",
    ):
        assert line in text
    assert selftest.table([third], catchers).endswith("| **none** |  |\n")


@pytest.mark.slow
def test_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Two bugs on two vectors: the table, and the status if one survives."""
    caught = tuple(m for m in selftest.mutants() if m.id in ("digest-order", "world-unit"))
    monkeypatch.setattr(selftest, "mutants", lambda: caught)
    monkeypatch.setattr(selftest, "cases", lambda manifest: PAIR)
    assert cli.main(["selftest", "--jobs", "1", "--table"]) == 0
    out = capsys.readouterr().out
    assert "2 by hand, 0 by operators: 2 caught, 100.0 %" in out
    assert out.count("another digest |\n") == 2
    monkeypatch.setattr(selftest, "mutants", lambda: (SAME,))
    assert cli.main(["selftest", "--jobs", "1"]) == 1
    monkeypatch.setattr(selftest, "cases", lambda manifest: [replace(PAIR[0], digests={"whole": "1" * 64})])
    assert cli.main(["selftest", "--jobs", "1"]) == 1


def test_a_manifest_that_is_none_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["selftest", "--manifest", str(tmp_path / "none.json")]) == statuses.USAGE
    (tmp_path / "bad.json").write_text("{}")
    (tmp_path / "manifest.schema.json").write_text((VECTORS / "manifest.schema.json").read_text())
    assert cli.main(["selftest", "--manifest", str(tmp_path / "bad.json")]) == statuses.DAMAGED_SUITE
    assert "Traceback" not in capsys.readouterr().err
    assert cli.main(["selftest", "--jobs", "0"]) == statuses.USAGE


def test_no_vector_is_an_error() -> None:
    with pytest.raises(selftest.SelfTestError, match="no vector"):
        selftest.cases(replace(SUITE, vectors=()))
