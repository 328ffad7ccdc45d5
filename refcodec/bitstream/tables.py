"""Annex A and clause 8.4: the tables.

They are read from the shipped file, whose SHA-256 is checked. Annex A defines its content, and spec/tables.py computes
it with 50 digits.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# SPEC A: the shipped file and its SHA-256.
TABLES_FILE = "tables-0.bin"
TABLES_SHA256 = "b8b489ae1faadaa4b3c91467cd7517a68c3ac7cda6ee1c5a2c8282dd3ec087b5"
# SPEC 8.2: the frequencies of a model sum to 2^PRECISION. SPEC A.3: the rows of a family, which are scale indices, and
# its columns, which are fractions of the mean.
PRECISION = 14
TOTAL = 1 << PRECISION
SCALE_MIN = -40
SCALE_END = 24
FRACTIONS = 16
MODELS = (SCALE_END - SCALE_MIN) * FRACTIONS
# SPEC A.1 and A.2: the lengths of the sine table and the step table. The unit of the step table is 2^-STEP_SHIFT.
SINE_LENGTH = 1024
STEP_LENGTH = 64
STEP_SHIFT = 12


@dataclass(frozen=True)
class ModelSet:
    """The models of one family, in arrays for lookup. The symbols of all models are concatenated.

    family: its name in traces.
    offset: int64 [models], where the symbols of each model start.
    lower, upper: uint32 [symbols]. A symbol has the slots from lower to upper - 1.
    radius: int64 [models], R of SPEC A.3, or 0 for a model without one.
    first: int64 [models * 256], for each model and the top 8 bits of a slot the first symbol that the slot can mean.
    """

    family: str
    offset: NDArray[np.int64]
    lower: NDArray[np.uint32]
    upper: NDArray[np.uint32]
    radius: NDArray[np.int64]
    first: NDArray[np.int64]

    @property
    def null(self) -> int:
        """The index of a model with one symbol that has all slots. Coding it changes no state (SPEC 8.2)."""
        return len(self.offset) - 1


def build_models(family: str, frequencies: Sequence[NDArray[np.integer]], radius: list[int]) -> ModelSet:
    """Returns the ModelSet of some models, with the null model after them.

    frequencies: for each model integers [symbols], with the sum 2^14. radius: for each model R, or 0.
    """
    lengths = np.array([*map(len, frequencies), 1])
    offset = np.cumsum(lengths) - lengths
    # All models at once: each has the sum 2^14, so the slots of model m start at m 2^14.
    every = np.concatenate([*frequencies, np.array([TOTAL])])
    first_slot = np.arange(len(lengths)) << PRECISION
    upper = np.cumsum(every)
    # The number of symbols that end at or below each multiple of 2^(PRECISION - 8).
    ends = np.bincount((upper - 1 >> PRECISION - 8) + 1, minlength=256 * len(lengths))[: 256 * len(lengths)]
    first = np.cumsum(ends).reshape(-1, 256) - offset[:, None]
    upper -= np.repeat(first_slot, lengths)
    return ModelSet(
        family,
        offset,
        (upper - every).astype(np.uint32),
        upper.astype(np.uint32),
        np.array([*radius, 0], dtype=np.int64),
        first.reshape(-1),
    )


@dataclass(frozen=True)
class Tables:
    """The shipped tables.

    sine: int64 [1024]. step: int64 [64], in units of 2^-12. gauss, laplace: the two families of models.
    """

    sine: NDArray[np.int64]
    step: NDArray[np.int64]
    gauss: ModelSet
    laplace: ModelSet


def tables_file() -> Path:
    """SPEC A: returns the path of the shipped file."""
    return Path(__file__).parents[1] / "data" / TABLES_FILE


@cache
def tables_bytes() -> bytes:
    """Returns the bytes of the shipped file (SPEC A). Raises RuntimeError if their SHA-256 is not that of SPEC.md."""
    data = tables_file().read_bytes()
    if hashlib.sha256(data).hexdigest() != TABLES_SHA256:
        raise RuntimeError(
            f"{TABLES_FILE} is damaged: its SHA-256 is not the one of SPEC.md Annex A; reinstall refcodec"
        )
    return data


@cache
def step_table() -> NDArray[np.int64]:
    """SPEC A.2: returns the step table, int64 [64], the only one that decoding with the native kernel needs."""
    return np.frombuffer(tables_bytes(), "<u2", STEP_LENGTH, offset=2 * SINE_LENGTH).astype(np.int64)


@cache
def tables() -> Tables:
    """Returns the tables of the shipped file (SPEC A). Raises RuntimeError as tables_bytes does."""
    data = tables_bytes()
    sine = np.frombuffer(data, "<i2", SINE_LENGTH).astype(np.int64)
    at = 2 * SINE_LENGTH + 2 * STEP_LENGTH
    families = []
    for family in ("gauss", "laplace"):
        frequencies, radius = [], []
        for _ in range(MODELS):
            r = data[at]
            frequencies.append(np.frombuffer(data, "<u2", 2 * r + 2, offset=at + 1))
            radius.append(r)
            at += 1 + 2 * (2 * r + 2)
        families.append(build_models(family, frequencies, radius))
    return Tables(sine, step_table(), *families)
