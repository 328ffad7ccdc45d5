"""check-encoder: a file against what its encoder meant. test_runner.py has the verdicts without that."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conformance import cli, spec_decoder
from conformance.cases.checksums import repair
from conformance.manifest import VECTORS
from refcodec import statuses
from refcodec.bitstream import codec
from refcodec.inspect.elements import rows
from refcodec.inspect.trace import symbol_trace

EXAMPLE, PACKED = VECTORS / "tiny-example.c3gs", VECTORS / "tiny-packed.c3gs"


def _probes(path: Path) -> list[str]:
    lines: list[str] = []
    symbol_trace(path.read_bytes(), lines.append, probes=True)
    return [line for line in "".join(lines).splitlines(keepends=True) if line.startswith("probe ")]


def _changed(lines: list[str], start: str) -> str:
    """The lines, with another last number in the first one that begins so."""
    at = next(i for i, line in enumerate(lines) if line.startswith(start))
    head, _, number = lines[at].rstrip("\n").rpartition(" ")
    return "".join([*lines[:at], f"{head} {int(number) + 1}\n", *lines[at + 1 :]])


def test_a_file_as_meant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    decoded = spec_decoder.decode(EXAMPLE.read_bytes())
    output, probes = tmp_path / "output", tmp_path / "probes"
    output.write_bytes(decoded.reconstruction)
    probes.write_text("".join(_probes(EXAMPLE)))
    words = ["check-encoder", "--expect", decoded.digest.upper(), "--reconstruction", str(output)]
    assert cli.main([*words, "--probes", str(probes), str(EXAMPLE)]) == statuses.DONE
    assert "differs" not in capsys.readouterr().out


def test_a_packed_negative_zero(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """SPEC B.5: the file is valid, and its scene is not that of the encoder."""
    scene = codec.parse(PACKED.read_bytes()).scene
    networks = {name: [(w.copy(), b.copy()) for w, b in layers] for name, layers in scene.networks.items()}
    networks["colour"][1][0][1, 0] = np.float32(-0.0)
    meant = spec_decoder.decode(codec.emit(replace(scene, networks=networks, weight_scales=None, weight_forms=None)))
    output = tmp_path / "output"
    output.write_bytes(meant.reconstruction)
    words = ["check-encoder", str(PACKED)]
    assert cli.main([*words, "--expect", meant.digest]) == statuses.REJECTED
    assert f"not {meant.digest}" in capsys.readouterr().out
    assert cli.main([*words, "--reconstruction", str(output)]) == statuses.REJECTED
    out = capsys.readouterr().out
    assert "colour, layer 1, weight 0 of row 1 is 0.0 (00000000) in the file, -0.0 (80000000) was meant" in out


def test_the_number_behind_a_wrong_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A wrong context gives wrong words. The probes are compared with those of the decoders, up to the refusal."""
    data = bytearray(EXAMPLE.read_bytes())
    state = next(row for row in rows(bytes(data)) if row.path == "attributes[chunk 0].state")
    data[state.start] ^= 1
    wrong, probes = tmp_path / "wrong.c3gs", tmp_path / "probes"
    wrong.write_bytes(repair(bytes(data)))
    probes.write_text(_changed(_probes(EXAMPLE), "probe gamma[1]"))
    assert cli.main(["check-encoder", "--probes", str(probes), str(wrong)]) == statuses.REJECTED
    refused = capsys.readouterr().out
    assert "substream." in refused
    assert cli.main(["check-encoder", "--probes", str(probes), str(EXAMPLE)]) == statuses.REJECTED
    for out in (refused, capsys.readouterr().out):
        assert "the first number that differs is gamma[3] of anchor 1" in out
        assert "(SPEC 7.5.5)" in out
    probes.write_text(_changed(_probes(EXAMPLE), "probe slice.1.means[4]"))
    assert cli.main(["check-encoder", "--probes", str(probes), str(wrong)]) == statuses.REJECTED
    assert "it depends on decoded symbols" in capsys.readouterr().out
    # Without a header there are no numbers. A symbol in the trace is compared, too.
    wrong.write_bytes(b"")
    assert cli.main(["check-encoder", "--probes", str(probes), str(wrong)]) == statuses.REJECTED
    probes.write_text("planes.r1[0,0,0] 7\n")
    assert cli.main(["check-encoder", "--probes", str(probes), str(EXAMPLE)]) == statuses.REJECTED
    assert "trace: planes.r1[0,0,0] is 0 in the file, 7 was meant" in capsys.readouterr().out
    probes.write_text("probe none[0] 1\n")
    cli.main(["check-encoder", "--probes", str(probes), str(EXAMPLE)])
    assert "this file has no numbers none" in capsys.readouterr().out


def test_warnings_and_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """SPEC 6.14 and 6.15: metadata and cameras never make a file wrong."""
    path, data = tmp_path / "odd.c3gs", bytearray(EXAMPLE.read_bytes())
    found = {row.path: row for row in rows(bytes(data))}
    width = next(row for name, row in found.items() if name.endswith("camera[0].width"))
    data[width.start : width.end] = bytes(4)
    path.write_bytes(repair(bytes(data)))
    assert cli.main(["check-encoder", str(path)]) == statuses.DONE
    assert "    warning: cameras: " in capsys.readouterr().out
    assert cli.main(["check-encoder", "--expect", "0" * 64, str(path), str(path)]) == statuses.USAGE
    assert cli.main(["check-encoder", "--expect", "7", str(path)]) == statuses.USAGE
