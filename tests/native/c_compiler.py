"""The compiler of the native kernel's tests, and its sanitizers."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from refcodec.native import library

ROOT = Path(__file__).resolve().parents[2]
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
# The fixture `use`: it takes the name of a path, and the number of threads.
Use = Callable[..., None]


def sanitizer() -> str | None:
    """The sanitizer's library, which has to be loaded before Python, or None."""
    if COMPILER is None:
        return None
    asked = [COMPILER, "-print-file-name=libasan.so"]
    path = subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()
    return path if os.path.isabs(path) and Path(path).exists() else None


def build_kernel(folder: Path, **environment: str) -> Path:
    """Builds the library as setup.py does, and returns its path. environment: additional variables, such as CC."""
    command = [sys.executable, "setup.py", "-q", "build_ext", "--build-lib", folder, "--build-temp", folder / "temp"]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    assert kernel_in(folder).is_file(), done.stdout + done.stderr
    return kernel_in(folder)


def kernel_in(folder: Path) -> Path:
    """The library in a folder that it was built in."""
    return folder / "refcodec" / "native" / library.LIBRARY.name
