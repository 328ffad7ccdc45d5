"""Whole training runs of some seconds: their results, and the states that they refuse."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch import Tensor

from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.scene import Scene
from refcodec.evaluate.evaluation import evaluate
from refcodec.folder.layout import REPORT_FILE
from refcodec.photographs.photographs import Photograph, PhotographSet
from refcodec.train.command import report, train
from refcodec.train.messages import line, opening
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.stage import Stage, Step
from refcodec.train.stages import size
from refcodec.train.state import Saved, restore
from refcodec.train.trainer import Trainer


def times(photographs: PhotographSet, factor: float) -> PhotographSet:
    """The same scene in another unit."""

    def moved(group: Sequence[Photograph]) -> tuple[Photograph, ...]:
        return tuple(replace(p, camera=replace(p.camera, translation=p.camera.translation * factor)) for p in group)

    return replace(
        photographs, train=moved(photographs.train), test=moved(photographs.test), points=photographs.points * factor
    )


def test_what_a_training_says(trained: Trainer, coded: Scene, small: TrainSettings) -> None:
    facts = report(trained, coded)
    assert len(facts["quantised"]) == len(trained.photographs.test)
    assert json.loads(json.dumps(facts)) == facts
    assert facts["steps"] == small.steps
    # All settings, by which it can be trained again.
    assert varied(TrainSettings(), facts["settings"]) == small
    assert len(facts["history"]) >= small.looks.count
    assert facts["history"][-1]["psnr"] > facts["history"][0]["psnr"] + 1


@pytest.mark.parametrize("case", [(1, "points", 3), (size.PIXELS, "points", 0), (1, "hull", 0)])
def test_photographs_are_halved_at_first(
    case: tuple[int, str, int], photographs: PhotographSet, small: TrainSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until the rate begins, but not to nothing. A halved photograph shows the same through the same camera."""
    least, within, halves = case
    monkeypatch.setattr(size, "PIXELS", least)
    trainer, whole, widths = Trainer(photographs, varied(small, {"steps": 10})), photographs.train[0], list[int]()
    trainer.scaffold.within = within
    step, photograph = trainer._looked_at(0)
    assert photograph.shape == (step.camera.height, step.camera.width, 3)
    assert float(photograph.mean()) == pytest.approx(whole.image.mean() / 255, rel=1e-3)
    trainer.run(lambda run: widths.append(run._looked_at(0)[0].camera.width))
    assert ("of halved photographs" in line(trainer)) == bool(halves)
    assert widths == [whole.camera.width // 2] * halves + [whole.camera.width] * (10 - halves)


@pytest.mark.slow
def test_same_file_whatever_the_number_of_threads(examples: Path, tmp_path: Path) -> None:
    def run(threads: int) -> dict[str, bytes]:
        environment = os.environ | dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"), str(threads))
        output, few = tmp_path / str(threads), ["--set", "start.anchors=800", "--set", "growth.most=900"]
        words = [str(examples / "caliterra"), "-o", str(output), "--threads", str(threads), "--size", "100x75", *few]
        subprocess.run(
            [sys.executable, "-m", "refcodec", "train", *words, "--steps", "60"], env=environment, check=True
        )
        return {path.name: path.read_bytes() for path in output.iterdir() if path.name != REPORT_FILE}

    assert run(1) == run(2)


@pytest.mark.slow
def test_another_unit_gives_the_same_scene(photographs: PhotographSet, small: TrainSettings) -> None:
    """The same photographs with cameras and points in hundredths of the unit: same anchors, about the same bytes.

    Grids of weights are fixed. Of two that are as good a training may take either, which has a fifth of the weights'
    bytes more or less; anchors come and go by sums that are rounded otherwise.
    """
    settings = varied(small, {"weights.rendering_bits": (8, 8), "weights.coarser": (2, 2)})
    one, other = Trainer(photographs, settings), Trainer(times(photographs, 100.0), settings)
    for trainer in (one, other):
        trainer.run(lambda _: None)
    looks = [trainer.looks.history[-1] for trainer in (one, other)]
    assert looks[1]["psnr"] == pytest.approx(looks[0]["psnr"], abs=0.5)
    assert looks[1]["bytes"] == pytest.approx(looks[0]["bytes"], rel=0.02)
    assert other.scaffold.units.length == pytest.approx(100 * one.scaffold.units.length)


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        {"sampling.among": "visible", "rate.plane_period": 1, "masks.epsilon": 0.0004},
        {"masks.used": False, "phases.weights.modes": {"weights": "float"}},
        {"phases.masks.begin": 0.5, "phases.rate.begin": 0.5, "low_pass": 0.3},
    ],
)
def test_variations(change: dict[str, Any], photographs: PhotographSet, small: TrainSettings) -> None:
    trainer = Trainer(photographs, varied(small, {"steps": 40, **change}))
    trainer.run(lambda _: None)
    result = trainer.result()
    assert isinstance(result, Scene)
    assert result.render.low_pass == np.float32(change.get("low_pass", 0.1))
    assert result.masks.all() or change.get("masks.used", True)
    assert parse(emit(result)).scene.anchor_count == result.anchor_count


