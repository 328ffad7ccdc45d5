"""Trials of the artefacts of a folder, each in an empty folder and by its own means, as far as this machine can.

What cannot run here is listed with the reason. `audit` has checked it when it was built.
"""

from __future__ import annotations

import importlib.util
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from conformance.runner.grading import read_output
from refcodec.files.terminal import say

from . import audit, compiler, statements, wheels

_SECONDS = 600
# One vector in so many: all of them take long on a processor that is emulated.
_SAMPLE = 40
Trial = tuple[str, Callable[[], str]]


class UntriedError(Exception):
    """An artefact that cannot be tried here. Its text says why."""


def run(folder: Path) -> int:
    """Tries the artefacts of a folder and prints what was found. Returns the number of faults."""
    faults = 0
    with tempfile.TemporaryDirectory() as name:
        for artefact, trial in _Room(folder, Path(name)).trials():
            begin = time.monotonic()
            try:
                say(f"{artefact}: {trial()}, {time.monotonic() - begin:.0f} s")
            except UntriedError as reason:
                say(f"{artefact}: not run here: {reason}")
            except (AssertionError, OSError, subprocess.SubprocessError) as error:
                faults += 1
                detail = str(getattr(error, "stderr", None) or error).strip()
                say(f"{artefact}: FAULT: {detail[-1000:]}", lines=True)
    say(f"== {faults} faults")
    return faults


