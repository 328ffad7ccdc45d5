"""The matrix: every encoder of the registry writes the given scenes, and every decoder decodes each of its files."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from msgspec import Struct, to_builtins
from tqdm import tqdm

from refcodec.bitstream import codec
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reconstruction import digest
from refcodec.files.documents import DocumentError, checked, read_json
from refcodec.statuses import UsageError

from ..runner import process
from ..runner.folder import Folder
from ..runner.grading import read
from .implementations import Implementation

NAME = "matrix.json"
_TINY = ("vectors/tiny-example.c3gs", "vectors/tiny-packed.c3gs", "vectors/valid/static-degree-3.c3gs")
# The given scenes: the files of the repository that hold them, by the forms that they are given in. JSON: as in SPEC.md
# Annex D. A folder: that of `refcodec decode`. PLY: the Gaussians of a static scene, which an encoder quantises.
SCENES: dict[str, tuple[str, ...]] = {
    "json": (*_TINY, "examples/scenes/caliterra.c3gs"),
    "folder": (*_TINY, "examples/scenes/caliterra.c3gs", "examples/scenes/snowmiku.c3gs"),
    "ply": ("vectors/valid/static-degree-0.c3gs", "vectors/valid/static-degree-3.c3gs"),
}
# The bounds of a decoder for one file, and the seconds of an encoder.
_SECONDS, _MEMORY, _ENCODING = 120, 1 << 30, 600


class Row(Struct, frozen=True, forbid_unknown_fields=True):
    """A file of an encoder, from a scene in a form. expected: the digest that was meant, None if the form has none.

    fault: of the encoder, or "". digests: the answers of the decoders by name.
    """

    encoder: str
    form: str
    scene: str
    bytes: int
    canonical: bool
    expected: str | None
    fault: str
    digests: dict[str, str]

    @property
    def digest(self) -> str:
        """The digest that was meant, or the one that most decoders give, or ""."""
        given = sorted(filter(_is_digest, self.digests.values()))
        return self.expected or max(given, key=given.count, default="")

    @property
    def right(self) -> bool:
        """Whether the file is canonical, and every decoder gives the scene that was meant, or the same if none was."""
        return self.canonical and self.digest != "" and {*self.digests.values()} == {self.digest}


Matrix = list[Row]


def _is_digest(text: str) -> bool:
    return re.fullmatch("[0-9a-f]{64}", text) is not None


def load(folder: Path) -> Matrix:
    """Reads the matrix of a folder. It is empty if there is none.

    Raises OSError, and UsageError if a file was meant to be another scene than the given one, if that is here.
    """
    try:
        matrix: Matrix = checked(read_json(folder / NAME), Matrix)
    except FileNotFoundError:
        return []
    except DocumentError as error:
        raise UsageError(f"{folder / NAME}: {error}") from None
    for row in matrix:
        if Path(row.scene).is_file() and row.expected != expected(row.form, row.scene):
            raise UsageError(f"the matrix was edited: {row.scene} has another digest than {row.expected}")
    return matrix


def expected(form: str, source: str) -> str | None:
    """Returns the digest of a given scene, and None if its form has other numbers than a file."""
    return None if form == "ply" else digest(codec.parse(Path(source).read_bytes()).scene)[0]


def text(matrix: Matrix) -> str:
    """Returns the matrix as JSON, with a line for each file."""
    return "[\n" + ",\n".join(json.dumps(to_builtins(row)) for row in matrix) + "\n]\n"


def _given(form: str, source: str, place: Path) -> None:
    """Makes a given scene in a form."""
    words = ["refcodec", "decode", source, "-o" if form == "folder" else "--splat", str(place)]
    command = [sys.executable, "-m", *(["spec.example", source] if form == "json" else words)]
    made = subprocess.run(command, check=True, capture_output=True).stdout
    if form == "json":
        place.write_bytes(made)


def _encoded(command: str, scene: Path, file: Path) -> tuple[bytes, str]:
    """Runs an encoder. Returns its file and no fault, or no file and its fault."""
    words = process.fill(shlex.split(command), {"input": scene, "output": file})
    try:
        subprocess.run(words, capture_output=True, check=True, timeout=_ENCODING, stdin=subprocess.DEVNULL)
        return file.read_bytes(), ""
    except (OSError, subprocess.SubprocessError) as error:
        return b"", type(error).__name__


def _is_canonical(data: bytes) -> bool:
    try:
        return codec.emit(codec.parse(data).scene) == data
    except BitstreamError:
        return False


def _decoded(command: str, data: bytes) -> str:
    """Returns the digest that a decoder gives within the runner's bounds, or what it answers instead."""
    with closing(Folder(data)) as folder:
        words = process.fill(shlex.split(command), {"input": folder.input, "output": folder.output})
        ended = process.Watcher().run(words, process.Bounds(_SECONDS, _MEMORY, folder, threading.Event()))
        answer = read(ended, folder.output)
    refusal = f"refused: {answer.code}" if answer.result == "rejected" else f"crashed: {answer.text}"
    return answer.digest or "" if answer.result == "accepted" else refusal


def _is_here(key: str, command: str, note: Callable[[str], None]) -> bool:
    try:
        process.check_command(shlex.split(command))
        return True
    except process.CommandError as error:
        note(f"{key} is left out: {error}")
        return False


def run(
    known: list[Implementation], note: Callable[[str], None], scenes: dict[str, tuple[str, ...]] = SCENES
) -> Matrix:
    """Makes the matrix of the programs that are on this machine.

    note: is called with a line on each that is not. scenes: by form, as paths from the working folder. Raises
    UsageError for a given scene that is not there, and OSError.
    """
    if missing := [path for sources in scenes.values() for path in sources if not Path(path).is_file()]:
        raise UsageError(f"{missing[0]} is not here: run this from the project's folder")
    decoders = {i.key: i.decoder.run for i in known if i.decoder and _is_here(i.key, i.decoder.run, note)}
    tasks = [
        (i.key, form, source, command)
        for i in known for form, command in i.encoder.items() if form in scenes and _is_here(i.key, command, note)
        for source in scenes[form]
    ]  # fmt: skip
    rows = []
    for key, form, source, command in tqdm(tasks, unit="file", disable=None):
        with tempfile.TemporaryDirectory() as folder:
            scene = Path(folder, f"scene.{form}")
            _given(form, source, scene)
            data, fault = _encoded(command, scene, Path(folder, "file.c3gs"))
        digests = {} if fault else {name: _decoded(own, data) for name, own in decoders.items()}
        canonical, meant = _is_canonical(data), expected(form, source)
        rows.append(Row(key, form, source, len(data), canonical, meant, fault, digests))
    return rows
