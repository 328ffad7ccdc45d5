"""The bounds that a caller puts on the work of a file: --max-anchors and --max-memory."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import os
import re
import stat
from pathlib import Path

from ..bitstream.errors import BitstreamError
from .shared import UsageError, read_file

# What is estimated, in bytes, beside bitstream.bounds. The program with its packages; and a value of the scene, as a
# command holds it: in one copy, or in several.
PROGRAM, PROGRAM_DRAWING = 64 << 20, 192 << 20
HOLDING = {"validate": 8, "export": 600}
HOLDING_MOST = 20
# Bytes of symbols that stand for one value in the traces of inspect and reconstruct.
TRACE = 64

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30}


def memory(text: str) -> int:
    """Returns a number of bytes, at least 1. It may end with K, M or G, which are 2^10, 2^20 and 2^30."""
    found = re.fullmatch(r"([0-9]{1,18})([KMG]?)", text.upper())
    if found is None or not int(found[1]):
        raise argparse.ArgumentTypeError(f"{text} found, a number of bytes is required, such as 800M")
    return int(found[1]) * _UNITS[found[2]]


def anchors(text: str) -> int:
    """Returns a number of anchors, at least 0."""
    if not re.fullmatch(r"[0-9]{1,18}", text):
        raise argparse.ArgumentTypeError(f"{text} found, a number of anchors is required")
    return int(text)


def add_bounds(parser: argparse.ArgumentParser) -> None:
    """Adds the options to a command."""
    parser.add_argument(
        "--max-anchors", type=anchors, metavar="N", help="refuse more anchors, before any work (exit status 64)"
    )
    parser.add_argument(
        "--max-memory",
        type=memory,
        metavar="BYTES",
        help="refuse what may take more memory by the header, with K, M or G (exit status 64)",
    )


def estimated_memory(command: str, length: int, count: int, values: int, trace: bool = False, fixed: int = 0) -> int:
    """Returns how many bytes of memory a command may take, from one to two times what is measured.

    The measured peak is the largest resident memory of the process. Images of a renderer come on top.

    Args:
        command: its name.
        length: of the file, in bytes.
        count: N, the number of anchors.
        values: D + K, the attributes and the masks of an anchor.
        trace: whether every symbol is written.
        fixed: what networks and planes take.
    """
    from ..bitstream.batches import GROUP_ANCHORS
    from ..bitstream.bounds import DECODING

    held = HOLDING.get(command, HOLDING_MOST) + (TRACE if trace else 0)
    program = PROGRAM_DRAWING if command in ("render", "eval", "export") else PROGRAM
    return program + fixed + 2 * length + values * (min(count, GROUP_ANCHORS) * DECODING + count * held)


def check_bounds(
    arguments: argparse.Namespace, path: str, length: int, count: int = 0, values: int = 0, fixed: int = 0
) -> None:
    """Raises UsageError if the caller does not want the work.

    count, values, fixed: as for estimated_memory, 0 if unknown.
    """
    if arguments.max_anchors is not None and count > arguments.max_anchors:
        raise UsageError(f"{path} has {count} anchors, --max-anchors is {arguments.max_anchors}; this is no verdict")
    if arguments.max_memory is None:
        return
    command = arguments.run.__name__.removeprefix("_")
    needed = estimated_memory(command, length, count, values, bool(getattr(arguments, "trace", False)), fixed)
    if needed > arguments.max_memory:
        raise UsageError(
            f"{path} may take {needed} bytes of memory, --max-memory is {arguments.max_memory}; this is no verdict"
        )


def read_bounded(arguments: argparse.Namespace) -> bytes:
    """Returns the bytes of the command's file, unless its length or its header breaks the caller's bounds.

    Raises UsageError, and BitstreamError as read_file. A header that is not allowed is left to the decoder.
    """
    from ..bitstream.bounds import memory_needed
    from ..bitstream.codec import parse_container

    path = arguments.file
    if arguments.max_memory is not None:
        try:
            status = os.stat(path)
        except OSError as error:
            raise UsageError(f"cannot read {path}: {error.strerror or error}") from None
        if stat.S_ISREG(status.st_mode):
            check_bounds(arguments, path, status.st_size)
    data = read_file(path, lambda length: check_bounds(arguments, path, length))
    if arguments.max_anchors is None and arguments.max_memory is None:
        return data
    try:
        header = parse_container(data)
    except BitstreamError:
        return data
    d = header.dimensions
    values = d.attribute_width + d.offset_count
    check_bounds(arguments, path, len(data), header.anchor_count, values, memory_needed(header, 0))
    return data


def check_folder(arguments: argparse.Namespace, folder: Path) -> None:
    """Raises UsageError if the point cloud of a scene folder breaks the caller's bounds, by its header.

    What is wrong with the folder itself is left to its reader.
    """
    if arguments.max_anchors is None and arguments.max_memory is None:
        return
    from ..files.ply_header import PlyHeaderError, check_ply_header
    from ..folder.layout import PLY_FILE

    file = folder / PLY_FILE
    try:
        count, properties = check_ply_header(file)
    except (PlyHeaderError, OSError):
        return
    check_bounds(arguments, str(file), file.stat().st_size, count, properties)
