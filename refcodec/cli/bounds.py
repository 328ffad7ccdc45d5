"""The bounds of a caller on a file: --max-anchors, --max-work and --max-memory."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..bitstream.errors import BitstreamError
from ..files.remote import MEMORY_MAX, is_url
from .shared import UsageError, open_source, read_file

if TYPE_CHECKING:
    from ..bitstream.bounds import BoundPassedError, Bounds
    from ..bitstream.header import Header
    from ..bitstream.source import Source

# Estimated bytes of the program with its packages, in addition to bitstream.bounds.
PROGRAM, PROGRAM_DRAWING, PROGRAM_TORCH = 64 << 20, 192 << 20, 320 << 20
# Commands that decode a few chunks at a time, and hold neither the file nor the scene, except with these options.
STREAMING = ("validate", "digest", "decode", "inspect")
HOLDING_OPTIONS = ("trace", "hex", "near", "anchor")
# The copies of a scene that other commands hold, and the further ones for a text of the symbols.
COPIES, TRACE_COPIES = 3, 8
# The copies for export, which holds the Gaussians of many views and their harmonics.
EXPORT_COPIES = 75

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30}
_NO_VERDICT = "this is not a verdict on the file"


def memory(text: str) -> int:
    """Returns a number of bytes, at least 1. The suffixes K, M and G stand for 2^10, 2^20 and 2^30."""
    match = re.fullmatch(r"([0-9]{1,18})([KMG]?)", text.upper())
    if match is None or not int(match[1]):
        raise argparse.ArgumentTypeError(f"must be a number of bytes such as 800M, not {text}")
    return int(match[1]) * _UNITS[match[2]]


def number(text: str) -> int:
    """Returns a number of anchors or of units of work, at least 0."""
    if not re.fullmatch(r"[0-9]{1,18}", text):
        raise argparse.ArgumentTypeError(f"must be an integer of at least 0, not {text}")
    return int(text)


def add_bounds(parser: argparse.ArgumentParser, *, decodes: bool = True) -> None:
    """Adds the options to a command. decodes: whether it decodes a file, whose header states the work."""
    parser.add_argument(
        "--max-anchors", type=number, metavar="N", help="refuse more anchors before any work (exit status 64)"
    )
    if decodes:
        parser.add_argument(
            "--max-work",
            type=number,
            metavar="UNITS",
            help="refuse a file that may take more units of work (SPEC.md 13.1) by its header (exit status 64)",
        )
    parser.add_argument(
        "--max-memory",
        type=memory,
        metavar="BYTES",
        help="refuse a file that may take more memory by its tables; K, M and G are allowed (exit status 64; default: "
        "4G for a URL)",
    )


def held_copies(arguments: argparse.Namespace) -> int:
    """Returns the number of copies of a scene that a command holds, 0 if it holds none."""
    options = vars(arguments)
    asked = [name for name in HOLDING_OPTIONS if options.get(name) not in (None, False)]
    if _command(arguments) in STREAMING and not asked:
        return 0
    if _command(arguments) == "export":
        return EXPORT_COPIES
    return COPIES + (TRACE_COPIES if "trace" in asked else 0)


def _command(arguments: argparse.Namespace) -> str:
    return str(arguments.run.__name__.removeprefix("_"))


def check_bounds(arguments: argparse.Namespace, path: str, count: int, needed: int, work: int = 0) -> None:
    """Raises UsageError if a bound of the caller is exceeded.

    count: N, or 0 if unknown. needed: bytes of memory, without the program and the images of a renderer. work: units of
    bitstream.bounds.all_work, or 0 if nothing is decoded.
    """
    most = vars(arguments).get("max_work")
    if most is not None and work > most:
        raise UsageError(f"{path} may take {work} units of work, but --max-work allows {most}; {_NO_VERDICT}")
    if arguments.max_anchors is not None and count > arguments.max_anchors:
        raise UsageError(f"{path} has {count} anchors, but --max-anchors allows {arguments.max_anchors}; {_NO_VERDICT}")
    most = _most_memory(arguments)
    needed += _program(arguments)
    if most is not None and needed > most:
        raise _too_much(arguments, path, needed)


def _program(arguments: argparse.Namespace) -> int:
    if vars(arguments).get("scaffold"):
        return PROGRAM_TORCH
    return PROGRAM_DRAWING if _command(arguments) in ("render", "eval", "export") else PROGRAM


def _most_memory(arguments: argparse.Namespace) -> int | None:
    """Returns the bytes that the caller allows. A URL always has a bound."""
    if arguments.max_memory is None and is_url(vars(arguments).get("file") or ""):
        return MEMORY_MAX
    most: int | None = arguments.max_memory
    return most


def _too_much(arguments: argparse.Namespace, path: str, needed: int) -> UsageError:
    most = _most_memory(arguments)
    default = " by default for a URL" if arguments.max_memory is None else ""
    return UsageError(
        f"{path} may take {needed} bytes of memory, but --max-memory allows {most}{default}; {_NO_VERDICT}"
    )


def reader_bounds(arguments: argparse.Namespace) -> Bounds | None:
    """Returns the bounds for a reader of the command's file, which it checks against the index, or None."""
    from ..bitstream.bounds import Bounds

    most = _most_memory(arguments)
    return None if most is None else Bounds(memory=most - _program(arguments))


