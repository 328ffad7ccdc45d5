"""The parts of other projects inside the artefacts, and their licences, which must go with them.

The compiler links parts of its C libraries into what it makes. Their licences are files of the compiler's package.
"""

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
MINGW = Part("mingw-w64", "LicenseRef-MinGW-w64", ("lib/libc/mingw/COPYING",))
FILE = "THIRD-PARTY.txt"


def parts(tag: str) -> list[Part]:
    """Returns the parts in a wheel, each of which has c3gs.wasm. tag: of its system."""
    native = [RUNTIME] if tag in {target.tag for target in TARGETS} else []
    return [WASI, *native, *([MINGW] if tag.startswith("win") else [])]


@cache
def text(*of: Part) -> bytes:
    package = importlib.util.find_spec("ziglang")
    assert package is not None
    assert package.origin is not None
    folder, line = Path(package.origin).parent, "=" * 80
    return b"\n".join(
        f"{line}\n{part.name} ({part.licence})\n{line}\n\n".encode()
        + b"\n".join((folder / name).read_bytes() for name in part.files)
        for part in of
    )
