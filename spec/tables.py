"""The tables' file, refcodec/data/tables-0.bin, from the rules of SPEC.md Annex A in 50-digit arithmetic."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import mpmath as mp

from .made import ROOT, Made

TARGET = ROOT / "refcodec" / "data" / "tables-0.bin"
TOTAL = 1 << 14
mp.mp.dps = 50


def half_up(x: mp.mpf) -> int:
    return int(mp.floor(x + mp.mpf(1) / 2))


def upper_gauss(t: mp.mpf, scale: mp.mpf) -> mp.mpf:
    return mp.erfc(t / (scale * mp.sqrt(2))) / 2


def upper_laplace(t: mp.mpf, scale: mp.mpf) -> mp.mpf:
    return mp.exp(-t / scale) / 2 if t >= 0 else 1 - mp.exp(t / scale) / 2


def radius(kind: str, scale: mp.mpf) -> int:
    """Annex A.3."""
    width = mp.sqrt(2 * mp.log(TOTAL)) if kind == "gauss" else mp.log(TOTAL)
    return int(mp.ceil(width * scale + mp.mpf(1) / 2))


def frequencies(kind: str, scale_index: int, fraction: int) -> tuple[int, list[int]]:
    """Annex A.3 and A.4: radius R and the 2R + 2 frequencies, the escape's last."""
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


def tables() -> bytes:
    out = b""
    for j in range(1024):  # Annex A.1
        out += struct.pack("<h", half_up(1023 * mp.sin(2 * mp.pi * j / 1024)))
    for q in range(64):  # Annex A.2
        out += struct.pack("<H", half_up(mp.mpf(2) ** (mp.mpf(q - 32) / 8) * 4096))
    for kind in ("gauss", "laplace"):
        for scale_index in range(-40, 24):
            for fraction in range(16):
                r, f = frequencies(kind, scale_index, fraction)
                out += struct.pack(f"<B{len(f)}H", r, *f)
    return out


def made() -> Iterator[Made]:
    """The file."""
    yield Made(TARGET, tables())
