"""What commands read, within limits, what they write, after checks, and their progress on stderr.

`words` are those of a command: `limits` states what a file may use, and `progress` whether progress is shown even where
stderr is not a terminal.
"""

import builtins
import contextlib
import os
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, cast

from ..bitstream.batches import GROUP_ANCHORS, Progress
from ..bitstream.bounds import Limits
from ..bitstream.errors import BitstreamError
from ..bitstream.header import SIGNATURE, read_header
from ..bitstream.reader import Opened, Reader
from ..bitstream.scene import Scene as CodedScene
from ..bitstream.source import Place, Source, StoredFile, StrPath, WholeFile
from ..bitstream.streaming import pieces, stated_bytes
from ..files.lock import errors_of
from ..files.outputs import Kind, check_apart, check_file
from ..files.ply import PlyError, check_ply_header
from ..files.remote import RemoteFile, is_url
from ..files.terminal import ProgressStream, note
from ..native.library import faster
from ..statuses import UsageError
from .layout import PLY_FILE, is_free, scene_files

Words = Mapping[str, Any]

# The copies of a scene that an operation holds unless it states another number, and those for a text of its symbols.
COPIES, TRACE_COPIES = 3, 8
# Those of the Gaussians of a static scene that is drawn or written to a splat file (own measurement: 2 to 6.3).
SPLAT_COPIES = 7
# The largest file, in bytes, that is read regardless of its header.
_WHOLE_FILE_MAX = (1 << 32) - 1
C3GS = Kind.signed("a C3GS file", SIGNATURE)


