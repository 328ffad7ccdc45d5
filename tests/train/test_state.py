"""The saved state of training: written completely or not at all, and loaded unchanged or refused."""

import contextlib
import errno
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from refcodec.bitstream.networks import BoundError
from refcodec.cli.main import main
from refcodec.folder.read import read_folder
from refcodec.folder.write import write_folder
from refcodec.photographs.photographs import PhotographSet
from refcodec.train import command, state
from refcodec.train.command import state_path
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.state import Keeper, StateError, restore, save
from refcodec.train.trainer import Trainer

MANY = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


class Kept:
    """A saved state, and how to load another one in its place."""

    def __init__(self, photographs: PhotographSet, chosen: TrainSettings, path: Path) -> None:
        self.photographs, self.chosen, self.path, self.said = photographs, chosen, path, ""
        trainer = Trainer(photographs, chosen)
        trainer.run(lambda t: None)
        save(trainer, path)
        self.data = path.read_bytes()
        with safe_open(path, "pt") as file:
            self.notes = file.metadata()
            # Copies: the file is written over.
            self.tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
        self.values = json.loads(self.notes["values"])

    def load(self) -> dict[str, Any] | None:
        """What a training has that loads the file at the path, or None if it is refused."""
        trainer = Trainer(self.photographs, self.chosen)
        try:
            restore(trainer, self.path)
        except StateError as error:
            self.said = str(error)
            return None
        return trainer.state()

    def write(self, tensors: dict[str, Tensor], values: dict[str, Any], **notes: str) -> None:
        """Writes a state with a right checksum."""
        metadata = {**self.notes, "values": json.dumps(values), **notes}
        tensors = {name: value.clone().contiguous() for name, value in tensors.items()}
        metadata["sha256"] = state._checksum(metadata, tensors)
        save_file(tensors, self.path, metadata)


@pytest.fixture(scope="module")
def kept(photographs: PhotographSet, tmp_path_factory: pytest.TempPathFactory) -> Kept:
    """At the end of a training, when every part has a state. It begins in a moment, with few points of known voxels."""
    changes = {"steps": 40, "start.voxel": 8.0, "growth.most": 120, "weights.judges": 1}
    few = replace(photographs, points=photographs.points[::40], colours=photographs.colours[::40])
    chosen = varied(TrainSettings(), changes)
    return Kept(few, chosen, tmp_path_factory.mktemp("kept") / "scene.train-state")


def same(one: dict[str, Any], two: dict[str, Any]) -> bool:
    return one.keys() == two.keys() and all(
        torch.equal(one[name], two[name]) if isinstance(one[name], Tensor) else one[name] == two[name] for name in one
    )


def test_a_state_is_loaded_as_it_was_saved(kept: Kept) -> None:
    """Tensors are no views of the file, which may change later."""
    kept.write(kept.tensors, kept.values)
    trainer = Trainer(kept.photographs, kept.chosen)
    restore(trainer, kept.path)
    assert same(trainer.state(), {**kept.tensors, **kept.values})
    # Integers are not floats of the same value.
    restored = trainer.state()
    assert json.dumps({name: restored[name] for name in kept.values}) == json.dumps(kept.values)
    with kept.path.open("r+b") as file:
        file.write(bytes(kept.path.stat().st_size))
    assert same(trainer.state(), {**kept.tensors, **kept.values})


@MANY
@given(st.data())
def test_changed_bytes_are_refused_or_mean_the_same(kept: Kept, data: st.DataObject) -> None:
    """What a training is restored from has the values that were saved."""
    at = data.draw(st.one_of(st.integers(0, 4000), st.integers(0, len(kept.data) - 1)))
    end = data.draw(st.sampled_from([at, at + 1, at + 8, len(kept.data)]))
    kept.path.write_bytes(kept.data[:at] + data.draw(st.binary(max_size=8)) + kept.data[end:])
    with contextlib.suppress(StateError):
        before, stored = state._read(kept.path)
        assert before == json.loads(kept.notes["of"])
        assert same(dict(stored._values), {**kept.tensors, **kept.values})


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-10, 1 << 70) | st.floats(allow_nan=False) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)


