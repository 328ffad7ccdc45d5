"""Builds all artefacts of a release from the commit of this clone, into one folder. Nothing is published.

python -m release             builds what is missing in out/release
python -m release --check     builds them in two new clones, compares all bytes, and tries the artefacts
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from refcodec.files.terminal import note, say
from refcodec.statuses import DONE, REJECTED, USAGE, UsageError

from . import compiler, document, packages, source, statements, trials, wheels

# What a folder holds beside artefacts: the commit, and the sums of the files of each step that is done.
STATE = ".state.json"
Step = Callable[[source.Source, Path], list[Path]]


def steps() -> dict[str, Step]:
    """Returns the steps by name, in their order. Each writes one or some artefacts to a folder."""
    return {
        "source distribution": packages.sdist,
        "wheels for any system": wheels.plain,
        **{f"wheel for {target.name}": partial(wheels.native, target=target) for target in compiler.TARGETS},
        "module for browsers": packages.npm,
        "vectors": packages.vectors,
        **{f"decoder for Linux {name}": partial(packages.decoder, processor=name) for name in compiler.STATIC},
        "descriptions": packages.copies,
        "container file": packages.container,
        "specification": document.page,
        "specification as PDF": document.pdf,
        "notes": statements.notes,
        # Over all that is made before.
        "statement": statements.statement,
        "sums": statements.sums,
    }


def build(folder: Path) -> None:
    """Builds the artefacts that a folder lacks. Raises UsageError."""
    folder.mkdir(parents=True, exist_ok=True)
    state = _state(folder, source.commit())
    with tempfile.TemporaryDirectory() as name:
        tree = source.export(Path(name) / "tree")
        compiler.check(tree)
        changed = False
        for number, (step, make) in enumerate(steps().items(), 1):
            begin = time.monotonic()
            # The last two are over all others.
            again = changed and step in ("statement", "sums")
            if not again and _done(folder, state["steps"].get(step)):
                continue
            changed = True
            say(f"[{number:2}/{len(steps())}] {step} ...")
            made = make(tree, folder)
            state["steps"][step] = {path.name: statements.sha256(path) for path in made}
            (folder / STATE).write_bytes(statements.dumped(state))
            sizes = ", ".join(f"{path.name} {path.stat().st_size:,} bytes" for path in made)
            say(f"        {time.monotonic() - begin:.0f} s: {sizes}")


def _state(folder: Path, commit: str) -> dict[str, Any]:
    """Returns what is done in a folder. That of another commit is removed. Raises UsageError for other files."""
    path = folder / STATE
    state: dict[str, Any] = json.loads(path.read_bytes()) if path.exists() else {"commit": commit, "steps": {}}
    known = {name for files in state["steps"].values() for name in files}
    strange = {entry.name for entry in folder.iterdir()} - known - {STATE}
    if strange and not path.exists():
        raise UsageError(f"{folder} has other files, such as {min(strange)}: give an empty folder")
    # What an interrupted step left is in no list.
    for name in strange if state["commit"] == commit else strange | known:
        (folder / name).unlink(missing_ok=True)
    return state if state["commit"] == commit else {"commit": commit, "steps": {}}


def _done(folder: Path, files: dict[str, str] | None) -> bool:
    """Whether the files of a step are there. files: their sums by name."""
    return files is not None and all(
        (folder / name).is_file() and statements.sha256(folder / name) == known for name, known in files.items()
    )


def check(folder: Path) -> int:
    """Builds in two clones below a folder, compares, and tries the first. Returns an exit status. Raises UsageError.

    The clones differ in path, time zone, language, umask and hash seed, and have caches of the compiler of their own.
    """
    commit = source.commit()
    surroundings = {
        "first": (0o022, {"TZ": "UTC", "PYTHONHASHSEED": "1"}),
        "second, in a folder with a longer name": (0o077, {"TZ": "Asia/Tokyo", "PYTHONHASHSEED": "2", "LC_ALL": "C"}),
    }
    outputs = []
    for name, (umask, variables) in surroundings.items():
        place = folder / name
        clone, output = place / "clone", place / "out"
        outputs.append(output)
        if not clone.exists():
            place.mkdir(parents=True, exist_ok=True)
            subprocess.run(["git", "clone", "--quiet", "--no-checkout", source.ROOT, clone], check=True)
        subprocess.run(["git", "fetch", "--quiet", source.ROOT, commit], cwd=clone, check=True)
        subprocess.run(["git", "checkout", "--quiet", "--detach", commit], cwd=clone, check=True)
        say(f"== in the clone: {name}")
        # The packages of the clone come first.
        others = [p for p in os.environ.get("PYTHONPATH", "").split(os.pathsep) if p and Path(p) != source.ROOT]
        environment = {**os.environ, **variables, "PYTHONPATH": os.pathsep.join([str(clone), *others])}
        environment |= {f"ZIG_{kind}_CACHE_DIR": str(place / f"zig-{kind.lower()}") for kind in ("GLOBAL", "LOCAL")}
        command = [sys.executable, "-m", "release", "--output", str(output)]
        done = subprocess.run(command, cwd=clone, env=environment, umask=umask, check=False)
        if done.returncode:
            return done.returncode
    first, second = outputs
    names = sorted({path.name for output in outputs for path in output.iterdir()} - {STATE})
    differing = [n for n in names if not _same(first / n, second / n)]
    size = sum((first / name).stat().st_size for name in names if (first / name).exists())
    say(f"== {len(names)} artefacts, {size:,} bytes, {len(differing)} differ {' '.join(differing)}".rstrip())
    faults = trials.run(first)
    return REJECTED if differing or faults else DONE


def _same(one: Path, other: Path) -> bool:
    return one.is_file() and other.is_file() and one.read_bytes() == other.read_bytes()


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m release", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, help="default: out/release, or out/release-check")
    parser.add_argument("--check", action="store_true", help="build twice, compare, and try")
    arguments = parser.parse_args()
    name = "release-check" if arguments.check else "release"
    folder = (arguments.output or source.ROOT / "out" / name).resolve()
    try:
        if arguments.check:
            return check(folder)
        build(folder)
    except UsageError as error:
        note(f"python -m release: {error}")
        return USAGE
    return DONE


if __name__ == "__main__":
    sys.exit(main())