class _Named:
    """A file object whose errors have its name."""

    def __init__(self, file: Any, name: str) -> None:
        self._file, self._name = file, name

    def read(self, size: int, /) -> bytes:
        """Returns bytes as the file object does. Raises OSError."""
        with errors_of(Path(self._name)):
            return cast(bytes, self._file.read(size))

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Moves the file object. Raises OSError."""
        with errors_of(Path(self._name)):
            return cast(int, self._file.seek(offset, whence))


def shown_name(place: object) -> str:
    """Returns the name of a file, a folder or a scene in messages."""
    if isinstance(place, str | os.PathLike):
        return os.fspath(place)
    return "the scene" if hasattr(place, "coded") else str(getattr(place, "name", "the file"))


def limits_of(words: Words) -> Limits:
    """Returns the limits of a command. Raises UsageError for anything else in their place."""
    limits = words.get("limits")
    if not isinstance(limits, Limits | None):
        raise UsageError(f"limits must be refcodec.Limits, not {limits!r}")
    return limits or Limits()


@contextlib.contextmanager
def opened_source(place: Place, limits: Limits | None = None) -> Iterator[tuple[Source, Limits]]:
    """Yields the bytes of a file, on request where possible, and the limits for them.

    A pipe is read at once, to one byte past the end that its header states, which suffices for the verdict on it. The
    header is checked against the limits first.

    Raises:
        BitstreamError: the header of a pipe is rejected.
        BoundPassedError: a pipe exceeds the limits.
        OSError: the file cannot be read.
        UsageError: the URL cannot be read, or the limits are none.
        TypeError: the place is none of these, or a file object in text mode.
    """
    limits = limits_of({"limits": limits})
    at_url = isinstance(place, str | os.PathLike) and is_url(os.fspath(place))
    with contextlib.ExitStack() as opened:
        if not (at_url or isinstance(place, bytes | bytearray | memoryview)):
            file, seekable = _file_object(place, opened)
            if seekable:
                yield StoredFile(file), limits
                return
            held = stated_bytes(file, lambda header: limits.check(header, size=header.sections[-1].end))
            yield WholeFile(held), limits.beside(len(held))
        elif isinstance(place, bytes | bytearray | memoryview):
            yield WholeFile(bytes(place)), limits
        else:
            yield opened.enter_context(RemoteFile(os.fspath(cast(StrPath, place)))), limits.of_url()


def _file_object(place: Any, opened: contextlib.ExitStack) -> tuple[_Named, bool]:
    """Returns the file object of a path, or a given one, and whether it can be read at any offset.

    opened: closes it, if it is that of a path. Raises OSError, and TypeError for anything but these in binary mode.
    """
    file, seekable = place, None
    if isinstance(place, str | os.PathLike):
        if os.path.isdir(place):
            problem = "it is a folder, not a C3GS file; encode a scene folder with refcodec encode"
            raise IsADirectoryError(21, problem, os.fspath(place))
        try:
            file = opened.enter_context(builtins.open(place, "rb"))  # noqa: SIM115
        except ValueError as error:
            raise UsageError(f"{os.fspath(place)!r} is not a path: {error}") from None
        # Some devices are seekable, but have no length.
        seekable = stat.S_ISREG(os.fstat(file.fileno()).st_mode)
    elif not hasattr(place, "read") or not isinstance(place.read(0), bytes):
        kind = type(place).__name__
        raise TypeError(f"a path, a URL, bytes or a file object in binary mode is required, {kind} found")
    elif stated := getattr(place, "seekable", None):
        seekable = stated()
    return _Named(file, shown_name(place)), bool(seekable)


@contextlib.contextmanager
def reading(
    place: Place, words: Words, copies: int = 0, program: int = 0, gaussians: int = 0
) -> Iterator[tuple[Source, Limits]]:
    """Yields as opened_source. Raises BoundPassedError if the header exceeds the limits.

    copies, gaussians: of the scene, and of a static scene's Gaussians, that the caller holds. program: the bytes of its
    further packages. An invalid header is left to the decoder.
    """
    with opened_source(place, limits_of(words).beside(program)) as (source, left):
        with contextlib.suppress(BitstreamError):
            left.check(read_header(source), copies=copies, gaussians=gaussians)
        yield source, left


def read_whole(place: Place, words: Words, copies: int = COPIES, program: int = 0, gaussians: int = 0) -> bytes:
    """Returns the bytes of a file: all, or to one byte past the end that the header of a long file or a URL states.

    Raises BitstreamError if the header of such a file is wrong, and as reading.
    """
    with reading(place, words, copies, program, gaussians) as (source, left):
        size = _WHOLE_FILE_MAX + 1 if isinstance(source, RemoteFile) else source.length()
        if size > _WHOLE_FILE_MAX:
            size = read_header(source).sections[-1].end + 1
        left.check_memory(size)
        return source.read(0, size)


def decode_stream(
    source: Source, limits: Limits, words: Words, use: Callable[[CodedScene], object] | None = None
) -> Opened:
    """Decodes and checks a whole file in bounded memory, and shows progress.

    use: called with the anchors in order, in pieces that are scenes. Raises BitstreamError and BoundPassedError.
    """
    reader = Reader(source, at_once=GROUP_ANCHORS, limits=limits)
    with progress_bar(words) as show:
        opened = reader.open(progress=show)
        for piece in pieces(opened, progress=show):
            if use:
                use(piece)
    opened.close()
    return opened


def check_cloud(folder: Path, words: Words, program: int = 0) -> None:
    """Raises BoundPassedError if the point cloud of a scene folder exceeds the limits by its header.

    Faults of the folder itself are left to its reader.
    """
    file = folder / PLY_FILE
    with contextlib.suppress(PlyError, OSError):
        limits_of(words).beside(program).check_cloud(*check_ply_header(file), file.stat().st_size, COPIES)


def check_outputs(
    reads: Iterable[object],
    *files: tuple[StrPath | None, Kind | None],
    scene: StrPath | None = None,
    uncompressed: bool = False,
    made: bool = False,
) -> None:
    """Raises UsageError if an output must not be written.

    Args:
        reads: the files and folders that the command reads. Anything but a path is passed over.
        files: the files that it writes, with their kinds. None stands for an output that is not wanted, and for the
            kind of one that is checked elsewhere.
        scene: the scene folder that it writes.
        uncompressed: whether that folder may hold an uncompressed scene.
        made: whether the command makes missing folders.
    """
    if scene is not None and Path(scene).suffix.lower() == ".c3gs":
        raise UsageError(f"{scene} is the name of a file, but a scene folder is written: choose another name")
    if scene is not None and not is_free(Path(scene), uncompressed):
        raise UsageError(f"{scene} exists and is not a scene folder: choose another folder, or empty it")
    folder = [] if scene is None else scene_files(Path(scene))
    wanted = [(Path(path), kind) for path, kind in files if path is not None]
    for path, kind in wanted:
        if kind is not None:
            check_file(path, kind, made or scene is not None)
    read = [path for path in reads if isinstance(path, str | os.PathLike)]
    check_apart([*folder, *(path for path, _ in wanted)], map(Path, read))


@contextlib.contextmanager
def progress_bar(words: Words) -> Iterator[Progress]:
    """Yields a function that shows progress on stderr: if it is wanted, or on a terminal for stages over a second.

    If chunks take over a second on a slower path than the processor allows, it prints the reason once.
    """
    wanted = bool(words.get("progress"))
    shown = wanted or sys.stderr.isatty()
    bars: dict[str, Any] = {}
    begun: dict[str, float] = {}

    def show(stage: str, done: int, total: int) -> None:
        if stage == "chunks" and time.monotonic() - begun.setdefault(stage, time.monotonic()) > 1:
            if stage in bars:
                bars[stage].clear()
            note_slower_path()
        if not shown:
            return
        from tqdm import tqdm  # noqa: PLC0415 (only here)

        if stage not in bars:
            for finished in bars.values():
                finished.close()
            bars[stage] = tqdm(total=total, desc=stage, file=ProgressStream(), delay=0 if wanted else 1, leave=wanted)
        bars[stage].update(done - bars[stage].n)

    try:
        yield show
    finally:
        for bar in bars.values():
            bar.close()


@cache
def note_slower_path() -> None:
    """Reports once that a slower path decodes than the processor allows."""
    if reason := faster():
        note(f"refcodec: a slower path runs than the processor allows: {reason}")
