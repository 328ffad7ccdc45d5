"""The second decoder (conformance/spec_decoder): it agrees with refcodec, and does not import it."""

from __future__ import annotations

import ast
import io
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from conformance import cli, spec_decoder
from conformance.cases.checksums import repair, resized
from conformance.cases.fault import Refused
from conformance.cases.scenes import CONSTANT, MAIN_DIMENSIONS, random_scene
from conformance.cases.target import Target
from conformance.fuzz import compare
from conformance.fuzz.strategies import draw_fault, drawable
from conformance.spec_decoder import __main__ as second_main
from conformance.spec_decoder.watch import watched
from refcodec import statuses
from refcodec.bitstream import codec, directory, reconstruction
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.errors import REGISTRY, BitstreamError
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Ancillary
from refcodec.encoder.positions import position_model
from refcodec.encoder.weights import pack_weights
from refcodec.inspect.trace import symbol_trace
from spec import decoder

ROOT = Path(__file__).resolve().parents[2]
start_worker = compare._start_worker
SOURCES = sorted((ROOT / "conformance" / "spec_decoder").glob("*.py"))
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"

MIXED = random_scene(39, 9, chunk_size=4, lanes=Lanes(0, 1, 0))
# Files that between them have a place for every fault: ancillary sections, idle lanes, several chunks, one slice and
# more, no anchors, no planes and no frame, a later minor version, positions and weights that are packed.
TARGETS = [
    Target(codec.emit(scene))
    for scene in (
        replace(
            random_scene(32, 11, chunk_size=4, lanes=Lanes(1, 4, 1), spread=6),
            ancillary=(Ancillary(b"noTE", 1, b"hello", 2), Ancillary(b"mETa", 0, b"", 9)),
        ),
        random_scene(36, 3, Dimensions(1, (2,), 1, 1, 3, (2, 2), (2,), (), 1), chunk_size=1, lanes=Lanes(0, 2, 3)),
        random_scene(37, 0),
        replace(random_scene(38, 5, CONSTANT, chunk_size=3), minor=1, later=b"abcd"),
        # Anchors in no order: two raw chunks, and a packed one of a single anchor.
        pack_weights(replace(MIXED, position_model=position_model(MIXED.positions, 4))),
    )
]


def test_every_code_has_a_fault() -> None:
    """One at least whose parameters can be drawn."""
    assert {fault.error for fault in drawable().values()} == set(REGISTRY)


@pytest.mark.parametrize("name", sorted(drawable()))
@given(data=st.data())
@settings(max_examples=3, deadline=None)
def test_any_file_may_lack_the_place_of_a_fault(name: str, data: st.DataObject) -> None:
    """A file without anchors, planes, packed weights and so without substreams has few places."""
    empty = Target(codec.emit(random_scene(38, 0, CONSTANT)))
    assert not empty.substreams
    found = draw_fault(data.draw, empty, name)
    assert found is None or found.data != empty.data


@st.composite
def faulty(draw: st.DrawFn, error: str) -> Refused:
    """A file with any fault that has this error."""
    name = draw(st.sampled_from([name for name, fault in drawable().items() if fault.error == error]))
    targets = draw(st.permutations(TARGETS))
    found = next((refused for t in targets if (refused := draw_fault(draw, t, name)) is not None), None)
    assume(found is not None)
    assert found is not None
    return found


@pytest.mark.no_cover
@pytest.mark.requirement("D15.4-1")
@pytest.mark.parametrize("name", REGISTRY)
@settings(max_examples=8)
@given(st.data())
def test_fault(name: str, data: st.DataObject) -> None:
    """Both decoders refuse a file with one fault by its code, at its offset."""
    fault = data.draw(faulty(name))
    verdict, wrong = compare.compare(fault.data, (fault.name, fault.offset))
    assert wrong is None, wrong
    assert verdict == (name, fault.offset)
    with pytest.raises(BitstreamError) as caught:
        codec.parse(fault.data)
    error = caught.value
    assert error.exit_status == (2 if error.kind.klass == "unsupported" else 1)
    # What was found, what is allowed, where, and which clause.
    assert error.found
    assert error.allowed
    assert error.found != error.allowed
    for part in (error.found, error.allowed, error.path, f"byte {error.offset}", f"SPEC.md {error.kind.clause}"):
        assert part in str(error)


