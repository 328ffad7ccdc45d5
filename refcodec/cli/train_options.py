"""The options of train that concern the data set. demo and rd pass them to their training runs."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .shared import UsageError, length, positive, whole

if TYPE_CHECKING:
    from ..train.settings import TrainSettings

_RATE = "rate.lambda_r"
# The index of an axis is its number in SPEC 6.5.
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


def parser() -> argparse.ArgumentParser:
    """Returns a parser of these options, for the `parents` of a command parser."""
    options = argparse.ArgumentParser(add_help=False)
    options.add_argument(
        "--background",
        metavar="C",
        help="colour behind transparent photographs: white, black or R,G,B (default: white for NeRF folders, else "
        "black)",
    )
    options.add_argument(
        "--holdout",
        type=whole,
        metavar="N",
        help="hold out every N-th photograph, or none with 0, unless the data set has a split (default: 8)",
    )
    first = options.add_mutually_exclusive_group()
    first.add_argument(
        "--anchors", type=positive, metavar="N", help="approximate number of initial anchors (default: the preset's)"
    )
    first.add_argument(
        "--voxel", type=length, metavar="V", help="edge length of the voxels of the initial anchors, in world units"
    )
    options.add_argument(
        "--static",
        action="store_true",
        help="learn a static scene: its Gaussians do not depend on the view, and its colours have spherical harmonics",
    )
    options.add_argument(
        "--degree",
        type=int,
        choices=range(4),
        help="degree of the harmonics of a static scene (default: chosen by rate and distortion)",
    )
    options.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="change one setting; repeatable"
    )
    add_up(options)
    return options


def add_up(options: argparse.ArgumentParser, default: str = "derived from the cameras and the points") -> None:
    """Adds the option for the up axis of the scene."""
    options.add_argument("--up", choices=AXES, help=f"up axis of the scene, such as --up=+z (default: {default})")


def up_axis(arguments: argparse.Namespace) -> int | None:
    """SPEC 6.5: returns the axis number of --up, None if it was not given."""
    return None if arguments.up is None else AXES.index(arguments.up)


def words(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Returns the given options as arguments of train."""
    given = [
        ("--background", arguments.background),
        ("--holdout", arguments.holdout),
        ("--anchors", arguments.anchors),
        ("--voxel", arguments.voxel),
        ("--degree", arguments.degree),
        *(("--set", change) for change in arguments.set),
    ]
    # As an argument by itself, -y would be an option.
    up = () if arguments.up is None else (f"--up={arguments.up}",)
    static = ("--static",) if arguments.static else ()
    return (*static, *(word for name, value in given if value is not None for word in (name, str(value))), *up)


def settings(arguments: argparse.Namespace, base: TrainSettings, own: Mapping[str, Any]) -> TrainSettings:
    """Returns the settings of `base`, changed by --static, then by --set, and then by options for single settings.

    own: the values of further such options by the names of their settings, None if not given. Raises UsageError.
    """
    from ..train.settings import STATIC_CHANGES
    from ..train.settings_file import SettingsError, assigned, varied

    changes = {
        **own,
        "degree": arguments.degree,
        "background": arguments.background,
        "holdout": arguments.holdout,
        "start.anchors": arguments.anchors,
        # The voxel size then follows from the number of anchors.
        "start.voxel": 0.0 if arguments.anchors else arguments.voxel,
    }
    try:
        given = {name: value for name, value in changes.items() if value is not None}
        base = varied(base, STATIC_CHANGES) if arguments.static else base
        chosen = varied(assigned(base, arguments.set), given)
    except SettingsError as error:
        raise UsageError(str(error)) from None
    if arguments.degree is not None and not chosen.static:
        raise UsageError("--degree is that of a static scene: add --static")
    return chosen


def refuse_rate(arguments: argparse.Namespace, advice: str) -> None:
    """Raises UsageError if --set has the weight of the rate, for commands with their own rates. advice: the remedy."""
    if any(change.partition("=")[0].strip() == _RATE for change in arguments.set):
        raise UsageError(f"--set cannot change {_RATE}: {advice}")
