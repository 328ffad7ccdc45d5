"""The options of train that say what a training makes of a data set. demo and rd take them too, and pass them on."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .shared import UsageError, length, positive, whole

if TYPE_CHECKING:
    from ..train.settings import TrainSettings

_RATE = "rate.weight"
# Their places are the numbers of SPEC 6.5.
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


def parser() -> argparse.ArgumentParser:
    """Returns a parser of these options, for the `parents` of a command's."""
    options = argparse.ArgumentParser(add_help=False)
    options.add_argument(
        "--background",
        metavar="C",
        help="what transparent photographs are laid over: white, black or R,G,B (default: white for NeRF's format, "
        "else black)",
    )
    options.add_argument(
        "--holdout",
        type=whole,
        metavar="N",
        help="hold out every N-th photograph, or none with 0, unless the data set has a split (default: 8)",
    )
    first = options.add_mutually_exclusive_group()
    first.add_argument(
        "--anchors", type=positive, metavar="N", help="about how many anchors to begin with (default: the preset's)"
    )
    first.add_argument(
        "--voxel", type=length, metavar="V", help="edge of the voxels of the first anchors, in world units"
    )
    options.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[], help="change one setting; can be given again"
    )
    add_up(options)
    return options


def add_up(options: argparse.ArgumentParser, default: str = "what the cameras and the points say") -> None:
    """Adds the option that says what is up in the scene."""
    options.add_argument(
        "--up", choices=AXES, help=f"axis of the world that is up, such as --up=+z (default: {default})"
    )


def up_axis(arguments: argparse.Namespace) -> int | None:
    """SPEC 6.5: returns what --up says, None if it was not given."""
    return None if arguments.up is None else AXES.index(arguments.up)


def words(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Returns the options that were given, as train takes them."""
    given = [
        ("--background", arguments.background),
        ("--holdout", arguments.holdout),
        ("--anchors", arguments.anchors),
        ("--voxel", arguments.voxel),
        *(("--set", change) for change in arguments.set),
    ]
    # In words of its own, -y would be an option.
    up = () if arguments.up is None else (f"--up={arguments.up}",)
    return (*(word for name, value in given if value is not None for word in (name, str(value))), *up)


def settings(arguments: argparse.Namespace, base: TrainSettings, own: Mapping[str, Any]) -> TrainSettings:
    """Returns settings, changed by --set, and then by the options that have names of their own.

    base: without any change. own: the values of further such options by the names of their settings, None where one is
    not given. Raises UsageError.
    """
    from ..train.settings_file import SettingsError, assigned, varied

    changes = {
        **own,
        "background": arguments.background,
        "holdout": arguments.holdout,
        "start.anchors": arguments.anchors,
        # A number of anchors asks for an edge of its own.
        "start.voxel": 0.0 if arguments.anchors else arguments.voxel,
    }
    try:
        given = {name: value for name, value in changes.items() if value is not None}
        return varied(assigned(base, arguments.set), given)
    except SettingsError as error:
        raise UsageError(str(error)) from None


def refuse_rate(arguments: argparse.Namespace, advice: str) -> None:
    """Raises UsageError if --set has the weight of the rate, for a command that has rates of its own.

    advice: what to do instead.
    """
    if any(change.partition("=")[0].strip() == _RATE for change in arguments.set):
        raise UsageError(f"--set cannot change {_RATE}: {advice}")
