"""A chunk that would have fewer bytes than its floor (SPEC [R6.10-5])."""

from dataclasses import replace

import numpy as np
import pytest
from random_scenes import random_scene

from conformance.cases.scenes import CONSTANT
from refcodec.bitstream.codec import derive_steps, emit, parse
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import PACKED, RAW
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import pack_positions
from refcodec.folder.read import read_folder
from refcodec.folder.write import write_folder


@pytest.fixture(scope="module")
def cube() -> Scene:
    """Anchors in each cell of a cube, and four apart from it. All symbols of the cube are likely ones."""
    dense = np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3)
    apart = np.array([[600, 3, 5], [40, 90, 7], [700, 800, 900], [30, 999, 70]])
    where = np.concatenate([dense, apart]).astype(np.float16)
    scene = random_scene(3, len(where), CONSTANT, spread=0.0, positions=where, keep=1.0, chunk_size=1728)
    networks = {name: [(w * 0, b * 0) for w, b in layers] for name, layers in scene.networks.items()}
    width = CONSTANT.attribute_width
    networks["hyper"][-1][1][width : 2 * width] = -500
    scene = replace(
        scene,
        networks=networks,
        masks=np.ones_like(scene.masks),
        mask_model=np.full_like(scene.mask_model, 16383),
        lanes=Lanes(0, 0, 0),
    )
    scene = replace(scene, attributes=replace(scene.attributes, steps=derive_steps(scene)))
    return pack_positions(scene)


def test_raw_positions_keep_a_chunk_above_its_floor(cube: Scene, tmp_path) -> None:
    assert cube.chunks == [range(1728), range(1728, 1732)]
    data = emit(cube)
    parsed = parse(data).scene
    assert parsed.position_forms == (RAW, PACKED)
    np.testing.assert_array_equal(parsed.positions, cube.positions)
    assert emit(parsed) == data
    write_folder(parsed, tmp_path / "scene")
    assert emit(read_folder(tmp_path / "scene")) == data


def test_a_form_that_breaks_the_floor_is_refused(cube: Scene) -> None:
    with pytest.raises(ValueError, match=r"R6\.10-5"):
        emit(replace(cube, position_forms=(PACKED, PACKED)))