def changed(tensor: Tensor, data: st.DataObject) -> Tensor:
    """Another shape, another dtype, or another number."""
    kind = data.draw(st.sampled_from(["shape", "flat", "empty", "dtype", "number"]))
    if kind == "shape":
        return torch.cat([tensor, tensor]) if tensor.dim() else tensor.reshape(1)
    if kind == "flat":
        return tensor.reshape(-1)
    if kind == "empty":
        return tensor[:0] if tensor.dim() else torch.zeros(0)
    if kind == "dtype":
        return tensor.to(data.draw(st.sampled_from([torch.float64, torch.int32, torch.bool, torch.bfloat16])))
    out = tensor.clone().reshape(-1)
    number = data.draw(st.sampled_from([-1.0, 0.0, 1e30, float("nan"), float("inf"), -1e30]))
    if len(out):
        out[data.draw(st.integers(0, len(out) - 1))] = number if out.dtype.is_floating_point else int(data.draw(INTS))
    return out.reshape(tensor.shape)


INTS = st.sampled_from([0, 1, 200])


@MANY
@given(st.data())
def test_what_is_checked_does_not_rest_on_the_checksum(kept: Kept, data: st.DataObject) -> None:
    """One value is changed and the checksum is right: the training has that value then, or the state is refused."""
    tensors, values = dict(kept.tensors), dict(kept.values)
    name = data.draw(st.sampled_from(sorted({*tensors, *values})))
    kind = data.draw(st.sampled_from(["remove", "rename", "json", "change"]))
    chosen: dict[str, Any] = tensors if name in tensors else values
    if kind == "remove" or (kind == "json" and name in tensors):
        del chosen[name]
        if kind == "json":
            values[name] = data.draw(JSON)
    elif kind == "rename":
        chosen[data.draw(st.sampled_from(["", "x", "scaffold/x", "rate/model.x", "é"]))] = chosen.pop(name)
    elif name in tensors:
        tensors[name] = changed(tensors[name], data)
    else:
        values[name] = data.draw(JSON)
    kept.write(tensors, values)
    loaded = kept.load()
    assert loaded is None or same(loaded, {**tensors, **values})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("clock/done", done) for done in (-5, 41, True)),
        *(("clock/steps", 41), ("clock/first", 40), ("clock/base", 1.5)),
        *(("looks/pace/means", [1.0]), ("looks/pace/counts", [1.0, -1])),
        *(("order", order) for order in ([0, 0], [1000])),
        ("weights/gridded", 1),
        ("looks/history", [{}]),
        ("looks/seconds", -1),
    ],
)
def test_values_out_of_range_are_refused(name: str, value: object, kept: Kept) -> None:
    kept.write(kept.tensors, {**kept.values, name: value})
    assert kept.load() is None
    assert name in kept.said
    assert str(kept.path) in kept.said
    assert "\n" not in kept.said


def test_other_trainings_versions_and_files_are_refused(kept: Kept, tmp_path: Path) -> None:
    trainer, photographs = Trainer(kept.photographs, kept.chosen), kept.photographs
    kept.write(kept.tensors, kept.values)
    with pytest.raises(StateError, match=r"other settings; rate\.lambda_r is 0\.004, not 0\.01$"):
        restore(Trainer(photographs, varied(kept.chosen, {"rate.lambda_r": 0.01})), kept.path)
    with pytest.raises(StateError, match=r"other photographs$"):
        restore(Trainer(replace(photographs, train=photographs.train[1:]), kept.chosen), kept.path)
    masked = tuple(replace(p, load_mask=lambda: torch.ones(75, 100).bool().numpy()) for p in photographs.train)
    with pytest.raises(StateError, match=r"other masks$"):
        restore(Trainer(replace(photographs, train=masked), kept.chosen), kept.path)
    kept.write(kept.tensors, kept.values, version="1")
    with pytest.raises(StateError, match=r"its format is .* remove it, or write the scene to another folder$"):
        restore(trainer, kept.path)
    save_file(kept.tensors, kept.path)
    with pytest.raises(StateError, match="its format is"):
        restore(trainer, kept.path)
    with pytest.raises(StateError, match="a directory, not a file"):
        restore(trainer, tmp_path)
    kept.path.write_bytes(kept.data[:-1] + bytes([kept.data[-1] ^ 1]))
    with pytest.raises(StateError, match="checksum"):
        restore(trainer, kept.path)
    kept.path.write_bytes(b"no state")
    with pytest.raises(StateError, match="cannot be read"):
        restore(trainer, kept.path)


# --- a state or a scene that cannot be written ------------------------------------------------------------------------


def words(examples: Path, output: Path) -> list[str]:
    options = ["--steps", "24", "--size", "64", "--set", "start.anchors=800", "--set", "growth.most=900"]
    return ["train", str(examples / "caliterra"), "-o", str(output), *options, "--set", "looks.save_seconds=0"]


