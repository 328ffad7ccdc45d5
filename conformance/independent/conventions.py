"""Clause 2: the constants, and the operators on integers."""

MAJOR, MINOR = 0, 0
HEADER_LENGTH_MIN, HEADER_LENGTH_MAX = 4, 65532
SECTION_LENGTH_MAX = 1 << 48
FEATURES_MAX = 128
ANCHORS_OF_A_BYTE = 16
LANES_LOG2_MAX = 8
BASE_STEP_MIN, BASE_STEP_MAX = 2.0**-60, 2.0**60
ORIGIN_BOUND = 1 << 62
SCALE_EXPONENT_MAX = 60
MATRIX_BOUND = 1 << 20
TRANSLATION_BOUND = 1 << 61
FRAME_SHIFT_MAX = 60
FRAME_RANGE_BOUND = 1 << 18
PLANE_SHIFT_MAX = 10
CARM_SHIFT_MAX = 16
WEIGHT_SYMBOL_MAX = (1 << 24) - 1
WEIGHT_EXPONENT_MIN, WEIGHT_EXPONENT_MAX = -104, 149
PLANE_SYMBOL_MAX = (1 << 15) - 1
ATTRIBUTE_SYMBOL_MAX = (1 << 23) - 1
CELL_LEVELS = 16
CELL_INDEX = 40
POSITION_MODELS = 18
ACTIVATION_MAX = 1023
WEIGHT_MAX = 1023
ACCUMULATOR_BOUND = 1 << 24
EXPONENT_MAX = 20
UNIT_BITS = 16
FRAME_CLAMP = (1 << 30) - 1
LERP_BITS = 8
STATE_MIN = 1 << 16
PRECISION = 14
RAW_MAX = 16
ESCAPE_PREFIX_MAX = 23
SCALE_MIN, SCALE_END = -40, 24
FRACTIONS = 16
SINE_LENGTH = 1024
STEP_LENGTH = 64
STEP_SHIFT = 12


# SPEC 5
def padded(length: int) -> int:
    """Return the least multiple of four that is not below length."""
    return length + -length % 4


# SPEC 2.4, RSHIFT_ROUND
def shift_round(value: int, shift: int) -> int:
    """Return value / 2^shift, rounded half up."""
    return (value + (1 << shift - 1)) >> shift if shift else value


# SPEC 2.4, CLAMP
def clamp(value: int, low: int, high: int) -> int:
    """Return the integer from low to high that is nearest to value."""
    return low if value < low else high if value > high else value


# SPEC 7.2, 7.9: the range of a network's input
def activation(value: int) -> int:
    """Return value, clamped to what a network reads."""
    return clamp(value, -ACTIVATION_MAX, ACTIVATION_MAX)


# SPEC 2.4, ROUND_SCALED: the f32 is given as numerator / 2^denominator_log2
def round_ratio(numerator: int, denominator_log2: int, exponent: int) -> int:
    """Return numerator * 2^(exponent - denominator_log2), rounded half up."""
    down = denominator_log2 - exponent
    return shift_round(numerator, down) if down >= 0 else numerator << -down


# SPEC 2.4, ROUND_F32
def f32_bits(number: int, exponent: int) -> int:
    """Return the bits of the binary32 nearest to number * 2^exponent, ties to even. The result is normal or zero."""
    if number == 0:
        return 0
    magnitude = abs(number)
    excess = magnitude.bit_length() - 24
    if excess <= 0:
        significand = magnitude << -excess
    else:
        significand, rest = magnitude >> excess, magnitude & ((1 << excess) - 1)
        half = 1 << (excess - 1)
        if rest > half or (rest == half and significand & 1):
            significand += 1
            if significand == 1 << 24:
                significand, excess = 1 << 23, excess + 1
    biased = exponent + excess + 23 + 127
    return (number < 0) << 31 | biased << 23 | significand & 0x7FFFFF
