"""The cache of compiled functions: outside the package, in folders named by their sources, and bounded."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

pytest.importorskip("numba")

import numba

import refcodec
from refcodec.rendering import blending, compiled, constants, simd, tiles

PACKAGE = Path(refcodec.__file__).parent


def fresh() -> None:
    """Forgets what the process knows of sources and folders."""
    compiled.stamp.cache_clear()
    compiled._folder.cache_clear()


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    fresh()
    yield tmp_path
    fresh()


def twice(x: int) -> int:
    return 2 * x


def test_a_function_is_kept_outside_the_package(cache: Path) -> None:
    """What one process has compiled another one loads."""
    made = [compiled.compiled()(twice) for _ in range(2)]
    assert [function(21) for function in made] == [42, 42]
    assert [sum(function.stats.cache_hits.values()) for function in made] == [0, 1]
    # Functions of other packages keep numba's own places.
    assert not Path(numba.njit(cache=True)(twice).stats.cache_path).is_relative_to(cache / __name__)
    folder = compiled._folder(__name__)
    assert folder.parent == cache / __name__
    assert folder.name.startswith(f"{refcodec.__version__}-")
    assert {path.suffix for path in folder.iterdir()} == {".nbi", ".nbc"}
    assert not Path(blending.blend_tiles.stats.cache_path).is_relative_to(PACKAGE)


def changed(module: ModuleType) -> Callable[[Path, pytest.MonkeyPatch], None]:
    """Gives a module another source."""

    def change(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        source = Path(str(module.__file__))
        (folder / source.name).write_bytes(source.read_bytes() + b"# changed\n")
        monkeypatch.setattr(module, "__file__", str(folder / source.name))

    return change


@pytest.mark.parametrize(
    ("module", "change", "is_change"),
    [
        (blending, lambda *_: None, False),
        # Functions that are inlined, and a constant of another module.
        *((blending, changed(inlined), True) for inlined in (blending, tiles, simd)),
        (blending, lambda _, monkeypatch: monkeypatch.setattr(blending, "LEAST", constants.LEAST * 2), True),
        (tiles, changed(blending), False),
    ],
)
def test_a_stamp_tells_changes(
    module: ModuleType, change: Callable[..., None], is_change: bool, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = compiled.stamp(module.__name__)
    fresh()
    change(cache, monkeypatch)
    assert (compiled.stamp(module.__name__) != before) == is_change


def test_the_folders_that_were_used_last_stay(cache: Path) -> None:
    first = compiled._folder(tiles.__name__)
    for age in range(8):
        old = first.parent / f"0.0.{age}-0123456789abcdef"
        old.mkdir()
        os.utime(old, (1_000_000 - age, 1_000_000 - age))
    other = cache / "other"
    other.mkdir()
    fresh()
    assert compiled._folder(tiles.__name__) == first
    ages = [f"0.0.{age}-0123456789abcdef" for age in range(compiled.KEPT - 1)]
    assert sorted(path.name for path in first.parent.iterdir()) == [*ages, first.name]
    assert other.is_dir()


def test_a_folder_that_another_process_removes_is_made_again(cache: Path) -> None:
    function = compiled.compiled()(twice)
    folder = compiled._folder(__name__)
    shutil.rmtree(folder)
    assert function(1) == 2
    assert any(folder.iterdir())


def test_a_place_that_cannot_be_written_ends_nothing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (cache / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache / "file"))
    assert not compiled.is_kept()
    assert compiled.compiled()(twice)(3) == 6


def test_a_full_disk_ends_nothing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=compiled.SPACE_LEAST - 1))
    assert not compiled.is_kept()
    assert compiled.compiled()(twice)(3) == 6
