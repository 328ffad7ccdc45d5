"""The comparison of decoders on generated files."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from conformance import cli, spec_decoder
from conformance.fuzz import compare
from conformance.manifest import VECTORS
from refcodec import statuses
from refcodec.bitstream import codec

EXAMPLE = (VECTORS / "tiny-example.c3gs").read_bytes()


def refusing(code: int, offset: str, status: int) -> list[str]:
    """A decoder that refuses every file so."""
    return ["sh", "-c", f"""echo '{{"code": {code}{offset}}}' >&2; exit {status}""", "sh", "{input}", "{output}"]


def test_the_comparison_can_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """Found are a decoder that differs, one that fails otherwise, one that hangs, and one that is not canonical."""

    def fault(expected: compare.Verdict | None = None, patch: tuple[object, str, object] | None = None) -> str:
        with monkeypatch.context() as m:
            if patch:
                m.setattr(*patch)
            return str(compare.compare(EXAMPLE, expected)[1])

    assert fault() == "None"
    assert "expected was" in fault(("prologue.crc", 16))
    assert "the second decoder" in fault(patch=(spec_decoder.Decoded, "digest", "0"))
    assert "KeyError" in fault(patch=(spec_decoder, "decode", lambda data: {}["x"]))
    assert "accepted, but" in fault(patch=(codec, "emit", lambda scene: b""))
    monkeypatch.setattr(compare, "FILE_SECONDS", 1)
    assert "BudgetError" in fault(patch=(spec_decoder, "decode", lambda data: [None for _ in iter(int, 1)]))


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (["cp", "{input}", "{output}"], "the decoder ('"),
        (["true", "{input}", "{output}"], "a crash: exit status 0 without an output"),
        (["false", "{input}", "{output}"], "a crash: exit status 1"),
        (refusing(103, ', "offset": 16', 1), "the decoder ('prologue.crc', 16)"),
        (refusing(103, "", 1), "without an offset"),
        (refusing(103, ', "offset": 16', 2), "exit status 2 with prologue.crc, which is malformed"),
    ],
)
def test_another_decoder_is_compared(command: list[str], what: str) -> None:
    assert what in str(compare.compare(EXAMPLE, None, command)[1])


def test_a_right_decoder_agrees() -> None:
    right = [sys.executable, "-m", "conformance.spec_decoder", "decode", "{input}", "{output}"]
    assert compare.compare(EXAMPLE, None, right)[1] is None
    assert compare.compare(EXAMPLE[:9], None, right) == (("prologue.truncated", 9), None)


# --- the command ------------------------------------------------------------------------------------------------------


class Here:
    """A pool of this process."""

    def __init__(self, *_: object) -> None:
        pass

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    imap = staticmethod(map)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small batches, without processes of their own."""
    monkeypatch.setattr(compare.multiprocessing, "get_context", lambda kind: type("Context", (), {"Pool": Here}))
    monkeypatch.setattr(compare, "BATCH_SCENES", 2)


@pytest.mark.slow
@pytest.mark.no_cover
def test_a_batch_is_the_same_again(small: None) -> None:
    first, second = compare.run_batch(7), compare.run_batch(7)
    assert first == second
    # A fault that a drawn scene has no place for makes no file, so that the number of files depends on the seed.
    assert first.seen["accepted"] >= 2
    assert len(first.seen) >= 5
    assert not first.wrong


def test_a_disagreement_is_kept(
    small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file is written, and the command that shows it printed. Another seed continues."""
    findings = compare.Findings(compare.Counter({"accepted": 30}), [("refcodec says a, the second decoder b", b"file")])
    monkeypatch.setattr(compare, "run_batch", lambda number, command: findings)
    words = ["fuzz", "-n", "60", "--seed", "4", "--keep", str(tmp_path / "keep")]
    assert cli.main(words) == statuses.REJECTED
    kept = sorted(path.name[:2] for path in (tmp_path / "keep").iterdir())
    assert kept == ["4-", "5-"]
    out = capsys.readouterr().out
    assert "refcodec inspect" in out
    assert "60 files, 2 disagreements" in out
    assert "the next seed is 6" in out

    def interrupted(number: int, command: list[str]) -> compare.Findings:
        if number == 5:
            raise KeyboardInterrupt
        return findings

    monkeypatch.setattr(compare, "run_batch", interrupted)
    assert cli.main(words) == statuses.INTERRUPTED
    assert "--seed 5 continues" in capsys.readouterr().err


def test_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["fuzz", "-n", "1", "--keep", str(tmp_path / "keep")]
    for wrong in (["-n", "0"], ["--", str(tmp_path / "none"), "{input}", "{output}"], ["--", "true", "{input}"]):
        assert cli.main([*words, *wrong]) == statuses.USAGE
    assert "needs {output}" in capsys.readouterr().err


@pytest.mark.slow
def test_processes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["fuzz", "-n", "1", "--seed", "5", "--jobs", "1", "--keep", str(tmp_path / "keep")]) == 0
    assert "0 disagreements" in capsys.readouterr().out
    assert not (tmp_path / "keep").exists()