@pytest.mark.no_cover
@pytest.mark.slow
@pytest.mark.requirement("D15.4-1", "D7.7-1", "D7.8-1", "D7.9-1", "D7.10-1", "D10.2-3")
@given(compare.families())
@settings(max_examples=16)
def test_decoders_agree(made: list[tuple[bytes, compare.Verdict | None]]) -> None:
    for data, expected in made:
        _, wrong = compare.compare(data, expected)
        assert wrong is None, wrong


def test_a_main_file() -> None:
    data = codec.emit(random_scene(38, 40, replace(MAIN_DIMENSIONS, plane_size=5), chunk_size=256))
    assert compare.compare(data)[1] is None


def test_the_comparison_can_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """Found are a decoder that differs, one that fails otherwise, one that hangs, and one that is not canonical."""
    data = EXAMPLE.read_bytes()
    assert compare.compare(data)[1] is None
    assert "expected was" in str(compare.compare(data, ("prologue.crc", 16))[1])
    with monkeypatch.context() as m:
        m.setattr(spec_decoder.Decoded, "digest", "0")
        assert "the second decoder" in str(compare.compare(data)[1])
    with monkeypatch.context() as m:
        m.setattr(spec_decoder, "decode", lambda data: {}["x"])
        assert "KeyError" in str(compare.compare(data)[1])
    with monkeypatch.context() as m:
        m.setattr(codec, "emit", lambda scene: b"")
        assert "accepted, but" in str(compare.compare(data)[1])
    with monkeypatch.context() as m:
        m.setattr(compare, "FILE_SECONDS", 1)
        m.setattr(spec_decoder, "decode", lambda data: [None for _ in iter(int, 1)])
        assert "BudgetError" in str(compare.compare(data)[1])


def test_sections_grow() -> None:
    """A section that is four bytes longer, its checksum right, is refused by what holds its length."""
    target = Target(codec.emit(random_scene(5, 0)))
    found = {}
    for kind in directory.SECTIONS:
        (found[kind], _), wrong = compare.compare(resized(target.data, kind, target.content(kind) + bytes(4)))
        assert wrong is None
    implied = dict.fromkeys((directory.FRAME, directory.WEIGHTS, directory.INDEX), "directory.length")
    assert found == {**implied, directory.PLANES_SECTION: "planes.length", directory.DATA: "index.length"}


def test_traces() -> None:
    """Both decoders write the same lines, and of a file that is refused what comes before the fault."""
    scene = pack_weights(replace(MIXED, position_model=position_model(MIXED.positions, 4)))
    data = codec.emit(scene)
    first: list[str] = []
    second = io.StringIO()
    symbol_trace(data, first.append)
    with watched(second):
        spec_decoder.decode(data)
    assert "".join(first) == second.getvalue()
    places = ["weights", "planes", "masks[0", "attributes.scalings[0", "attributes.offsets[0", "attributes.features[0"]
    starts = [second.getvalue().index("\n" + place) if n else 0 for n, place in enumerate(places)]
    assert second.getvalue().startswith("weights")
    assert starts == sorted(starts)
    # Chunk after chunk: the masks of the second one come behind the attributes of the first one.
    assert second.getvalue().index("\nmasks[4,0]") > second.getvalue().rindex("\nattributes.features[3,")
    cut = io.StringIO()
    with pytest.raises(spec_decoder.C3GSError), watched(cut):
        spec_decoder.decode(data[:-1])
    assert second.getvalue().startswith(cut.getvalue())
    assert "attributes.features[3," in cut.getvalue()


