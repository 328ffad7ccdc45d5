"""The decoder in C on hostile bytes: refcodec's verdict, silent sanitizers, bounded memory, and nothing left behind."""

from __future__ import annotations

import resource
import struct
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from c_program import Program
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance.cases.checksums import repair
from conformance.cases.scenes import CONSTANT, PLANELESS, SMALLEST, UNENCODED, packed_weights, random_scene
from conformance.cases.target import Target
from conformance.fuzz.compare import first_verdict
from conformance.fuzz.strategies import draw_mutation, draw_splice
from refcodec import statuses
from refcodec.bitstream import codec, directory, reconstruction
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.encoder.positions import position_model

# Address space of a program that is to need little: less than the 64 MiB that any file may take (SPEC 13.1).
LITTLE = 48 << 20


def _scenes() -> dict[str, Scene]:
    """Every section and form, with and without planes and frequencies, several chunks, and more than is known."""
    mixed = random_scene(39, 9, chunk_size=4, lanes=Lanes(0, 1, 0))
    sections = (
        Ancillary(b"noTE", 3, b"hello", 0),
        Ancillary(b"mETA", 0, bytes(4), 2),
        Ancillary(b"cAMS", 0, b"x", 5),
    )
    return {
        "raw": random_scene(31, 7, chunk_size=3),
        "packed": packed_weights(replace(mixed, position_model=position_model(mixed.positions, 4))),
        "planeless": replace(random_scene(32, 7, PLANELESS), ancillary=sections),
        "unencoded": random_scene(33, 5, UNENCODED),
        "constant": replace(random_scene(34, 6, CONSTANT), minor=1, later=b"\1\2\3\4"),
        "smallest": random_scene(35, 3, SMALLEST, chunk_size=1),
        "empty": random_scene(36, 0, SMALLEST),
    }


SCENES = _scenes()
FILES = {name: codec.emit(scene) for name, scene in SCENES.items()}


@pytest.mark.no_cover
@pytest.mark.parametrize("name", FILES)
def test_the_files_decode(c_decoder: Program, name: str) -> None:
    """Both the digests and the reconstruction, whole and part by part."""
    scene = SCENES[name]
    file, output = c_decoder.folder / "valid.c3gs", c_decoder.folder / "output"
    file.write_bytes(FILES[name])
    whole, parts = reconstruction.digest(scene)
    said = dict(line.split() for line in c_decoder.run("digest", file).stdout.decode().splitlines())
    assert said == {"whole": whole, **parts}
    assert c_decoder.run("decode", file, output).returncode == statuses.DONE
    expected = reconstruction.digested(scene) + b"".join(part for _, part in reconstruction.canonical_parts(scene))
    assert output.read_bytes() == expected


@pytest.mark.no_cover
@pytest.mark.parametrize("name", FILES)
@settings(max_examples=15)
@given(st.data())
def test_changed_bytes(c_decoder: Program, name: str, data: st.DataObject) -> None:
    file = FILES[name]
    at = data.draw(st.integers(0, len(file) - 1))
    flipped = file[:at] + bytes([file[at] ^ 1 << data.draw(st.integers(0, 7))]) + file[at + 1 :]
    for changed in (flipped, draw_mutation(data.draw, file), draw_splice(data.draw, file)):
        assert c_decoder.verdict(changed) == first_verdict(changed)


@pytest.mark.no_cover
@pytest.mark.parametrize("name", ["packed", "planeless"])
def test_cut_files(c_decoder: Program, name: str) -> None:
    """Cut at the borders of the elements that tell how much follows, and at many other places."""
    target = Target(FILES[name])
    borders = [0, 19, 20, target.header_end, *(section.start for section in target.header.sections)]
    borders += [target.chunk_at(chunk) + more for chunk in range(target.header.chunk_count) for more in (0, 1, 16)]
    for length in {*borders, *range(3, len(target.data), 61)}:
        cut = target.data[:length]
        assert c_decoder.verdict(cut) == first_verdict(cut)
        for whole in (cut + b"\0", repair(cut) if length >= 20 else cut):
            assert c_decoder.verdict(whole) == first_verdict(whole)


def _wide(target: Target, path: str) -> bytes:
    """The file with all bits of a field set, checksums right."""
    element = target.element(path)
    return repair(target.put(element.start, b"\xff" * (element.end - element.start)))


