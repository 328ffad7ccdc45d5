"""Annex A and clause 8.4: the tables."""

import hashlib
import struct
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from .conventions import FRACTIONS, PRECISION, SCALE_END, SCALE_MIN, SINE_LENGTH, STEP_LENGTH

TABLE_SHA256 = "b8b489ae1faadaa4b3c91467cd7517a68c3ac7cda6ee1c5a2c8282dd3ec087b5"
TABLE_PATH = Path(__file__).resolve().parents[2] / "refcodec" / "data" / "tables-0.bin"


# SPEC 8.2, 8.4
class Model(NamedTuple):
    """A model. starts: the first slot of each symbol. radius: 0 if the model has none."""

    starts: list[int]
    frequencies: list[int]
    radius: int


# family[row][column]: the rows count from SCALE_MIN
Family = list[list[Model]]


@dataclass(frozen=True)
class Tables:
    """The sine table, the step table and the two families of models."""

    sine: tuple[int, ...]
    step: tuple[int, ...]
    gauss: Family
    laplace: Family


# SPEC 8.2
def make_model(frequencies: list[int], radius: int) -> Model:
    """Return a model. The frequencies sum to 2^PRECISION."""
    return Model([0, *accumulate(frequencies[:-1])], frequencies, radius)


# SPEC Annex A
def parse_tables(data: bytes) -> Tables:
    """Return the tables. data: the bytes of the file. Raises RuntimeError if they are not the normative ones."""
    if hashlib.sha256(data).hexdigest() != TABLE_SHA256:
        raise RuntimeError("the table file is not the one of version 0")
    sine = struct.unpack_from(f"<{SINE_LENGTH}h", data, 0)
    step = struct.unpack_from(f"<{STEP_LENGTH}H", data, 2 * SINE_LENGTH)
    at = 2 * (SINE_LENGTH + STEP_LENGTH)
    families: list[Family] = []
    for _ in range(2):
        models = []
        for _ in range((SCALE_END - SCALE_MIN) * FRACTIONS):
            radius = data[at]
            models.append(make_model(list(struct.unpack_from(f"<{2 * radius + 2}H", data, at + 1)), radius))
            assert sum(models[-1].frequencies) == 1 << PRECISION
            at += 1 + 2 * (2 * radius + 2)
        families.append([models[n : n + FRACTIONS] for n in range(0, len(models), FRACTIONS)])
    return Tables(sine, step, *families)


# SPEC Annex A
@lru_cache(maxsize=1)
def load_tables() -> Tables:
    """Return the normative tables, which are read once."""
    return parse_tables(TABLE_PATH.read_bytes())