def saying(code: int, offset: str, status: int) -> list[str]:
    """A decoder that refuses every file so."""
    return ["sh", "-c", f"""echo '{{"code": {code}{offset}}}' >&2; exit {status}""", "sh", "{input}", "{output}"]


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (["cp", "{input}", "{output}"], "the decoder ('"),
        (["true", "{input}", "{output}"], "a crash: exit status 0 without an output"),
        (["false", "{input}", "{output}"], "a crash: exit status 1"),
        (saying(103, ', "offset": 16', 1), "the decoder ('prologue.crc', 16)"),
        (saying(103, "", 1), "without an offset"),
        (saying(103, ', "offset": 16', 2), "exit status 2 with prologue.crc, which is malformed"),
    ],
)
def test_another_decoder_is_compared(command: list[str], what: str) -> None:
    wrong = compare.compare(EXAMPLE.read_bytes(), None, command)[1]
    assert wrong is not None
    assert what in wrong
    right = [sys.executable, "-m", "conformance.spec_decoder", "decode", "{input}", "{output}"]
    assert compare.compare(EXAMPLE.read_bytes(), None, right)[1] is None
    refused = EXAMPLE.read_bytes()[:9]
    assert compare.compare(refused, None, right) == (("prologue.truncated", 9), None)


class Here:
    """A pool of this process."""

    def __init__(self, *_: object) -> None:
        pass

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    imap = staticmethod(map)


