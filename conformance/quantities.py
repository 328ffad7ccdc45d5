"""The integers whose bounds and types clause 7.11 of SPEC.md has, and where the blocks compute them."""

import re
from functools import cache

from .spec_decoder.program import SPEC

_STATE = "(x >> PRECISION)"
# Quantities of 7.11, each with the function and the expression that computes it.
QUANTITIES = {
    ("NETWORK", "sum([x * a for x, a in zip(w, inputs)]) + b"): "accumulator of a row",
    ("CONTEXT", "POSITION_INTEGER(b)"): "P",
    ("FRAME_COORDINATES", "t"): "frame sum",
    ("FRAME_COORDINATES", "CLAMP(RSHIFT_ROUND(t, frame['shift'][r]), -FRAME_CLAMP, FRAME_CLAMP)"): "v",
    ("CONTRACT", "q"): "q",
    ("CONTRACT", "ISQRT(q)"): "n",
    ("CONTRACT", "2 * n - unit"): "2 n - U",
    ("CONTRACT", "(2 * n - unit) * unit"): "(2 n - U) U",
    ("CONTRACT", "x * f"): "v f",
    ("CONTRACT", "x * f // n"): "w",
    ("RESCALE", "x - a << UNIT_BITS"): "(w - low) U",
    ("QUERY", "x * (size - 1)"): "u (s - 1)",
    ("QUERY", "t"): "sum of four weighted symbols",
    ("group", "hyper[n][c] + dm"): "mean, scale index",
    ("SELECT", "mean - 8 * ((1 << k) - 1)"): "mean - 8 (2^k - 1), rounded",
    ("READ_ESCAPE", "(1 << z) + READ_BITS(stream, z)"): "n of an escape",
    ("DECODE_VALUES", "value"): "symbol before its range is checked",
    ("DECODE_SYMBOL", f"frequencies[symbol] * {_STATE} + slot - low"): f"frequency * {_STATE} + slot - low",
    ("READ_BITS", "at + 1"): "raw bits of a substream",
    ("WORLD", "grid['origin'][axis] + grid['scale_mantissa'] * p"): "origin + S P",
    ("STEP_VALUE", "STEP[step_index] * m"): "step_table * m",
    ("VALUE", "symbol * m"): "symbol * m",
    ("EXPONENTIAL", "t * LOG2_E"): "s LOG2_E",
    ("EXPONENTIAL", "m * fraction"): "m fraction",
    ("SPLAT", "own * m"): "significand of an offset times m",
    ("SPLAT", "s[3 + i] + c"): "logarithm of a length in 2^-SCALING_BITS",
    ("PACKED_LAYER", "e"): "grid exponent of any row, as a sum before the check",
    ("CELL_NUMBER", "abs(n) << cell_shift"): "coordinate of a cell as an integer",
    ("CHECK_SUBSTREAM", "8 + 4 * lanes + 2 * U(data, at + 4, 4)"): "bytes that the head of a substream implies",
    ("PARSE_PLANES", "20 + sum([PAD4(n) for n in lengths])"): "bytes that a PlaneTable or the head of a chunk implies",
    ("PARSE_INDEX", "sum([x['length'] for x in entries])"): "sum of the entries' lengths",
    ("DECODE_FILE", "at + e['length']"): "sum of the sections' lengths",
    ("WORK", "v['anchor_count'][0] * anchor + symbols * plane"): "work",
}


@cache
def bounds() -> dict[tuple[str, str], tuple[int, bool]]:
    """Returns for each key of QUANTITIES the power of two that its row names as n (2^n), and whether it is signed."""
    clause = re.search(r"^### 7\.11 .*?(?=^### )", SPEC.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert clause is not None
    rows = re.findall(r"^\| (.+?) \| [\d.]+ \| .+? \| 2\^(\d+) \| ([iu])\d+ \|", clause[0], re.MULTILINE)
    found = {name: (int(below), sign == "i") for name, below, sign in rows}
    return {key: found[name] for key, name in QUANTITIES.items()}
