"""Every decoder on hostile files: all have one verdict, in bounded memory, and no sanitizer reports anything."""

import contextlib
import resource
import tracemalloc
from dataclasses import replace

import pytest
from c_program import Program
from decoders import NEEDED, Decoders
from hostile_files import FILES, GREEDY, SCENES, TARGETS, UNDRAWN, changed_fields, changes, cuts, faulty, largest_planes
from hypothesis import given, settings
from hypothesis import strategies as st
from random_scenes import random_scene
from web_program import Decoder

from conformance.cases.checksums import repair, resized
from conformance.cases.scenes import CONSTANT, MAIN_DIMENSIONS, cheap, cuboid
from conformance.cases.target import Target
from conformance.fuzz import compare
from conformance.fuzz.compare import Verdict, first_verdict
from conformance.fuzz.strategies import draw_fault, drawable, scenes
from conformance.manifest import VECTORS
from refcodec.bitstream import codec, directory, reconstruction
from refcodec.bitstream.errors import REGISTRY, BitstreamError
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Ancillary, Scene

# Address space of a program that is to need little: less than the 64 MiB that any file may take (SPEC 13.1).
LITTLE = 48 << 20

pytestmark = pytest.mark.no_cover


@pytest.mark.parametrize("name", NEEDED)
def test_the_program_is_here(name: str) -> None:
    """Without it the tests of all decoders leave this one out."""
    if NEEDED[name] is None:
        pytest.skip(f"no compiler or interpreter for the decoder {name}")


def accepted(scene: Scene) -> Verdict:
    return reconstruction.digest(scene)[0], -1


# --- valid files ------------------------------------------------------------------------------------------------------


@pytest.mark.requirement("D9.3-1", "DH-1")
@pytest.mark.parametrize("name", SCENES)
def test_files(decoders: Decoders, name: str) -> None:
    decoders.agreed(FILES[name], accepted(SCENES[name]))


@pytest.mark.slow
@pytest.mark.requirement("R11.2-1", "D15.4-1")
def test_more_anchors_than_level_20_allows(plain_c_decoder: Program, decoder: Decoder) -> None:
    """A file of level 30, which the suite makes from its seed and does not store. The blocks would take hours."""
    data = codec.emit(cheap("level-30", cuboid(128, 128, 65)[: (1 << 20) + 1], profile=MAIN, chunk_size=16384))
    assert codec.parse_container(data).level == 30
    verdict = first_verdict(data)
    assert verdict[1] == -1
    for path in ("numpy", "native"):
        with compare.on_path(path):
            assert first_verdict(data) == verdict
    assert plain_c_decoder.verdict(data) == decoder.verdict(data) == verdict


@pytest.mark.requirement("D7.3-1", "D7.6-1", "D7.7-1", "D7.8-1", "D7.9-1", "D7.10-1", "D7.12-1", "D7.13-1")
@pytest.mark.requirement("D9.2-1", "D9.3-1", "D12.1-1", "D15.4-1", "DH-1")
@settings(max_examples=25)
@given(scenes(max_anchors=8))
def test_any_scene(decoders: Decoders, scene: Scene) -> None:
    decoders.agreed(codec.emit(scene), accepted(scene))


def test_other_scenes(decoders: Decoders) -> None:
    """The example, profile Main, and a render model that nobody draws."""
    main = random_scene(38, 40, replace(MAIN_DIMENSIONS, plane_size=5), chunk_size=256)
    for scene in (codec.parse((VECTORS / "tiny-example.c3gs").read_bytes()).scene, main, UNDRAWN):
        decoders.agreed(codec.emit(scene), accepted(scene))


@pytest.mark.slow
def test_the_largest_planes(decoders: Decoders) -> None:
    scene = largest_planes()
    for name, other in decoders.others.items():
        assert other.verdict(codec.emit(scene)) == accepted(scene), name


# --- one fault --------------------------------------------------------------------------------------------------------


def test_every_code_has_a_fault() -> None:
    """One at least whose parameters can be drawn."""
    assert {fault.error for fault in drawable().values()} == set(REGISTRY)


@pytest.mark.parametrize("name", sorted(drawable()))
@settings(max_examples=2)
@given(data=st.data())
def test_any_file_may_lack_the_place_of_a_fault(name: str, data: st.DataObject) -> None:
    """A file without anchors, planes, packed weights and so without substreams has few places."""
    empty = Target(codec.emit(random_scene(38, 0, CONSTANT)))
    assert not empty.substreams
    faulted = draw_fault(data.draw, empty, name)
    assert faulted is None or faulted.data != empty.data


@pytest.mark.requirement("D15.4-1", "D10.2-1")
@pytest.mark.parametrize("name", REGISTRY)
@settings(max_examples=3)
@given(data=st.data())
def test_fault(decoders: Decoders, name: str, data: st.DataObject) -> None:
    """All decoders refuse a file with one fault by its code, at its offset. The error says what is wrong."""
    fault = data.draw(faulty(name))
    decoders.agreed(fault.data, (name, fault.offset))
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


