"""The code blocks of the manual, and how they are run.

A comment above each block of a shell, Python or JavaScript states how: CONTRIBUTING.md ("The manual") has the forms.
The blocks of a page are run in order, in one folder that has the project's files, as a reader would run them.
"""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LANGUAGES = ("sh", "python", "js")
# What a reader has at hand in the folder of the project.
_THERE = ("SPEC.md", "benchmarks", "conformance", "examples", "refcodec", "spec", "vectors")
# Training runs of some steps. The last of two equal options counts.
_TINY = {
    "train": "--steps 12 --size 48 --anchors 300",
    "convert": "--steps 12 --size 48 --anchors 300",
    "fit": "--steps 12",
}
_BLOCK = re.compile(
    r"(?:^<!-- (?P<mark>[^\n]*) -->\n)?^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE
)
_TIMEOUT = 300


@dataclass(frozen=True)
class Block:
    """A block of a page. mark: the comment above it, or empty. line: of its first line."""

    page: str
    line: int
    language: str
    mark: str
    text: str

    @property
    def runs(self) -> bool:
        """Whether the tests run it."""
        return self.mark == "run" or self.mark.startswith("run: ")

    @property
    def status(self) -> int:
        """The exit status that it must have."""
        stated = re.fullmatch(r"run: it exits with (\d+)", self.mark)
        return int(stated[1]) if stated else 0

    @property
    def needs(self) -> str | None:
        """The program or the package of Python that it needs."""
        stated = re.fullmatch(r"run: needs (\S+)", self.mark)
        return stated[1] if stated else None


def blocks(page: Path) -> list[Block]:
    """Returns the code blocks of a page."""
    text = page.read_text(encoding="utf-8")
    return [
        Block(
            page.name,
            text.count("\n", 0, block.start("text")) + 1,
            block["language"],
            block["mark"] or "",
            block["text"],
        )
        for block in _BLOCK.finditer(text)
        if block["language"] in LANGUAGES
    ]


def _is_there(name: str) -> bool:
    """Whether there is a program or a package of Python with this name."""
    return shutil.which(name) is not None or find_spec(name) is not None


def runnable(page: Path) -> list[Block]:
    """Returns the blocks of a page that are run, in order. Those of Python are one program, which is run at the end."""
    wanted = [block for block in blocks(page) if block.runs and (block.needs is None or _is_there(block.needs))]
    programs = [block for block in wanted if block.language == "python"]
    others = [block for block in wanted if block.language != "python"]
    if programs:
        others.append(replace(programs[0], text="\n".join(block.text for block in programs)))
    return others


class Desk:
    """A folder with the project's files, in which the blocks of a page are run."""

    def __init__(self, folder: Path) -> None:
        """folder: empty."""
        self._folder = folder / "project"
        programs = folder / "programs"
        for path in (self._folder, programs):
            path.mkdir()
        for name in _THERE:
            (self._folder / name).symlink_to(ROOT / name)
        for name in ("refcodec", "conformance"):
            self._program(programs / name, f'exec "{sys.executable}" -m {name} "$@"')
        self._program(programs / "python", f'exec "{sys.executable}" "$@"')
        # A training of the manual takes minutes.
        # A model in a folder is converted without a training, and so is a splat with --fast.
        short = '[ "$1" = convert ] && { [ -d "$2" ] || [ "$5" = --fast ]; }'
        cases = "".join(f'{command}) {short} || set -- "$@" {options} ;;\n' for command, options in _TINY.items())
        self._program(programs / "refcodec", f'case "$1" in\n{cases}esac\nexec "{sys.executable}" -m refcodec "$@"')
        self._environment = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}

    @staticmethod
    def _program(path: Path, text: str) -> None:
        path.write_text(f"#!/bin/sh\n{text}\n", encoding="utf-8")
        path.chmod(0o755)

    def run(self, block: Block) -> None:
        """Runs a block. Raises AssertionError if it does not end as its mark says."""
        if block.language == "sh":
            command = ["bash", "-euo", "pipefail", "-c", block.text]
        else:
            command = [sys.executable, "-c", block.text]
        done = subprocess.run(
            command,
            cwd=self._folder,
            env=self._environment,
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=_TIMEOUT,
            check=False,
        )
        report = f"{block.page}, line {block.line}:\n{block.text}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        assert done.returncode == block.status, report
