"""Artefacts beside the wheels: source, module for browsers, vectors, specification, sums."""

import hashlib
import json
import time
from fnmatch import fnmatchcase
from pathlib import Path

from docs import document
from refcodec.statuses import UsageError

from . import archives, compiler, notices, wheels
from .source import SourceTree

SUMS = "SHA256SUMS"


def sdist(source: SourceTree, folder: Path) -> list[Path]:
    """Writes the source distribution. It has the files of the commit, and builds the same wheel. Returns its path."""
    path = folder / f"refcodec-{source.version}.tar.gz"
    path.write_bytes(archives.same_tar_gz(wheels.build(source.folder, "build_sdist", source.epoch), source.epoch))
    return [path]


def npm(source: SourceTree, folder: Path) -> list[Path]:
    """Writes the package for npm, with the WebAssembly built again, and its hash. Returns its path.

    It has the files that `npm pack` takes, and the licences, which npm seeks in the package's folder.
    """
    compiler.webassembly(source)
    web = source.folder / "refcodec" / "web"
    package = json.loads((web / "package.json").read_bytes())
    # npm's form of 1.0.0rc1.
    version = source.version.replace("rc", "-rc.")
    if package["version"] != version:
        raise UsageError(f"package.json has the version {package['version']}, and refcodec has {source.version}")
    names = [path.name for path in web.iterdir() if any(fnmatchcase(path.name, one) for one in package["files"])]
    files = {f"package/{name}": (web / name).read_bytes() for name in (*names, "package.json", "README.md")}
    files["package/LICENSE"] = (source.folder / "LICENSE").read_bytes()
    files[f"package/{notices.FILE}"] = notices.text(notices.WASI)
    programs = frozenset(f"package/{name}" for name in package["bin"].values())
    path = folder / f"{package['name']}-{version}.tgz"
    path.write_bytes(archives.tar_gz(files, source.epoch, programs))
    return [path]


def vectors(source: SourceTree, folder: Path) -> list[Path]:
    """Writes the archive of the suite's vectors, with schema, licences and sums. Returns its path."""
    prefix = f"c3gs-vectors-{source.suite}/"
    files = archives.tree(source.folder / "vectors")
    files["LICENSE"] = (source.folder / "LICENSE").read_bytes()
    lines = [f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files)]
    files["SHA256SUMS"] = "".join(lines).encode()
    path = folder / f"c3gs-vectors-{source.suite}.tar.gz"
    path.write_bytes(archives.tar_gz({prefix + name: content for name, content in files.items()}, source.epoch))
    return [path]


def specification(source: SourceTree, folder: Path) -> list[Path]:
    """Writes SPEC.md as one HTML file. Returns its path."""
    path = folder / f"c3gs-spec-{source.version}.html"
    manifest = sha256(source.folder / "vectors" / "manifest.json")
    date = time.strftime("%Y-%m-%d", time.gmtime(source.epoch))
    about = {"Version": source.version, "Date": date, "Commit": source.commit}
    about[f"Vectors {source.suite}"] = f"manifest.json, SHA-256 {manifest}"
    path.write_text(document.page(about, source.folder), encoding="utf-8")
    return [path]


def sums(source: SourceTree, folder: Path) -> list[Path]:
    """Writes SHA256SUMS over all artefacts of a folder, which are made before. Returns its path."""
    path = folder / SUMS
    path.write_text(
        "".join(f"{sha256(p)}  {p.name}\n" for p in sorted(folder.iterdir()) if p != path), encoding="utf-8"
    )
    return [path]


def sha256(path: Path) -> str:
    """Returns the SHA-256 of a file in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