def test_sections_grow(decoders: Decoders) -> None:
    """A section that is four bytes longer, its checksum right, is refused by what holds its length."""
    target = TARGETS[2]
    verdicts = {
        kind: decoders.agreed(resized(target.data, kind, target.content(kind) + bytes(4)))[0]
        for kind in directory.SECTIONS
    }
    implied = dict.fromkeys((directory.FRAME, directory.WEIGHTS, directory.INDEX), "directory.length")
    assert verdicts == {**implied, directory.PLANES_SECTION: "planes.length", directory.DATA: "index.length"}


# --- many faults ------------------------------------------------------------------------------------------------------


@pytest.mark.requirement("D10.2-3", "DH-1")
@pytest.mark.parametrize("name", FILES)
@settings(max_examples=8)
@given(data=st.data())
def test_changed_bytes(decoders: Decoders, name: str, data: st.DataObject) -> None:
    """Of several errors, all decoders report the first one in the order of 10.1."""
    for changed in changes(data.draw, FILES[name]):
        decoders.agreed(changed)


@pytest.mark.requirement("D15.4-1", "D10.2-1", "D10.2-3", "DH-1")
@pytest.mark.parametrize("name", FILES)
@settings(max_examples=25)
@given(data=st.data())
def test_changed_fields(decoders: Decoders, name: str, data: st.DataObject) -> None:
    decoders.agreed(data.draw(changed_fields(name)))


@pytest.mark.requirement("D10.2-3", "DH-1")
@pytest.mark.parametrize("name", ["packed", "planeless"])
def test_cut_files(decoders: Decoders, name: str) -> None:
    for cut in cuts(FILES[name], 199):
        error, offset = decoders.agreed(cut)
        assert error in REGISTRY
        assert offset <= len(cut)


@pytest.mark.slow
@pytest.mark.requirement("DH-1")
@pytest.mark.parametrize("first", range(2))
def test_each_byte(decoders: Decoders, first: int) -> None:
    """Each byte changed. Without right checksums the file is refused, and only a chunk is lost behind the sections."""
    file, data = FILES["smallest"], Target(FILES["smallest"]).start(directory.DATA)
    for at in range(first, len(file), 2):
        changed = file[:at] + bytes([file[at] ^ (1 << at * 5 % 8)]) + file[at + 1 :]
        decoders.agreed(repair(changed))
        assert first_verdict(changed)[1] >= 0
        try:
            damage = [error.kind.name for error in codec.parse(changed, keep_going=True).damage.values()]
        except BitstreamError:
            damage = None
        assert damage == (None if at < data else ["chunk.crc"])


@pytest.mark.slow
@pytest.mark.requirement("D15.4-1", "D7.7-1", "D7.8-1", "D7.9-1", "D7.10-1", "D10.2-3")
@settings(max_examples=8)
@given(compare.families())
def test_what_the_fuzzer_makes(decoders: Decoders, made: list[tuple[bytes, Verdict | None]]) -> None:
    for data, expected in made:
        decoders.agreed(data, expected)


# --- memory -----------------------------------------------------------------------------------------------------------


def _little() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (LITTLE, LITTLE))


def peak(data: bytes, keep_going: bool) -> int:
    """The most bytes that refcodec takes for a file that it refuses, or whose only chunks it drops."""
    tracemalloc.start()
    try:
        with contextlib.suppress(BitstreamError):
            assert codec.parse(data, keep_going=keep_going).damage
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.requirement("D13.1-1")
@pytest.mark.parametrize("name", GREEDY)
def test_asking_for_much_allocates_little(decoders: Decoders, plain_c_decoder: Program, name: str) -> None:
    """With too little memory the program in C would end with another status, and there would be no verdict."""
    data = GREEDY[name](Target(FILES["packed"]))
    verdict = decoders.agreed(data)
    assert verdict[1] >= 0
    assert plain_c_decoder.verdict(data, preexec_fn=_little) == verdict
    assert max(peak(data, keep_going) for keep_going in (False, True)) < 2 << 20


@pytest.mark.requirement("D13.1-1")
def test_a_header_of_many_chunks_allocates_little(decoders: Decoders) -> None:
    """Profile Main, 2^24 anchors in chunks of 256, and no byte behind the header."""
    target = Target(codec.emit(random_scene(42, 0, replace(MAIN_DIMENSIONS, plane_size=2), chunk_size=256)))
    asked = target.with_values({"anchor_count": 1 << 24, "chunk_count": 1 << 16, "level": 40})
    small = repair(asked)[: target.header_end]
    assert decoders.agreed(small)[0] == "directory.length"
    assert max(peak(small, keep_going) for keep_going in (False, True)) < 2 << 20


@pytest.mark.requirement("D12.1-1", "D13.1-1")
def test_a_section_that_is_passed_over_is_not_held(plain_c_decoder: Program) -> None:
    scene = replace(SCENES["smallest"], ancillary=(Ancillary(b"noTE", 0, bytes(LITTLE), 1),))
    assert plain_c_decoder.verdict(codec.emit(scene), preexec_fn=_little) == accepted(scene)
