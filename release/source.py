"""What a release is built from: the files of one commit, without those of the working tree."""

import io
import json
import re
import subprocess
import tarfile
from dataclasses import dataclass
from pathlib import Path

from refcodec.statuses import UsageError

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class SourceTree:
    """The files of a commit.

    folder: that of the files. commit: its hash. epoch: its time, in seconds since 1970. version: of the project.
    suite: the version of the vectors.
    """

    folder: Path
    commit: str
    epoch: int
    version: str
    suite: str


def commit() -> str:
    """Returns the hash of the commit of this clone. Raises UsageError if it has other files than its commit."""
    changed = _git("status", "--porcelain", "--untracked-files=no").decode()
    if changed:
        raise UsageError(f"a release is built from a commit, and these files differ from it: commit them\n{changed}")
    return _git("rev-parse", "HEAD").decode().strip()


def export(folder: Path) -> SourceTree:
    """Writes the files of the commit to a new folder. Raises UsageError."""
    name = commit()
    with tarfile.open(fileobj=io.BytesIO(_git("archive", "--format=tar", name))) as archive:
        archive.extractall(folder, filter="data")
    package = (folder / "refcodec" / "__init__.py").read_text(encoding="utf-8")
    version = re.search(r'^__version__ = "(.+)"$', package, re.MULTILINE)
    if version is None:
        raise UsageError("refcodec/__init__.py states no __version__")
    manifest = json.loads((folder / "vectors" / "manifest.json").read_text(encoding="utf-8"))
    epoch = int(_git("log", "-1", "--format=%ct", name))
    return SourceTree(folder, name, epoch, version[1], manifest["suite_version"])


def _git(*arguments: str) -> bytes:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, check=False)
    if done.returncode:
        raise UsageError(f"git {arguments[0]} failed; a release needs a clone: {done.stderr.decode().strip()}")
    return done.stdout
