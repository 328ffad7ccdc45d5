"""Changes that do not make a wrong decoder: for each the proof that no file distinguishes it from the right one."""

from __future__ import annotations

_ONE_ITEM = "A field that is not a list is a list of one item, whose first and last item are the same."
_SYMMETRIC = "The minimum or maximum of two integers does not depend on their order."
_UNREAD_SIGN = "A value of 128 or more is refused with the same error, as negative as it is as positive."

PROOFS: dict[str, str] = {
    "BOUNDS-constant-024c42db": "The lower bound of an unsigned field may be -1 instead of 0.",
    "ROUND_SCALED-compare-0adb4382": "The two differ only for a shift of 0, where RSHIFT_ROUND(m, 0) = m << 0 = m.",
    "ROUND_F32-arguments-0e5729d1": _SYMMETRIC,
    "ROUND_F32-arithmetic-03ba666a": (
        "For m = 2^24 both give (e + s + 151) * 2^23: the right decoder as 2^23 + (e + s + 150) * 2^23, the changed "
        "one as 2^24 + (e + s + 149) * 2^23. No other m has its exponent changed, because m is not 0: n is not 0, "
        "and the limits of base steps, grids and exponents keep its lowest bit at 2^-149 or above."
    ),
    "ACTIVATION-arguments-07236520": "min(max(a, -A), A) does not depend on the order of a and -A.",
    "QUERY-arguments-17902e5e": _SYMMETRIC,
    "GAMMA-constant-0a5caf9d": (
        "The phase modulo 2^17 differs from the phase modulo 2^16 by 0 or 2^16, thus the turn by 0 or SINE_LENGTH. "
        "It is used modulo SINE_LENGTH."
    ),
    "EXPONENTIAL-constant-0048a028": "The two differ in the lowest bit of y only, which the shift by 16 drops.",
    "PARSE_HEADER-arguments-0904a40e": "Either takes 20 bytes. The value is not read: an entry is parsed from data.",
    "FIRST_FIELDS-constant-04a16a56": _UNREAD_SIGN,
    "FIRST_FIELDS-constant-07a8ca10": _UNREAD_SIGN,
    "FIRST_FIELDS-constant-09ef8081": _UNREAD_SIGN,
    "RENDERING-arguments-c66d6e6e": (
        "The names of these networks tell them from the integer networks, and their order in the file is that of the "
        "tuple. No other use depends on which name comes first."
    ),
    "SHAPES-constant-02fb110b": _ONE_ITEM,
    "CHECK_HEADER-constant-0ce1f44d": _ONE_ITEM,
    "CHECK_DIRECTORY-constant-0933885a": _ONE_ITEM,
    "PARSE_PLANES-constant-0457e909": _ONE_ITEM,
}
