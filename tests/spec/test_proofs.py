"""The proofs of SPEC.md's integer arithmetic. Each fails if what it proves is changed in SPEC.md."""

from collections.abc import Iterable
from typing import Any

import pytest

from conformance.spec_decoder.program import SPEC
from spec import proofs
from spec.proofs import BODIES, prove, specification

TEXT = SPEC.read_text(encoding="utf-8")
ROWS = specification(TEXT).rows
# They take some seconds of a processor, those that only fail as well if they come to it late.
SLOW = ("QUERY", "CELL_NUMBER", "WORK", "WORLD", "VALUE", "SPLAT", "ROUND_F32: weights")
LATE = ("CELL_NUMBER", "WORLD", "VALUE", "SPLAT", "ROUND_F32")
# The rows of each proof, by the start of its name. A planted bound is half of the stated one, because most rows have
# less than twice the largest value.
ROWS_OF = {
    "ROUND_SCALED": [proofs.SCALED],
    "DERIVE_ROW": ["sum of the second rule, if the first one holds", "accumulator of a row"],
    "POSITION_INTEGER": ["P"],
    "PARSE_FRAME, FRAME": ["frame sum", "v"],
    "CONTRACT": ["q", "n", "2 n - U", "(2 n - U) U", "v f", "w"],
    "PARSE_FRAME, RESCALE": ["(w - low) U"],
    "QUERY": ["u (s - 1)", "sum of four weighted symbols"],
    "DECODE_ATTRIBUTES": ["mean, scale index"],
    "SELECT": ["mean - 8 (2^k - 1), rounded", "symbol before its range is checked"],
    "READ_ESCAPE": ["n of an escape"],
    "DECODE_SYMBOL": ["frequency * (x >> PRECISION) + slot - low"],
    "READ_BITS: raw": ["raw bits of a substream"],
    "WORLD": ["origin + S P"],
    "STEP_VALUE": ["step_table * m"],
    "VALUE": ["symbol * m"],
    "EXPONENTIAL": ["s LOG2_E", "m fraction"],
    "SPLAT": ["significand of an offset times m", "logarithm of a length in 2^-SCALING_BITS"],
    "PACKED_LAYER": ["grid exponent of any row, as a sum before the check"],
    "CELL_NUMBER": ["coordinate of a cell as an integer"],
    "DECODE_CELLS": [proofs.MORTON],
    "CHECK_SUBSTREAM": ["bytes that the head of a substream implies"],
    "PARSE_PLANES": ["bytes that a PlaneTable or the head of a chunk implies"],
    "PARSE_INDEX": ["sum of the entries' lengths"],
    "PARSE_HEADER": ["sum of the sections' lengths"],
    "WORK": ["work"],
}
PLANTED = {row: start for start, rows in ROWS_OF.items() for row in rows}
# Other divisors. Before the last term of the exponential is added, m is below 2^30. A header of 65532 bytes has 3272
# entries of the 65535 that section_count could count.
DIVISORS = {"m fraction": 4, "sum of the sections' lengths": 32}
# Proofs of other properties, each with a change of SPEC.md that makes it wrong.
CHANGES = {
    "a field of signed bytes": ("U, I", "value - (1 << 8 * size) if", "value - (1 << 7 * size) if"),
    "a bit too few": ("BIT_LENGTH", "    while a >> n:\n", "    while a >> n + 1:\n"),
    "a root without its lowest bit": ("ISQRT", "BIT_LENGTH(a) // 2, -1, -1)", "BIT_LENGTH(a) // 2, 0, -1)"),
    "a root that may be too large": ("ISQRT", "(r | 1 << bit) <= a:", "(r | 1 << bit) <= a + 1:"),
    "a significand of 25 bits": ("SIGNIFICAND", "(fraction | 1 << 23, exponent", "(fraction | 1 << 24, exponent"),
    "a row rule without the bias": ("DERIVE_ROW", "ACTIVATION_MAX + abs(b) + ((1", "ACTIVATION_MAX + ((1"),
    "sums beyond binary32": ("DERIVE_ROW", "| ACCUMULATOR_BOUND | 2^24 |", "| ACCUMULATOR_BOUND | 2^25 |"),
    "binary32 of 23 bits": ("binary32", "s = max(BIT_LENGTH(m) - 24, -149", "s = max(BIT_LENGTH(m) - 23, -149"),
    "a coordinate without its clamp": ("PARSE_FRAME, FRAME", "| FRAME_CLAMP | 2^30 -", "| FRAME_CLAMP | 2^31 -"),
    "a frame shift of 64": ("PARSE_FRAME, FRAME", "| FRAME_SHIFT_MAX | 60 |", "| FRAME_SHIFT_MAX | 64 |"),
    "sines above the inputs": ("GAMMA", "| ACTIVATION_MAX | 1023 |", "| ACTIVATION_MAX | 1022 |"),
    "a negative shift of a sample": ("QUERY", "| PLANE_SHIFT_MAX | 10 |", "| PLANE_SHIFT_MAX | 17 |"),
    "a shift by the width of a mean": ("SELECT", "| RAW_MAX | 16 |", "| RAW_MAX | 32 |"),
    "a bit that is read twice": ("READ_BITS: k bits", 'stream["raw_at"] = at + 1', 'stream["raw_at"] = at + i'),
    "a state of 33 bits": ("DECODE_SYMBOL", "x = (x << 16) | word", "x = (x << 17) | word"),
    "a lower bound of 2^17 for states": ("rANS", "| STATE_MIN | 2^16 |", "| STATE_MIN | 2^17 |"),
    "an encoder that renormalises late": ("rANS", "If `x >> (32 - PRECISION)`", "If `x >> (33 - PRECISION)`"),
    "an encoder with another quotient": ("rANS", "`((x // f) << PRECISION)", "`((x // f) << PRECISION + 1)"),
    "a decoder that keeps the slot": ("rANS", "(x >> PRECISION) + slot - low\n", "(x >> PRECISION) + slot\n"),
    "cells of 17 bits": ("DECODE_CELLS", "(2 * x + (k & 1),", "(2 * x + (k & 3),"),
    "an exponential that overflows": ("EXPONENTIAL", "EXP2 = [1073741824, ", "EXP2 = [1073743924, "),
    "world positions beyond f32": ("WORLD", "| SCALE_EXPONENT_MAX | 60 |", "| SCALE_EXPONENT_MAX | 100 |"),
    "subnormal values": ("VALUE", "ROUND_F32(1, -60) <= step", "ROUND_F32(1, -126) <= step"),
    "weights beyond f32": ("ROUND_F32", "| WEIGHT_EXPONENT_MIN | -104 |", "| WEIGHT_EXPONENT_MIN | -105 |"),
    "more features": ("CHECK_HEADER", '"]) <= FEATURES_MAX, "h', '"]) <= FEATURES_MAX + 1, "h'),
    "more rows": ("SHAPES", "| colour_outputs | 1 to 48 | 1 to 48 |", "| colour_outputs | 1 to 48 | 1 to 49 |"),
    "a longer padding": ("DECODE_CHUNK", "return (n + 3) // 4 * 4", "return (n + 3) // 4 * 8"),
    "lanes of 64 bits": ("PARSE_WEIGHTS", "| LANES_LOG2_MAX | 8 |", "| LANES_LOG2_MAX | 64 |"),
    "a byte beyond 64 bits": ("BYTES", "[value >> 8 * i & 255", "[value >> 10 * i & 255"),
}


