"""Training of static scenes: the decoder's Gaussians are those of the training."""

import numpy as np
import pytest
import torch

from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.dimensions import STATIC
from refcodec.bitstream.networks import ACTIVATION_MAX
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Scene
from refcodec.encoder.weights import pack_weights
from refcodec.photographs.photographs import PhotographSet
from refcodec.rendering.gaussians import gaussians_of
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import SettingsError, varied
from refcodec.train.trainer import Trainer
from refcodec.train.views import show


@pytest.fixture(scope="module")
def static(photographs: PhotographSet, small: TrainSettings) -> Trainer:
    trainer = Trainer(photographs, varied(small, {"static": True, "degree": 2}))
    assert trainer.run(lambda _: None)
    return trainer


@pytest.fixture(scope="module")
def scene(static: Trainer) -> Scene:
    result = static.result()
    assert isinstance(result, Scene)
    return parse(emit(pack_weights(result))).scene


def test_the_networks_learn(static: Trainer) -> None:
    looks = static.looks.history
    assert looks[-1]["psnr"] > looks[0]["psnr"] + 1


def test_a_file_of_a_static_scene(static: Trainer, scene: Scene) -> None:
    assert scene.render.render_model == STATIC
    assert (scene.dimensions.view_inputs, scene.dimensions.colour_outputs) == (0, 27)
    assert scene.weight_scales is not None
    # All layers of the rendering networks are packed.
    assert (scene.weight_scales[-6:] > 0).any(axis=1).all()


# SPEC B.5, "Static scenes"
def test_features_fill_the_range_of_activations(scene: Scene) -> None:
    largest = float(np.abs(reconstruct(scene).features).max())
    assert 0.7 * ACTIVATION_MAX < largest <= ACTIVATION_MAX


def test_the_decoder_has_the_gaussians_of_the_training(static: Trainer, scene: Scene) -> None:
    camera = static.photographs.test[0].camera
    held = gaussians_of(scene, camera)
    shown = show(static.scaffold, static.drawing, scene, camera)
    drawn = static.draw(camera)
    # The training rounds neither positions of offsets nor activations to the integers of the file.
    error = float(torch.mean((shown - drawn) ** 2))
    assert -10 * np.log10(error) > 40
    assert len(held.mean) == scene.masks.sum()


def test_an_uncompressed_scene_is_not_static(small: TrainSettings) -> None:
    with pytest.raises(SettingsError, match="must be view-dependent"):
        varied(small, {"static": True, "rate.lambda_r": 0.0})
