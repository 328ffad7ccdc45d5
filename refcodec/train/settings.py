"""Every constant of the training method, as settings with a meaning, a unit, a default and a source.

`TrainSettings` is one training run. It has groups, one for each part of the method, and phases, which state when the
parts work. Presets are objects of the same type. settings_file.py prints settings, reads them and changes them.

Nothing here needs NumPy or torch.
"""

# setting() gives a field.
# ruff: noqa: RUF009

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from msgspec import Struct

T = TypeVar("T")

# The origins of defaults: tried for this trainer, 3D Gaussian Splatting (Kerbl et al. 2023), Scaffold-GS (Lu et al.
# 2024), the published code of CAT-3DGS, the paper of CAT-3DGS Pro.
OWN, GS, SCAFFOLD, CAT, PRO = "own", "3DGS", "Scaffold-GS", "CAT-3DGS's code", "CAT-3DGS Pro"


def setting(
    default: T,
    meaning: str,
    source: str = OWN,
    *,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    choices: tuple[str, ...] = (),
) -> T:
    """A field with its documentation.

    source: the origin of the default, or the values of others. low, high: the least and the largest allowed value, of
    each element of a tuple. choices: the allowed texts.
    """
    notes = {"meaning": meaning, "source": source, "unit": unit, "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=notes)


# SPEC 11.1: the most features and slices of features in Main. The first features begin as a colour.
FEATURES_MAX, COLOURS = 128, 3
SLICES_MAX = 16
# The degree of harmonics that training chooses.
CHOSEN = -1
# lambda_r of training, and of a fit that keeps its base steps.
BASE_LAMBDA = 0.004


# --- learning rates ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Decay:
    """A learning rate that falls from `start` to `end` with a constant ratio from step to step.

    held: the share of the way for which `start` is kept first.
    """

    start: float = setting(0.01, "learning rate at first", low=1e-12)
    end: float = setting(0.001, "learning rate at the end", low=1e-12)
    held: float = setting(0.0, "share of the way for which the first rate is held", low=0, high=0.99)


@dataclass(frozen=True)
class LearningSettings:
    """Adam's learning rates.

    Those of planes and coding networks fall from the beginning of the rate on, the others from the first step on.
    """

    features: Decay = setting(Decay(0.01, 0.001, 0.6), "of the anchors' features", f"{OWN}; {SCAFFOLD}: 0.0075")
    offsets: Decay = setting(Decay(0.01, 1e-4), "of the anchors' offsets", SCAFFOLD)
    scalings: Decay = setting(Decay(0.01, 0.001, 0.6), "of the anchors' scalings", f"{OWN}; {SCAFFOLD}: 0.007")
    masks: Decay = setting(Decay(0.1, 0.01, 0.6), "of the masks' logits", f"{OWN}; {CAT}: 0.01 to 1e-4")
    opacity: Decay = setting(Decay(0.004, 2e-4), "of the opacity network", f"{OWN}; {SCAFFOLD}: 0.002 to 2e-5")
    covariance: Decay = setting(Decay(0.004, 0.002), "of the covariance network", f"{OWN}; {SCAFFOLD}: 0.004")
    colour: Decay = setting(Decay(0.008, 5e-4), "of the colour network", f"{OWN}; {SCAFFOLD}: 0.008 to 5e-5")
    planes: Decay = setting(Decay(0.0075, 0.001), "of the planes")
    coding: Decay = setting(Decay(0.005, 0.0005), "of F_h, SARM and CARM", f"{OWN}; {CAT}: 0.008, of SARM 0.005")
    exposure: Decay = setting(Decay(0.002, 2e-4), "of the photographs' exposures")
    cube: float = setting(
        4.0, "factor of the starts of features, offsets and scalings, where random points fill a cube", low=1, high=100
    )
    clip: float = setting(1.0, "largest norm of the coding networks' gradient, which is scaled down to it", low=0)


# --- the parts --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StartSettings:
    """The anchors of the beginning."""

    anchors: int = setting(0, "about how many there are; 0: as `least` and `pixels` say", low=0)
    least: int = setting(
        5000,
        "how many there are where points are given, and least number where they are drawn at random; "
        "0: a voxel is the median distance of neighbouring points",
        f"{OWN}; {SCAFFOLD}: 0",
        low=0,
    )
    pixels: int = setting(
        800,
        "pixels of all photographs for each of them, where points are drawn at random, up to `growth.most`",
        unit="pixels",
        low=1,
    )
    voxel: float = setting(
        0.0, "edge of the voxels of the first anchors; 0: chosen for the number of anchors", unit="world units", low=0
    )
    cells: int = setting(2, "edge of the voxels of the first anchors", unit="cells of the lattice", low=1, high=64)
    random_cells: int = setting(
        8,
        "that edge where points were drawn at random: the scene must find its places by growing, on a finer lattice",
        unit="cells of the lattice",
        low=1,
        high=64,
    )
    drawn: int = setting(
        20000, "least number of random points to begin with where photographs are transparent", unit="points", low=1
    )
    behind: float = setting(
        30.0,
        "largest depth of anchors that begin behind given points, where opaque photographs show none; 1 adds none",
        unit="depths of the points",
        low=1,
        high=1000,
    )
    near: float = setting(0.02, "nearest depth that is drawn", unit="training units", low=1e-6)
    neighbours: int = setting(3, "anchors around one whose distances give its size", GS, low=1, high=64)
    colours: int = setting(4, "points around an anchor whose mean colour it begins with", low=1, high=64)
    smallest: float = setting(0.1, "least size of a first anchor", unit="median sizes", low=0)
    largest: float = setting(0.99, "quantile of the sizes that none exceeds", low=0, high=1)
    least_cells: float = setting(0.5, "least size of a first anchor", unit="cells of the lattice", low=1e-3)


@dataclass(frozen=True)
class LossSettings:
    """L_Scaffold, the loss of the image."""

    ssim: float = setting(0.2, "share of 1 - SSIM in the loss; the rest is L1", GS, low=0, high=1)
    volume: float = setting(
        0.01, "weight of the Gaussians' mean volume", SCAFFOLD, unit="loss / cubic training unit", low=0
    )


@dataclass(frozen=True)
class GrowthSettings:
    """The growth of anchors where the image needs more, and their removal."""

    period: int = setting(100, "from one growth to the next", SCAFFOLD, unit="steps", low=1)
    most: int = setting(40000, "largest number of anchors at any time", unit="anchors", low=1)
    pixels: int = setting(
        64,
        "pixels of all photographs for each anchor, at least; more anchors overfit the photographs",
        unit="pixels",
        low=1,
    )
    each: int = setting(350, "largest number for each photograph; more overfit few photographs", unit="anchors", low=1)
    gradient: float = setting(
        2e-4,
        "mean gradient of a projected centre above which its offset grows on the coarsest lattice",
        SCAFFOLD,
        unit="loss / normalised device unit",
        low=0,
    )
    hull: float = setting(0.5, "factor of that gradient where points fill a hull: renderings gain from anchors", low=0)
    ratio: float = setting(2.0, "factor of that gradient from one lattice to the next finer one", SCAFFOLD, low=1)
    chance: float = setting(
        0.5,
        "share of the offsets that may not grow on the coarsest lattice; its powers on finer ones",
        SCAFFOLD,
        low=0,
        high=1,
    )
    edges: tuple[int, ...] = setting(
        (4, 2, 1),
        "edges of the lattices on which anchors grow, coarsest first",
        f"{OWN}; {SCAFFOLD}: 16, 4 and 1 voxels",
        unit="cells of the lattice",
        low=1,
        high=1024,
    )
    opacity: float = setting(0.005, "mean sum of an anchor's opacities under which it is dropped", SCAFFOLD, low=0)
    offset_views: int = setting(
        10, "times that an offset was drawn before it is judged", f"{OWN}; {SCAFFOLD}: 40", unit="steps", low=1
    )
    anchor_views: int = setting(
        25, "times that an anchor was seen before it is judged", f"{OWN}; {SCAFFOLD}: 80", unit="steps", low=1
    )


@dataclass(frozen=True)
class MaskSettings:
    """The masks of offsets. An offset is kept if its weighted share is above epsilon.

    The share is the logistic function of its logit. The weight is the number of views that see its anchor over the mean
    of all anchors.
    """

    used: bool = setting(True, "whether offsets may be masked at all", PRO)
    epsilon: float = setting(
        0.01, "weighted share up to which one is dropped; 0.0004 where views are concentrated", PRO, low=0, high=1
    )
    start: float = setting(1.0, "logit of a new offset; 1 is a share of 0.73")
    least: float = setting(
        0.0, "least weight of the masks' mean share in the loss, lambda_m", f"{OWN}; {CAT}: 0.001", low=0
    )
    drop_period: int = setting(
        100, "from one dropping of lost anchors to the next, once the rate counts", unit="steps", low=1
    )
    lost: float = setting(
        0.2, "weighted share up to which all of an anchor's offsets are if it is lost", unit="epsilon", low=0, high=1
    )
    share: float = setting(0.3, "that weight over lambda_r, where it is more", CAT, low=0)


@dataclass(frozen=True)
class RateSettings:
    """L_rate, the bits of a parameter (the paper's equation 5), and its weight in the loss (its equation 4)."""

    lambda_r: float = setting(
        BASE_LAMBDA,
        "weight in the loss, lambda_r; 0 trains an uncompressed Scaffold-GS",
        f"{PRO}: 0.002 to 0.04",
        low=0,
        high=1,
    )
    planes: float = setting(10.0, "weight of the planes' bits, lambda_tri", CAT, low=0)
    plane_period: int = setting(
        4,
        "from a step that counts the planes' bits to the next (A-RDO); they are not scaled up",
        PRO,
        unit="steps",
        low=1,
    )


@dataclass(frozen=True)
class SamplingSettings:
    """The anchors whose bits a step counts."""

    among: str = setting(
        "all", "drawn from all anchors (USRO) or from the visible ones (ViSRO)", PRO, choices=("all", "visible")
    )
    share: float = setting(
        0.05,
        "number of drawn anchors, as a share of all anchors; the same for both values of `among`",
        PRO,
        low=0,
        high=1,
    )
    least: int = setting(512, "least number that is drawn", unit="anchors", low=1)


@dataclass(frozen=True)
class EntropySettings:
    """The entropy model in training: planes, F_h, SARM and CARM."""

    channels: int = setting(
        8, "channels of the planes; 0 for none, which saves bytes where anchors are few", PRO, low=0, high=16
    )
    frequencies: int = setting(
        10,
        "frequencies of the positional encoding; with none and without planes F_h is a row of constants",
        PRO,
        low=0,
        high=16,
    )
    layers: int = setting(
        1,
        "hidden layers of F_h and CARM; 0 saves bytes where anchors are few; F_h of constants has none",
        PRO,
        low=0,
        high=2,
    )
    slices: tuple[int, ...] = setting(
        (5, 10, 15, 20),
        "features of each slice, 16 slices at most: a training's anchors have as many features as these add up to; "
        "a fit takes the features that there are, in slices of these proportions",
        CAT,
        low=1,
        high=64,
    )
    width: int = setting(100, "most hidden units of F_h and CARM; fewer are decoded faster", PRO, low=16, high=100)
    planes: float = setting(0.03, "deviation of the planes at first", unit="latents, of 16 plane symbols each", low=0)
    gain: float = setting(0.1, "spread of a last layer's first weights, times the root of its inputs", low=0)
    bias: float = setting(0.2, "largest first bias of a hidden unit; none is negative", low=0)
    deviation: float = setting(
        2.0**-4, "least deviation of a channel that the model begins with", unit="symbols", low=2**-5
    )
    floor: float = setting(
        2.0**-20,
        "probability added to each symbol's, so that an outlier costs about as much as an escape",
        low=1e-12,
        high=0.01,
    )

    def __post_init__(self) -> None:
        """Raises ValueError for more slices than Main holds (SPEC 11.1)."""
        if not 1 <= len(self.slices) <= SLICES_MAX:
            raise ValueError(f"entropy.slices has {len(self.slices)} slices, but must have 1 to {SLICES_MAX}")


@dataclass(frozen=True)
class QuantisationSettings:
    """The base steps of attributes (SPEC B.5): the entropy model's steps are multiples of them."""

    features: float = setting(1 / 3, "of features", unit="median spreads of a feature", low=1e-4)
    scalings: float = setting(0.1, "of scalings", unit="natural logarithms", low=1e-4)
    offsets: float = setting(0.2, "of offsets", PRO, unit="exp(scaling)", low=1e-4)


@dataclass(frozen=True)
class WeightSettings:
    """The grids of the networks' weights. All of these are tried, and rate and distortion choose (docs/method.md)."""

    rendering_bits: tuple[int, int] = setting(
        (5, 12), "fewest and most bits of the largest weight of a rendering network's layer", low=2, high=24
    )
    coarser: tuple[int, int] = setting(
        (0, 7), "least and most bits by which coding networks are coarser than SPEC 7.2's integers", low=0, high=12
    )
    judges: int = setting(5, "training photographs that judge the grids", low=1)


@dataclass(frozen=True)
class LookSettings:
    """The records that training keeps of its progress."""

    count: int = setting(40, "evaluations on held-out photographs during training", low=1)
    save_seconds: float = setting(30.0, "from one saving of the state to the next", unit="seconds", low=0)


# --- phases -----------------------------------------------------------------------------------------------------------

# The stages of the method, each a module of `stages`, in the order in which a step calls them, and the modes that a
# phase may give them.
MODES: dict[str, tuple[str, ...]] = {
    # on: offsets may be masked, and the masks' loss counts.
    "masks": ("off", "on"),
    # on: the frame and the size of the planes are fixed, and bits count. integers: activations, contexts and step
    # indices are rounded and cut as in the decoder, too.
    "rate": ("off", "on", "integers"),
    # noise: uniform noise stands for rounding. round: attributes and planes are rounded, with the same gradients.
    "quantisation": ("noise", "round"),
    # grid: the weights of all networks are rounded to grids.
    "weights": ("float", "grid"),
    # observe: gradients and opacities are noted. grow: anchors grow and are dropped, too.
    "growth": ("off", "observe", "grow"),
    "learning": ("on",),
    # on: each photograph has an affine colour of its own.
    "exposure": ("off", "on"),
    # half: photographs are of half their width and height, if enough pixels are left, and if points fill no hull.
    "size": ("full", "half"),
    # on: training ends with the mean of its steps from here on, and no anchor is removed.
    "averaging": ("off", "on"),
}


class Phase(Struct, frozen=True, forbid_unknown_fields=True):
    """A phase of training.

    name: its name in messages and tables. begin: the share of all steps after which it begins. modes: the modes of
    parts from then on; the other parts keep theirs. Growth and other work between two steps belongs to the phases on
    both sides.
    """

    name: str
    begin: float
    modes: Mapping[str, str]


PHASES = (
    Phase("start", 0.0, {"growth": "observe", "size": "half"}),
    Phase("growth", 0.03, {"growth": "grow"}),
    Phase("masks", 0.25, {"masks": "on"}),
    Phase("rate", 0.4, {"size": "full", "growth": "off", "rate": "on", "quantisation": "noise"}),
    Phase("rounding", 0.6, {"quantisation": "round"}),
    Phase("integers", 0.8, {"rate": "integers"}),
    Phase("weights", 0.85, {"weights": "grid"}),
    Phase("averaging", 0.9, {"averaging": "on"}),
)


# --- the whole --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TrainSettings:
    """The settings of training a scene from photographs, which `refcodec train --print-settings` prints."""

    steps: int = setting(5000, "steps of training, a photograph each", f"{OWN}; {PRO}: 40,000", unit="steps", low=1)
    seed: int = setting(0, "of all random numbers", low=0, high=2**63 - 1)
    size: str = setting(
        "400",
        "size that photographs are averaged down to: WxH, their longest side, or full for their own",
        unit="pixels",
    )
    background: str = setting(
        "auto",
        "what is behind the photographs: white, black or R,G,B; auto: white behind transparent ones; behind opaque "
        "ones a random colour in each step, so that none shines through, and in the file the points' mean colour",
        f"{OWN}; {GS}: black behind opaque ones",
        unit="0 to 255",
    )
    low_pass: float = setting(
        0.1,
        "added to both variances of a Gaussian in an image, which the file tells renderers; a training that continues "
        "from a scene keeps that scene's",
        f"{OWN}; {GS}: 0.3",
        unit="square pixels",
        low=0,
        high=1,
    )
    holdout: int = setting(
        8, "every N-th photograph by name is held out, 0 for none; a data set's own split comes before it", GS, low=0
    )
    static: bool = setting(
        False, "whether the scene is static: its Gaussians do not depend on the view, but their colours have harmonics"
    )
    degree: int = setting(
        CHOSEN, "degree of the harmonics of a static scene; -1: rate and distortion choose it", low=CHOSEN, high=3
    )
    start: StartSettings = StartSettings()
    loss: LossSettings = LossSettings()
    growth: GrowthSettings = GrowthSettings()
    masks: MaskSettings = MaskSettings()
    rate: RateSettings = RateSettings()
    sampling: SamplingSettings = SamplingSettings()
    # Twelve features instead of the paper's 50, which gain only in large files of some scenes (docs/method.md).
    entropy: EntropySettings = EntropySettings(slices=(2, 2, 4, 4))
    quantisation: QuantisationSettings = QuantisationSettings()
    weights: WeightSettings = WeightSettings()
    learning: LearningSettings = LearningSettings()
    looks: LookSettings = LookSettings()
    phases: tuple[Phase, ...] = PHASES

    def __post_init__(self) -> None:
        """Raises ValueError for phases that are not a schedule, and for empty ranges."""
        begins = [phase.begin for phase in self.phases]
        if begins != sorted(begins) or any(not 0 <= begin < 1 for begin in begins):
            raise ValueError(f"phases begin at {begins}: shares from 0 to less than 1 in ascending order are required")
        if len({phase.name for phase in self.phases}) < len(self.phases):
            raise ValueError("two phases have the same name")
        for phase in self.phases:
            for part, mode in phase.modes.items():
                if mode not in MODES.get(part, ()):
                    known = ", ".join(f"{name}: {' or '.join(modes)}" for name, modes in MODES.items())
                    raise ValueError(f"phases.{phase.name} has {part} = {mode!r}; parts and their modes are {known}")
        growth = rate = "off"
        for phase in self.phases:
            growth, rate = phase.modes.get("growth", growth), phase.modes.get("rate", rate)
            if rate != "off" and growth != "off":
                raise ValueError(f"phases.{phase.name} has growth = {growth!r}: anchors cannot change under a rate")
        features = sum(self.entropy.slices)
        if not COLOURS <= features <= FEATURES_MAX:
            raise ValueError(
                f"entropy.slices has {features} features, but must have {COLOURS}, which begin as an anchor's "
                f"colour, to {FEATURES_MAX}"
            )
        if self.static and not self.rate.lambda_r:
            raise ValueError("static is true, but an uncompressed scene (rate.lambda_r = 0) must be view-dependent")
        for name in ("rendering_bits", "coarser"):
            least, most = getattr(self.weights, name)
            if least > most:
                raise ValueError(f"weights.{name} is {least} to {most}: nothing is left to try")


@dataclass(frozen=True)
class FitSettings:
    """The settings of a fit of an entropy model to given anchors (SPEC B.5)."""

    steps: int = setting(4000, "steps of training, a batch of anchors each", unit="steps", low=0)
    seed: int = setting(0, "of all random numbers", low=0, high=2**63 - 1)
    lambda_r: float = setting(
        BASE_LAMBDA,
        f"weight of the rate, lambda_r: all base steps are those below times the root of it over {BASE_LAMBDA}, as the "
        "squared error of a step grows with its square",
        low=1e-6,
        high=1,
    )
    batch: int = setting(4096, "anchors of a step, drawn from all (USRO)", unit="anchors", low=1)
    plane_period: int = setting(
        4,
        "from one step that counts the planes' bits to the next (A-RDO), scaled up by as much",
        PRO,
        unit="steps",
        low=1,
    )
    plane_learning_rate: float = setting(
        0.01, "largest learning rate of the planes under the one-cycle schedule", low=0
    )
    network_learning_rate: float = setting(
        0.008, "largest learning rate of the networks under the one-cycle schedule", low=0
    )
    clip: float = setting(1.0, "largest norm of the networks' gradient, which is scaled down to it", low=0)
    rounding: float = setting(0.6, "share of the steps after which planes are rounded, not noisy", low=0, high=1)
    integers: float = setting(0.85, "share of the steps after which activations are integers", low=0, high=1)
    calibration: int = setting(8, "batches whose activations give the hidden units their integers' units", low=1)
    notes: int = setting(50, "entries of the history", low=1)
    save_seconds: float = setting(30.0, "from one saving of the state to the next", unit="seconds", low=0)
    entropy: EntropySettings = EntropySettings()
    # For points.
    quantisation: QuantisationSettings = QuantisationSettings()
    # For a scene with its rendering networks, which shows coarse steps that it was not trained with (own measurement,
    # in benchmarks/RESULTS.md, closed studies).
    scene: QuantisationSettings = QuantisationSettings(offsets=0.025)


# What differs in a training of a static scene, by own measurements (docs/method.md).
STATIC_CHANGES: dict[str, bool | float] = {
    "static": True,
    "masks.share": 0.9,
    "learning.opacity.start": 0.016,
    "learning.opacity.end": 0.001,
    "learning.covariance.start": 0.008,
}

# fast: minutes on two cores.
# paper: the paper's steps and features, Scaffold-GS's first voxels, photographs as large as 3DGS takes them.
PRESETS = {
    "fast": TrainSettings(),
    "paper": TrainSettings(
        steps=40000,
        size="1600",
        start=StartSettings(least=0, behind=1.0),
        growth=GrowthSettings(most=1 << 20, each=1 << 20, hull=1.0),
        entropy=EntropySettings(),
        learning=LearningSettings(cube=1.0),
    ),
}
