"""Makes refcodec/data/tables-0.bin, the file of the tables, from the formulas of SPEC.md Annex A, with 50 digits."""

import struct
from collections.abc import Iterator
from functools import cache

import mpmath as mp

from .made import ROOT, Made

TARGET = ROOT / "refcodec" / "data" / "tables-0.bin"
TOTAL = 1 << 14
mp.mp.dps = 50


def half_up(x: mp.mpf) -> int:
    """Returns x rounded to an integer, half up."""
    return int(mp.floor(x + mp.mpf(1) / 2))


def upper_gauss(t: mp.mpf, scale: mp.mpf) -> mp.mpf:
    """Returns the probability above t of the normal distribution with a standard deviation."""
    return mp.erfc(t / (scale * mp.sqrt(2))) / 2


def upper_laplace(t: mp.mpf, scale: mp.mpf) -> mp.mpf:
    """Returns the probability above t of the Laplace distribution with a scale."""
    return mp.exp(-t / scale) / 2 if t >= 0 else 1 - mp.exp(t / scale) / 2


def radius(kind: str, scale: mp.mpf) -> int:
    """Returns R (A.3). kind: "gauss" or "laplace"."""
    width = mp.sqrt(2 * mp.log(TOTAL)) if kind == "gauss" else mp.log(TOTAL)
    return int(mp.ceil(width * scale + mp.mpf(1) / 2))


def frequencies(kind: str, scale_index: int, fraction: int) -> tuple[int, list[int]]:
    """Returns R and the 2 R + 2 frequencies of a model, the escape last (A.3, A.4).

    kind: "gauss" or "laplace". scale_index: the row. fraction: the column.
    """
    scale = mp.mpf(2) ** (mp.mpf(scale_index) / 8)
    mean = mp.mpf(fraction) / 16 - mp.mpf(1) / 2
    upper = upper_gauss if kind == "gauss" else upper_laplace
    r = radius(kind, scale)
    f = []
    for x in range(-r, r + 1):
        away = abs(x - mean)
        p = upper(away - mp.mpf(1) / 2, scale) - upper(away + mp.mpf(1) / 2, scale)
        f.append(max(1, half_up(p * TOTAL)))
    f.append(1)
    mode = max(range(2 * r + 1), key=lambda j: (f[j], -j))
    f[mode] += TOTAL - sum(f)
    if f[mode] < 1:
        raise AssertionError("the mode cannot take the remainder")
    return r, f


def family(kind: str) -> bytes:
    """Returns the bytes of a family: "gauss" or "laplace"."""
    out = b""
    for scale_index in range(-40, 24):
        for fraction in range(16):
            r, f = frequencies(kind, scale_index, fraction)
            out += struct.pack(f"<B{len(f)}H", r, *f)
    return out


@cache
def tables() -> dict[str, bytes]:
    """Returns the bytes of each table in the order of the file (Annex A)."""
    return {
        # A.1
        "sine table": b"".join(struct.pack("<h", half_up(1023 * mp.sin(2 * mp.pi * j / 1024))) for j in range(1024)),
        # A.2
        "step table": b"".join(struct.pack("<H", half_up(mp.mpf(2) ** (mp.mpf(q - 32) / 8) * 4096)) for q in range(64)),
        "Gaussian family": family("gauss"),
        "Laplace family": family("laplace"),
    }


def made() -> Iterator[Made]:
    yield Made(TARGET, b"".join(tables().values()))
