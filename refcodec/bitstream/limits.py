"""Clause 11: profiles and levels."""

from dataclasses import dataclass

from .dimensions import RENDER_MODELS, Dimensions, dimension_fields, work

TINY, MAIN = 0, 1
Bounds = tuple[int, int]


@dataclass(frozen=True)
class Level:
    """SPEC 11.2: the largest number of anchors, the largest plane size and the most work of a level."""

    anchors: int
    plane_size: int
    work: int

    def holds(self, d: Dimensions, anchors: int) -> bool:
        """Returns whether the level allows the plane size, the number of anchors and their work."""
        return anchors <= self.anchors and d.plane_size <= self.plane_size and work(d, anchors) <= self.work


@dataclass(frozen=True)
class Profile:
    """SPEC 11.1: the bounds of each dimension, both ends included.

    Bounds such as slice_count apply to the length of a list, and bounds such as slice_width to its items. Those of
    plane_size and sarm_layers apply to scenes with planes; without planes both are 0.
    levels: by number.
    """

    name: str
    offset_count: Bounds
    plane_channels: Bounds
    frequency_count: Bounds
    slice_count: Bounds
    hyper_layers: Bounds
    sarm_layers: Bounds
    carm_layers: Bounds
    view_inputs: Bounds
    colour_outputs: Bounds
    plane_size: Bounds
    render_width: Bounds
    hyper_width: Bounds
    sarm_width: Bounds
    carm_width: Bounds
    slice_width: Bounds
    chunk_size: Bounds
    levels: dict[int, Level]


# SPEC 11.1: the bounds in Tiny and in Main.
_BOUNDS: dict[str, tuple[Bounds, Bounds]] = {
    "offset_count": ((1, 10), (1, 16)),
    "plane_channels": ((0, 8), (0, 16)),
    "frequency_count": ((0, 10), (0, 16)),
    "slice_count": ((1, 4), (1, 16)),
    "hyper_layers": ((0, 2), (0, 2)),
    "sarm_layers": ((1, 2), (1, 2)),
    "carm_layers": ((0, 2), (0, 2)),
    "view_inputs": ((0, 8), (0, 8)),
    "colour_outputs": ((1, 48), (1, 48)),
    "plane_size": ((2, 32), (2, 1024)),
    "render_width": ((1, 64), (1, 128)),
    "hyper_width": ((1, 64), (1, 128)),
    "sarm_width": ((1, 16), (1, 32)),
    "carm_width": ((1, 64), (1, 128)),
    "slice_width": ((1, 16), (1, 64)),
    "chunk_size": ((1, 65536), (256, 16384)),
}
# SPEC 11.2: numbers of Main leave room between each two.
_LEVELS = {
    TINY: {0: Level(4096, 32, 1 << 28)},
    MAIN: {
        10: Level(1 << 17, 128, 1 << 33),
        20: Level(1 << 20, 256, 1 << 36),
        30: Level(1 << 22, 256, 1 << 38),
        40: Level(1 << 24, 512, 1 << 41),
        50: Level(1 << 26, 1024, 1 << 43),
    },
}
PROFILES = {
    number: Profile(name=name, levels=_LEVELS[number], **{field: bounds[number] for field, bounds in _BOUNDS.items()})
    for number, name in ((TINY, "Tiny"), (MAIN, "Main"))
}
# SPEC 11.1: the most feature channels of an anchor.
FEATURES_MAX = 128


def dimension_fault(profile: Profile, d: Dimensions, render_model: int) -> tuple[str, object, str] | None:
    """SPEC [R11.1-2]: returns the first dimension outside the profile or the render model, or None.

    The result is (field of the Dimensions table, found, allowed).
    """
    # SPEC 11.1: these two may also be 0, without planes, which is checked below.
    optional = ("plane_size", "sarm_layers")
    fields = dimension_fields(d)
    # The fields of Profile are in the order of 5.3.
    for field in (name for name in vars(profile) if name in fields):
        low, high = getattr(profile, field)
        listed = isinstance(fields[field], tuple | list)
        for i, value in enumerate(fields[field] if listed else [fields[field]]):
            if not (low <= value <= high or (value == 0 and field in optional)):
                return f"{field}[{i}]" if listed else field, value, f"in {profile.name} {low} to {high}"
    if d.features > FEATURES_MAX:
        return "slice_width", d.features, f"a sum of at most {FEATURES_MAX}"
    planes = d.plane_channels > 0
    for field, value in (("plane_size", d.plane_size), ("sarm_layers", len(d.sarm_width))):
        if (value > 0) != planes:
            return field, value, "0 exactly if plane_channels is 0"
    # SPEC 11.1: F_h then has no inputs. With one slice there is no network of CARM.
    if d.hyper_width and not d.has_frame:
        return "hyper_layers", len(d.hyper_width), "0 if plane_channels and frequency_count are 0"
    if d.carm_width and len(d.slices) == 1:
        return "carm_layers", len(d.carm_width), "0 if slice_count is 1"
    # SPEC 6.5: of other render models, a decoder knows nothing.
    if render_model in RENDER_MODELS:
        inputs, outputs = RENDER_MODELS[render_model]
        if d.view_inputs != inputs:
            return "view_inputs", d.view_inputs, f"{inputs} if render_model is {render_model}"
        if d.colour_outputs not in outputs:
            allowed = " or ".join(map(str, outputs))
            return "colour_outputs", d.colour_outputs, f"{allowed} if render_model is {render_model}"
    return None


def minimal_level(profile: Profile, anchors: int, d: Dimensions) -> int | None:
    """SPEC 11.2: returns the lowest level that holds a scene, or None if no level does."""
    return next((number for number, level in sorted(profile.levels.items()) if level.holds(d, anchors)), None)
