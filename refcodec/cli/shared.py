"""Common parts of the commands: files, progress, verdicts, and argument types."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
import os
import stat
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..bitstream.errors import BitstreamError
from ..files.looks import looks_like
from ..files.outputs import HELP, Kind, check_apart, check_file
from ..files.remote import RemoteFile, is_url
from ..files.terminal import ProgressStream, note
from ..files.text import shell_word
from ..resources import find
from ..statuses import UsageError

if TYPE_CHECKING:
    from ..bitstream.batches import Progress
    from ..bitstream.bounds import Bounds
    from ..bitstream.codec import Parsed
    from ..bitstream.header import Header
    from ..bitstream.reader import Opened
    from ..bitstream.scene import Scene
    from ..bitstream.source import Source
    from ..folder.uncompressed import Uncompressed
    from ..photographs.photographs import PhotographSet

# The largest file, in bytes, that is read regardless of its header.
_WHOLE_FILE_MAX = (1 << 32) - 1

# The packages of the extra `render`.
RENDER_PACKAGES = ("numba", "PIL", "skimage", "scipy")

# Help texts of several commands.
FILE = "a C3GS file: a path, or a URL with the extra `http`"
CODED_OR_PLAIN = "a C3GS file, or the folder of an uncompressed scene"
PHOTOGRAPHS = "a COLMAP or NeRF folder of photographs with cameras"

EXITS = """\
exit status:
  0   accepted, or done
  1   the file is rejected      } the last line on stderr is JSON:
  2   the file is not supported } code, name, offset, path, clause, requirement
  64  wrong usage, or a file or folder that cannot be read or written
  70  internal error
  71  out of memory; not a verdict on the file