def named(start: str) -> str:
    return next(name for name in BODIES if name.startswith(start))


def some(names: Iterable[str], starts: dict[str, str], slow: tuple[str, ...]) -> list[Any]:
    """Returns parameters, slow by the start of their proof."""
    return [pytest.param(n, marks=[pytest.mark.slow] if starts.get(n, n).startswith(slow) else []) for n in names]


@pytest.mark.parametrize("name", some(BODIES, {}, SLOW))
def test_proved(name: str) -> None:
    assert prove(name, TEXT).fault == ""


def test_each_row_has_a_planted_bound() -> None:
    assert set(PLANTED) == set(ROWS)


@pytest.mark.parametrize("row", some(PLANTED, PLANTED, LATE))
def test_a_lower_bound_is_not_proved(row: str) -> None:
    start, divisor = PLANTED[row], DIVISORS.get(row, 2)
    before, head, table = TEXT.partition("\n### 7.11 ")
    above, name, rest = table.partition(f"\n| {row} | ")
    clause, bound, tail = rest.split(" | ", 2)
    text = f"{before}{head}{above}{name}{clause} | ({bound}) // {divisor} | {tail}"
    assert prove(named(start), text).fault.startswith(f"{row}: not ")


@pytest.mark.parametrize("change", some(CHANGES, {change: start for change, (start, *_) in CHANGES.items()}, LATE))
def test_a_change_is_not_proved(change: str) -> None:
    start, old, new = CHANGES[change]
    assert TEXT.count(old) == 1
    assert prove(named(start), TEXT.replace(old, new)).fault


def test_each_proof_can_fail() -> None:
    names = {named(start) for start in ROWS_OF} | {named(start) for start, _, _ in CHANGES.values()}
    assert set(BODIES) - names == {"x^2 <= q < (n + 1)^2: |x| <= n"}


def test_shifts_without_a_proof_are_named() -> None:
    """Those of READ_BITS only are followed here."""
    wrong, summary = proofs.shifts([prove(named("READ_BITS: k bits"), TEXT)])
    assert summary.startswith(f"{len(specification(TEXT).shifts)} shifts: ")
    assert "READ_ESCAPE: 1 << z" in wrong
    assert not any(place.startswith(("READ_BITS", "CRC32", "ADD_F32")) for place in wrong)


def test_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """It fails if a row or a shift has no proof."""
    monkeypatch.setattr(proofs, "BODIES", {name: BODIES[name] for name in BODIES if name.startswith("PACKED_LAYER")})
    assert proofs.main() == 1
    printed = capsys.readouterr().out
    assert "PACKED_LAYER: 7.13" in printed
    assert "  no proof: work\n" in printed
    assert "  not proved: READ_ESCAPE: 1 << z\n" in printed
    assert "  argued: ADD_F32: " in printed