class _Room:
    """The artefacts of a folder, and an empty folder."""

    def __init__(self, folder: Path, room: Path) -> None:
        self.folder, self.room = folder, room
        self.vectors = self._unpacked("c3gs-vectors-*.tar.gz")
        manifest = json.loads((self.vectors / "manifest.json").read_bytes())
        decoded = [v for v in manifest["vectors"] if v["operation"] == "decode" and v["class"] != "resource"]
        self.sample: list[dict[str, Any]] = decoded[::_SAMPLE]

    def trials(self) -> Iterator[Trial]:
        """Yields the name of each artefact, and what tries it and returns what it found. It raises AssertionError."""
        yield "sums", self._sums
        yield self.vectors.name, self._vectors
        for path in sorted(self.folder.glob("refcodec-*.whl")):
            yield path.name, lambda path=path: self._wheel(path)  # type: ignore[misc]
        (suite,) = self.folder.glob(f"{wheels.SUITE}-*.whl")
        yield suite.name, lambda: self._suite(suite)
        yield "module for browsers", self._module
        for processor in compiler.STATIC:
            yield f"decoder for Linux {processor}", lambda name=processor: self._decoder(name)  # type: ignore[misc]
        yield "c3gs.magic", self._magic
        yield "specification", self._specification
        yield "Containerfile", self._container

    def _sums(self) -> str:
        lines = (self.folder / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
        assert [line for line in lines if not _is(self.folder, line)] == []
        listed = {line.partition("  ")[2] for line in lines}
        there = {path.name for path in self.folder.iterdir() if not path.name.startswith(".")}
        assert there - listed == {"SHA256SUMS"}, there ^ listed
        return f"{len(lines)} artefacts"

    def _vectors(self) -> str:
        lines = (self.vectors / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
        assert [line for line in lines if not _is(self.vectors, line)] == []
        return f"{len(lines)} sums"

    def _wheel(self, path: Path) -> str:
        needs = ""
        if path.name.endswith("-any.whl"):
            code = "numpy"
        else:
            program = self._target(path, path.name) / wheels.KERNEL
            needs = f"{audit.facts(program.read_bytes())}; {_auditwheel(path)}; "
            if not ("manylinux" in path.name and "x86_64" in path.name and sys.platform == "linux"):
                raise UntriedError(f"another system. It is {needs.rstrip('; ')}")
            code = "native"
        target = self._target(path, path.name)
        count = self._compare(lambda file: [sys.executable, "-m", "refcodec", "digest", str(file)], target, code)
        return f"{needs}{count} vectors right by the path {code}"

    def _suite(self, path: Path) -> str:
        plain = next(self.folder.glob("refcodec-*-any.whl"))
        target = self._target(path, "suite", plain)
        decoder = (sys.executable, "-m", "refcodec", "reconstruct", "{input}", "{output}")
        command = [sys.executable, "-m", "conformance", "run", "--select", "requirement:R6.2-2", "--", *decoder]
        done = self._run(command, environment=_alone(target))
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.strip().splitlines()[0]

    def _module(self) -> str:
        if not shutil.which("node"):
            raise UntriedError("there is no node")
        package = self._unpacked("c3gs-*.tgz")
        target = self.room / "page" / "node_modules" / "c3gs"
        shutil.copytree(package, target)
        wanted = [v for v in self.sample if v["expectation"]["result"] == "accepted"]
        output = self.room / "page" / "output"
        for vector in wanted:
            file = self.vectors / vector["input"]["path"]
            self._run(["node", str(target / "cli.js"), "decode", str(file), str(output)], check=True)
            with output.open("rb") as file:
                assert read_output(file).digest == vector["expectation"]["digest"], vector["id"]
            output.unlink()
        code = "import('c3gs').then(m => console.log(Object.keys(m).length))"
        names = self._run(["node", "-e", code], folder=self.room / "page", check=True).stdout.strip()
        return f"import gives {names} names, {len(wanted)} vectors right in node"

    def _decoder(self, processor: str) -> str:
        program = self._unpacked(f"c3gs-decoder-*-linux-{processor}.tar.gz") / "c3gs-decoder"
        emulator = [] if processor == os.uname().machine else [shutil.which(f"qemu-{processor}") or ""]
        if emulator == [""]:
            raise UntriedError(f"there is no qemu-{processor}")
        count = self._compare(lambda file: [*emulator, str(program), "digest", str(file)])
        return f"{count} vectors right{' by qemu' if emulator else ''}"

    def _magic(self) -> str:
        if not shutil.which("file"):
            raise UntriedError("there is no file(1)")
        files = [str(self.vectors / name) for name in ("tiny-example.c3gs", "manifest.json")]
        command = ["file", "--brief", "-m", str(self.folder / "c3gs.magic"), *files]
        first, other = self._run(command, check=True).stdout.splitlines()
        assert first.startswith("C3GS scene of 3D Gaussians, version 0.0"), first
        assert not other.startswith("C3GS"), other
        return first

    def _specification(self) -> str:
        (page,) = self.folder.glob("c3gs-spec-*.html")
        text = page.read_text(encoding="utf-8")
        assert not re.search(r'(?:src|rel="stylesheet" href)="(?!data:)', text), "it needs other files"
        places = set(re.findall(r' id="([^"]+)"', text))
        assert set(re.findall(r'href="#([^"]+)"', text)) <= places, "a link leads nowhere"
        (pdf,) = self.folder.glob("c3gs-spec-*.pdf")
        assert pdf.read_bytes().startswith(b"%PDF-")
        return f"{len(places)} places, {len(re.findall('<img', text))} figures within"

    def _container(self) -> str:
        if importlib.util.find_spec("dockerfile_parse") is None:
            raise UntriedError("it is not built, and dockerfile-parse, which reads it, is not installed")
        from dockerfile_parse import DockerfileParser  # noqa: PLC0415

        text = (self.folder / "Containerfile").read_bytes()
        found = [step["instruction"] for step in DockerfileParser(fileobj=io.BytesIO(text)).structure]
        instructions = [name for name in found if name != "COMMENT"]
        assert instructions[0] == "FROM", instructions
        return f"not built; read: {' '.join(instructions)}"

    def _compare(self, command: Callable[[Path], list[str]], target: Path | None = None, path: str = "native") -> int:
        """Returns how many vectors of the sample a decoder was right about. command: of `digest` for a file."""
        for vector in self.sample:
            environment = {**_alone(target), "REFCODEC_PATH": path} if target else None
            done = self._run(command(self.vectors / vector["input"]["path"]), environment=environment)
            wanted = vector["expectation"]
            if wanted["result"] == "accepted":
                assert wanted["digest"] in done.stdout, f"{vector['id']}: {done.stdout}{done.stderr}"
            else:
                assert done.returncode == (2 if vector["class"] == "unsupported" else 1), vector["id"]
                assert wanted["name"] in done.stderr, f"{vector['id']}: {done.stderr}"
        return len(self.sample)

    def _target(self, path: Path, name: str, *others: Path) -> Path:
        """Returns a folder with wheels installed, without their requirements, whatever system they are for."""
        target = self.room / name
        if not target.exists():
            for wheel in (path, *others):
                shutil.unpack_archive(wheel, target, "zip")
        return target

    def _unpacked(self, pattern: str) -> Path:
        """Returns the folder in an archive."""
        (path,) = self.folder.glob(pattern)
        target = self.room / f"{path.name}-unpacked"
        with tarfile.open(path) as archive:
            archive.extractall(target, filter="data")
        (found,) = target.iterdir()
        return found

    def _run(
        self, command: Iterable[str], *, environment: Any = None, folder: Path | None = None, check: bool = False
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*command],
            cwd=folder or self.room,
            env=environment,
            capture_output=True,
            text=True,
            check=check,
            timeout=_SECONDS,
        )


def _is(folder: Path, line: str) -> bool:
    """Whether a file is what a line of sums says."""
    digest, _, name = line.partition("  ")
    return statements.sha256(folder / name) == digest


def _alone(target: Path) -> dict[str, str]:
    """Returns an environment in which Python finds the packages of a folder first."""
    return {**os.environ, "PYTHONPATH": str(target)}


def _auditwheel(path: Path) -> str:
    """Returns what auditwheel finds: the policies that a wheel for Linux keeps."""
    if "linux" not in path.name:
        return "auditwheel reads Linux only"
    if importlib.util.find_spec("auditwheel") is None:
        return "auditwheel is not installed"
    command = [sys.executable, "-m", "auditwheel", "show", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS)
    if done.returncode:
        # On a system with glibc it fails for musl, because libc.so is a text there.
        return f"auditwheel failed: {done.stderr.strip().splitlines()[-1]}"
    tag = re.search(r'platform tag:\s+"(\w+)"', done.stdout)
    return f"auditwheel: {tag[1] if tag else done.stdout}"
