"""The decoder in C on hostile bytes: refcodec's verdicts, no sanitizer reports, bounded memory, nothing left behind."""

from __future__ import annotations

import resource
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from c_program import Program
from hostile_files import FILES, GREEDY, SCENES, changes, cuts
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance.cases.checksums import repair
from conformance.cases.target import Target
from conformance.fuzz.compare import first_verdict
from refcodec import statuses
from refcodec.bitstream import codec, reconstruction
from refcodec.bitstream.scene import Ancillary

# Address space of a program that is to need little: less than the 64 MiB that any file may take (SPEC 13.1).
LITTLE = 48 << 20


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
    for changed in changes(data.draw, FILES[name]):
        assert c_decoder.verdict(changed) == first_verdict(changed)


@pytest.mark.no_cover
@pytest.mark.parametrize("name", ["packed", "planeless"])
def test_cut_files(c_decoder: Program, name: str) -> None:
    for cut, others in cuts(FILES[name]):
        assert c_decoder.verdict(cut) == first_verdict(cut)
        for whole in others:
            assert c_decoder.verdict(whole) == first_verdict(whole)


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
