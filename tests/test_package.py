"""The project as a package: the build contains everything that its commands need, without a checkout."""

import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
# Licences of packages that are often not installed, or whose metadata is ambiguous.
LICENCES = {
    "bjontegaard": "BSD-3-Clause",
    # Its classifiers name the GPL too, which applies to an Emacs mode that the wheel does not contain.
    "docutils": "LicenseRef-Public-Domain AND BSD-2-Clause",
    "gsplat": "Apache-2.0",
    "lief": "Apache-2.0",
    "matplotlib": "PSF-2.0",
    "msgspec": "BSD-3-Clause",
    "numba": "BSD-2-Clause",
    "ray": "Apache-2.0",
    "tensorboard": "Apache-2.0",
    "ziglang": "MIT",
    "zstandard": "BSD-3-Clause",
}
COPYLEFT = re.compile(r"GPL|GNU .*GENERAL PUBLIC|EUPL|CDDL|EPL-|OSL-|-SA-|SSPL|MPL|MOZILLA PUBLIC", re.IGNORECASE)
# The MPL is a copyleft of single files: only changes to the files of these packages would be under it.
ALLOWED = {"certifi", "tqdm"}
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
            command, cwd=tmp_path_factory.mktemp("empty"), env=variables, capture_output=True, text=True, check=False
        )

    return run


def _licence(name: str) -> str | None:
    """Returns the licence of a package, or None if neither the table nor its metadata states one."""
    if name in LICENCES:
        return LICENCES[name]
    try:
        metadata = importlib.metadata.metadata(name)
    except importlib.metadata.PackageNotFoundError:
        return None
    if expression := metadata.get("License-Expression"):
        return expression
    classifiers = [text for text in metadata.get_all("Classifier") or [] if text.startswith("License ::")]
    # Some packages give the text of the licence. Its first lines name it.
    return " AND ".join(filter(None, [(metadata.get("License") or "")[:100], *classifiers])) or None


def _objection(name: str, licence: str | None) -> str | None:
    """Returns why a package cannot be a dependency, or None. licence: an SPDX expression, or what a package states."""
    if licence is None:
        return f"{name}: the licence is unknown; look it up, and add it to LICENCES"
    if COPYLEFT.search(licence) and name not in ALLOWED:
        return f"{name}: {licence} is copyleft, and allowed in the extra `test` only; use another package"
    return None


def _dependencies() -> set[str]:
    """The packages that the project and its extras need, except the extra `test`, and what these need in turn."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    own = [*project["dependencies"], *(text for extra in extras if extra != "test" for text in extras[extra])]
    pending = [Requirement(text) for text in own]
    seen: set[tuple[str, str]] = set()
    while pending:
        requirement = pending.pop()
        name = canonicalize_name(requirement.name)
        for extra in {"", *requirement.extras}:
            # All extras of the project itself are in the list.
            if name == "refcodec" or (name, extra) in seen:
                continue
            seen.add((name, extra))
            try:
                needed = [Requirement(text) for text in importlib.metadata.requires(name) or []]
            except importlib.metadata.PackageNotFoundError:
                continue
            pending += [n for n in needed if n.marker is None or n.marker.evaluate({"extra": extra})]
    return {name for name, _ in seen}


def test_no_dependency_is_copyleft() -> None:
    """The package is under Apache-2.0. Neither it nor an extra, except `test`, needs a package with copyleft."""
    names = _dependencies()
    assert {"numpy", "torch", "gsplat", "markupsafe"} <= names
    assert [text for name in sorted(names) if (text := _objection(name, _licence(name)))] == []
    for licence in ("MIT AND LGPL-2.1-only", "GNU Lesser General Public License v3 or later", "MPL-2.0", None):
        assert _objection("torchac", licence)


@pytest.mark.slow
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
    pages = ("pages/base.html", "pages/parts.html", "pages/style.css", "viewer/worker.js")
    pages += tuple(f"{room}/page.html" for room in ("experiments", "inspect/page", "viewer"))
    places |= {f"refcodec/{name}": f"refcodec/{name}" for name in pages}
    for name, place in places.items():
        assert direct[place] == (ROOT / name).read_bytes()
    # What type checkers read.
    for name in ("refcodec/__init__.pyi", "refcodec/py.typed"):
        assert direct[name] == (ROOT / name).read_bytes()


@pytest.mark.slow
def test_the_source_distribution_is_whole(built: Path) -> None:
    """It holds what a clone does, so that its own tests run."""
    (path,) = (built / "sdist").glob("*.tar.gz")
    with tarfile.open(path) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    tree = built / "tree"
    there = {str(p.relative_to(tree)) for p in tree.rglob("*") if p.is_file()}
    missing = {name for name in there - packed if "egg-info" not in name}
    assert missing == {".gitignore"}


@pytest.mark.slow
def test_explain_works_away_from_the_checkout(away: Run) -> None:
    done = away("refcodec", "explain", "432", "6.10")
    assert done.returncode == 0, done.stderr
    assert "R6.10-2" in done.stdout
    assert "conformance/c/decoder.c:" in done.stdout


@pytest.mark.slow
def test_the_suite_runs_away_from_the_checkout(away: Run) -> None:
    """`conformance run` finds the vectors that came with it; refcodec there passes those of one clause."""
    decoder = ("refcodec", "reconstruct", "{input}", "{output}")
    done = away("conformance", "run", "--select", "requirement:R6.2-*", "--", *decoder)
    assert done.returncode == 0, done.stdout + done.stderr
