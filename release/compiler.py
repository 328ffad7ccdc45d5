"""Programs and libraries for other systems, by the compiler that makes the WebAssembly: Zig, pinned in package.json."""

import importlib.metadata
import importlib.util
import json
import os
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from refcodec.statuses import UsageError

from .source import SourceTree


@dataclass(frozen=True)
class System:
    """A system. name: in messages. zig: the compiler's name of it. tag: that of wheels."""

    name: str
    zig: str
    tag: str


# The oldest systems are those that the compiler and its C libraries support, or that CPython 3.11 does.
TARGETS = (
    System("Linux x86_64", "x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64.manylinux2014_x86_64"),
    System("Linux aarch64", "aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64.manylinux2014_aarch64"),
    System("Linux x86_64, musl", "x86_64-linux-musl", "musllinux_1_2_x86_64"),
    System("macOS arm64", "aarch64-macos.11.0", "macosx_11_0_arm64"),
    System("macOS x86_64", "x86_64-macos.10.13", "macosx_10_13_x86_64"),
    System("Windows x86_64", "x86_64-windows-gnu", "win_amd64"),
)


def check(source: SourceTree) -> None:
    """Raises UsageError unless the pinned compiler is installed."""
    pinned = package(source)["config"]["ziglang"]
    installed = importlib.metadata.version("ziglang") if importlib.util.find_spec("ziglang") else "missing"
    if installed != pinned:
        raise UsageError(f"ziglang {pinned} is needed, and here it is {installed}: pip install ziglang=={pinned}")


def package(source: SourceTree) -> dict[str, dict[str, str]]:
    """Returns the package.json of the module for browsers."""
    document: dict[str, dict[str, str]] = json.loads((source.folder / "refcodec" / "web" / "package.json").read_bytes())
    return document


def kernel(source: SourceTree, target: System) -> bytes:
    """Returns the library of the kernel for a system, built with the sources and flags of setup.py. Raises UsageError.

    Nothing of a build may depend on its folder: the sources have relative names, and the linker writes no time.
    """
    code = (
        "import json; from distutils.core import run_setup; e = run_setup('setup.py', stop_after='init').ext_modules[0]"
        "; print(json.dumps([*e.extra_compile_args, *e.extra_link_args, *e.sources]))"
    )
    printed = subprocess.run(
        [sys.executable, "-c", f"import setuptools; {code}"], cwd=source.folder, capture_output=True, check=True
    )
    # A library of Windows needs no position-independent code, and Zig ignores the flag there.
    flags = ["-target", target.zig, "-shared", "-fPIC", "-s", *json.loads(printed.stdout.splitlines()[-1])]
    return _compile(source, "kernel.so", flags)


def webassembly(source: SourceTree) -> bytes:
    """Returns c3gs.wasm, built again. Raises UsageError if it is not the committed one."""
    web = source.folder / "refcodec" / "web"
    committed = (web / "c3gs.wasm").read_bytes()
    words = shlex.split(package(source)["scripts"]["build"])
    made = _run([sys.executable, *words[1:]], web, web / words[words.index("-o") + 1])
    if made != committed:
        raise UsageError("c3gs.wasm is not what its sources make: run npm run build in refcodec/web, and commit it")
    return made


def _compile(source: SourceTree, name: str, flags: list[str]) -> bytes:
    # A library of macOS has the path that was given to the linker in it, thus this has no folder.
    path = source.folder / name
    try:
        return _run([sys.executable, "-m", "ziglang", "cc", *flags, "-o", name], source.folder, path)
    finally:
        path.unlink(missing_ok=True)


def _run(command: list[str], folder: Path, made: Path) -> bytes:
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "0"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UsageError(f"{shlex.join(command)} failed: {done.stderr}")
    return made.read_bytes()