GREEDY: dict[str, Callable[[Target], bytes]] = {
    "anchor_count": lambda t: _wide(t, "anchor_count"),
    "chunk_count": lambda t: _wide(t, "chunk_count"),
    "section_count": lambda t: _wide(t, "section_count"),
    "plane_size": lambda t: _wide(t, "dimensions.plane_size"),
    "weights": lambda t: t.with_values({f"directory[{t.sections[directory.WEIGHTS].number}].length": 1 << 48}),
    "planes": lambda t: t.with_values({f"directory[{t.sections[directory.PLANES_SECTION].number}].length": 1 << 48}),
    "data": lambda t: t.with_values({f"directory[{t.sections[directory.DATA].number}].length": 1 << 48}),
    "a plane": lambda t: _wide(t, "planes.length[1]"),
    "words": lambda t: _wide(t, "attributes[chunk 0].word_count"),
    "positions": lambda t: _wide(t, "chunk[0].position_length"),
    "a chunk and all of them": lambda t: t.with_values(
        {
            "index.entry[0].length": 0xFFFFFFFC,
            f"directory[{t.sections[directory.DATA].number}].length": 0xFFFFFFFC
            + sum(t.value(f"index.entry[{n}].length") for n in range(1, t.header.chunk_count)),
        }
    ),
}


def _little() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (LITTLE, LITTLE))


@pytest.mark.requirement("D13.1-1")
@pytest.mark.no_cover
@pytest.mark.parametrize("name", GREEDY)
def test_asking_for_much_allocates_little(plain_c_decoder: Program, name: str) -> None:
    """With too little memory the program would end with another status, and there would be no verdict."""
    data = GREEDY[name](Target(FILES["packed"]))
    verdict = plain_c_decoder.verdict(data, preexec_fn=_little)
    assert verdict == first_verdict(data)
    assert verdict[1] >= 0


@pytest.mark.requirement("D12.1-1", "D13.1-1")
@pytest.mark.no_cover
def test_a_section_that_is_passed_over_is_not_held(plain_c_decoder: Program) -> None:
    scene = replace(SCENES["smallest"], ancillary=(Ancillary(b"noTE", 0, bytes(LITTLE), 1),))
    assert plain_c_decoder.verdict(codec.emit(scene), preexec_fn=_little) == (reconstruction.digest(scene)[0], -1)


def test_a_pipe_is_read(c_decoder: Program) -> None:
    """Nothing is sought, so bytes may arrive one after the other."""
    piped = c_decoder.run("digest", "/dev/stdin", input=FILES["raw"])
    assert piped.stdout.split()[1].decode() == reconstruction.digest(SCENES["raw"])[0]
    assert c_decoder.run("digest", "/dev/stdin", input=FILES["raw"][:-1]).returncode == statuses.REJECTED


def test_a_refused_file_leaves_the_output_alone(c_decoder: Program) -> None:
    """A fault of the last chunk: all others had been decoded."""
    target = Target(FILES["raw"])
    last = target.part("attributes", target.header.chunk_count - 1)[0]
    file, output = c_decoder.folder / "refused.c3gs", c_decoder.folder / "output"
    file.write_bytes(repair(target.put(last, struct.pack("<I", 0))))
    output.write_bytes(b"from before")
    assert c_decoder.run("decode", file, output).returncode == statuses.REJECTED
    assert output.read_bytes() == b"from before"


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("digest",),
        ("encode", "file.c3gs"),
        ("decode", "file.c3gs"),
        ("digest", "nothing.c3gs"),
        ("digest", "."),
        ("decode", "file.c3gs", "nowhere/output"),
        ("decode", "file.c3gs", "/dev/full"),
        ("decode", "/dev/stdin", "output"),
    ],
)
def test_wrong_usage(c_decoder: Program, arguments: tuple[str, ...]) -> None:
    (c_decoder.folder / "file.c3gs").write_bytes(FILES["raw"])
    with subprocess.Popen(["cat", "file.c3gs"], stdout=subprocess.PIPE, cwd=c_decoder.folder) as pipe:
        ended = c_decoder.run(*arguments, cwd=c_decoder.folder, stdin=pipe.stdout)
    assert ended.returncode == statuses.USAGE
    assert ended.stderr.startswith(b"decoder: ")
    assert ended.stdout == b""


@pytest.mark.parametrize("tables", [b"", bytes(99840), bytes(200000)])
def test_other_tables(c_decoder: Program, tmp_path: Path, tables: bytes) -> None:
    file = tmp_path / "tables-0.bin"
    file.write_bytes(tables)
    (c_decoder.folder / "file.c3gs").write_bytes(FILES["raw"])
    for path in (file, tmp_path / "none"):
        ended = c_decoder.run("digest", c_decoder.folder / "file.c3gs", env={"C3GS_TABLES": str(path)})
        assert ended.returncode == statuses.USAGE