def passed(arguments: argparse.Namespace, error: BoundPassedError) -> UsageError:
    """Returns the error for an exceeded bound of reader_bounds."""
    return _too_much(arguments, arguments.file, error.needed + _program(arguments))


def needed_memory(header: Header, copies: int, file: bool = False) -> int:
    """Returns an estimate of the memory for a file in bytes, without the program: one to two times the measured use.

    copies: of the scene, as by held_copies. file: whether the file is held, as it always is with a copy of the scene.
    """
    from ..bitstream.batches import GROUP_ANCHORS
    from ..bitstream.bounds import READING, memory_needed, section_bytes

    count, length = header.anchor_count, header.sections[-1].end
    # If the scene is held, any part of the file may be decoded at once.
    more = (1 + READING) * length if copies else section_bytes(header, True) + file * length
    return memory_needed(header, min(count, GROUP_ANCHORS), copies * count, more)


def _check_header(arguments: argparse.Namespace, header: Header, file: bool) -> None:
    from ..bitstream.bounds import all_work

    needed = needed_memory(header, held_copies(arguments), file)
    check_bounds(arguments, arguments.file, header.anchor_count, needed, all_work(header))


def _check_source(arguments: argparse.Namespace, source: Source, file: bool) -> None:
    """Raises UsageError if the header of a file exceeds the bounds of the caller. file: as for needed_memory.

    An invalid header is left to the decoder.
    """
    from ..bitstream.header import read_header

    if (arguments.max_anchors, arguments.max_work, _most_memory(arguments)) == (None, None, None):
        return
    with contextlib.suppress(BitstreamError):
        _check_header(arguments, read_header(source), file)


def read_bounded(arguments: argparse.Namespace) -> bytes:
    """Returns the bytes of the command's file.

    Raises UsageError if its length or its header exceeds the bounds of the caller, and BitstreamError as read_file.
    """
    from ..bitstream.source import WholeFile

    path = arguments.file
    if arguments.max_memory is not None and not is_url(path):
        try:
            status = os.stat(path)
        except OSError as error:
            raise UsageError(f"cannot read {path}: {error.strerror or error}") from None
        if stat.S_ISREG(status.st_mode):
            check_bounds(arguments, path, 0, status.st_size)
    data = read_file(path, lambda header: _check_header(arguments, header, True))
    _check_source(arguments, WholeFile(data), True)
    return data


@contextlib.contextmanager
def open_bounded(arguments: argparse.Namespace) -> Iterator[Source]:
    """Yields the command's file as open_source. Raises UsageError if its header exceeds the bounds of the caller."""
    with open_source(arguments.file, lambda header: _check_header(arguments, header, True)) as source:
        _check_source(arguments, source, False)
        yield source


def check_folder(arguments: argparse.Namespace, folder: Path) -> None:
    """Raises UsageError if the point cloud of a scene folder exceeds the bounds of the caller, by its header.

    Faults of the folder itself are left to its reader.
    """
    if arguments.max_anchors is None and arguments.max_memory is None:
        return
    from ..bitstream.batches import GROUP_ANCHORS
    from ..bitstream.bounds import DECODING, HOLDING
    from ..files.ply import PlyError, check_ply_header
    from ..folder.layout import PLY_FILE

    file = folder / PLY_FILE
    try:
        count, properties = check_ply_header(file)
    except (PlyError, OSError):
        return
    each = min(count, GROUP_ANCHORS) * DECODING + COPIES * count * HOLDING
    check_bounds(arguments, str(file), count, properties * each + 2 * file.stat().st_size)
