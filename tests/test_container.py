"""The commands with few permissions: the package is read-only, there is no home, no cache, no shared memory.

A container runs programs in this way. A command works there, or it reports in one line what is missing.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"
PHOTOGRAPHS = ROOT / "examples" / "photographs" / "caliterra"
NOBODY = 65534

# There are no semaphores, as without /dev/shm. torch alone needs a folder for temporary files.
PRELUDE = """
import _multiprocessing, sys, tempfile
class Refused:
    SEM_VALUE_MAX = 1
    def __init__(self, *_, **__):
        raise OSError(38, "Function not implemented")
_multiprocessing.SemLock = Refused
tempfile.tempdir = "." if sys.argv[1] == "train" and "no-place" not in sys.argv else "../site/tmp"
from refcodec.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
# The first words of a command that root's rights over permissions are taken from.
WITHOUT_RIGHTS = ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner", "--inh-caps=-all")

Run = Callable[..., subprocess.CompletedProcess[str]]


def identity(user: int) -> dict[str, Any]:
    """Of a process of a user and its group alone: those of root's group may not do what others may."""
    return {"user": user, "group": user, "extra_groups": [], "capture_output": True}


def compiled_root() -> Path | None:
    """The folder of compiled functions that the other tests fill, if numba is installed."""
    try:
        from refcodec.rendering import compiled  # noqa: PLC0415
    except ImportError:
        return None
    return compiled.root()


def may_be(user: int) -> bool:
    """Whether Python can run as another user: its own files may lie where that user cannot read them."""
    if os.geteuid() != 0:
        return False
    try:
        done = subprocess.run([sys.executable, "-c", "import numpy"], **identity(user), check=False)
    except OSError:
        return False
    return done.returncode == 0


@pytest.fixture(scope="module", params=["the same user", "another user"])
def contained(request: pytest.FixtureRequest) -> Iterator[Run]:
    """Runs refcodec from a read-only copy, in a folder that may be written."""
    if request.param == "another user" and not may_be(NOBODY):
        pytest.skip("Python cannot run as another user here")
    if request.param == "the same user" and os.geteuid() == 0 and shutil.which(WITHOUT_RIGHTS[0]) is None:
        pytest.skip("root may write everywhere")
    # pytest closes the folders above its own to others whenever it starts.
    folder = Path(tempfile.mkdtemp(prefix="contained-"))
    folder.chmod(0o755)
    site, work = folder / "site", folder / "work"
    site.mkdir()
    work.mkdir()
    shutil.copytree(ROOT / "refcodec", site / "refcodec", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copyfile(ROOT / "SPEC.md", site / "SPEC.md")
    # Compiling takes most of the time of training. Only `render` does it here.
    cache = compiled_root()
    first: tuple[str, ...] = ()
    who: dict[str, Any] = {"capture_output": True}
    if request.param == "another user":
        who = identity(NOBODY)
        os.chown(work, NOBODY, NOBODY)
        if cache is not None and cache.exists():
            cache = Path(shutil.copytree(cache, folder / "cache"))
            for path in (cache, *cache.rglob("*")):
                os.chown(path, NOBODY, NOBODY)
    elif os.geteuid() == 0:
        first = WITHOUT_RIGHTS
    places = [site, *site.rglob("*")]
    for path in places:
        path.chmod(0o555 if path.is_dir() else 0o444)
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(site), "HOME": str(site / "home")}
    environment |= {"NUMBA_NUM_THREADS": "2", "LC_ALL": "C"}

    def run(*words: str | Path, **more: object) -> subprocess.CompletedProcess[str]:
        command = [*first, sys.executable, "-c", PRELUDE, *map(str, words)]
        variables = environment
        if words[0] == "render":
            # It compiles anew, without optimisation, which takes a third less.
            variables = {**environment, "NUMBA_OPT": "0"}
        elif cache is not None:
            variables = {**environment, "NUMBA_CACHE_DIR": str(cache)}
        return subprocess.run(  # type: ignore[call-overload, no-any-return]
            command, cwd=work, env=variables, text=True, check=False, **who, **more
        )

    yield run
    for path in places:
        path.chmod(0o755)
    shutil.rmtree(folder)


def test_coding(contained: Run) -> None:
    for words in (
        ("validate", EXAMPLE),
        ("digest", EXAMPLE),
        ("decode", EXAMPLE, "-o", "scene"),
        ("encode", "scene", "-o", "again.c3gs"),
        ("inspect", "again.c3gs", "--progress"),
    ):
        done = contained(*words)
        assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
    assert contained("decode", EXAMPLE, "-o", "../site/scene").returncode == 64


