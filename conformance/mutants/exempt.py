"""Mutants that no vector catches.

PROOFS: those that are right decoders, each with the proof that no file distinguishes it from the unchanged one.
GAPS: wrong decoders, each with a file that would distinguish it, and that the suite does not have. They are not counted
as planted bugs. A later suite should have such files.
"""

_ONE_ITEM = "A field that is not a list is a list of one item, whose first and last item are the same."
_SYMMETRIC = "The minimum or maximum of two integers does not depend on their order."
_ONE_ERROR = "Both checks refuse a file with the same error at the same offset."
_ROW_OF_A_PLANE = "i is -1 to size - 1. Row -1 is the last one, which is still 0 where the first one is decoded."
_UNREAD_SIGN = "A value whose highest bit is set is refused with the same error, as negative as it is as positive."

PROOFS: dict[str, str] = {
    "BOUNDS-constant-024c42db": "The lower bound of an unsigned field may be -1 instead of 0.",
    "ROUND_SCALED-moved-e8f0d575": "The two differ only for a shift of 0, where RSHIFT_ROUND(m, 0) = m << 0 = m.",
    "ROUND_F32-moved-f180782a": "n is not 0 there: for 0 the function has returned.",
    "ROUND_F32-arguments-0e5729d1": _SYMMETRIC,
    "ROUND_F32-arithmetic-03ba666a": (
        "For m = 2^24 both give (e + s + 151) * 2^23: the right decoder as 2^23 + (e + s + 150) * 2^23, the changed "
        "one as 2^24 + (e + s + 149) * 2^23. No other m has its exponent changed, because m is not 0: n is not 0, "
        "and the limits of base steps, grids and exponents keep its lowest bit at 2^-149 or above."
    ),
    "ACTIVATION-arguments-07236520": "min(max(a, -A), A) does not depend on the order of a and -A.",
    "DECODE_PLANE-moved-5c25d25e": _ROW_OF_A_PLANE,
    "DECODE_PLANE-part-f2e8918a": _ROW_OF_A_PLANE,
    "DECODE_PLANE-split-11995b4e": _ROW_OF_A_PLANE,
    "DECODE_PLANE-split-ba898142": _ROW_OF_A_PLANE,
    "CONTRACT-moved-799e3e14": "Where q is the square of unit, n and f are unit, and x * unit // unit is x.",
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
    "CHECK_HEADER-swapped-0f6a2229": "No header has both render models, thus only one of the two branches is run.",
    "CHECK_HEADER-swapped-ed56457c": (
        "A scene with more anchors than its level allows has more than each lower level allows, thus only one of the "
        "two checks can fail."
    ),
    "PARSE_WEIGHTS-swapped-aac93085": "The first check can fail for packed layers only, and the second for raw ones.",
    "PARSE_INDEX-swapped-d5ed32bf": _ONE_ERROR,
    "PARSE_INDEX-swapped-c1d1fcf9": _ONE_ERROR,
    "DECODE_CHUNK-swapped-c8a7c289": "-0 is finite, thus only one of the two checks can fail for a number.",
}

GAPS: dict[str, str] = {
    "END-swapped-010f84de": "an escape that is too long, in a substream whose final state is wrong",
    "END-swapped-2f536dc6": "a substream without raw bytes, whose symbols have raw bits",
    "PACKED_LAYER-split-35a80710": "a packed row with an exponent below WEIGHT_EXPONENT_MIN",
    "CHECK_DIRECTORY-swapped-04b4e9e7": "a file without DATA, and with an unknown mode of another section",
    "PARSE_WEIGHTS-swapped-ccf7accf": "a carm_shift beyond its bound, and padding of WeightScales that is not zero",
    "PARSE_WEIGHTS-swapped-c7ceb772": "a section that ends inside a LayerModel, and bytes behind it that are not zero",
    "PARSE_WEIGHTS-offset-28afa05a": "padding of WeightScales that is not zero, behind a carm_shift",
    "PARSE_WEIGHTS-moved-7f926d27": "a section that ends with the last LayerModel, without a substream",
    "PARSE_PLANES-moved-599b4dba": "a section of planes that ends with the lengths of its substreams, all of them 0",
    "OPEN-narrowed-c3f1cad1": "a substream of more than 65,535 words",
    "PARSE_PROLOGUE-narrowed-f264dc18": "a header_length of 65,536 more than the right one",
    "PARSE_PROLOGUE-narrowed-956b7141": "a minor version of 256 or more, with fields that it adds to the header",
    "PARSE_INDEX-narrowed-583275a7": "a chunk of 65,536 anchors in profile Tiny",
    "PARSE_INDEX-narrowed-bc994fcf": "a chunk that keeps more than 65,535 offsets",
}
