"""The engine: what is done is not done again, and an interrupt at any point changes no result."""

import json
import os
import re
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from refcodec.experiments import jobs
from refcodec.experiments.cells import Look, Training
from refcodec.experiments.jobs import Job, Outcome, RunError, Step, claim, read, run_job, run_jobs
from refcodec.statuses import DONE, INTERRUPTED

STEPS = 12


def chain(folder: Path, name: str = "a", lambda_r: str = "0.01") -> Job:
    scene, file = folder / f"{name}-scene", folder / f"{name}.c3gs"
    made = scene / "training.json"
    words = ("train", "photographs", "-o", str(scene), "--lambda", lambda_r, "--steps", str(STEPS))
    steps = (
        Step(words, made, state=folder / f"{name}-scene.train-state", free=("--threads", "1")),
        Step(("encode", str(scene), "-o", str(file)), file, (made,)),
        Step(("eval", str(file), "photographs"), folder / f"{name}.eval.json", (file,), printed=True),
    )
    return Job(name, folder / f"{name}.json", steps)


def outputs(job: Job) -> list[bytes]:
    return [step.output.read_bytes() for step in job.steps]


def trained(job: Job) -> list[int]:
    return [int(number) for number in re.findall(r"^step (\d+)$", job.log.read_text(), re.MULTILINE)]


def progress(job: Job) -> int:
    """The steps of training that were begun, and the commands that are done."""
    done = sum(entry.done for entry in job.entries().values())
    return done + (len(trained(job)) if job.log.exists() else 0)


