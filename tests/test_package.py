"""The project as a package: what is built holds all that its commands need, far from any checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[1]
# What a working tree holds and a clone does not, beside virtual environments.
UNTRACKED = shutil.ignore_patterns(
    ".git", "*.so", "out", "build", "dist", "__pycache__", ".*_cache", ".hypothesis", ".coverage*", "*.egg-info"
)
EXAMPLE = "vectors/tiny-example.c3gs"

Run = Callable[..., subprocess.CompletedProcess[str]]


def _build(source: Path, target: Path, *what: str) -> None:
    command = [sys.executable, "-m", "build", "--no-isolation", *what, "--outdir", target, source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def _untracked(folder: str, names: list[str]) -> set[str]:
    """The names in a folder that are not copied. An environment may have any name."""
    return UNTRACKED(folder, names) | {name for name in names if Path(folder, name, "pyvenv.cfg").exists()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `direct`, the wheel of the tree, and `sdist`, a source distribution with the wheel made of it."""
    folder = tmp_path_factory.mktemp("built")
    shutil.copytree(ROOT, folder / "tree", ignore=_untracked)
    _build(folder / "tree", folder / "direct", "--wheel")
    shutil.rmtree(folder / "tree" / "build")
    _build(folder / "tree", folder / "sdist")
    return folder


@pytest.fixture(scope="module")
def away(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs a program of an environment that has the wheel alone, in an empty folder."""
    environment = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    (wheel,) = (built / "sdist").glob("*.whl")
    pip = [environment / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, f"{wheel}[conformance]"], check=True)
    variables = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COV_", "COVERAGE"))}
    variables["PATH"] = f"{environment / 'bin'}{os.pathsep}{variables['PATH']}"

    def run(*command: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command,
            cwd=tmp_path_factory.mktemp("empty"),
            env=variables,
            capture_output=True,
            text=True,
            check=False,
        )

    return run


def test_both_distributions_are_the_same(built: Path) -> None:
    """The wheel of the source distribution is that of the tree, file by file."""
    contents = []
    for folder in ("direct", "sdist"):
        (path,) = (built / folder).glob("*.whl")
        with zipfile.ZipFile(path) as wheel:
            contents.append({n: wheel.read(n) for n in wheel.namelist()})
    direct, again = contents
    assert direct == again
    places = {"SPEC.md": "refcodec/data/SPEC.md", EXAMPLE: f"conformance/data/{EXAMPLE}"}
    places |= {name: name for name in ("refcodec/web/c3gs.js", "refcodec/web/c3gs.wasm", "refcodec/web/package.json")}
    places |= {f"refcodec/viewer/{name}": f"refcodec/viewer/{name}" for name in ("page.html", "style.css", "worker.js")}
    for name, place in places.items():
        assert direct[place] == (ROOT / name).read_bytes()
    # What type checkers read.
    for name in ("refcodec/__init__.pyi", "refcodec/py.typed"):
        assert direct[name] == (ROOT / name).read_bytes()


def test_the_source_distribution_is_whole(built: Path) -> None:
    """It holds what a clone does, so that its own tests run."""
    (path,) = (built / "sdist").glob("*.tar.gz")
    with tarfile.open(path) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    tree = built / "tree"
    there = {str(p.relative_to(tree)) for p in tree.rglob("*") if p.is_file()}
    missing = {name for name in there - packed if "egg-info" not in name}
    assert missing == {".gitignore"}


def test_explain_works_away_from_the_checkout(away: Run) -> None:
    found = away("refcodec", "explain", "432", "6.10")
    assert found.returncode == 0, found.stderr
    assert "R6.10-2" in found.stdout
    assert "conformance/c/decoder.c:" in found.stdout


def test_the_suite_runs_away_from_the_checkout(away: Run) -> None:
    """`conformance run` finds the vectors that came with it; refcodec there passes those of one clause."""
    decoder = ("refcodec", "reconstruct", "{input}", "{output}")
    found = away("conformance", "run", "--select", "requirement:R6.2-*", "--", *decoder)
    assert found.returncode == 0, found.stdout + found.stderr
