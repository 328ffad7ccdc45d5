"""Outputs of the decoders in each language: none overwrites an input, and failed runs change no file."""

import resource
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from c_program import COMPILER, compiled
from web_program import NODE, PROGRAM

from conformance.spec_decoder import __main__ as second
from refcodec.cli import main as refcodec
from refcodec.statuses import DONE, REJECTED, USAGE

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = (ROOT / "vectors" / "tiny-example.c3gs").read_bytes()
CAMERA = '{"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [0, 0, 4]}'

# A decoder: decodes INPUT to OUTPUT, and perhaps to a second one. Returns the exit status.
Decoder = Callable[..., int]

pytestmark = pytest.mark.no_cover


def in_c(folder: Path) -> Decoder:
    program = compiled(folder)
    return lambda *words: program.run("decode", *words).returncode


def in_javascript(*_: Path) -> Decoder:
    return lambda *words: subprocess.run([str(NODE), PROGRAM, "decode", *words], check=False).returncode


def in_python(*_: Path) -> Decoder:
    return lambda source, output, *trace: refcodec.main(
        ["reconstruct", str(source), str(output), *(f"--trace={name}" for name in trace)]
    )


def in_second_python(*_: Path) -> Decoder:
    return lambda source, output, *trace: second.main(
        ["decode", str(source), str(output), *(word for name in trace for word in ("--trace", str(name)))]
    )


def needs(program: str | None) -> pytest.MarkDecorator:
    return pytest.mark.skipif(program is None, reason="its compiler or interpreter is not here")


TWO_OUTPUTS = [in_python, in_second_python, pytest.param(in_c, marks=needs(COMPILER))]


@pytest.fixture(scope="module", params=[*TWO_OUTPUTS, pytest.param(in_javascript, marks=needs(NODE))])
def decode(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Decoder:
    made: Decoder = request.param(tmp_path_factory.mktemp("decoder"))
    return made


@pytest.fixture(scope="module", params=TWO_OUTPUTS)
def traced(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Decoder:
    made: Decoder = request.param(tmp_path_factory.mktemp("decoder"))
    return made


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Path]:
    """A file, which is as it was at the end of each test, as is the folder of it but for what the test made."""
    path = tmp_path / "scene.c3gs"
    path.write_bytes(EXAMPLE)
    yield path
    assert path.read_bytes() == EXAMPLE


def named(kind: str, path: Path) -> str:
    """Another name of a file."""
    beside = path.parent / "other"
    if kind == "the same":
        return str(path)
    if kind == "with dots":
        return f"{path.parent}/./{path.name}"
    if kind == "a symbolic link":
        beside.symlink_to(path.name)
    else:
        beside.hardlink_to(path)
    return str(beside)


NAMES = ["the same", "with dots", "a symbolic link", "a hard link"]


@pytest.mark.parametrize("kind", NAMES)
def test_an_output_is_not_the_input(decode: Decoder, scene: Path, kind: str) -> None:
    assert decode(scene, named(kind, scene)) == USAGE


@pytest.mark.parametrize("kind", NAMES)
def test_a_second_output_is_neither_the_input_nor_the_first(traced: Decoder, scene: Path, kind: str) -> None:
    output = scene.parent / "out"
    assert traced(scene, output, named(kind, scene)) == USAGE
    assert not output.exists()
    if "link" not in kind:
        assert traced(scene, output, named(kind, output)) == USAGE
        assert not output.exists()


def test_an_output_that_is_there_is_not_touched_by_a_refused_file(decode: Decoder, tmp_path: Path) -> None:
    (tmp_path / "bad.c3gs").write_bytes(EXAMPLE[:-4])
    (tmp_path / "out").touch()
    (tmp_path / "mine").write_text("mine")
    assert decode(tmp_path / "bad.c3gs", tmp_path / "mine") in (REJECTED, USAGE)
    assert decode(tmp_path / "bad.c3gs", tmp_path / "new") == REJECTED
    assert decode(tmp_path / "gone.c3gs", tmp_path / "mine") == USAGE
    assert (tmp_path / "mine").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.c3gs", "mine", "out"]


def test_a_second_output_that_is_there_is_not_touched_by_a_file_without_lines(traced: Decoder, tmp_path: Path) -> None:
    (tmp_path / "bad.c3gs").write_bytes(EXAMPLE[4:])
    (tmp_path / "mine").write_text("mine")
    assert traced(tmp_path / "bad.c3gs", tmp_path / "new", tmp_path / "mine") in (REJECTED, USAGE)
    assert (tmp_path / "mine").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.c3gs", "mine"]


def test_a_full_disk_leaves_nothing(decode: Decoder, scene: Path) -> None:
    """The limit of a file's length stands for it."""
    (scene.parent / "out").touch()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        assert decode(scene, scene.parent / "out") == USAGE
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert sorted((path.name, path.stat().st_size) for path in scene.parent.iterdir() if path != scene) == [("out", 0)]


def test_an_output_is_moved_to_its_place(decode: Decoder, scene: Path) -> None:
    """A link to it stays, and nothing is left beside it."""
    folder = scene.parent / "there"
    folder.mkdir()
    (folder / "out").touch()
    (scene.parent / "link").symlink_to("there/out")
    assert decode(scene, scene.parent / "link") == DONE
    made = (folder / "out").read_bytes()
    assert decode(scene, folder / "new") == DONE
    assert made == (folder / "new").read_bytes() != b""
    assert (scene.parent / "link").is_symlink()
    assert sorted(path.name for path in folder.iterdir()) == ["new", "out"]
    assert decode(scene, folder) == USAGE
    assert decode(scene, "/dev/null") == DONE


@needs(NODE)
@pytest.mark.parametrize("place", ["scene", "camera"])
def test_gaussians_are_not_written_over_what_is_read(scene: Path, place: str) -> None:
    camera = scene.parent / "camera.json"
    camera.write_text(CAMERA)
    output = {"scene": scene, "camera": camera}[place]
    command = [str(NODE), PROGRAM, "gaussians", scene, camera]
    assert subprocess.run([*command, output], check=False).returncode == USAGE
    assert camera.read_text() == CAMERA
    assert subprocess.run([*command, scene.parent / "out"], check=False).returncode == DONE


@needs(NODE)
@pytest.mark.parametrize("line", ["x", "7", "null", "{}", '{"id": 1, "input": 2, "output": "o"}'])
def test_a_request_that_is_none_is_no_verdict(line: str) -> None:
    ended = subprocess.run([str(NODE), PROGRAM, "serve"], input=line, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (USAGE, "")
    assert len(ended.stderr.splitlines()) == 1
