"""Every constant of the plain 3DGS trainer, with a meaning, a unit, a default and a source.

The source "3DGS" is Kerbl et al., "3D Gaussian Splatting for Real-Time Radiance Field Rendering" (2023), with the
values of its published code. Its training runs have 30,000 steps. Its step numbers become shares of the steps here, so
that a short training has the same order of events. Periods of recovery are in steps, as in 3DGS.
"""

# setting() returns a field.
# ruff: noqa: RUF009

from __future__ import annotations

from dataclasses import dataclass

from refcodec.train.settings import GS, OWN, Decay, setting


@dataclass(frozen=True)
class RateSettings:
    """Adam's learning rates. Some begin higher than in 3DGS, for short training runs, and end at its values."""

    mean: Decay = setting(Decay(6.4e-4, 1.6e-6), "of means, times the scene's extent", f"{OWN}; {GS}: 1.6e-4 to 1.6e-6")
    base: Decay = setting(Decay(0.01, 0.0025), "of the harmonics of degree 0", f"{OWN}; {GS}: 0.0025")
    rest: Decay = setting(Decay(5e-4, 1.25e-4), "of the other harmonics", f"{OWN}; {GS}: 1.25e-4")
    opacity: Decay = setting(Decay(0.05, 0.05), "of opacity logits", GS)
    scale: Decay = setting(Decay(0.02, 0.005), "of logarithms of lengths", f"{OWN}; {GS}: 0.005")
    quaternion: Decay = setting(Decay(0.004, 0.001), "of quaternions", f"{OWN}; {GS}: 0.001")


@dataclass(frozen=True)
class BeginSettings:
    """The initial Gaussians."""

    share: float = setting(0.5, "largest share of `most` to begin with, drawn from the points", low=0, high=1)
    opacity: float = setting(0.1, "opacity of a new Gaussian", GS, low=0, high=1)
    neighbours: int = setting(3, "points around one whose distances give its size", GS, low=1, high=64)
    near: float = setting(0.02, "nearest depth that is drawn", "refcodec's trainer", unit="scene lengths", low=1e-6)


@dataclass(frozen=True)
class DensitySettings:
    """Adaptive density control: clone, split, prune, reset.

    The limit of 20 pixels for radii in an image, which 3DGS's code has, is omitted. According to its authors it has no
    effect, because the code resets the radii first (issue 643 of graphdeco-inria/gaussian-splatting). With an effective
    limit, 10,000 steps lost 5 dB on a scene at 200 pixels.
    """

    most: int = setting(16000, "largest number of Gaussians at any time", OWN, unit="Gaussians", low=1)
    begin: float = setting(1 / 60, "share of the steps after which it begins", GS, low=0, high=1)
    end: float = setting(0.5, "share of the steps at which it ends", GS, low=0, high=1)
    period: int = setting(100, "from one change to the next", GS, unit="steps", low=1)
    gradient: float = setting(
        2e-4,
        "mean gradient of a projected mean from which on a Gaussian is cloned or split",
        GS,
        unit="loss / normalised device unit",
        low=0,
    )
    dense: float = setting(0.01, "length above which it is split, else cloned", GS, unit="extents of the scene", low=0)
    children: int = setting(2, "Gaussians that one is split into", GS, low=2, high=8)
    shrink: float = setting(1.6, "a child's lengths are its parent's over this", GS, low=1)
    opacity: float = setting(0.005, "opacity under which one is pruned", GS, low=0, high=1)
    reset_period: int = setting(
        3000, "from one reset of the opacities to the next; a training of 2,000 has none", GS, unit="steps", low=1
    )
    reset_opacity: float = setting(0.01, "largest opacity after a reset", GS, low=0, high=1)
    largest: float = setting(
        0.1, "length above which one is pruned, after the first reset", GS, unit="extents of the scene", low=0
    )


@dataclass(frozen=True)
class SplatSettings:
    """A training run of a plain 3DGS from photographs."""

    steps: int = setting(2000, "steps of training, a photograph each", f"{OWN}; {GS}: 30,000", unit="steps", low=1)
    seed: int = setting(0, "of all random numbers", low=0, high=2**63 - 1)
    size: int = setting(200, "longest side that photographs are averaged down to", unit="pixels", low=1)
    degree: int = setting(1, "of the spherical harmonics", f"{OWN}; {GS}: 3", low=0, high=3)
    degree_share: float = setting(1 / 30, "share of the steps after which one more degree is in use", GS, low=0, high=1)
    ssim: float = setting(0.2, "share of 1 - SSIM in the loss; the rest is L1", GS, low=0, high=1)
    low_pass: float = setting(
        0.1,
        "added to both variances of a Gaussian in an image, also where the file is drawn",
        f"refcodec's trainer; {GS}: 0.3",
        unit="square pixels",
        low=0,
        high=1,
    )
    extent: float = setting(
        1.1, "extent of the scene over the largest distance of a camera from their middle", GS, low=0
    )
    save_seconds: float = setting(30.0, "from one saving of the state to the next", unit="seconds", low=0)
    begin: BeginSettings = BeginSettings()
    density: DensitySettings = DensitySettings()
    rates: RateSettings = RateSettings()
