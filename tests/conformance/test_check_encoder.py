"""check-encoder: a file against what its encoder meant. test_runner.py has the verdicts without that."""

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

EXAMPLE, PACKED = VECTORS / "tiny-example.c3gs", VECTORS / "tiny-packed.c3gs"


def test_a_file_as_meant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    decoded = spec_decoder.decode(EXAMPLE.read_bytes())
    output = tmp_path / "output"
    output.write_bytes(decoded.reconstruction)
    words = ["check-encoder", "--expect", decoded.digest.upper(), "--reconstruction", str(output), str(EXAMPLE)]
    assert cli.main(words) == statuses.DONE
    assert "was meant" not in capsys.readouterr().out


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


def test_warnings_and_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """SPEC 6.14 and 6.15: metadata and cameras never make a file wrong."""
    path, data = tmp_path / "odd.c3gs", bytearray(EXAMPLE.read_bytes())
    by_path = {row.path: row for row in rows(bytes(data))}
    width = next(row for name, row in by_path.items() if name.endswith("camera[0].width"))
    data[width.start : width.end] = bytes(4)
    path.write_bytes(repair(bytes(data)))
    assert cli.main(["check-encoder", str(path)]) == statuses.DONE
    assert "    warning: cameras: " in capsys.readouterr().out
    assert cli.main(["check-encoder", "--expect", "0" * 64, str(path), str(path)]) == statuses.USAGE
    assert cli.main(["check-encoder", "--expect", "7", str(path)]) == statuses.USAGE
