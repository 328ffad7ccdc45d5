"""Clause 11: profiles and levels."""

from __future__ import annotations

from dataclasses import dataclass

from .dimensions import Dimensions

TINY, MAIN = 0, 1
Bounds = tuple[int, int]


@dataclass(frozen=True)
class Level:
    """SPEC 11.2: the largest number of anchors and the largest plane size of a level."""

    anchors: int
    plane_size: int


@dataclass(frozen=True)
class Profile:
    """SPEC 11.1: the bounds of each dimension, both ends included.

    Bounds such as slice_count are those of the length of a list. Bounds such as slice_width are those of its items.
    levels: by number.
    """

    name: str
    offset_count: Bounds
    slice_count: Bounds
    slice_width: Bounds
    plane_channels: Bounds
    frequency_count: Bounds
    plane_size: Bounds
    hyper_layers: Bounds
    hyper_width: Bounds
    sarm_layers: Bounds
    sarm_width: Bounds
    carm_layers: Bounds
    carm_width: Bounds
    render_width: Bounds
    chunk_size: Bounds
    levels: dict[int, Level]


# SPEC 11.1 and 11.2.
PROFILES = {
    TINY: Profile(
        name="Tiny",
        offset_count=(1, 10),
        slice_count=(1, 4),
        slice_width=(1, 16),
        plane_channels=(1, 8),
        frequency_count=(1, 10),
        plane_size=(2, 32),
        hyper_layers=(1, 2),
        hyper_width=(1, 64),
        sarm_layers=(1, 2),
        sarm_width=(1, 16),
        carm_layers=(0, 2),
        carm_width=(1, 64),
        render_width=(1, 64),
        chunk_size=(1, 65536),
        levels={0: Level(4096, 32)},
    ),
    MAIN: Profile(
        name="Main",
        offset_count=(10, 10),
        slice_count=(4, 4),
        slice_width=(5, 20),
        plane_channels=(8, 8),
        frequency_count=(10, 10),
        plane_size=(2, 256),
        hyper_layers=(1, 1),
        hyper_width=(16, 128),
        sarm_layers=(2, 2),
        sarm_width=(16, 16),
        carm_layers=(1, 1),
        carm_width=(16, 128),
        render_width=(50, 50),
        chunk_size=(256, 65536),
        levels={1: Level(1 << 17, 128), 2: Level(1 << 20, 256), 3: Level(1 << 24, 256)},
    ),
}
# SPEC 11.1: the slices of Main, in order.
MAIN_SLICES = (5, 10, 15, 20)


def dimension_fault(profile: Profile, d: Dimensions) -> tuple[str, object, str] | None:
    """SPEC 11.1: returns the first dimension outside the profile, or None.

    It is given as (field of the Dimensions table, found, allowed).
    """

    def outside(field: str, value: int, bounds: Bounds) -> tuple[str, object, str] | None:
        if bounds[0] <= value <= bounds[1]:
            return None
        return field, value, f"in {profile.name} {bounds[0]} to {bounds[1]}"

    checks = [
        ("offset_count", d.offset_count, profile.offset_count),
        ("slice_count", len(d.slices), profile.slice_count),
        *((f"slice_width[{i}]", w, profile.slice_width) for i, w in enumerate(d.slices)),
        ("plane_channels", d.plane_channels, profile.plane_channels),
        ("frequency_count", d.frequency_count, profile.frequency_count),
        ("plane_size", d.plane_size, profile.plane_size),
        ("hyper_layers", len(d.hyper_width), profile.hyper_layers),
        *((f"hyper_width[{i}]", w, profile.hyper_width) for i, w in enumerate(d.hyper_width)),
        ("sarm_layers", len(d.sarm_width), profile.sarm_layers),
        *((f"sarm_width[{i}]", w, profile.sarm_width) for i, w in enumerate(d.sarm_width)),
        ("carm_layers", len(d.carm_width), profile.carm_layers),
        *((f"carm_width[{i}]", w, profile.carm_width) for i, w in enumerate(d.carm_width)),
        ("render_width", d.render_width, profile.render_width),
    ]
    for field, value, bounds in checks:
        fault = outside(field, value, bounds)
        if fault:
            return fault
    # SPEC 11.1: without a second slice there is no network of CARM, and so no hidden layer.
    if (len(d.slices) == 1) != (len(d.carm_width) == 0):
        return "carm_layers", len(d.carm_width), "0 exactly if there is one slice"
    if profile is PROFILES[MAIN] and d.slices != MAIN_SLICES:
        return "slice_width[0]", d.slices, f"in Main {MAIN_SLICES}"
    return None


def minimal_level(profile: Profile, anchors: int, plane_size: int) -> int | None:
    """SPEC 11.2: returns the lowest level that holds a scene, or None if no level does."""
    for number, level in sorted(profile.levels.items()):
        if anchors <= level.anchors and plane_size <= level.plane_size:
            return number
    return None