def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small batches, without processes of their own."""
    monkeypatch.setattr(compare.multiprocessing, "get_context", lambda kind: type("Context", (), {"Pool": Here}))
    monkeypatch.setattr(compare, "BATCH_SCENES", 3)


@pytest.mark.slow
@pytest.mark.no_cover
def test_a_batch_is_the_same_again(monkeypatch: pytest.MonkeyPatch) -> None:
    in_this_process(monkeypatch)
    first, second = compare.run_batch(7), compare.run_batch(7)
    assert first == second
    # The first scene is the smallest one: it has no anchors, and no place for the fault that is drawn first.
    assert sum(first.seen.values()) >= 36
    assert not first.wrong


@pytest.mark.slow
def test_fuzz_notes_what_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    in_this_process(monkeypatch)
    state = tmp_path / "state.json"
    assert compare.run(1, 3, 1, state, tmp_path / "keep", []) == 0
    saved = json.loads(state.read_text())
    assert saved["batches"] == [3]
    assert compare.run(1, 3, 1, state, tmp_path / "keep", []) == 0
    assert json.loads(state.read_text()) == saved, "nothing is done twice"
    with pytest.raises(compare.StateError, match="seed 3"):
        compare.run(1, 4, 1, state, tmp_path / "keep", [])
    with pytest.raises(compare.StateError, match="another decoder"):
        compare.run(1, 3, 1, state, tmp_path / "keep", ["true", "{input}", "{output}"])
    assert "0 disagreements" in capsys.readouterr().out
    assert not (tmp_path / "keep").exists()


@pytest.mark.slow
def test_fuzz_of_another_decoder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    in_this_process(monkeypatch)
    words = ["fuzz", "-n", "1", "--state", str(tmp_path / "state.json"), "--keep", str(tmp_path / "keep"), "--"]
    assert cli.main([*words, *saying(102, ', "offset": 0', 1)]) == 1
    assert "the decoder ('prologue.signature', 0)" in capsys.readouterr().out
    assert list((tmp_path / "keep").iterdir())
    assert cli.main([*words, str(tmp_path / "none"), "{input}", "{output}"]) == statuses.USAGE
    assert cli.main([*words, "true", "{input}"]) == statuses.USAGE
    assert "needs {output}" in capsys.readouterr().err
    for state in (
        "",
        "{}",
        '{"seed": 0, "batches": [], "seen": {}, "wrong": 0}',
        '{"seed": 0, "command": [], "batches": 1, "seen": {}, "wrong": 0}',
    ):
        (tmp_path / "bad.json").write_text(state)
        with pytest.raises(compare.StateError, match="no state of this command"):
            compare.run(1, 0, 1, tmp_path / "bad.json", tmp_path / "keep", [])
    assert cli.main(["fuzz", "-n", "0"]) == statuses.USAGE
    assert cli.main(["fuzz", "-n", "1", "--state", str(tmp_path / "bad.json")]) == statuses.USAGE
    assert "no state of this command" in capsys.readouterr().err


# --- what it is made of -----------------------------------------------------------------------------------------------


def test_it_imports_the_standard_library_alone() -> None:
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                assert name.partition(".")[0] in sys.stdlib_module_names, f"{path.name} imports {name}"


def test_it_is_what_the_specification_says() -> None:
    """`python -m spec` would write the same file."""
    assert [made.path.name for made in decoder.made() if made.is_current()] == ["blocks.py"]


# --- its command ------------------------------------------------------------------------------------------------------


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, parts = reconstruction.digest(codec.parse(EXAMPLE.read_bytes()).scene)

    def command(*arguments: str | Path) -> tuple[int, str, str]:
        status = second_main.main([str(argument) for argument in arguments])
        return status, *capsys.readouterr()

    assert command("digest", EXAMPLE) == (0, f"whole  {whole}\n", "")
    status, out, _ = command("digest", "--parts", EXAMPLE)
    assert (status, dict(line.split() for line in out.splitlines())) == (0, {"whole": whole, **parts})
    assert command("validate", EXAMPLE) == (0, "", "")
    output = tmp_path / "output"
    assert command("decode", EXAMPLE, output) == (0, "", "")
    scene = codec.parse(EXAMPLE.read_bytes()).scene
    wanted = reconstruction.digested(scene) + b"".join(part for _, part in reconstruction.canonical_parts(scene))
    assert output.read_bytes() == wanted
    bad = tmp_path / "bad.c3gs"
    bad.write_bytes(EXAMPLE.read_bytes()[:-1])
    status, _, err = command("validate", bad)
    assert (status, json.loads(err.splitlines()[-1])["code"]) == (statuses.REJECTED, 311)
    bad.write_bytes(repair(Target(EXAMPLE.read_bytes()).put(20, b"\7")))
    assert command("digest", bad)[0] == statuses.UNSUPPORTED
    for wrong in ((), ("validate", tmp_path / "none"), ("decode", EXAMPLE, tmp_path / "none" / "output")):
        status, out, err = command(*wrong)
        assert (status, out) == (statuses.USAGE, "")
        assert err


def test_its_statuses_are_those_of_the_project() -> None:
    """It may not import them."""
    own = second_main.REJECTED, second_main.UNSUPPORTED, second_main.USAGE_ERROR
    assert own == (statuses.REJECTED, statuses.UNSUPPORTED, statuses.USAGE)


def test_command_in_a_process_of_its_own() -> None:
    words = [sys.executable, "-m", "conformance.spec_decoder", "digest", EXAMPLE]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"whole  {reconstruction.digest(codec.parse(EXAMPLE.read_bytes()).scene)[0]}\n"
    assert subprocess.run(words[:3], capture_output=True, check=False, cwd=ROOT).returncode == statuses.USAGE


def small_batches() -> None:
    """What a worker of fuzz does first, in a test."""
    start_worker()
    compare.BATCH_SCENES = 2


@pytest.mark.slow
def test_the_suite_s_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["fuzz", "-n", "1", "--seed", "5", "--jobs", "1"]
    arguments += ["--state", str(tmp_path / "state.json"), "--keep", str(tmp_path / "keep")]
    monkeypatch.setattr(compare, "_start_worker", small_batches)
    assert cli.main(arguments) == 0
    assert "0 disagreements" in capsys.readouterr().out
    # What an earlier part of the run found is not forgotten.
    saved = json.loads((tmp_path / "state.json").read_text())
    (tmp_path / "state.json").write_text(json.dumps({**saved, "wrong": 2}))
    assert cli.main(arguments) == 1

    def interrupted(*_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(compare, "run", interrupted)
    assert cli.main(arguments) == statuses.INTERRUPTED
    assert cli.main([]) == statuses.USAGE


def test_a_disagreement_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file is written, and the command that shows it printed."""

    found = compare.Findings(compare.Counter({"accepted": 3}), [("refcodec says a, the second decoder b", b"file")])
    monkeypatch.setattr(compare, "run_batch", lambda number, command: found)
    in_this_process(monkeypatch)
    assert compare.run(2, 0, 1, tmp_path / "state.json", tmp_path / "keep", []) == 1
    (kept,) = (tmp_path / "keep").iterdir()
    assert kept.read_bytes() == b"file"
    assert "refcodec inspect" in capsys.readouterr().out
