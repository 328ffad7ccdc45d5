"""Trials of the artefacts of a folder: their sums, and each decoder among them, unpacked, on some vectors.

What cannot run here is listed with the reason. `audit` has checked it when it was built.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Mapping
from pathlib import Path

from conformance.manifest import Accepted, Rejected, load
from conformance.runner.grading import read_output
from refcodec.files.terminal import say
from refcodec.statuses import DONE, REJECTED, UNSUPPORTED

from . import compiler, statements

_SECONDS = 600
# One vector in so many: all of them take long on a processor that is emulated.
_SAMPLE = 40


def run(folder: Path) -> int:
    """Tries the artefacts of a folder and prints what was found. Returns the number of faults."""
    faults = 0
    with tempfile.TemporaryDirectory() as name:
        vectors = unpacked(folder, "c3gs-vectors-*.tar.gz", Path(name))
        for place in (folder, vectors):
            wrong = wrong_sums(place)
            faults += len(wrong)
            say(f"{place.name}: {f'FAULT: wrong sums of {wrong}' if wrong else 'all sums are right'}")
        for artefact, (command, variables) in decoders(folder, Path(name)).items():
            if not command or not shutil.which(command[0]):
                say(f"{artefact}: not run here: {f'there is no {command[0]}' if command else 'another system'}")
                continue
            found = wrong_vectors(vectors, command, variables)
            faults += len(found)
            say(f"{artefact}: {f'FAULT: wrong about {found}' if found else 'right about the sample of vectors'}")
    say(f"== {faults} faults")
    return faults


def wrong_sums(folder: Path) -> list[str]:
    """Returns the files of a folder whose sum is missing or wrong, and those that are missing."""
    lines = (folder / statements.SUMS).read_text(encoding="utf-8").splitlines()
    listed = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != statements.SUMS]
    there = {path.relative_to(folder).as_posix(): statements.sha256(path) for path in files}
    return sorted(name for name in there.keys() | listed.keys() if there.get(name) != listed.get(name))


def decoders(folder: Path, room: Path) -> dict[str, tuple[list[str], Mapping[str, str]]]:
    """Returns the command of each decoder, before the words `FILE OUTPUT`, and its environment.

    The command is empty for another system. room: a folder, in which the artefacts are unpacked.
    """
    made: dict[str, tuple[list[str], Mapping[str, str]]] = {}
    for path in sorted(folder.glob("refcodec-*.whl")):
        native = sys.platform == "linux" and "manylinux" in path.name and os.uname().machine in path.name
        target = room / path.stem
        shutil.unpack_archive(path, target, "zip")
        variables = {"PYTHONPATH": str(target), "REFCODEC_PATH": "native" if native else "numpy"}
        command = [sys.executable, "-m", "refcodec", "reconstruct"] if native or "-any" in path.name else []
        made[path.name] = command, variables
    program = unpacked(folder, "c3gs-*.tgz", room) / "cli.js"
    made["module for browsers"] = ["node", str(program), "decode"], {}
    for name in compiler.STATIC:
        program = unpacked(folder, f"c3gs-decoder-*-linux-{name}.tar.gz", room) / "c3gs-decoder"
        emulator = [] if name == os.uname().machine else [f"qemu-{name}"]
        made[f"decoder for Linux {name}"] = [*emulator, str(program), "decode"], {}
    return made


def wrong_vectors(vectors: Path, command: list[str], variables: Mapping[str, str]) -> list[str]:
    """Returns the vectors of the sample about which a decoder is wrong, by their ids."""
    suite, wrong = load(vectors), []
    decoded = [vector for vector in suite.vectors if vector.operation == "decode" and vector.klass != "resource"]
    for vector in decoded[::_SAMPLE]:
        with tempfile.TemporaryDirectory() as name:
            words, output = [*command, str(suite.path(vector)), f"{name}/output"], Path(name, "output")
            environment = {**os.environ, **variables}
            done = subprocess.run(words, cwd=name, env=environment, capture_output=True, check=False, timeout=_SECONDS)
            wanted, right = vector.expectation, False
            if isinstance(wanted, Accepted) and done.returncode == DONE:
                with output.open("rb") as file:
                    right = read_output(file).digest == wanted.digest
            elif isinstance(wanted, Rejected):
                status = UNSUPPORTED if vector.klass == "unsupported" else REJECTED
                right = done.returncode == status and wanted.name in done.stderr.decode()
            wrong += [] if right else [vector.id]
    return wrong


def unpacked(folder: Path, pattern: str, room: Path) -> Path:
    """Returns the folder in an archive, unpacked."""
    (path,) = folder.glob(pattern)
    target = room / f"{path.name}-unpacked"
    with tarfile.open(path) as archive:
        archive.extractall(target, filter="data")
    (content,) = target.iterdir()
    return content
