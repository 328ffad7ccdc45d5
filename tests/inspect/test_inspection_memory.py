"""The memory of inspect: the file and little more, regardless of the counts that the file states."""

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import pytest
from random_scenes import random_scene

from benchmarks.resident import measured
from conformance.cases.checksums import resized
from conformance.cases.target import Target
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.directory import INDEX
from refcodec.bitstream.reconstruction import digest
from refcodec.bitstream.scene import Ancillary
from refcodec.inspect.elements import outline_of
from refcodec.inspect.page import file_map
from refcodec.inspect.summary import document, json_lines

EXAMPLE = Path(__file__).resolve().parents[2] / "vectors" / "tiny-example.c3gs"
LINUX = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")


def claiming(chunks: int) -> bytes:
    """A file whose index has many more entries than chunk_count says. It is rejected for the length of the index."""
    target = Target(emit(random_scene(3, 12, chunk_size=5)))
    section = target.sections[INDEX]
    content = target.content(INDEX) + bytes(range(28)) * chunks
    return resized(target.data, section.type, content)


@LINUX
@pytest.mark.slow
@pytest.mark.parametrize("options", [["--decode"], ["--json", "--decode"], ["--near", "3000"]])
def test_a_rejected_file_takes_memory_as_it_is_long(options: list[str], tmp_path: Path) -> None:
    file = tmp_path / "claimed.c3gs"
    file.write_bytes(claiming(200_000))
    status, least = measured(["inspect", str(EXAMPLE), *options])
    assert status == 0
    status, most = measured(["inspect", str(file), *options])
    assert status == 1
    assert most - least < 4 * file.stat().st_size


@LINUX
@pytest.mark.slow
def test_an_ancillary_section_takes_memory_as_it_is_long(tmp_path: Path) -> None:
    file = tmp_path / "ancillary.c3gs"
    file.write_bytes(
        emit(replace(parse(EXAMPLE.read_bytes()).scene, ancillary=(Ancillary(b"noTE", 0, bytes(40_000_000)),)))
    )
    least = measured(["inspect", str(EXAMPLE)])[1]
    for options in ([], ["--json"], ["--hex"]):
        status, most = measured(["inspect", str(file), *options])
        assert status == 0
        assert most - least < 4 * file.stat().st_size


def test_the_map_of_many_chunks_takes_little_memory() -> None:
    """As elements, the entry of a chunk takes nearly 3 KB."""
    data = emit(random_scene(4, 3000, chunk_size=1))
    outline = outline_of(data)
    tracemalloc.start()
    try:
        drawn = list(file_map.pieces(data, outline))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(drawn) == 2 + len(outline.sections)
    assert peak < 300 * outline.header.chunk_count


@pytest.mark.parametrize("data", [EXAMPLE.read_bytes(), claiming(3), claiming(9000), b"", EXAMPLE.read_bytes()[:500]])
def test_lines_of_json_are_the_document(data: bytes) -> None:
    from refcodec.bitstream.errors import BitstreamError  # noqa: PLC0415

    try:
        verdict = digest(parse(data).scene)
    except BitstreamError as error:
        verdict = error
    facts = document(data, verdict)
    text = "\n".join(json_lines(facts))
    plain = {name: list(value) if name == "chunks" else value for name, value in facts.items()}
    assert text == json.dumps(plain, indent=1)
