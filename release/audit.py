"""Checks of libraries and programs that need no other system: kind, processor, and what they import.

auditwheel reads only wheels of Linux, and delocate needs macOS. LIEF reads the libraries of all systems.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from refcodec.statuses import UsageError

if TYPE_CHECKING:
    from .compiler import Target

# refcodec.native.library calls it first.
FIRST = "kernel_version"
# The newest glibc that a wheel of manylinux2014 may need (PEP 599).
GLIBC = (2, 17)
# The kind of the library and its processors by the first word of a tag, and the libraries that every system has: those
# of PEP 599 for manylinux, and on Windows the system and its C library in pieces.
_KINDS = {"manylinux": "ELF", "musllinux": "ELF", "macosx": "Mach-O", "win": "PE"}
_PROCESSORS = {name.lower(): name for name in ("X86_64", "AARCH64", "ARM64", "AMD64")}
_LIBRARIES = {
    "manylinux": r"lib(?:[cm]\.so\.6|pthread\.so\.0)|ld-linux-(?:x86-64\.so\.2|aarch64\.so\.1)",
    "musllinux": r"libc\.so",
    "macosx": r"/usr/lib/libSystem\.B\.dylib",
    "win": r"(?i:kernel32|ntdll|api-ms-win-crt-[\w-]+)\.dll",
}


@dataclass(frozen=True)
class Facts:
    """What a library or program states. oldest: the oldest glibc or macOS that it needs, or empty."""

    kind: str
    processor: str
    libraries: tuple[str, ...]
    exports: frozenset[str]
    oldest: tuple[int, ...]
    # Only macOS asks for a signature, which may be that of no one.
    signed: bool


def facts(content: bytes) -> Facts:
    """Returns the facts of a library or program. Raises UsageError for any other file."""
    import lief  # noqa: PLC0415 (only the extra `release` has it)

    # It reports what it skips, too.
    lief.logging.disable()
    found = lief.parse(content)
    exports = frozenset(str(symbol.name).removeprefix("_") for symbol in getattr(found, "exported_symbols", ()))
    if isinstance(found, lief.ELF.Binary):
        versions = {str(a.name) for r in found.symbols_version_requirement for a in r.get_auxiliary_symbols()}
        glibc = [_numbers(name) for name in versions if name.startswith("GLIBC_")]
        libraries = tuple(sorted(map(str, found.libraries)))
        return Facts("ELF", found.header.machine_type.name, libraries, exports, max(glibc, default=()), False)
    if isinstance(found, lief.MachO.Binary):
        build, earlier = found.build_version, found.version_min
        oldest = build.minos if build else earlier.version if earlier else []
        # The first is the name of the library itself.
        libraries = tuple(str(lib.name) for lib in found.libraries if lib.command.name != "ID_DYLIB")
        processor = found.header.cpu_type.name
        return Facts("Mach-O", processor, libraries, exports, tuple(oldest[:2]), found.has_code_signature)
    if isinstance(found, lief.PE.Binary):
        table = found.get_export()
        exports = frozenset(str(entry.name) for entry in table.entries) if table else exports
        libraries = tuple(sorted(str(lib.name) for lib in found.imports))
        return Facts("PE", found.header.machine.name, libraries, exports, (), False)
    raise UsageError("neither ELF nor Mach-O nor PE")


def check_kernel(content: bytes, target: Target) -> None:
    """Raises UsageError if the system of a wheel may not load its kernel."""
    if faults := [*_faults(facts(content), target.tag.split(".")[0])]:
        raise UsageError(f"the kernel for {target.name}: {'; '.join(faults)}")


def _faults(found: Facts, tag: str) -> Iterator[str]:
    system = re.split(r"[_0-9]", tag)[0]
    processor = next(name for end, name in _PROCESSORS.items() if tag.endswith(end))
    if (found.kind, found.processor) != (_KINDS[system], processor):
        yield f"it is {found.kind} for {found.processor}"
    strange = [name for name in found.libraries if not re.fullmatch(_LIBRARIES[system], name)]
    if strange:
        yield f"it needs {', '.join(strange)}, which not every system has"
    promised = {"manylinux": GLIBC, "macosx": _numbers(tag)}.get(system, ())
    if promised and found.oldest > promised:
        name, *versions = "glibc" if system == "manylinux" else "macOS", found.oldest, promised
        needed, tagged = (".".join(map(str, version)) for version in versions)
        yield f"it needs {name} {needed}, and the tag promises {tagged}"
    if tag.endswith("arm64") and not found.signed:
        yield "it has no signature, not even that of no one, which macOS asks for on this processor"
    if FIRST not in found.exports:
        yield f"it does not export {FIRST}"


def _numbers(name: str) -> tuple[int, ...]:
    """Returns the version in a name, such as that of GLIBC_2.2.5 or macosx_11_0_arm64."""
    found = re.search(r"\d+(?:[._]\d+)*", name)
    return tuple(map(int, re.split("[._]", found[0]))) if found else ()
