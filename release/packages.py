"""Artefacts beside the wheels: source, module for browsers, vectors, decoder in C, specification, notes, sums."""

from __future__ import annotations

import hashlib
import json
import re
import time
from fnmatch import fnmatchcase
from pathlib import Path

from docs import document
from refcodec.statuses import UsageError

from . import archives, audit, compiler, notices, wheels
from .source import Source

SUMS = "SHA256SUMS"
_DECODER = """\
A decoder of C3GS for Linux {processor}, as one static program. It is conformance/c/decoder.c of C3GS {version}.

  ./c3gs-decoder digest FILE          prints the digests of the canonical reconstruction (SPEC.md 9.3)
  ./c3gs-decoder decode FILE OUTPUT   writes the values that the digests are of

Both check the whole file. The exit status is 0 for an accepted file, 1 for a malformed or invalid one, 2 for one that
is not supported, and 64 for wrong usage. With 1 or 2, the last line on stderr states code, name and offset of the error
(SPEC.md 10.3). tables-0.bin must lie beside the program.
"""


def sdist(source: Source, folder: Path) -> list[Path]:
    """Writes the source distribution. It has the files of the commit, and builds the same wheel. Returns its path."""
    path = folder / f"refcodec-{source.version}.tar.gz"
    path.write_bytes(archives.same_tar_gz(wheels.build(source.folder, "build_sdist", source.epoch), source.epoch))
    return [path]


def npm(source: Source, folder: Path) -> list[Path]:
    """Writes the package for npm, with the WebAssembly built again, and its hash. Returns its path.

    It has the files that `npm pack` takes, and the licences, which npm seeks in the package's folder.
    """
    compiler.webassembly(source)
    web = source.folder / "refcodec" / "web"
    package = json.loads((web / "package.json").read_bytes())
    if package["version"] != source.version:
        raise UsageError(f"package.json has the version {package['version']}, and refcodec has {source.version}")
    names = [path.name for path in web.iterdir() if any(fnmatchcase(path.name, one) for one in package["files"])]
    files = {f"package/{name}": (web / name).read_bytes() for name in (*names, "package.json", "README.md")}
    files["package/LICENSE"] = (source.folder / "LICENSE").read_bytes()
    files[f"package/{notices.FILE}"] = notices.text(notices.WASI)
    programs = frozenset(f"package/{name}" for name in package["bin"].values())
    path = folder / f"{package['name']}-{source.version}.tgz"
    path.write_bytes(archives.tar_gz(files, source.epoch, programs))
    return [path]


def vectors(source: Source, folder: Path) -> list[Path]:
    """Writes the archive of the suite's vectors, with schema, licences and sums. Returns its path."""
    prefix = f"c3gs-vectors-{source.suite}/"
    files = archives.tree(source.folder / "vectors")
    files["LICENSE"] = (source.folder / "LICENSE").read_bytes()
    lines = [f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted(files)]
    files["SHA256SUMS"] = "".join(lines).encode()
    path = folder / f"c3gs-vectors-{source.suite}.tar.gz"
    path.write_bytes(archives.tar_gz({prefix + name: content for name, content in files.items()}, source.epoch))
    return [path]


def decoder(source: Source, folder: Path, processor: str) -> list[Path]:
    """Writes the archive with the static decoder for Linux. processor: of compiler.STATIC. Returns its path."""
    program = compiler.static_decoder(source, processor)
    if libraries := audit.facts(program).libraries:
        raise UsageError(f"the static decoder for {processor} needs {', '.join(libraries)}")
    prefix = f"c3gs-decoder-{source.version}-linux-{processor}/"
    files = {
        "c3gs-decoder": program,
        "tables-0.bin": (source.folder / "refcodec" / "data" / "tables-0.bin").read_bytes(),
        "README.txt": _DECODER.format(processor=processor, version=source.version).encode(),
        "LICENSE": (source.folder / "LICENSE").read_bytes(),
        notices.FILE: notices.text(notices.MUSL, notices.RUNTIME),
    }
    path = folder / f"{prefix.rstrip('/')}.tar.gz"
    packed = {prefix + name: content for name, content in files.items()}
    path.write_bytes(archives.tar_gz(packed, source.epoch, frozenset({f"{prefix}c3gs-decoder"})))
    return [path]


def copies(source: Source, folder: Path) -> list[Path]:
    """Writes the files of the repository that are artefacts as they are. Returns their paths."""
    made = []
    for name in ("spec/c3gs.ksy", "spec/c3gs.magic", "CITATION.cff", ".zenodo.json"):
        # A name that begins with a point is not shown.
        path = folder / name.rpartition("/")[2].lstrip(".")
        path.write_bytes((source.folder / name).read_bytes())
        made.append(path)
    return made


def specification(source: Source, folder: Path) -> list[Path]:
    """Writes SPEC.md as one HTML file. Returns its path."""
    path = folder / f"c3gs-spec-{source.version}.html"
    manifest = sha256(source.folder / "vectors" / "manifest.json")
    date = time.strftime("%Y-%m-%d", time.gmtime(source.epoch))
    about = {"Version": source.version, "Date": date, "Commit": source.commit}
    about[f"Vectors {source.suite}"] = f"manifest.json, SHA-256 {manifest}"
    path.write_text(document.page(about, source.folder), encoding="utf-8")
    return [path]


def notes(source: Source, folder: Path) -> list[Path]:
    """Writes the release notes: the first section of CHANGELOG.md. Returns their path."""
    text = (source.folder / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.split(r"^## ", text, flags=re.MULTILINE)[1]
    title, _, body = first.partition("\n")
    name = source.version if title.strip() == "Unreleased" else title.strip()
    path = folder / f"c3gs-{source.version}-notes.md"
    path.write_text(f"# C3GS {name}\n{body.rstrip()}\n", encoding="utf-8")
    return [path]


def sums(source: Source, folder: Path) -> list[Path]:
    """Writes SHA256SUMS over all artefacts of a folder, which are made before. Returns its path."""
    path = folder / SUMS
    path.write_text(
        "".join(f"{sha256(p)}  {p.name}\n" for p in sorted(folder.iterdir()) if p != path), encoding="utf-8"
    )
    return [path]


def sha256(path: Path) -> str:
    """Returns the SHA-256 of a file in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
