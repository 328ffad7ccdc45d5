"""The wheels of codec and suite: for each system with its kernel, and one for any system without.

setuptools builds the one of the whole tree, as it does for `pip install .` in a clone. The others are it with a kernel.
"""

import base64
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from refcodec.statuses import UsageError

from . import archives, audit, compiler, notices
from .source import SourceTree

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
    """Writes the wheel without a kernel, for any system. Returns its path."""
    return [_write(source, folder, ANY, archives.members(build(source.folder, "build_wheel", source.epoch)))]


def native(source: SourceTree, folder: Path, target: compiler.System) -> list[Path]:
    """Writes the wheel for a system. folder: has that for any system. Returns its path."""
    files = archives.members(path_of(folder, source.version, ANY).read_bytes())
    files[KERNEL] = compiler.kernel(source, target)
    audit.check_kernel(files[KERNEL], target)
    return [_write(source, folder, target.tag, files)]


def path_of(folder: Path, version: str, tag: str) -> Path:
    """Returns the path of a wheel."""
    return folder / f"refcodec-{version}-py3-none-{tag}.whl"


def _write(source: SourceTree, folder: Path, tag: str, files: dict[str, bytes]) -> Path:
    """Writes a wheel with its licences and record. Returns its path."""
    info = f"refcodec-{source.version}.dist-info/"
    line, more = "License-File: LICENSE\n", f"License-File: {notices.FILE}\n"
    metadata = files[f"{info}METADATA"].decode()
    metadata = metadata if more in metadata else metadata.replace(line, line + more, 1)
    files = {**files, f"{info}licenses/{notices.FILE}": notices.text(*notices.parts(tag))}
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
    path = path_of(folder, source.version, tag)
    path.write_bytes(archives.zipped(files, source.epoch))
    return path


def _hash(content: bytes) -> str:
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
