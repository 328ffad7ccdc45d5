"""Arguments and checks that several commands share."""

import argparse
import os
import shlex
from collections.abc import Sequence
from pathlib import Path

from ..manifest import MANIFEST, VECTORS, Manifest, ManifestError, load
from ..runner import process
from ..runner.run import wrong_hashes
from .errors import UsageError


def positive(text: str) -> int:
    """Returns an argument that is a positive integer. Raises ArgumentTypeError."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be at least 1")
    return value


def add_jobs(parser: argparse.ArgumentParser) -> None:
    """Adds the option for the number of processes."""
    parser.add_argument(
        "--jobs",
        type=positive,
        default=os.cpu_count() or 1,
        metavar="N",
        help="number of processes (default: one for each core)",
    )


def check_files(manifest: Manifest, text: str) -> None:
    """Raises ManifestError, with a text before the list, for files of the suite that differ from the manifest."""
    wrong = wrong_hashes(manifest)
    if wrong:
        raise ManifestError("\n".join([text, *wrong]))


def suite(folder: Path) -> Manifest:
    """Returns the manifest of a folder with absolute paths, after a check of all files. Raises ManifestError."""
    try:
        manifest = load(folder.absolute() / MANIFEST)
    except OSError as error:
        raise ManifestError(f"{error.filename}: {error.strerror}") from None
    check_files(manifest, "the suite is damaged, nothing was run:")
    return manifest


def check_template(command: Sequence[str], names: Sequence[str]) -> None:
    """Raises UsageError for a command without a placeholder, and CommandError for a missing program."""
    missing = [f"{{{name}}}" for name in names if not any(f"{{{name}}}" in word for word in command)]
    if not command or missing:
        raise UsageError(f"the command needs {' and '.join(missing)}: {shlex.join(command)}")
    process.check_command(command)


def add_vectors(parser: argparse.ArgumentParser) -> None:
    """Adds the option for the folder of the suite."""
    parser.add_argument(
        "--vectors",
        type=Path,
        default=VECTORS,
        metavar="DIR",
        help="folder of the suite (default: that of this program)",
    )
