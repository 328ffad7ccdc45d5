"""Unreadable files are not missing: they are not made again, and nothing is removed for them."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

for package in ("PIL", "scipy", "matplotlib", "bjontegaard"):
    pytest.importorskip(package, reason="experiments need the packages of the extras train, render and rd")

from refcodec import statuses  # noqa: E402
from refcodec.experiments import cells, experiment, runs, work  # noqa: E402
from refcodec.experiments.plan import ExperimentError  # noqa: E402
from refcodec.experiments.runs import Command, Notes, OtherFolderError, RunError  # noqa: E402

Lock = Callable[[Path], None]


@pytest.fixture
def locked(monkeypatch: pytest.MonkeyPatch) -> Lock:
    """Makes a path that nobody may look at, also for root."""
    paths: set[str] = set()
    stat = os.stat

    def refuse(path: Any, *arguments: Any, **options: Any) -> os.stat_result:
        if os.fspath(path) in paths:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(path))
        return stat(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", refuse)
    return lambda path: paths.add(str(path))


def test_a_result_is_not_made_again(tmp_path: Path, locked: Lock) -> None:
    assert cells.read_result(tmp_path) is None
    result = tmp_path / cells.RESULT
    result.symlink_to("nowhere")
    with pytest.raises(RunError, match="a link that leads nowhere, not a file; remove it"):
        cells.read_result(tmp_path)
    result.unlink()
    result.write_text("{")
    assert cells.read_result(tmp_path) is None
    locked(result)
    with pytest.raises(PermissionError):
        cells.read_result(tmp_path)


def test_a_cell_keeps_its_work(tmp_path: Path, locked: Lock) -> None:
    """Notes that cannot be read are no reason to remove hours of work."""
    kept = tmp_path / work.WORK / "scene.train-state"
    kept.parent.mkdir()
    kept.write_text("hours")
    task = work.Task("a", tmp_path, (), {"refcodec": work.__version__}, 1, 0)
    (kept.parent / work.NOTES).write_text("{}")
    locked(kept.parent / work.NOTES)
    outcome = work.run_cell(task, lambda: 0)
    assert (outcome.status, "Permission denied" in outcome.text) == (statuses.USAGE, True)
    assert kept.read_text() == "hours"


def test_notes_and_outputs(tmp_path: Path, locked: Lock) -> None:
    command = Command("x", ("train",), tmp_path / "out", state=tmp_path / "state")
    notes = Notes.open(tmp_path / "notes", "notes.json", "a format")
    notes.begin(command)
    notes.end(command, 1.0, True)
    assert not notes.is_done(command)
    assert not notes.can_resume(command)
    for path, asks in ((command.output, notes.is_done), (tmp_path / "state", notes.can_resume)):
        path.mkdir()
        with pytest.raises(RunError, match="it is a directory, not a file; remove it"):
            asks(command)
        path.rmdir()
        path.write_text("")
        assert asks(command)
        locked(path)
        with pytest.raises(PermissionError):
            asks(command)
    locked(notes.path)
    with pytest.raises(RunError, match="Permission denied") as error:
        Notes.open(tmp_path / "notes", "notes.json", "a format")
    assert not isinstance(error.value, OtherFolderError)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.json").symlink_to("nowhere")
    with pytest.raises(OtherFolderError, match="choose another one"):
        Notes.open(tmp_path / "other", "notes.json", "a format")


def test_a_mark(tmp_path: Path, locked: Lock) -> None:
    """The advice to empty a folder is for what is certainly no experiment."""
    experiment.Folder(tmp_path / "out")
    mark = tmp_path / "out" / experiment.MARK
    locked(mark)
    with pytest.raises(PermissionError):
        experiment.Folder(tmp_path / "out")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / experiment.MARK).mkdir()
    with pytest.raises(ExperimentError, match="not the folder of an experiment"):
        experiment.Folder(tmp_path / "other")


def test_credits(tmp_path: Path) -> None:
    """A licence that is not where it should be is said: a page without it would be wrong."""
    from refcodec.experiments.demo import _credits  # noqa: PLC0415

    (tmp_path / "LICENSE").symlink_to("nowhere")
    with pytest.raises(runs.RunError, match="LICENSE: it is a link that leads nowhere"):
        _credits(tmp_path)
