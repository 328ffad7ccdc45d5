"""Annex A and clause 8.4: the tables, from the shipped file, which is checked against its SHA-256.

The rules that make the file are in Annex A; spec/tables.py follows them with 50 digits.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable

import numpy as np
from numpy.typing import NDArray

# SPEC A: the shipped file and its SHA-256.
TABLES_FILE = "tables-0.bin"
TABLES_SHA256 = "b8b489ae1faadaa4b3c91467cd7517a68c3ac7cda6ee1c5a2c8282dd3ec087b5"
# SPEC 8.4: precision of the frequencies; SPEC A.3: rows (scale index) and columns (mean fraction) of a family.
PRECISION = 14
TOTAL = 1 << PRECISION
SCALE_MIN = -40
SCALE_END = 24
FRACTIONS = 16
MODELS = (SCALE_END - SCALE_MIN) * FRACTIONS
# SPEC A.1 and A.2: lengths of the sine and the step table; the step table's unit is 2^-12.
SINE_LENGTH = 1024
STEP_LENGTH = 64
STEP_SHIFT = 12


@dataclass(frozen=True)
class ModelSet:
    """Frequency models of one family, laid out for lookup.

    family: its name in traces; offset: int64 [models], where a model's symbols start; lower and upper: uint32, the slots of a
    symbol, from lower to upper - 1; radius: int64 [models], SPEC A.3's R (0 for models without one); first: int64 [models * 256],
    for the top 8 bits of a slot the first symbol it can mean.
    """

    family: str
    offset: NDArray[np.int64]
    lower: NDArray[np.uint32]
    upper: NDArray[np.uint32]
    radius: NDArray[np.int64]
    first: NDArray[np.int64]

    @property
    def null(self) -> int:
        """Index of a model with one symbol of full frequency: coding it changes nothing (SPEC 8.2)."""
        return len(self.offset) - 1


def build_models(family: str, frequencies: list[NDArray[np.int64]], radius: list[int]) -> ModelSet:
    """A ModelSet from the frequencies of each model (each sums to 2^14); the null model is appended."""
    every = [*frequencies, np.array([TOTAL])]
    upper = [np.cumsum(f) for f in every]
    lengths = np.array([len(f) for f in every])
    starts = np.arange(256) << (PRECISION - 8)
    return ModelSet(
        family,
        np.cumsum(lengths) - lengths,
        np.concatenate([u - f for u, f in zip(upper, every, strict=True)]).astype(np.uint32),
        np.concatenate(upper).astype(np.uint32),
        np.array([*radius, 0], dtype=np.int64),
        np.concatenate([np.searchsorted(u, starts, side="right") for u in upper]),
    )


@dataclass(frozen=True)
class Tables:
    """The shipped tables: sine int64 [1024]; step int64 [64] in units of 2^-12; the two families of models."""

    sine: NDArray[np.int64]
    step: NDArray[np.int64]
    gauss: ModelSet
    laplace: ModelSet


def tables_file() -> Traversable:
    """SPEC A: the shipped file."""
    return resources.files("refcodec").joinpath("data", TABLES_FILE)


@cache
def tables() -> Tables:
    """Reads the shipped file (SPEC A). Raises RuntimeError when it is not the file that SPEC.md names."""
    data = tables_file().read_bytes()
    if hashlib.sha256(data).hexdigest() != TABLES_SHA256:
        raise RuntimeError(
            f"{TABLES_FILE} is damaged: its SHA-256 is not the one of SPEC.md Annex A; reinstall refcodec"
        )
    sine = np.frombuffer(data, "<i2", SINE_LENGTH).astype(np.int64)
    step = np.frombuffer(data, "<u2", STEP_LENGTH, offset=2 * SINE_LENGTH).astype(np.int64)
    at = 2 * SINE_LENGTH + 2 * STEP_LENGTH
    families = []
    for family in ("gauss", "laplace"):
        frequencies, radius = [], []
        for _ in range(MODELS):
            r = data[at]
            frequencies.append(np.frombuffer(data, "<u2", 2 * r + 2, offset=at + 1).astype(np.int64))
            radius.append(r)
            at += 1 + 2 * (2 * r + 2)
        families.append(build_models(family, frequencies, radius))
    return Tables(sine, step, *families)
