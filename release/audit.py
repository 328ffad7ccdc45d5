"""Checks of libraries and programs for other systems: what they import and export. The target decides all else.

auditwheel reads only wheels of Linux, and delocate needs macOS. LIEF reads the libraries of all systems.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from refcodec.statuses import UsageError

if TYPE_CHECKING:
    from .compiler import System

# refcodec.native.library calls it first.
FIRST = "kernel_version"
# The libraries that every system has by the first word of a tag: those of PEP 599 for manylinux, and on Windows the
# system and its C library in pieces.
_LIBRARIES = {
    "manylinux": r"lib(?:[cm]\.so\.6|pthread\.so\.0)|ld-linux-(?:x86-64\.so\.2|aarch64\.so\.1)",
    "musllinux": r"libc\.so",
    "macosx": r"/usr/lib/libSystem\.B\.dylib",
    "win": r"(?i:kernel32|ntdll|api-ms-win-crt-[\w-]+)\.dll",
}


@dataclass(frozen=True)
class Facts:
    """What a library or program states. signed: only macOS asks for a signature, which may be that of no one."""

    libraries: tuple[str, ...]
    exports: frozenset[str]
    signed: bool = False


def facts(content: bytes) -> Facts:
    """Returns the facts of a library or program. Raises UsageError for any other file."""
    import lief  # noqa: PLC0415 (only the extra `release` has it)

    # It reports what it skips, too.
    lief.logging.disable()
    binary = lief.parse(content)
    exports = frozenset(str(symbol.name).removeprefix("_") for symbol in getattr(binary, "exported_symbols", ()))
    if isinstance(binary, lief.ELF.Binary):
        return Facts(tuple(map(str, binary.libraries)), exports)
    if isinstance(binary, lief.MachO.Binary):
        # The first is the name of the library itself.
        libraries = tuple(str(lib.name) for lib in binary.libraries if lib.command.name != "ID_DYLIB")
        return Facts(libraries, exports, binary.has_code_signature)
    if isinstance(binary, lief.PE.Binary):
        table = binary.get_export()
        exports = frozenset(str(entry.name) for entry in table.entries) if table else exports
        return Facts(tuple(str(lib.name) for lib in binary.imports), exports)
    raise UsageError("neither ELF nor Mach-O nor PE")


def check_kernel(content: bytes, target: System) -> None:
    """Raises UsageError if the system of a wheel may not load its kernel."""
    if faults := [*_faults(facts(content), target.tag)]:
        raise UsageError(f"the kernel for {target.name}: {'; '.join(faults)}")


def _faults(own: Facts, tag: str) -> Iterator[str]:
    known = _LIBRARIES[re.split(r"[_0-9]", tag)[0]]
    strange = sorted(name for name in own.libraries if not re.fullmatch(known, name))
    if strange:
        yield f"it needs {', '.join(strange)}, which not every system has"
    if tag.endswith("arm64") and not own.signed:
        yield "it has no signature, not even that of no one, which macOS asks for on this processor"
    if FIRST not in own.exports:
        yield f"it does not export {FIRST}"
