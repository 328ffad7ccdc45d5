"""The matrix: every encoder of the registry writes the given scenes, and every decoder decodes each of its files."""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from tqdm import tqdm

from refcodec.bitstream import codec
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.reconstruction import digest
from refcodec.files.documents import DocumentError, read_json
from refcodec.files.stage import write_file
from refcodec.statuses import UsageError

from ..runner import process
from ..runner.folder import Folder
from ..runner.grading import Found, read
from .implementations import Implementation

Matrix = dict[str, Any]
NAME = "matrix.json"
# The given scenes: the files of the repository that hold them, by the forms that they are given in. JSON: as in SPEC.md
# Annex D. A folder: that of `refcodec decode`. PLY: the Gaussians of a static scene, which an encoder quantises.
SCENES = {
    "json": (
        "vectors/tiny-example.c3gs",
        "vectors/tiny-packed.c3gs",
        "vectors/valid/static-degree-3.c3gs",
        "examples/scenes/caliterra.c3gs",
    ),
    "folder": (
        "vectors/tiny-example.c3gs",
        "vectors/tiny-packed.c3gs",
        "vectors/valid/static-degree-3.c3gs",
        "examples/scenes/caliterra.c3gs",
        "examples/scenes/snowmiku.c3gs",
    ),
    "ply": ("vectors/valid/static-degree-0.c3gs", "vectors/valid/static-degree-3.c3gs"),
}
# The bounds of a decoder for one file, and the seconds of an encoder.
_SECONDS, _MEMORY, _ENCODING = 120, 1 << 30, 600


def is_right(row: dict[str, Any]) -> bool:
    """Whether a file is canonical, and every decoder gives the scene that was meant, or the same one if none was."""
    found = set(row["found"].values())
    return row["canonical"] and len(found) == 1 and row["expected"] in (None, *found)


def load(folder: Path) -> Matrix:
    """Reads the matrix of a folder. It is empty if there is none. Raises UsageError or OSError."""
    try:
        found: Matrix = read_json(folder / NAME)
    except FileNotFoundError:
        return {"decoders": {}, "files": []}
    except DocumentError as error:
        raise UsageError(f"{folder / NAME}: {error}") from None
    return found


def expected(form: str, source: str) -> str | None:
    """Returns the digest of a given scene, and None if its form has other numbers than a file."""
    return None if form == "ply" else digest(codec.parse(Path(source).read_bytes()).scene)[0]


def check(matrix: Matrix) -> None:
    """Raises UsageError if a file of the matrix was meant to be another scene than the given one.

    Scenes that are not on this machine are not compared.
    """
    for row in matrix["files"]:
        if Path(row["scene"]).is_file() and row["expected"] != expected(row["form"], row["scene"]):
            raise UsageError(f"the matrix was edited: {row['scene']} has another digest than {row['expected']}")


def text(matrix: Matrix) -> str:
    """Returns the matrix as JSON, with a line for each file."""
    rows = ",\n".join(f"  {json.dumps(row)}" for row in matrix["files"])
    return f'{{\n "decoders": {json.dumps(matrix["decoders"])},\n "files": [\n{rows}\n ]\n}}\n'


def _is_ready(what: str, build: str | None, command: str, note: Callable[[str], None]) -> bool:
    """Builds a program, and returns whether it can be run."""
    try:
        if build:
            subprocess.run(build, shell=True, check=True, stdin=subprocess.DEVNULL)
        process.check_command(shlex.split(command))
    except (subprocess.CalledProcessError, process.CommandError) as error:
        note(f"{what} is left out: {error}")
        return False
    return True


def _given(form: str, source: str, folder: Path) -> Path:
    """Makes a given scene in a form. Returns its path."""
    stem = Path(source).stem
    if form == "json":
        place = folder / f"{stem}.json"
        command = [sys.executable, "-m", "spec.example", source]
        place.write_bytes(subprocess.run(command, check=True, capture_output=True).stdout)
        return place
    place = folder / (stem if form == "folder" else f"{stem}.ply")
    if not place.exists():
        option = "-o" if form == "folder" else "--splat"
        command = [sys.executable, "-m", "refcodec", "decode", source, option, str(place)]
        subprocess.run(command, check=True, capture_output=True)
    return place


