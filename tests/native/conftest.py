"""The native kernel for the tests: compiled from this tree, regardless of the installed one.

REFCODEC_TEST_KERNEL names one that is compiled already, for another processor: tests/native/aarch64.
"""

import os
from pathlib import Path

import pytest
from c_compiler import COMPILER, Use, build_kernel, kernel_in
from once import once

from refcodec.native import library


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library, as setup.py builds it."""
    if made := os.environ.get("REFCODEC_TEST_KERNEL"):
        return Path(made)
    if COMPILER is None:
        pytest.skip("there is no C compiler")
    return kernel_in(once(tmp_path_factory, "kernel", build_kernel))


@pytest.fixture
def use(built: Path, monkeypatch: pytest.MonkeyPatch) -> Use:
    """Chooses a path by its name, and the number of threads. A variant that this machine cannot run is skipped."""
    loaded = library.load(built)
    assert loaded is not None
    monkeypatch.setattr(library, "load", lambda: loaded)

    def choose(path: str, threads: int = 1) -> None:
        if path not in library.paths():
            pytest.skip(f"this machine cannot run {path}")
        monkeypatch.setenv(library.PATH_VARIABLE, path)
        monkeypatch.setenv(library.THREADS_VARIABLE, str(threads))

    return choose