@pytest.mark.slow
def test_drawing_and_learning(contained: Run) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("numba")
    for words in (
        ("train", PHOTOGRAPHS, "-o", "trained", "--steps", "3", "--size", "48", "--progress"),
        ("encode", "trained", "-o", "trained.c3gs"),
        ("render", "trained.c3gs", "-o", "images"),
        ("eval", "trained.c3gs", PHOTOGRAPHS, "--size", "48"),
    ):
        done = contained(*words)
        assert done.returncode == 0, done.stderr
        if words[0] in ("render", "encode"):
            assert ("NUMBA_CACHE_DIR" in done.stderr) == (words[0] == "render")
        assert "Warning" not in done.stderr
    done = contained("train", PHOTOGRAPHS, "-o", "no-place", "--steps", "3", "--size", "48")
    assert done.returncode == 64
    assert "tmp: Permission denied" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_user_without_a_home_gets_no_folder_of_that_name(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    code = "import os\nos.path.expanduser = lambda path: path\nfrom refcodec.rendering import compiled, tiles\n"
    code += "print(compiled.is_kept())"
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"
    assert list(tmp_path.iterdir()) == []


# --- the standard streams ---------------------------------------------------------------------------------------------


def shell(line: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A line of sh in which $R is refcodec."""
    command = ["sh", "-c", line.replace("$R", f"'{sys.executable}' -m refcodec")]
    variables = {**os.environ, **environment}
    return subprocess.run(command, cwd=cwd, env=variables, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("$R validate a.c3gs >&-", 0),
        ("$R validate a.c3gs <&- >&- 2>&-", 0),
        ("$R digest a.c3gs >&-", 0),
        ("$R decode a.c3gs -o scene <&- >&- 2>&-", 0),
        ("$R validate b.c3gs >&- 2>&-", 1),
        ("$R validate b.c3gs 2>/dev/full", 1),
        ("$R validate missing 2>/dev/full", 64),
        ("$R validate missing 2>&-", 64),
        ("$R validate a.c3gs >/dev/full", 64),
        ("$R inspect a.c3gs --hex >/dev/full", 64),
        ("$R digest a.c3gs --progress 2>/dev/full", 0),
    ],
)
def test_streams_that_take_nothing(line: str, status: int, tmp_path: Path) -> None:
    shutil.copyfile(EXAMPLE, tmp_path / "a.c3gs")
    (tmp_path / "b.c3gs").write_bytes(b"no file of C3GS")
    if "/dev/full" in line and not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    done = shell(line, tmp_path)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    assert len(done.stderr.splitlines()) <= 1


def test_a_file_gets_nothing_of_a_closed_stream(tmp_path: Path) -> None:
    """A file that is opened first would get the number of stdout, and what is printed would go into it."""
    shutil.copyfile(EXAMPLE, tmp_path / "a.c3gs")
    assert shell("$R reconstruct a.c3gs one && $R reconstruct a.c3gs two >&- 2>&-", tmp_path).returncode == 0
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


@pytest.mark.parametrize("name", ["tïny.c3gs", "a\x1b[31m\nb.c3gs", "x\udcff.c3gs", "it's \\ \t.c3gs"])
def test_names_that_a_terminal_cannot_show(name: str, tmp_path: Path) -> None:
    """They are printed in one line of plain characters, and the hint for a shell still names the file."""
    shutil.copyfile(EXAMPLE, tmp_path / name)
    command = [sys.executable, "-m", "refcodec"]
    plain = {**os.environ, "LC_ALL": "C", "PYTHONIOENCODING": "ascii"}

    def run(*words: str, env: dict[str, str] = plain) -> subprocess.CompletedProcess[bytes]:
        return subprocess.run([*command, *words], cwd=tmp_path, env=env, capture_output=True, check=False)

    for words in (("validate",), ("inspect",), ("inspect", "--json")):
        done = run(*words, name)
        assert done.returncode == 0, done.stderr
        assert all(byte == 10 or 32 <= byte < 127 for byte in done.stdout)
    assert len(run("validate", name).stdout.splitlines()) == 1
    (tmp_path / name).write_bytes(EXAMPLE.read_bytes()[:-1])
    refused = run("validate", name)
    assert refused.returncode == 1
    assert all(byte == 10 or 32 <= byte < 127 for byte in refused.stderr)
    assert refused.stderr.splitlines()[1].startswith(b"{")
    # The hint of a terminal that has the characters, as it stands, in a shell that knows such quotes.
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("there is no bash")
    line = run("validate", name, env={**os.environ, "PYTHONUTF8": "1"}).stderr.decode().splitlines()[0]
    hint = line.partition("To see the spot: refcodec ")[2]
    again = subprocess.run(
        [bash, "-c", f"'{sys.executable}' -m refcodec {hint}"], cwd=tmp_path, capture_output=True, check=False
    )
    assert again.returncode == 1
    assert b"cannot read" not in again.stderr