"""


# --- files ------------------------------------------------------------------------------------------------------------


def read_file(path: str, check: Callable[[Header], None]) -> bytes:
    """Returns the bytes of a file.

    A URL, a file of 4 GiB or more, or an endless one is read only to one byte past the end that its header states. This
    suffices for the verdict on the whole file. check: called with the header before any later byte is read. Raises
    UsageError if the file cannot be read, and BitstreamError if the header of such a file is wrong.
    """
    from ..bitstream.header import read_header
    from ..bitstream.streaming import stated_bytes

    if is_url(path):
        with RemoteFile(path) as remote:
            header = read_header(remote)
            check(header)
            return remote.read(0, header.sections[-1].end + 1)
    try:
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            if stat.S_ISREG(status.st_mode) and status.st_size <= _WHOLE_FILE_MAX:
                return file.read()
            return stated_bytes(file, check)
    except OSError as error:
        raise _unreadable(path, error) from None


@contextlib.contextmanager
def open_source(path: str, check: Callable[[Header], None]) -> Iterator[Source]:
    """Yields a file or URL as a source that reads bytes on request.

    A path that is not a regular file, such as a pipe, is read as by read_file, with the same check. Raises UsageError
    if the file cannot be read, also within the block, and BitstreamError as read_file.
    """
    from ..bitstream.source import StoredFile, WholeFile
    from ..bitstream.streaming import stated_bytes

    with contextlib.ExitStack() as opened:
        if is_url(path):
            yield opened.enter_context(RemoteFile(path))
            return
        try:
            file = opened.enter_context(open(path, "rb"))
            regular = stat.S_ISREG(os.fstat(file.fileno()).st_mode)
            source: Source = StoredFile(file) if regular else WholeFile(stated_bytes(file, check))
        except OSError as error:
            raise _unreadable(path, error) from None
        yield _Checked(source, path)


class _Checked:
    """A source whose errors name the file as unreadable, which distinguishes them from errors of outputs."""

    def __init__(self, source: Source, path: str) -> None:
        self._source, self._path = source, path

    def read(self, start: int, size: int) -> bytes:
        """As Source.read."""
        try:
            return self._source.read(start, size)
        except OSError as error:
            raise _unreadable(self._path, error) from None

    def length(self) -> int:
        """As Source.length."""
        return self._source.length()


def _unreadable(path: str, error: OSError) -> UsageError:
    if isinstance(error, IsADirectoryError):
        return UsageError(
            f"cannot read {path}: it is a folder, not a C3GS file; encode a scene folder with refcodec encode"
        )
    return UsageError(f"cannot read {path}: {error.strerror or error}")


def check_scene_folder(path: Path) -> None:
    """Raises UsageError for the folder of a Scaffold-GS model in place of a scene folder."""
    from ..folder.layout import SCENE_FILE

    if (path / "point_cloud").is_dir() and not (path / SCENE_FILE).exists():
        raise UsageError(
            f"{path} is a model of another program, not a scene folder: convert it first with "
            f"refcodec convert {shell_word(str(path))} -o SCENE_DIR"
        )


def check_scene_output(
    path: Path,
    inputs: Iterable[str | Path | None],
    uncompressed: bool = False,
    others: Sequence[tuple[Path, Kind]] = (),
) -> None:
    """Raises UsageError if a scene must not be written to a folder. Called before any work.

    Args:
        path: the folder.
        inputs: files and folders that the run reads.
        uncompressed: whether the folder may hold an uncompressed scene.
        others: further outputs.
    """
    from ..folder.layout import is_free, scene_files

    if not is_free(path, uncompressed):
        raise UsageError(f"{path} exists and is not a scene folder: choose another folder, or empty it")
    for other, kind in others:
        check_file(other, kind, made=True)
    check_apart([*scene_files(path), *(other for other, _ in others)], inputs)


def uncompressed_of(path: str) -> Uncompressed | None:
    """Returns the uncompressed scene of a folder, or None for another path. Raises SceneFolderError."""
    from ..folder.uncompressed import is_uncompressed, read_uncompressed

    return read_uncompressed(Path(path)) if is_uncompressed(Path(path)) else None


def read_photographs_of(folder: str, size: str, background: str = "auto", holdout: int | None = None) -> PhotographSet:
    """Returns the photographs of a folder, by the values of --size, --background and --holdout.

    holdout: None for every eighth image. Raises UsageError.
    """
    from ..photographs.photographs import (
        TEST_EVERY,
        PhotographError,
        parse_background,
        parse_size,
        read_photographs,
    )

    try:
        colour, every = parse_background(background), TEST_EVERY if holdout is None else holdout
        return read_photographs(folder, parse_size(size), colour, holdout=every)
    except (PhotographError, ValueError) as error:
        raise UsageError(str(error)) from None


def encoded(
    arguments: argparse.Namespace,
    path: str,
    scene: Scene,
    positions: str | None = None,
    weights: str | None = None,
    smallest: bool = False,
) -> bytes:
    """Returns the encoded scene of a folder. positions, weights: as encoder.quantise.packed. Raises UsageError.

    smallest: whether encoder.constants.smallest chooses the form.
    """
    from ..bitstream.codec import emit
    from ..encoder.quantise import packed

    try:
        scene = packed(scene, positions, weights)
        if smallest:
            from ..encoder import constants

            scene = constants.smallest(scene, positions)
        with progress_bar(arguments.progress) as progress:
            return emit(scene, progress=progress)
    except ValueError as error:
        raise UsageError(f"{path} cannot be encoded: {error}") from None


# --- progress and verdicts --------------------------------------------------------------------------------------------


@contextlib.contextmanager
def progress_bar(wanted: bool) -> Iterator[Progress]:
    """Yields a function that shows progress on stderr: always if wanted, else on terminals for stages over a second.

    If chunks take over a second on a slower path than the processor allows, it prints the reason once.
    """
    shown = wanted or sys.stderr.isatty()
    bars: dict[str, Any] = {}
    begun: dict[str, float] = {}

    def show(stage: str, done: int, total: int) -> None:
        if stage == "chunks" and time.monotonic() - begun.setdefault(stage, time.monotonic()) > 1:
            if stage in bars:
                bars[stage].clear()
            _note_slower_path()
        if not shown:
            return
        from tqdm import tqdm

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
def _note_slower_path() -> None:
    from ..native.library import faster

    if reason := faster():
        note(f"refcodec: a slower path runs than the processor allows: {reason}")


def reject(path: str, error: BitstreamError) -> int:
    """Reports a verdict on stderr, as a line of text and a line of JSON. Returns the exit status."""
    word = "is not supported" if error.kind.klass == "unsupported" else "is rejected"
    sys.stdout.flush()
    # SPEC 6.1: the signature error has the first eight bytes, as hexadecimal text.
    kind = looks_like(bytes.fromhex(error.found[:23])) if error.kind.name == "prologue.signature" else None
    spot = f"To see the spot: refcodec inspect {shell_word(path)} --near {error.offset}"
    advice = f"It looks like {kind}" if kind else f"{_likely_cause(error.kind.name)} {spot}"
    note(f"{path} {word}: {error}. {advice}")
    note(error.to_json())
    return error.exit_status


def _likely_cause(name: str) -> str:
    """Returns the first sentence of the causes that `explain` prints for an error. name: of the error."""
    reasons = tomllib.loads(find("data/explanations.toml").read_text(encoding="utf-8"))
    return str(reasons[name]["how"].partition(". ")[0]).rstrip(".") + "."


def parse_file(arguments: argparse.Namespace, data: bytes, keep_going: bool = False) -> Parsed:
    """Decodes a file and shows progress. Raises BitstreamError."""
    from ..bitstream.codec import parse

    with progress_bar(arguments.progress) as progress:
        return parse(data, keep_going=keep_going, progress=progress)


def decoded(
    arguments: argparse.Namespace,
    source: Source,
    bounds: Bounds | None,
    use: Callable[[Scene], object] | None = None,
) -> Opened:
    """Decodes and checks a whole file in bounded memory, and shows progress.

    bounds: limits of the caller. use: called with the anchors in order, in pieces that are scenes. Raises
    BitstreamError and BoundPassedError.
    """
    from ..bitstream.reader import Reader
    from ..bitstream.streaming import pieces

    reader = Reader(source, bounds=bounds)
    with progress_bar(arguments.progress) as progress:
        opened = reader.open(progress=progress)
        for piece in pieces(opened, progress=progress):
            if use:
                use(piece)
    opened.close()
    return opened


def needs(command: str, extra: str, error: ModuleNotFoundError, packages: tuple[str, ...]) -> UsageError:
    """Returns an error that names the extra that a command needs.

    error: the failed import. It is raised again if the missing module is not one of the packages of the extra.
    """
    if (error.name or "").split(".")[0] not in packages:
        raise error
    return UsageError(f"{command} needs {error.name}: pip install 'refcodec[{extra}]'")


def note_compiling() -> None:
    """Reports on stderr if the rasteriser is compiled at each start. Needs the extra `render`."""
    from ..rendering.compiled import is_kept

    if not is_kept():
        note(
            "refcodec: compiled code cannot be stored, so compiling takes some seconds at each start: "
            "set NUMBA_CACHE_DIR to a writable folder"
        )


def counted(count: int, what: str) -> str:
    """Returns a number with a noun, such as 1 anchor and 2 anchors."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


