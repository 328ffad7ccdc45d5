"""What inspect holds of a file: the file itself and little more, whatever the file claims."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from conformance.cases.checksums import resized
from conformance.cases.scenes import random_scene
from conformance.cases.target import Target
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.directory import INDEX
from refcodec.bitstream.reconstruction import digest
from refcodec.bitstream.scene import Ancillary
from refcodec.inspect.summary import document, json_lines

EXAMPLE = Path(__file__).resolve().parents[2] / "vectors" / "tiny-example.c3gs"
# Runs the program, and prints its status and its largest resident memory in bytes. What getrusage says of it would be
# that of the process that started it, if that was larger.
MEASURED = """
import sys
from pathlib import Path
from refcodec.cli.main import main
status = main(sys.argv[1:])
fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(status, int(fields["VmHWM"].split()[0]) << 10, file=sys.stderr)
"""

LINUX = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")


def claiming(chunks: int) -> bytes:
    """A file whose index has many more entries than chunk_count says. It is rejected for the length of the index."""
    target = Target(emit(random_scene(3, 12, chunk_size=5)))
    section = target.sections[INDEX]
    content = target.content(INDEX) + bytes(range(28)) * chunks
    return resized(target.data, section.type, content)


def memory(*words: str) -> tuple[int, int]:
    """Status and memory in bytes of a command."""
    run = subprocess.run(
        [sys.executable, "-c", MEASURED, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=True,
    )
    status, most = run.stderr.splitlines()[-1].split()
    return int(status), int(most)


@LINUX
@pytest.mark.slow
@pytest.mark.parametrize("options", [["--decode"], ["--json", "--decode"], ["--near", "3000"]])
def test_a_rejected_file_takes_memory_as_it_is_long(options: list[str], tmp_path: Path) -> None:
    file = tmp_path / "claimed.c3gs"
    file.write_bytes(claiming(600_000))
    status, least = memory("inspect", str(EXAMPLE), *options)
    assert status == 0
    status, most = memory("inspect", str(file), *options)
    assert status == 1
    assert most - least < 4 * file.stat().st_size


@LINUX
@pytest.mark.slow
def test_an_ancillary_section_takes_memory_as_it_is_long(tmp_path: Path) -> None:
    file = tmp_path / "ancillary.c3gs"
    file.write_bytes(
        emit(replace(parse(EXAMPLE.read_bytes()).scene, ancillary=(Ancillary(b"noTE", 0, bytes(40_000_000)),)))
    )
    least = memory("inspect", str(EXAMPLE))[1]
    for options in ([], ["--json"], ["--hex"]):
        status, most = memory("inspect", str(file), *options)
        assert status == 0
        assert most - least < 4 * file.stat().st_size


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
