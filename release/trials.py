"""Trials of the artefacts of a folder: their sums, and each decoder among them, unpacked, by the suite on some vectors.

What cannot run here is listed with the reason. `audit` has checked it when it was built.
"""

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from refcodec.files.terminal import say

from .packages import SUMS
from .source import ROOT

# All vectors take long with NumPy.
SAMPLE = "operation:decode id:valid-trained-*,valid-static-*,valid-weights-*,invalid-weights-*,unsupported-minor-*"


def run(folder: Path) -> int:
    """Tries the artefacts of a folder and prints the results. Returns the number of faults."""
    faults = 0
    with tempfile.TemporaryDirectory() as name:
        vectors = unpacked(folder, "c3gs-vectors-*.tar.gz", Path(name))
        sums = ["sha256sum", "--check", "--strict", "--quiet", SUMS]
        suite = [sys.executable, "-m", "conformance", "run", "--vectors", str(vectors), "--select", SAMPLE]
        trials = {f"sums of {place.name}": (place, sums) for place in (folder, vectors)}
        for artefact, command in decoders(folder, Path(name)).items():
            if command and shutil.which(command[0]):
                trials[artefact] = ROOT, [*suite, "--", *command, "{input}", "{output}"]
            else:
                say(f"{artefact}: not run here: {f'there is no {command[0]}' if command else 'another system'}")
        for what, (place, words) in trials.items():
            done = subprocess.run(words, cwd=place, capture_output=True, text=True, check=False)
            faults += done.returncode != 0
            say(f"{what}: {f'FAULT: {done.stdout}{done.stderr}' if done.returncode else 'right'}", lines=True)
    say(f"== {faults} faults")
    return faults


def decoders(folder: Path, room: Path) -> dict[str, list[str]]:
    """Returns the command of each decoder, before the words `FILE OUTPUT`. It is empty for another system.

    room: a folder, in which the artefacts are unpacked.
    """
    made: dict[str, list[str]] = {}
    for path in sorted(folder.glob("refcodec-*.whl")):
        native = sys.platform == "linux" and "manylinux" in path.name and os.uname().machine in path.name
        target = room / path.stem
        shutil.unpack_archive(path, target, "zip")
        # -P: not the package of the working folder.
        command = ["env", f"PYTHONPATH={target}", f"REFCODEC_PATH={'native' if native else 'numpy'}", sys.executable]
        command += ["-P", "-m", "refcodec", "reconstruct"]
        made[path.name] = command if native or "-any" in path.name else []
    made["module for browsers"] = ["node", str(unpacked(folder, "c3gs-*.tgz", room) / "cli.js"), "decode"]
    return made


def unpacked(folder: Path, pattern: str, room: Path) -> Path:
    """Returns the folder in an archive, unpacked."""
    (path,) = folder.glob(pattern)
    target = room / f"{path.name}-unpacked"
    with tarfile.open(path) as archive:
        archive.extractall(target, filter="data")
    (content,) = target.iterdir()
    return content
