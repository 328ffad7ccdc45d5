"""The commands that look into a file: explain, inspect."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
import sys
from typing import TYPE_CHECKING, Any

from .. import statuses
from ..bitstream.errors import BitstreamError
from ..files.text import printable
from .bounds import add_bounds, read_bounded
from .shared import UsageError, add_command, parse_file, reject

if TYPE_CHECKING:
    from ..bitstream.codec import Parsed
    from ..bitstream.scene import Scene


def _spots(data: bytes, error: BitstreamError) -> list[BitstreamError]:
    """Returns an error, and those of the single chunks.

    The error of the file can be the CRC-32 of a section, which does not say where in the section the damage is.
    """
    from ..bitstream.codec import parse

    with contextlib.suppress(BitstreamError):
        chunks = parse(data, keep_going=True).damage
        return [error, *(found for found in chunks.values() if found.to_json() != error.to_json())]
    return [error]


def _show_anchor(scene: Scene, number: int) -> int:
    from ..inspect.anchor import anchor_rows

    try:
        for what, clause, values in anchor_rows(scene, number):
            print(f"{what:<45} {clause:<6} {values}")
    except IndexError:
        raise UsageError(f"there is no anchor {number}: the file has {scene.anchor_count}") from None
    return 0


def _inspect(arguments: argparse.Namespace) -> int:
    from ..inspect import dump, summary, trace

    data = read_bounded(arguments)
    if arguments.trace:
        trace.trace(data, sys.stdout.write)
        return 0
    if arguments.anchor is not None:
        return _show_anchor(parse_file(arguments, data).scene, arguments.anchor)
    error: BitstreamError | None = None
    try:
        verdict: Parsed | BitstreamError = parse_file(arguments, data)
    except BitstreamError as found:
        verdict = error = found
    if arguments.hex or arguments.near is not None:
        lines = dump.hex_lines(data, _spots(data, error) if error else [], arguments.near)
    elif arguments.json:
        lines = summary.json_lines(summary.document(data, verdict))
    else:
        lines = summary.summary(summary.document(data, verdict), printable(arguments.file))
    for line in lines:
        print(line)
    if arguments.near is not None:
        print(*dump.about_lines(data, arguments.near), sep="\n")
    return reject(arguments.file, error) if error else 0


def _explain(arguments: argparse.Namespace) -> int:
    from ..inspect.explain import UnknownKeyError, explain

    try:
        found = [list(explain(key)) for key in arguments.keys]
    except UnknownKeyError as error:
        raise UsageError(error.args[0]) from None
    print("\n\n".join("\n".join(lines) for lines in found))
    return statuses.DONE


def add(commands: Any) -> None:
    """Adds the commands of this module."""
    explain = add_command(
        commands,
        "explain",
        _explain,
        "explain an error, a requirement, a clause or an element, with its code, tests and vectors",
        ["explain 432", "explain R6.10-2", "explain 7.5.4", "explain 'chunk_table.entry[0].mask_length'"],
        "KEY is the code or name of an error, a requirement or a clause of SPEC.md, or the path of an element as\n"
        "inspect prints it.",
    )
    explain.add_argument("keys", nargs="+", metavar="KEY")
    inspect = add_command(
        commands,
        "inspect",
        _inspect,
        "show what a file is made of",
        [
            "inspect scene.c3gs",
            "inspect scene.c3gs --hex | less",
            "inspect scene.c3gs --near 1106",
            "inspect scene.c3gs --trace | head -100",
            "inspect scene.c3gs --anchor 7",
        ],
        "Damaged files are shown as far as they parse, and then rejected as by validate.",
    )
    inspect.add_argument("file", metavar="FILE")
    add_bounds(inspect)
    form = inspect.add_mutually_exclusive_group()
    form.add_argument(
        "--hex", action="store_true", help="every byte with its syntax element, and each payload folded to a line"
    )
    form.add_argument(
        "--near",
        type=int,
        metavar="OFFSET",
        help="the same for the elements around a byte, and what the one at the byte means",
    )
    form.add_argument("--json", action="store_true", help="the summary as one JSON document")
    form.add_argument(
        "--trace", action="store_true", help="a line for each syntax element and symbol, in decoding order"
    )
    form.add_argument(
        "--anchor",
        type=int,
        metavar="N",
        help="all numbers from the position of an anchor to its symbols, as in Annex D.4",
    )
