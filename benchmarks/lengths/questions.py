"""The questions that are asked of code lengths: entropy models side by side, of which the first is the reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from .variants import ALONE, OFFSETS, SCALINGS, Group, Variant, slices

BASE = Variant(steps=600)
# No planes and no gamma: F_h is constants.
NONE = replace(BASE, channels=0, frequencies=0)


@dataclass(frozen=True)
class Question:
    """title: of its section. variants: by name, the reference first."""

    title: str
    variants: Mapping[str, Variant]


def _features_with(scalings: str, offsets: str, width: int = 32) -> Variant:
    groups = (*slices(5, 10, 15, 20), Group("s", 0, -1, scalings), Group("o", 0, -1, offsets))
    return replace(BASE, groups=groups, carm=(width,))


QUESTIONS = {
    "weights": Question(
        "How weights are coded",
        {
            "weights in the loss": BASE,
            "steps chosen after training": replace(BASE, weighed=False),
            "weights in the loss, Laplace": replace(BASE, laplace=True),
        },
    ),
    "widths": Question(
        "Widths of networks, and slices",
        {
            "32, 32, SARM 16 16": BASE,
            "F_h linear": replace(BASE, hyper=()),
            "F_h 16": replace(BASE, hyper=(16,)),
            "F_h 64": replace(BASE, hyper=(64,)),
            "CARM linear": replace(BASE, carm=()),
            "CARM 8": replace(BASE, carm=(8,)),
            "CARM 64": replace(BASE, carm=(64,)),
            "CARM shared, 32": replace(BASE, shared=True),
            "no CARM": replace(BASE, groups=ALONE),
            "slices 10 40": replace(BASE, groups=(*slices(10, 40), SCALINGS, OFFSETS)),
            "slices 5 x 10": replace(BASE, groups=(*slices(*[10] * 5), SCALINGS, OFFSETS)),
            "slices 10 x 5": replace(BASE, groups=(*slices(*[5] * 10), SCALINGS, OFFSETS)),
            "slices 10 x 5, linear": replace(BASE, groups=(*slices(*[5] * 10), SCALINGS, OFFSETS), carm=()),
            "SARM 8": replace(BASE, sarm=(8,)),
        },
    ),
    "smallest": Question(
        "The smallest useful networks",
        {
            "the format's": BASE,
            "F_h constants, CARM 32": NONE,
            "F_h constants, CARM 8": replace(NONE, carm=(8,)),
            "F_h constants, CARM linear": replace(NONE, carm=()),
            "F_h constants, slices 10 40, linear": replace(NONE, groups=(*slices(10, 40), SCALINGS, OFFSETS), carm=()),
            "F_h constants, slices 10 x 5, linear": replace(
                NONE, groups=(*slices(*[5] * 10), SCALINGS, OFFSETS), carm=()
            ),
            "F_h constants, no CARM": replace(NONE, groups=ALONE),
            "gamma, F_h linear, CARM linear": replace(BASE, channels=0, hyper=(), carm=()),
            "gamma, F_h 8, CARM 8": replace(BASE, channels=0, hyper=(8,), carm=(8,)),
            "2 channels, no gamma, F_h linear, CARM linear": replace(
                BASE, channels=2, frequencies=0, hyper=(), carm=()
            ),
        },
    ),
    "hyperprior": Question(
        "The hyperprior by number of anchors",
        {
            "planes and gamma": BASE,
            "planes": replace(BASE, frequencies=0),
            "gamma": replace(BASE, channels=0),
            "constants": NONE,
            "constants, no CARM": replace(NONE, groups=ALONE),
        },
    ),
    "planes": Question(
        "What could revive the planes",
        {
            "planes and gamma": BASE,
            "gamma": replace(BASE, channels=0),
            "start at 0.3": replace(BASE, start=0.3),
            "start at 0.3, rounded from the beginning": replace(BASE, start=0.3, sharp=True),
            "B doubled": replace(BASE, size=2.0, start=0.3),
            "16 channels": replace(BASE, channels=16),
            "F_h 64": replace(BASE, hyper=(64,)),
            "three times the steps": replace(BASE, steps=1800),
            "planes free of cost": replace(BASE, sarm=None, start=0.3),
            "nearest anchor of a coarser level": replace(BASE, channels=0, neighbours="levels:1"),
            "three nearest of a coarser level": replace(BASE, channels=0, neighbours="levels:3"),
            "four nearest anchors before": replace(BASE, channels=0, neighbours="before:4"),
            "eight nearest of all, no decoder": replace(BASE, channels=0, neighbours="oracle:8"),
        },
    ),
    "contexts": Question(
        "Contexts within an anchor",
        {
            "the format's": BASE,
            "scalings read features": _features_with("f", ""),
            "offsets read features": _features_with("", "f"),
            "both read features": _features_with("f", "f"),
            "both read features, linear": replace(_features_with("f", "f"), carm=()),
            "offsets read scalings and masks": _features_with("", "sm"),
            "scalings one after the other": replace(
                BASE,
                groups=(
                    *slices(5, 10, 15, 20),
                    Group("s", 0, 3, "f"),
                    Group("s", 3, -1, "fs"),
                    OFFSETS,
                ),
            ),
            "scalings first, features read them": replace(
                BASE,
                groups=(
                    SCALINGS,
                    Group("f", 0, 5, "s"),
                    Group("f", 5, 15, "fs"),
                    Group("f", 15, 30, "fs"),
                    Group("f", 30, 50, "fs"),
                    OFFSETS,
                ),
            ),
            "features by bits, rising": replace(BASE, order="rising"),
            "mixture of two": replace(BASE, mixture=True),
            "mixture of two, both read features": replace(_features_with("f", "f"), mixture=True),
        },
    ),
}
