"""What several commands need: arguments, and the suite."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path

from ..manifest import MANIFEST, VECTORS, Manifest, ManifestError, load
from ..runner import process
from ..runner.run import wrong_hashes
from .errors import UsageError


def positive(text: str) -> int:
    """An argument that is an integer of at least 1. Raises ArgumentTypeError."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


def check_files(manifest: Manifest, text: str) -> None:
    """Raises ManifestError, with a text before the list, for files of the suite that have other bytes."""
    wrong = wrong_hashes(manifest)
    if wrong:
        raise ManifestError("\n".join([text, *wrong]))


def suite(folder: Path) -> Manifest:
    """The manifest of a folder whose files are all there and right, with whole paths. Raises ManifestError."""
    try:
        manifest = load(folder.absolute() / MANIFEST)
    except OSError as error:
        raise ManifestError(f"{error.filename}: {error.strerror}") from None
    check_files(manifest, "the suite is damaged, nothing was run:")
    return manifest


def check_template(command: Sequence[str], names: Sequence[str]) -> None:
    """Raises UsageError for a command without one of the places, and CommandError for a program that is not there."""
    missing = [f"{{{name}}}" for name in names if not any(f"{{{name}}}" in word for word in command)]
    if not command or missing:
        raise UsageError(f"the command needs {' and '.join(missing)}: {shlex.join(command)}")
    process.check_command(command)


def add_vectors(parser: argparse.ArgumentParser) -> None:
    """The option for the folder of the suite."""
    parser.add_argument(
        "--vectors",
        type=Path,
        default=VECTORS,
        metavar="DIR",
        help="folder of the suite (default: the one that came with this program)",
    )