def _encoded(command: str, scene: Path, file: Path) -> str:
    """Runs an encoder. Returns its fault, or an empty text."""
    words = process.fill(shlex.split(command), {"input": scene, "output": file})
    try:
        ended = subprocess.run(words, capture_output=True, check=False, timeout=_ENCODING, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return f"took more than {_ENCODING} s"
    if ended.returncode or not file.is_file():
        return f"exit status {ended.returncode}" if ended.returncode else "wrote no file"
    return ""


def _is_canonical(data: bytes) -> bool:
    try:
        return codec.emit(codec.parse(data).scene) == data
    except BitstreamError:
        return False


def _answer(found: Found) -> str:
    """Returns the digest that a decoder gives, or what it says instead."""
    if found.result == "accepted":
        return found.digest or ""
    return f"refused: {found.code}" if found.result == "rejected" else f"crashed: {found.text}"


def _decoded(command: str, file: Path) -> str:
    """Returns a decoder's answer to a file, within the runner's bounds."""
    with closing(Folder(file.read_bytes())) as folder:
        words = process.fill(shlex.split(command), {"input": folder.input, "output": folder.output})
        ended = process.Watcher().run(words, process.Bounds(_SECONDS, _MEMORY, folder, threading.Event()))
        return _answer(read(ended, folder.output))


def _key(row: dict[str, Any]) -> tuple[str, str, str]:
    return row["encoder"], row["form"], row["scene"]


class _State:
    """The state of a run that may be interrupted: a matrix that grows, and the encoders' files beside it."""

    def __init__(self, folder: Path, decoders: dict[str, str]) -> None:
        """folder: of the state. decoders: the version and the command of each, in one text."""
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        old = load(folder)
        same = {name for name, what in decoders.items() if old["decoders"].get(name) == what}
        self.old = {_key(row): row for row in old["files"]}
        for row in old["files"]:
            row["found"] = {name: said for name, said in row["found"].items() if name in same}
        self.matrix: Matrix = {"decoders": decoders, "files": []}

    def file(self, row: dict[str, Any]) -> Path:
        """The place of an encoder's file."""
        return self.folder / f"{row['encoder']}-{row['form']}-{Path(row['scene']).stem}.c3gs"

    def begin(self, row: dict[str, Any]) -> tuple[dict[str, Any], bool]:
        """Returns the row of a file, and whether an earlier run encoded it with the same encoder."""
        old = self.old.get(_key(row), {})
        file = self.file(row)
        same = {**old, **row} == old and file.is_file()
        kept = same and hashlib.sha256(file.read_bytes()).hexdigest() == old["sha256"]
        if not kept:
            file.unlink(missing_ok=True)
        self.matrix["files"].append(old if kept else row)
        return self.matrix["files"][-1], kept

    def save(self) -> None:
        """Writes the state. Rows of an earlier run that this one has not reached yet are kept."""
        reached = set(map(_key, self.matrix["files"]))
        rest = [row for key, row in self.old.items() if key not in reached]
        write_file(self.folder / NAME, text({**self.matrix, "files": [*self.matrix["files"], *rest]}).encode())


def _rows(encoders: list[Implementation], scenes: dict[str, tuple[str, ...]]) -> Iterator[dict[str, Any]]:
    for encoder in encoders:
        for form, sources in scenes.items():
            for source in sources if form in encoder.encoder else ():
                yield {
                    "encoder": encoder.key,
                    "version": encoder.version,
                    "command": encoder.encoder[form],
                    "form": form,
                    "scene": source,
                }


def run(
    implementations: list[Implementation],
    before: Matrix,
    folder: Path,
    note: Callable[[str], None],
    scenes: dict[str, tuple[str, ...]] = SCENES,
) -> Matrix:
    """Makes the matrix. An interrupted run is continued where it was.

    Programs that are not on this machine are left out. Their answers of before stay for files that did not change.

    Args:
        implementations: of the registry.
        before: the matrix of before.
        folder: of the state, which is removed at the end.
        note: tells of programs that are left out.
        scenes: the given scenes by form, as paths from the working folder.

    Raises:
        UsageError: a given scene is not there.
        OSError: a file cannot be read or written.
    """
    if missing := [path for sources in scenes.values() for path in sources if not Path(path).is_file()]:
        raise UsageError(f"{missing[0]} is not here: run this from the project's folder")
    encoders = [
        i for i in implementations
        if i.encoder and _is_ready(f"the encoder {i.key}", i.encoder.get("build"), _first(i.encoder), note)
    ]  # fmt: skip
    decoders = [
        i for i in implementations
        if i.decoder and _is_ready(f"the decoder {i.key}", i.decoder.get("build"), i.decoder["run"], note)
    ]  # fmt: skip
    state = _State(folder, _identities(decoders))
    rows = list(_rows(encoders, scenes))
    with (
        tqdm(total=len(rows) * (1 + len(decoders)), file=sys.stderr, disable=not sys.stderr.isatty()) as bar,
        tempfile.TemporaryDirectory() as given,
    ):
        for fresh in rows:
            row, kept = state.begin(fresh)
            file = state.file(row)
            bar.set_postfix_str(file.stem)
            if not kept:
                fault = _encoded(row["command"], _given(row["form"], row["scene"], Path(given)), file)
                data = b"" if fault else file.read_bytes()
                row |= {
                    "bytes": len(data),
                    "sha256": hashlib.sha256(data).hexdigest(),
                    "canonical": _is_canonical(data),
                    "expected": expected(row["form"], row["scene"]),
                    "fault": fault,
                    "found": {},
                }
            state.save()
            bar.update()
            for decoder in decoders:
                if decoder.key not in row["found"] and not row["fault"]:
                    row["found"][decoder.key] = _decoded(decoder.decoder["run"], file)
                    state.save()
                bar.update()
    matrix = _with_absent(state.matrix, before, implementations)
    shutil.rmtree(folder)
    return matrix


def _first(encoder: dict[str, str]) -> str:
    return next(command for form, command in encoder.items() if form != "build")


def _identities(decoders: Iterable[Implementation]) -> dict[str, str]:
    """Returns the version and the command of each decoder in one text: another text is another program."""
    return {d.key: f"{d.version}: {d.decoder['run']}" for d in decoders}


def _with_absent(matrix: Matrix, before: Matrix, implementations: list[Implementation]) -> Matrix:
    """Adds the answers of before of the programs that are not on this machine."""
    versions = _identities(i for i in implementations if i.decoder and i.key not in matrix["decoders"])
    absent = {name: what for name, what in before["decoders"].items() if versions.get(name) == what}
    by_file = {row["sha256"]: row for row in before["files"]}
    for row in matrix["files"]:
        old = by_file.get(row["sha256"], {"found": {}})["found"]
        row["found"] |= {name: said for name, said in old.items() if name in absent}
    here = {row["encoder"] for row in matrix["files"]}
    there = {i.key: i.version for i in implementations if i.encoder and i.key not in here}
    rest = [row for row in before["files"] if there.get(row["encoder"]) == row["version"]]
    return {"decoders": matrix["decoders"] | absent, "files": [*matrix["files"], *rest]}
