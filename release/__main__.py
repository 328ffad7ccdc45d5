"""Builds all artefacts of a release from the commit of this clone, into one folder. Nothing is published.

python -m release             builds them in out/release
python -m release --check     builds them in two new clones, compares all bytes, and tries the artefacts
python -m release --major N   makes the format version N in this clone, which must be one for it, and builds nothing
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from refcodec.files.terminal import note, say
from refcodec.statuses import DONE, REJECTED, USAGE, UsageError

from . import compiler, major, packages, source, trials, wheels

Step = Callable[[source.SourceTree, Path], list[Path]]


def steps() -> dict[str, Step]:
    """Returns the steps by name, in their order. Each writes one or some artefacts to a folder."""
    return {
        "source distribution": packages.sdist,
        "wheel for any system": wheels.plain,
        **{f"wheel for {target.name}": partial(wheels.native, target=target) for target in compiler.TARGETS},
        "module for browsers": packages.npm,
        "vectors": packages.vectors,
        "specification": packages.specification,
        # Over all that is made before.
        "sums": packages.sums,
    }


def build(folder: Path) -> None:
    """Builds the artefacts in a new folder. Raises UsageError, also for a folder with other files."""
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(f"{folder} has files: remove them, or give another folder")
    with tempfile.TemporaryDirectory() as name:
        tree = source.export(Path(name) / "tree")
        compiler.check(tree)
        folder.mkdir(parents=True, exist_ok=True)
        for number, (step, make) in enumerate(steps().items(), 1):
            begin = time.monotonic()
            sizes = ", ".join(f"{path.name} {path.stat().st_size:,} bytes" for path in make(tree, folder))
            say(f"[{number:2}/{len(steps())}] {step}, {time.monotonic() - begin:.0f} s: {sizes}")


def check(folder: Path) -> int:
    """Builds in two clones below a folder, compares, and tries the first. Returns an exit status. Raises UsageError.

    The clones differ in path, time zone, language, umask and hash seed, and have caches of the compiler of their own.
    """
    source.commit()
    surroundings = {
        "first": (0o022, {"TZ": "UTC", "PYTHONHASHSEED": "1"}),
        "second, in a folder with a longer name": (0o077, {"TZ": "Asia/Tokyo", "PYTHONHASHSEED": "2", "LC_ALL": "C"}),
    }
    outputs = []
    for name, (umask, variables) in surroundings.items():
        place = folder / name
        clone, output = place / "clone", place / "out"
        outputs.append(output)
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        subprocess.run(["git", "clone", "--quiet", source.ROOT, clone], check=True)
        say(f"== in the clone: {name}")
        # The packages of the clone come first.
        others = [p for p in os.environ.get("PYTHONPATH", "").split(os.pathsep) if p and Path(p) != source.ROOT]
        environment = {**os.environ, **variables, "PYTHONPATH": os.pathsep.join([str(clone), *others])}
        environment |= {f"ZIG_{kind}_CACHE_DIR": str(place / f"zig-{kind.lower()}") for kind in ("GLOBAL", "LOCAL")}
        command = [sys.executable, "-m", "release", "--output", str(output)]
        done = subprocess.run(command, cwd=clone, env=environment, umask=umask, check=False)
        if done.returncode:
            return done.returncode
    first, second = ({path.name: path.read_bytes() for path in output.iterdir()} for output in outputs)
    differing = sorted(name for name in first.keys() | second.keys() if first.get(name) != second.get(name))
    say(
        f"== {len(first)} artefacts, {sum(map(len, first.values())):,} bytes, {len(differing)} differ {differing or ''}"
    )
    faults = trials.run(outputs[0])
    return REJECTED if differing or faults else DONE


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m release", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, help="default: out/release, or out/release-check")
    parser.add_argument("--check", action="store_true", help="build twice, compare, and try")
    parser.add_argument("--major", metavar="N", type=int, help="make the next major version of the format")
    arguments = parser.parse_args()
    name = "release-check" if arguments.check else "release"
    folder = (arguments.output or source.ROOT / "out" / name).resolve()
    try:
        if arguments.major is not None:
            return major.change(arguments.major)
        if arguments.check:
            return check(folder)
        build(folder)
    except UsageError as error:
        note(f"python -m release: {error}")
        return USAGE
    return DONE


if __name__ == "__main__":
    sys.exit(main())
