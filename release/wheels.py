"""The wheels: `refcodec` for each system, with its kernel, and the suite as a distribution of its own.

setuptools builds one wheel of the whole tree, as it does for `pip install .` in a clone. It is divided here, thus a
decoder installs without the vectors. In the wheels, the extra `conformance` requires the second distribution.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from refcodec.statuses import UsageError

from . import archives, audit, compiler, notices
from .source import SourceTree

NAME, SUITE = "refcodec", "refcodec_conformance"
KERNEL = "refcodec/native/kernel.so"
ANY = "any"


def build(tree: Path, what: str, epoch: int) -> bytes:
    """Returns a distribution that setuptools builds from a copy of a tree, without the kernel.

    what: build_wheel or build_sdist, which are hooks of PEP 517. epoch: its time. Raises UsageError.
    """
    with tempfile.TemporaryDirectory() as name:
        copy, made = Path(name) / "tree", Path(name) / "made"
        shutil.copytree(tree, copy)
        made.mkdir()
        code = f"from setuptools import build_meta; build_meta.{what}({str(made)!r})"
        # The kernel is optional, and `false` is no compiler.
        environment = {**os.environ, "SOURCE_DATE_EPOCH": str(epoch), "CC": "false"}
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise UsageError(f"setuptools failed: {done.stderr}")
        (path,) = made.iterdir()
        return path.read_bytes()


def plain(source: SourceTree, folder: Path) -> list[Path]:
    """Writes the wheel of refcodec without a kernel, for any system, and that of the suite. Returns their paths."""
    whole = Path(folder, ".whole.whl")
    whole.write_bytes(build(source.folder, "build_wheel", source.epoch))
    with zipfile.ZipFile(whole) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    whole.unlink()
    info = f"{NAME}-{source.version}.dist-info/"
    requirements = _requirements(files[f"{info}METADATA"].decode())
    return [
        _write(source, folder, NAME, ANY, _light(files, info, source.version)),
        _write(source, folder, SUITE, ANY, _suite(files, info, source, requirements)),
    ]


def native(source: SourceTree, folder: Path, target: compiler.System) -> list[Path]:
    """Writes the wheel of refcodec for a system. folder: has that for any system. Returns its path."""
    with zipfile.ZipFile(path_of(folder, NAME, source.version, ANY)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    files[KERNEL] = compiler.kernel(source, target)
    audit.check_kernel(files[KERNEL], target)
    return [_write(source, folder, NAME, target.tag, files)]


def path_of(folder: Path, name: str, version: str, tag: str) -> Path:
    return folder / f"{name}-{version}-py3-none-{tag}.whl"


def _requirements(metadata: str) -> dict[str, str]:
    """Returns the requirements of the extra `conformance`, by name."""
    required = re.findall(r'^Requires-Dist: (([\w.-]+)\S*); extra == "conformance"$', metadata, re.MULTILINE)
    return {name: text for text, name in required}


def _light(files: dict[str, bytes], info: str, version: str) -> dict[str, bytes]:
    """Returns the files of refcodec without the suite."""
    own = {name: content for name, content in files.items() if name.startswith((f"{NAME}/", info))}
    metadata = own[f"{info}METADATA"].decode()
    suite = f'Requires-Dist: refcodec-conformance=={version}; extra == "conformance"\n'
    place = metadata.index("Provides-Extra: conformance\n") + len("Provides-Extra: conformance\n")
    own[f"{info}METADATA"] = (metadata[:place] + suite + metadata[place:]).encode()
    own[f"{info}entry_points.txt"] = _entry("refcodec", "refcodec.cli.main:main")
    own[f"{info}top_level.txt"] = b"refcodec\n"
    return own


def _suite(files: dict[str, bytes], info: str, source: SourceTree, requirements: dict[str, str]) -> dict[str, bytes]:
    """Returns the files of the suite as a distribution."""
    new = f"{SUITE}-{source.version}.dist-info/"
    metadata = files[f"{info}METADATA"].decode()
    head = {"Name": "refcodec-conformance", "Summary": "Conformance suite of C3GS, a bitstream for 3D Gaussian scenes"}
    kept = ("Metadata-Version", "Version", "Author", "License-Expression", "Requires-Python", "License-File")
    lines = [line for line in metadata.partition("\n\n")[0].splitlines() if line.partition(":")[0] in kept]
    lines[1:1] = [f"{name}: {text}" for name, text in head.items()]
    lines += [f"Requires-Dist: {text}" for text in (f"refcodec=={source.version}", *requirements.values())]
    readme = "The conformance suite of C3GS: `conformance run` tells whether a decoder is right.\n"
    own = {name: content for name, content in files.items() if name.startswith("conformance/")}
    own[f"{new}METADATA"] = ("\n".join([*lines, "Description-Content-Type: text/markdown"]) + f"\n\n{readme}").encode()
    own[f"{new}WHEEL"] = files[f"{info}WHEEL"]
    own[f"{new}entry_points.txt"] = _entry("conformance", "conformance.cli:main")
    own[f"{new}top_level.txt"] = b"conformance\n"
    own[f"{new}licenses/LICENSE"] = files[f"{info}licenses/LICENSE"]
    return own


def _entry(name: str, place: str) -> bytes:
    return f"[console_scripts]\n{name} = {place}\n".encode()


def _write(source: SourceTree, folder: Path, name: str, tag: str, files: dict[str, bytes]) -> Path:
    """Writes a wheel with its licences and record. Returns its path."""
    info = f"{name}-{source.version}.dist-info/"
    parts, metadata = notices.parts(name, tag), files[f"{info}METADATA"].decode()
    if parts:
        line, more = "License-File: LICENSE\n", f"License-File: {notices.FILE}\n"
        metadata = metadata if more in metadata else metadata.replace(line, line + more, 1)
        files = {**files, f"{info}licenses/{notices.FILE}": notices.text(*parts)}
    wheel = re.sub(r"^(?:Root-Is-Purelib|Tag): .*\n", "", files[f"{info}WHEEL"].decode(), flags=re.MULTILINE).strip()
    tags = "".join(f"Tag: py3-none-{one}\n" for one in tag.split("."))
    files[f"{info}WHEEL"] = f"{wheel}\nRoot-Is-Purelib: {str(tag == ANY).lower()}\n{tags}".encode()
    files[f"{info}METADATA"] = metadata.encode()
    record = f"{info}RECORD"
    files.pop(record, None)
    # The metadata are the last files of a wheel (binary distribution format).
    files = {path: files[path] for path in sorted(files, key=lambda path: (path.startswith(info), path))}
    lines = [f"{path},{_hash(content)},{len(content)}\n" for path, content in files.items()]
    files[record] = "".join([*lines, f"{record},,\n"]).encode()
    path = path_of(folder, name, source.version, tag)
    path.write_bytes(archives.zipped(files, source.epoch))
    return path


def _hash(content: bytes) -> str:
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