@pytest.mark.slow
def test_a_state_that_cannot_be_saved_does_not_end_the_training(examples: Path, tmp_path: Path) -> None:
    """The state is larger than a file may be, as on a full disk. The scene's files are not."""
    limit = 600_000
    run = subprocess.run(
        [sys.executable, "-m", "refcodec", *words(examples, tmp_path / "scene")],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, run.stderr.count("cannot be saved")) == (0, 1), run.stderr
    assert [line.split(":")[0] for line in run.stderr.splitlines() if not line.startswith("train: ")] == ["refcodec"]
    assert read_folder(tmp_path / "scene").anchor_count > 100
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene"]


def test_the_last_good_state_is_kept(kept: Kept, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trainer, path = Trainer(kept.photographs, kept.chosen), tmp_path / "state"
    keep = Keeper(trainer, path)
    keep()
    before = path.read_bytes()
    (tmp_path / "state.new").mkdir()
    trainer.clock.done = 7
    keep()
    keep()
    assert path.read_bytes() == before
    messages = capsys.readouterr().err.splitlines()
    assert len(messages) == 1
    assert "the one before is kept" in messages[0]
    # It is tried again.
    (tmp_path / "state.new").rmdir()
    keep()
    assert path.read_bytes() != before


def test_a_state_that_cannot_be_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is not taken for one that is missing, and does not end a training that cannot save itself."""
    path, look = tmp_path / "state", os.stat
    for make, words in (
        (lambda: None, "there is no saved state"),
        (lambda: path.symlink_to("nowhere"), "it is a link that leads nowhere, not a file"),
        (lambda: (path.unlink(), path.mkdir()), "it is a directory, not a file"),
    ):
        make()
        with pytest.raises(StateError, match=words):
            restore(cast(Any, None), path)

    def refuse(place: Any, *arguments: Any, **options: Any) -> os.stat_result:
        if os.fspath(place) == str(path):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return look(place, *arguments, **options)

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(os, "stat", refuse)
    with pytest.raises(StateError, match="cannot check whether there is a saved state"):
        restore(cast(Any, None), path)
    monkeypatch.setattr(state, "save", failing(lambda folder: True))
    capsys.readouterr()
    Keeper(cast(Any, None), path)()
    assert f"cannot check whether {path} exists (Permission denied)" in capsys.readouterr().err
    with pytest.raises(OSError, match=f"nor among the temporary files .*cannot check whether {path} exists"):
        state.write_somewhere(lambda folder: failing(lambda _: True)(None, folder), tmp_path / "scene", path)


def faults(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What is said of faults: other lines tell how the training goes."""
    return [line for line in capsys.readouterr().err.splitlines() if not line.startswith("train: ")]


def failing(places: Callable[[Path], bool]) -> Callable[..., None]:
    def write(scene: Any, folder: Path) -> None:
        if places(folder):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
        write_folder(scene, folder)

    return write


def failing_with(error: Exception) -> Callable[..., Any]:
    def fail(*_: object) -> None:
        raise error

    return fail


@pytest.mark.slow
def test_a_scene_that_cannot_be_written_gets_a_second_place(
    examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output, other = tmp_path / "scene", tmp_path / "other"
    other.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(other))
    monkeypatch.setattr(command, "write_folder", failing(lambda folder: folder == output))
    assert main(words(examples, output)) == 64
    messages = faults(capsys)
    assert len(messages) == 1
    second = Path(messages[0].rpartition("; it is in ")[2])
    assert second.parent.parent == other
    assert read_folder(second).anchor_count > 100
    assert (second / "training.json").is_file()
    # Without any place the state goes on.
    monkeypatch.setattr(command, "write_folder", failing(lambda folder: True))
    assert main([*words(examples, output), "--resume"]) == 64
    messages = faults(capsys)
    assert len(messages) == 1
    assert f"--resume to continue from {state_path(output)}" in messages[0]
    monkeypatch.setattr(command, "write_folder", write_folder)
    # Nor is anything lost of a training whose result no file can hold.
    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "result", failing_with(BoundError(10, "carm.1.0")))
        assert main([*words(examples, output), "--resume"]) == 64
    (message,) = faults(capsys)
    assert "learned does not fit into a file: weights of the network layer carm.1.0, row 10, are too large" in message
    assert f"{state_path(output)} keeps it, and --resume" in message
    assert main([*words(examples, output), "--resume"]) == 0
    assert read_folder(output).anchor_count > 100


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_place_that_cannot_be_written_is_said_at_once(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tmp_path.chmod(0o500)
    assert main(words(examples, tmp_path / "scene")) == 64
    assert "read-only" in capsys.readouterr().err
