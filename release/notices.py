"""The parts of other projects inside the artefacts, and their licences, which must go with them.

The compiler links parts of its C libraries into what it makes. Their licences are files of the compiler's package.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from .compiler import TARGETS


@dataclass(frozen=True)
class Part:
    """A part. name: its project's. licence: an SPDX identifier. files: with its licence, in the package ziglang."""

    name: str
    licence: str
    files: tuple[str, ...]


# The compiler's own support functions, such as memcpy and divisions of 128 bits.
RUNTIME = Part("zig compiler-rt", "MIT", ("LICENSE",))
WASI = Part("wasi-libc", "MIT", ("lib/libc/wasi/LICENSE-MIT", "lib/libc/wasi/libc-top-half/musl/COPYRIGHT"))
MUSL = Part("musl", "MIT", ("lib/libc/musl/COPYRIGHT",))
MINGW = Part("mingw-w64", "LicenseRef-MinGW-w64", ("lib/libc/mingw/COPYING",))
FILE = "THIRD-PARTY.txt"


def parts(name: str, tag: str) -> list[Part]:
    """Returns the parts in a wheel. name: of the distribution. tag: of its system."""
    if name != "refcodec":
        return []
    # Each wheel of refcodec has c3gs.wasm.
    native = [RUNTIME] if tag in {target.tag for target in TARGETS} else []
    return [WASI, *native, *([MINGW] if tag.startswith("win") else [])]


def text(found: list[Part]) -> bytes:
    """Returns the licences of parts."""
    return b"\n".join(_licence(part) for part in found)


@cache
def _licence(part: Part) -> bytes:
    found = importlib.util.find_spec("ziglang")
    assert found is not None
    assert found.origin is not None
    folder = Path(found.origin).parent
    head = f"{'=' * 80}\n{part.name} ({part.licence})\n{'=' * 80}\n\n".encode()
    return head + b"\n".join((folder / name).read_bytes() for name in part.files)


def of_wheel(info: str, name: str, tag: str) -> dict[str, bytes]:
    """Returns the file of the licences of a wheel's parts, by path. info: its .dist-info folder."""
    found = parts(name, tag)
    return {f"{info}licenses/{FILE}": text(found)} if found else {}


def listed(metadata: str, info: str, files: dict[str, bytes]) -> str:
    """Returns metadata that list the file, if it is among the files."""
    line = f"License-File: {FILE}\n"
    if f"{info}licenses/{FILE}" not in files or line in metadata:
        return metadata
    return metadata.replace("License-File: LICENSE\n", f"License-File: LICENSE\n{line}", 1)
