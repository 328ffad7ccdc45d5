"""Look into files."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from ..files.remote import is_url
from ..files.stage import write_file
from ..files.text import counted, printable
from ..statuses import UsageError
from . import kinds
from .command import ReadingWords, Report, command, only_one

if TYPE_CHECKING:
    from ..bitstream.bounds import Limits
    from ..bitstream.header import Header
    from ..bitstream.scene import Scene as CodedScene
    from ..bitstream.source import Source


@command()
def explain(*keys: kinds.Key) -> str:
    """Explain an error, requirement, clause, element, term or function of SPEC.md, with its code, tests and vectors.

    KEY is an error code or name, a requirement or clause of SPEC.md, the path of an element as inspect prints
    it, a part, section type or field of a file, or a term, function, constant or word of SPEC.md. Words that
    are no keys by themselves are looked up together.

    Args:
        keys: what to explain, such as 432 or 7.5.4.

    Examples:
        explain 432
        explain R6.10-2
        explain 7.5.4
        explain CARM
        explain 'index.entry[0].kept_count'
        explain camera length
    """
    from ..inspect.explain import explain

    return "\n".join(explain(*keys))


@command(writes=True)
def inspect(
    file: kinds.Place,
    *,
    decode: bool = False,
    hex: bool = False,
    near: kinds.Count | None = None,
    json: bool = False,
    trace: bool = False,
    anchor: kinds.Count | None = None,
    html: kinds.FilePath | None = None,
    write: kinds.Write | None = None,
    **words: Unpack[ReadingWords],
) -> Report:
    """Show the contents of a file.

    Without options nothing is decoded: only the header, the section tables and the chunk heads are read, and
    only an error in the header is reported. Damaged files are shown as far as they parse. With --decode, --hex,
    --near and --trace they are then rejected as by validate.

    --html decodes the file and, if it is accepted, writes a page that opens from disk and needs no network. The
    page shows the file to scale, the size of each part, the bits of each anchor over the scene, the bits of
    symbols beside their entropy, planes, and annotated bytes.

    Args:
        decode: also decode the file, for its verdict and its digest.
        hex: every byte with its syntax element; payloads take one line each.
        near: the same for the elements around a byte, with the meaning of the one at the byte.
        json: the summary as a JSON document.
        trace: a line for each syntax element and symbol, in decoding order.
        anchor: all numbers from the position of an anchor to its symbols.
        html: write a page with pictures of the contents.
        write: receives the lines of --trace as they are made. Without it, they are in the report.

    Examples:
        inspect scene.c3gs
        inspect scene.c3gs --decode
        inspect scene.c3gs --hex | less
        inspect scene.c3gs --near 1106
        inspect scene.c3gs --trace | head -100
        inspect scene.c3gs --anchor 7
        inspect scene.c3gs --html page.html

    Returns:
        A report whose `values` are the summary, and whose `error` is the verdict on a file that is shown, but rejected.

    Raises BitstreamError, BoundPassedError and OSError as `decode`.
    """
    from ..folder.places import COPIES, TRACE_COPIES, read_whole

    only_one(hex=hex, near=near, json=json, trace=trace, anchor=anchor, html=html)
    if html is not None:
        return _page(file, Path(html), words)
    if trace:
        from ..inspect.trace import trace as write_trace

        lines: list[str] = []
        write_trace(read_whole(file, words, COPIES + TRACE_COPIES), write or lines.append)
        return Report("".join(lines).splitlines())
    if anchor is not None:
        return Report([*_anchor_lines(_parsed(read_whole(file, words), words), anchor)])
    if hex or near is not None:
        return _bytes(read_whole(file, words), near, words)
    return _summary(file, decode, json, words)


def _parsed(data: bytes, words: ReadingWords) -> CodedScene:
    from ..bitstream.codec import parse
    from ..folder.places import progress_bar

    with progress_bar(words) as show:
        return parse(data, progress=show).scene


def _anchor_lines(scene: CodedScene, number: int) -> Iterator[str]:
    from ..inspect.anchor import anchor_rows

    if number >= scene.anchor_count:
        raise UsageError(f"there is no anchor {number}: the file has {counted(scene.anchor_count, 'anchor')}, from 0")
    for what, clause, values in anchor_rows(scene, number):
        yield f"{what:<45} {clause:<6} {values}"


def _summary(file: kinds.Place, decode: bool, json: bool, words: ReadingWords) -> Report:
    """Returns the facts about a file."""
    from ..bitstream.errors import BitstreamError
    from ..bitstream.header import read_header
    from ..bitstream.reconstruction import StreamDigest
    from ..bitstream.source import FileBytes
    from ..folder.places import decode_stream, reading, shown_name
    from ..inspect import summary

    name, error, verdict = shown_name(file), None, None
    with reading(file, words) as (source, left):
        try:
            if decode:
                digest = StreamDigest()
                verdict = digest.finish_parts(decode_stream(source, left, words, digest.add).scene([]))
            else:
                read_header(source)
        except BitstreamError as rejected:
            error = rejected
        # For a URL, each chunk head would be a separate request.
        facts = summary.document(FileBytes(source), error or verdict, heads=not is_url(name))
    # The chunks of a damaged file may be a million. Each is made when its line is printed.
    lines = summary.json_lines(facts) if json else summary.summary(facts, printable(name))
    return Report(lines, facts, error=error)


def _page(file: kinds.Place, path: Path, words: ReadingWords) -> Report:
    """Writes the page of an accepted file. The file is decoded a few chunks at a time."""
    from ..bitstream.header import read_header
    from ..bitstream.reconstruction import StreamDigest
    from ..bitstream.source import FileBytes, WholeFile
    from ..files.remote import RemoteFile
    from ..folder.places import check_outputs, decode_stream, reading, shown_name
    from ..inspect import summary
    from ..inspect.page.document import PAGE, page
    from ..inspect.page.measures import SceneMeasures

    check_outputs([file], (path, PAGE))
    with reading(file, words) as (stored, left):
        # The page reads bytes in many places. A URL is fetched once.
        header = read_header(stored)
        source: Source = stored
        if isinstance(stored, RemoteFile):
            size = header.sections[-1].end + 1
            left.check_memory(size)
            source = WholeFile(stored.read(0, size))
        digest, measures = StreamDigest(), SceneMeasures(header.dimensions, header.anchor_count)

        def add(scene: CodedScene) -> None:
            digest.add(scene)
            measures.add(scene)

        scene = decode_stream(source, left, words, add).scene([])
        measures.finish(scene)
        data = FileBytes(source)
        facts = summary.document(data, digest.finish_parts(scene))
        picture = _picture(source, header, left)
        document = page(data, Path(shown_name(file)).name, facts, measures, picture)
    write_file(path, document)
    return Report([f"{path}: {len(document):,} bytes"], facts)


def _picture(source: Source, header: Header, left: Limits) -> bytes | None:
    """Returns a small image of an accepted file as PNG, or None where it cannot be drawn, or not within the limits."""
    from ..bitstream.bounds import DRAWING, BoundPassedError
    from ..bitstream.codec import parse
    from ..folder.places import COPIES, SPLAT_COPIES
    from .scenes import DRAWN_ANCHORS, Scene, small_picture

    if header.anchor_count > DRAWN_ANCHORS:
        return None
    try:
        left.beside(DRAWING).check(header, copies=COPIES, gaussians=SPLAT_COPIES)
    except BoundPassedError:
        return None
    return small_picture(Scene(parse(source.read(0, source.length())).scene))


def _bytes(data: bytes, near: int | None, words: ReadingWords) -> Report:
    """Returns all elements, or those around a byte. The whole file is read, because an error may be anywhere."""
    from ..bitstream.errors import BitstreamError
    from ..inspect.dump import about_lines, hex_lines, spots

    error = None
    try:
        _parsed(data, words)
    except BitstreamError as rejected:
        error = rejected
    lines = hex_lines(data, spots(data, error) if error else [], near)
    return Report(lines if near is None else chain(lines, about_lines(data, near)), error=error)