@pytest.mark.slow
@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("point", [0, 1, 4, STEPS // 2, STEPS, STEPS + 1, STEPS + 2, STEPS + 3])
def test_an_interrupt_at_any_point_changes_nothing(point: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The signal comes when so much is done. No step of the training is lost, and none is done twice."""
    monkeypatch.setenv("FAKE_STEP", "50")
    job, whole = chain(tmp_path / "cut"), chain(tmp_path / "whole")
    status = run_job(job, lambda: signal.SIGINT if progress(job) >= point else 0).status
    done = [job.is_done(step) for step in job.steps] if point else [False]
    assert (status == DONE) == all(done)
    # A step is done only after all before it.
    assert done == sorted(done, reverse=True)
    assert run_job(job, lambda: 0).status == DONE
    # A process that is interrupted while it ends may count as failed, and begins anew.
    assert trained(job) == [*range(1, STEPS + 1)] or (point == STEPS and len(trained(job)) == 2 * STEPS)
    assert run_job(whole, lambda: 0).status == DONE
    assert outputs(job) == outputs(whole)


@pytest.mark.usefixtures("fake")
def test_a_state_that_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The step begins anew. If that fails as well, the state stays for another try."""
    monkeypatch.setenv("FAKE_STEP", "50")
    job = chain(tmp_path)
    state = job.steps[0].state
    assert run_job(job, lambda: signal.SIGINT if progress(job) else 0).status == INTERRUPTED
    state.write_text("damaged")
    with monkeypatch.context() as context:
        context.setattr(jobs, "PROGRAM", (sys.executable, "-c", "raise SystemExit(64)"))
        assert run_job(job, lambda: 0).status == 64
    assert state.read_text() == "damaged"
    assert run_job(job, lambda: 0).status == DONE
    assert trained(job)[-STEPS:] == [*range(1, STEPS + 1)]
    assert [*tmp_path.glob("*.train-state*")] == []


@pytest.mark.usefixtures("fake")
def test_a_command_ends_with_its_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also after an exception of what shows its lines."""
    monkeypatch.setenv("FAKE_STEP", "50")
    job = chain(tmp_path)

    def failing(name: str, line: str) -> None:
        raise ValueError("closed")

    with pytest.raises(ValueError, match="closed"):
        run_job(job, lambda: 0, failing)
    lines = len(trained(job))
    time.sleep(0.2)
    assert len(trained(job)) == lines < STEPS


@pytest.mark.usefixtures("fake")
def test_what_is_made_again(tmp_path: Path) -> None:
    """A step whose command, inputs, other inputs or output changed, and no other."""
    job, lines = chain(tmp_path), list[str]()

    def begun(job: Job) -> list[str]:
        lines.clear()
        assert run_job(job, lambda: 0, lambda name, line: lines.append(line)).status == DONE
        return [line.partition(":")[0] for line in lines if "done in" in line]

    assert begun(job) == ["train", "encode", "eval"]
    assert begun(job) == []
    # Results do not depend on free words.
    train, encode, evaluate = job.steps
    assert begun(replace(job, steps=(replace(train, free=("--threads", "2")), encode, evaluate))) == []
    # A missing file is made again. It is the same one, so that nothing else follows.
    encode.output.unlink()
    assert begun(job) == ["encode"]
    # A changed file is an input of the next step.
    evaluate.inputs[0].write_bytes(b"longer" * 1000)
    assert begun(job) == ["eval"]
    longer = replace(train, words=(*train.words[:-1], "13"))
    assert begun(replace(job, steps=(longer, encode, evaluate))) == ["train", "encode", "eval"]
    assert begun(replace(job, steps=(longer, encode, evaluate), depends="x")) == ["train", "encode", "eval"]
    # A damaged record is no record.
    job.record.write_text("[]")
    assert begun(job) == ["train", "encode", "eval"]


@pytest.mark.usefixtures("fake")
def test_several_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failed job does not end the others, except together. A signal lets no other begin."""
    monkeypatch.setenv("FAKE_FAIL", "0.5")
    every = [chain(tmp_path, name, lambda_r) for name, lambda_r in (("a", "0.01"), ("b", "0.5"), ("c", "0.02"))]
    outcomes, stopped = run_jobs(every, 1)
    assert [outcome.status for outcome in outcomes] == [0, 70, 0]
    assert not stopped
    assert outcomes[1].text.splitlines()[0].startswith("this command failed: refcodec train photographs -o")
    assert outcomes[1].text.splitlines()[-1] == "it went wrong"
    outcomes, stopped = run_jobs(every[1:], 1, together=True)
    # Of the lines of an earlier run, none is shown.
    assert [(outcome.name, outcome.text.count("it went wrong")) for outcome in outcomes] == [("b", 1)]

    def interrupted(job: Job, wanted: jobs.Wanted) -> Outcome:
        os.kill(os.getpid(), signal.SIGTERM)
        while not wanted():
            time.sleep(0.01)
        return Outcome(job.name, INTERRUPTED)

    outcomes, stopped = run_jobs(every, 1, interrupted)
    assert ([outcome.name for outcome in outcomes], stopped) == (["a"], True)


def test_what_cannot_be_read_is_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hours of work may lie behind a folder that is not mounted."""
    job = chain(tmp_path)
    monkeypatch.setattr(jobs, "is_there", lambda path: path.stat().st_size > 0)
    outcome = run_job(job, lambda: 0)
    assert (outcome.status, "No such file" in outcome.text) == (64, True)
    monkeypatch.undo()
    job.steps[0].output.mkdir(parents=True)
    entry = {"key": job.steps[0].key(""), "done": True}
    job.record.write_text(json.dumps({"train": entry}))
    outcome = run_job(job, lambda: 0)
    assert (outcome.status, "it is a directory, not a file; remove it" in outcome.text) == (64, True)


def test_a_folder_of_another_kind(tmp_path: Path) -> None:
    claim(tmp_path / "new", "mark.json", "x")
    claim(tmp_path / "new", "mark.json", "x")
    for text in ("{", "[]", '{"format": "y"}'):
        (tmp_path / "new" / "mark.json").write_text(text)
        with pytest.raises(RunError, match="choose another one"):
            claim(tmp_path / "new", "mark.json", "x")
    (tmp_path / "letter.txt").write_text("x")
    with pytest.raises(RunError, match="choose another one"):
        claim(tmp_path, "mark.json", "x")
    assert not (tmp_path / "mark.json").exists()


def test_results_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for text in ("", "[]", "{}", '{"steps": "a"}', '{"steps": 1, "history": [3]}', "[" * 100_000):
        path.write_text(text)
        with pytest.raises(RunError, match=r"a\.json: .*; remove it"):
            read(path, Training)
    path.write_text('{"steps": 1, "history": [{"seconds": 1.5, "psnr": 20, "bytes": 3}], "other": []}')
    assert read(path, Training) == Training(1, [Look(1.5, 20.0)])
