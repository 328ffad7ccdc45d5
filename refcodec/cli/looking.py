"""The commands that look into a file: explain, inspect."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import statuses
from ..bitstream.errors import BitstreamError
from ..files.remote import is_url
from ..files.terminal import say
from ..files.text import printable
from .bounds import add_bounds, open_bounded, read_bounded, reader_bounds
from .shared import FILE, UsageError, add_command, counted, decoded, parse_file, reject

if TYPE_CHECKING:
    from ..bitstream.scene import Scene


def _spots(data: bytes, error: BitstreamError) -> list[BitstreamError]:
    """Returns an error, and those of the single chunks.

    The error of a file may be the CRC-32 of a section, which does not locate the damage.
    """
    from ..bitstream.codec import parse

    with contextlib.suppress(BitstreamError):
        chunks = parse(data, keep_going=True).damage
        return [error, *(damage for damage in chunks.values() if damage.to_json() != error.to_json())]
    return [error]


def _show_anchor(scene: Scene, number: int) -> int:
    from ..inspect.anchor import anchor_rows

    try:
        for what, clause, values in anchor_rows(scene, number):
            print(f"{what:<45} {clause:<6} {values}")
    except IndexError:
        raise UsageError(
            f"there is no anchor {number}: the file has {counted(scene.anchor_count, 'anchor')}, from 0"
        ) from None
    return 0


def _inspect(arguments: argparse.Namespace) -> int:
    if arguments.html is not None:
        return _inspect_page(arguments)
    if arguments.trace or arguments.hex or arguments.near is not None or arguments.anchor is not None:
        return _inspect_bytes(arguments)
    from ..bitstream.header import read_header
    from ..bitstream.reconstruction import StreamDigest
    from ..bitstream.source import FileBytes
    from ..inspect import summary

    error: BitstreamError | None = None
    verdict: summary.Verdict | None = None
    with open_bounded(arguments) as source:
        try:
            if arguments.decode:
                digest = StreamDigest()
                verdict = digest.finish_parts(
                    decoded(arguments, source, reader_bounds(arguments), digest.add).scene([])
                )
            else:
                read_header(source)
        except BitstreamError as rejected:
            error = rejected
        # For a URL, each chunk head would be a separate request.
        facts = summary.document(FileBytes(source), error or verdict, heads=not is_url(arguments.file))
    for line in summary.json_lines(facts) if arguments.json else summary.summary(facts, printable(arguments.file)):
        print(line)
    return reject(arguments.file, error) if error else 0


def _inspect_page(arguments: argparse.Namespace) -> int:
    """Writes the page of an accepted file. The file is decoded a few chunks at a time."""
    from ..bitstream.header import read_header
    from ..bitstream.reconstruction import StreamDigest
    from ..bitstream.source import FileBytes, WholeFile
    from ..files.outputs import check_apart, check_file
    from ..files.stage import write_file
    from ..inspect import summary
    from ..inspect.page.document import PAGE, page
    from ..inspect.page.measures import Measures

    path = Path(arguments.html)
    check_file(path, PAGE)
    check_apart([path], [arguments.file])
    # The page reads bytes in many places. A URL is fetched once.
    remote = is_url(arguments.file)
    with contextlib.nullcontext(WholeFile(read_bounded(arguments))) if remote else open_bounded(arguments) as source:
        header = read_header(source)
        digest, measures = StreamDigest(), Measures(header.dimensions, header.anchor_count)

        def add(scene: Scene) -> None:
            digest.add(scene)
            measures.add(scene)

        scene = decoded(arguments, source, reader_bounds(arguments), add).scene([])
        measures.finish(scene)
        data = FileBytes(source)
        facts = summary.document(data, digest.finish_parts(scene))
        document = page(data, Path(arguments.file).name, facts, measures)
    write_file(path, document)
    say(f"{path}: {len(document):,} bytes")
    return statuses.DONE


def _inspect_bytes(arguments: argparse.Namespace) -> int:
    """Shows elements or symbols. These may be anywhere in the file, so it is read and decoded as a whole."""
    from ..inspect import dump, trace

    data = read_bounded(arguments)
    if arguments.trace:
        trace.trace(data, sys.stdout.write)
        return 0
    if arguments.anchor is not None:
        return _show_anchor(parse_file(arguments, data).scene, arguments.anchor)
    error: BitstreamError | None = None
    try:
        parse_file(arguments, data)
    except BitstreamError as found:
        error = found
    for line in dump.hex_lines(data, _spots(data, error) if error else [], arguments.near):
        print(line)
    if arguments.near is not None:
        print(*dump.about_lines(data, arguments.near), sep="\n")
    return reject(arguments.file, error) if error else 0


def _explain(arguments: argparse.Namespace) -> int:
    from ..inspect.explain import explain

    print("\n".join(explain(*arguments.keys)))
    return statuses.DONE


def add(commands: Any) -> None:
    """Adds the commands of this module."""
    explain = add_command(
        commands,
        "explain",
        _explain,
        "explain an error, requirement, clause, element, term or function of SPEC.md, with its code, tests and vectors",
        [
            "explain 432",
            "explain R6.10-2",
            "explain 7.5.4",
            "explain CARM",
            "explain 'index.entry[0].kept_count'",
            "explain camera length",
        ],
        "KEY is an error code or name, a requirement or clause of SPEC.md, the path of an element as inspect prints\n"
        "it, a part, section type or field of a file, or a term, function, constant or word of SPEC.md. Words that\n"
        "are no keys by themselves are looked up together.",
    )
    explain.add_argument("keys", nargs="+", metavar="KEY", help="what to explain, such as 432 or 7.5.4")
    inspect = add_command(
        commands,
        "inspect",
        _inspect,
        "show the contents of a file",
        [
            "inspect scene.c3gs",
            "inspect scene.c3gs --decode",
            "inspect scene.c3gs --hex | less",
            "inspect scene.c3gs --near 1106",
            "inspect scene.c3gs --trace | head -100",
            "inspect scene.c3gs --anchor 7",
            "inspect scene.c3gs --html page.html",
        ],
        "Without options nothing is decoded: only the header, the section tables and the chunk heads are read, and\n"
        "only an error in the header is reported. Damaged files are shown as far as they parse. With --decode, --hex,\n"
        "--near and --trace they are then rejected as by validate.\n\n"
        "--html decodes the file and, if it is accepted, writes a page that opens from disk and needs no network. The\n"
        "page shows the file to scale, the size of each part beside that in the paper, the bits of each anchor over\n"
        "the scene, symbols compared with the predictions of their models, planes, masks, and annotated bytes.",
        writes=True,
    )
    inspect.add_argument("file", metavar="FILE", help=FILE)
    add_bounds(inspect)
    inspect.add_argument("--decode", action="store_true", help="also decode the file, for its verdict and its digest")
    form = inspect.add_mutually_exclusive_group()
    form.add_argument(
        "--hex", action="store_true", help="every byte with its syntax element; payloads take one line each"
    )
    form.add_argument(
        "--near",
        type=int,
        metavar="OFFSET",
        help="the same for the elements around a byte, with the meaning of the one at the byte",
    )
    form.add_argument("--json", action="store_true", help="the summary as a JSON document")
    form.add_argument(
        "--trace", action="store_true", help="a line for each syntax element and symbol, in decoding order"
    )
    form.add_argument(
        "--anchor",
        type=int,
        metavar="N",
        help="all numbers from the position of an anchor to its symbols",
    )
    form.add_argument("--html", metavar="PAGE", help="write a page with pictures of the contents")