# --- arguments --------------------------------------------------------------------------------------------------------


def whole(text: str) -> int:
    """Returns an integer of at least 0."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"must be at least 0, not {text}")
    return value


def positive(text: str) -> int:
    """Returns an integer of at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, not {text}")
    return value


def seed(text: str) -> int:
    """Returns an integer from 0 to 2^63 - 1, the range of all random generators."""
    value = int(text)
    if not 0 <= value < 1 << 63:
        raise argparse.ArgumentTypeError(f"must be from 0 to 2^63 - 1, not {text}")
    return value


def weight(text: str) -> float:
    """Returns a number from 0 to 1."""
    value = float(text)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"must be from 0 to 1, not {text}")
    return value


def length(text: str) -> float:
    """Returns a finite number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a number above 0, not {text}")
    return value


def rate(text: str) -> float:
    """Returns a rate, the lambda_r of the paper, above 0 and at most 1."""
    value = float(text)
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(f"must be above 0 and at most 1, not {text}")
    return value


def fit_rate(text: str) -> float:
    """Returns the lambda_r of a fit, from 10^-6 to 1."""
    value = float(text)
    if not 1e-6 <= value <= 1:
        raise argparse.ArgumentTypeError(f"must be from 0.000001 to 1, not {text}")
    return value


def quality(text: str) -> float:
    """Returns a PSNR in dB, from 20 to 70."""
    value = float(text)
    if not 20 <= value <= 70:
        raise argparse.ArgumentTypeError(f"must be from 20 to 70, not {text}")
    return value


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    text: str,
    examples: list[str],
    notes: str = "",
    writes: bool = False,
    parents: Sequence[argparse.ArgumentParser] = (),
) -> argparse.ArgumentParser:
    """Adds a command and returns its parser.

    run: returns the exit status. text: summary of the command. examples: without the program name. notes: further help.
    writes: whether the command has outputs. parents: parsers of common options. The help ends with the rules for
    outputs and the exit statuses.
    """
    epilog = (
        "examples:\n"
        + "".join(f"  refcodec {e}\n" for e in examples)
        + "\n"
        + (notes + "\n\n" if notes else "")
        + (HELP + "\n\n" if writes else "")
        + EXITS
    )
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=text,
        description=text[0].upper() + text[1:] + ".",
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        parents=parents,
    )
    parser.add_argument("--progress", action="store_true", help="show progress on stderr even if it is not a terminal")
    parser.set_defaults(run=run)
    return parser