def test_what_masks_of_photographs_exclude_is_not_learned(write_ball: Any, small: TrainSettings) -> None:
    """Whatever is there, opaque or transparent, the file has the same bytes, and the figures are the same."""
    ball, mask = write_ball("ball", "RGBA"), np.add.outer(np.arange(48), np.arange(48))[..., None] % 60 < 45

    def run(*garbage: int) -> list[Any]:
        def masked(p: Photograph) -> Photograph:
            load = lambda over: np.where(mask, p.load(over), np.uint8(garbage or over))  # noqa: E731
            return replace(p, load=load, load_mask=lambda: mask[..., 0])

        photographs = replace(ball, train=tuple(map(masked, ball.train)), test=tuple(map(masked, ball.test)))
        trainer = Trainer(photographs, varied(small, {"steps": 40, "start.drawn": 1000}))
        trainer.run(lambda _: None)
        result, said = trainer.result(), opening(trainer)
        assert isinstance(result, Scene)
        data, facts = emit(result), report(trainer, result)
        shown = evaluate(data, photographs, None, lambda *_: None)
        assert shown["mean"]["psnr_3dgs"] == pytest.approx(facts["psnr"], abs=0.02)
        assert shown["masks"] == "masks: 3 photographs, 27.7 % of pixels are excluded"
        return [data, said, facts["psnr"], trainer.looks.recent, shown["images"]]

    assert run() == run(9, 90, 200)


def test_masks_move(trained: Trainer) -> None:
    """In this short time the masks' loss and the rate move all masks together towards the threshold; none passes it."""
    assert float(trained.scaffold.tables["masks"].mean()) < 0


# --- a stage from outside ---------------------------------------------------------------------------------------------


class Opaque(Stage):
    """Makes visible Gaussians more opaque, and notes the calls that a run makes to it."""

    name = "opaque"

    def __init__(self, weight: float) -> None:
        self.weight, self.calls, self.count = weight, [], 0

    def loss(self, step: Step) -> Tensor | None:
        assert step.opacity is not None
        self.calls.append("loss")
        return -self.weight * step.opacity.clamp_min(0).mean()

    def after_step(self) -> None:
        self.calls.append("after_step")
        self.count += 1

    def anchors_changed(self) -> None:
        self.calls.append("anchors_changed")

    def finish(self) -> None:
        self.calls.append("finish")

    def state(self) -> dict[str, Any]:
        return {"count": self.count}

    def restore(self, state: Saved) -> None:
        self.count = state.integer("count", 0)


@pytest.mark.parametrize("lambda_r", [0.0, 0.01])
def test_a_stage_from_outside(
    lambda_r: float, photographs: PhotographSet, small: TrainSettings, tmp_path: Path
) -> None:
    """It is called with those of the method, and a saved state has its values."""
    settings = varied(small, {"steps": 12, "growth.period": 4, "rate.lambda_r": lambda_r})
    opacities = []
    for weight in (0.0, 10.0):
        stage = Opaque(weight)
        trained = train(photographs, settings, tmp_path / "scene", stages=[stage], keep_state=True).trainer
        assert (stage.calls.count("loss"), stage.calls.count("after_step"), stage.calls[-1]) == (12, 12, "finish")
        assert "anchors_changed" in stage.calls
        assert next(trained.of(Opaque)) is stage
        camera = photographs.test[0].camera
        rows = trained.scaffold.visible(trained.scaffold.units.camera(camera))
        values = {name: table[rows] for name, table in trained.scaffold.tables.items()}
        opacities.append(float(trained.scaffold.gaussians(rows, camera, values, None)[2].clamp_min(0).detach().mean()))
    assert opacities[1] > 1.05 * opacities[0]
    again = Opaque(10.0)
    restore(Trainer(photographs, settings, stages=[again]), tmp_path / "scene.train-state")
    assert again.count == 12
    with pytest.raises(ValueError, match="of other stages"):
        restore(Trainer(photographs, settings), tmp_path / "scene.train-state")


def test_a_stage_has_a_name_of_its_own(photographs: PhotographSet, small: TrainSettings) -> None:
    for name in ("", "growth", "looks", "a/b"):
        stage = Opaque(1.0)
        stage.name = name
        with pytest.raises(ValueError, match=f"a stage has the name '{name}', but each"):
            Trainer(photographs, small, stages=[stage])
