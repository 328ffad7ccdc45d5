"""What the tests of the command line share."""

import shutil
from pathlib import Path

import pytest
from cli_inputs import Call, inputs

from refcodec.cli.main import main


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    """A command in this process: its exit status, stdout and stderr."""

    def command(*words: object) -> tuple[int, str, str]:
        status = main([str(word) for word in words])
        return status, *capsys.readouterr()

    return command


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the inputs of all commands."""
    folder = Path(shutil.copytree(inputs(), tmp_path / "place"))
    monkeypatch.chdir(folder)
    return folder
