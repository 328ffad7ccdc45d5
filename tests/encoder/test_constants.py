"""Scenes without a hyperprior, and the choice of the smallest file."""

from dataclasses import replace

import numpy as np
import pytest
from random_scenes import random_scene

from conformance.cases.scenes import MAIN_SMALLEST
from refcodec.bitstream.attributes import KINDS
from refcodec.bitstream.codec import derive_steps, emit, parse
from refcodec.bitstream.reconstruction import digest
from refcodec.bitstream.scene import Scene
from refcodec.cli.main import main
from refcodec.encoder.constants import choose_constants, code_length, smallest, with_constants
from refcodec.encoder.quantise import packed
from refcodec.folder.write import write_folder
from refcodec.inspect.page.measures import SceneMeasures

SAME = ("positions", "features", "scalings", "offsets")


def scene_of(anchors: int, varying: bool = False) -> Scene:
    """A scene of Main whose steps depend on the anchor if they are varying."""
    scene = random_scene(5, anchors, MAIN_SMALLEST, chunk_size=256)
    where = np.random.default_rng(5).permutation(4096)[:anchors]
    lattice = np.stack([where % 16, where // 16 % 16, where // 256], axis=1).astype(np.float16)
    if not varying:
        weight, bias = scene.networks["hyper"][-1]
        weight[-3:], bias[-3:] = 0, (30, 32, 33)
    scene = replace(scene, positions=lattice)
    scene = replace(scene, attributes=replace(scene.attributes, steps=derive_steps(scene)))
    return packed(scene, None, None)


def test_constants_are_near_the_best() -> None:
    rng = np.random.default_rng(1)
    for count, mean, spread in ((1, 3, 1), (300, -40, 9), (300, 0.4, 0.05), (2000, 5000, 700)):
        symbols = np.round(rng.normal(mean, spread, count)).astype(np.int64)
        nothing = np.zeros(count, np.int64)
        chosen = choose_constants(symbols, nothing, nothing)
        bits = code_length(nothing + chosen[0], nothing + chosen[1], symbols)
        for i in range(-24, 25):
            for j in range(-12, 13):
                assert bits <= code_length(nothing + chosen[0] + i, nothing + chosen[1] + j, symbols) * 1.002 + 0.1
    assert choose_constants(nothing[:0], nothing[:0], nothing[:0]) == (0, 0)


@pytest.mark.parametrize("alone", [False, True])
def test_nothing_but_the_entropy_model_changes(alone: bool) -> None:
    scene = scene_of(300)
    d = scene.dimensions
    constant = with_constants(scene, (d.features,) if alone else d.slices)
    assert constant is not None
    decoded = parse(emit(constant)).scene
    assert decoded.frame is None
    assert decoded.dimensions.plane_channels == decoded.dimensions.frequency_count == 0
    assert decoded.dimensions.carm_width == (() if alone else d.carm_width)
    before, after = digest(scene)[1], digest(decoded)[1]
    assert {name: after[name] for name in SAME} == {name: before[name] for name in SAME}
    np.testing.assert_array_equal(decoded.masks, scene.masks)
    for kind in (*KINDS, "steps"):
        np.testing.assert_array_equal(getattr(decoded.attributes, kind), getattr(scene.attributes, kind))
    for name in ("opacity", "covariance", "colour"):
        for (weight, bias), (other, other_bias) in zip(scene.networks[name], decoded.networks[name], strict=True):
            np.testing.assert_array_equal(weight, other)
            np.testing.assert_array_equal(bias, other_bias)
    # The bits are those of the search.
    if alone:
        measures = SceneMeasures(decoded.dimensions, decoded.anchor_count)
        measures.add(decoded)
        total = 0.0
        values = np.concatenate([scene.attributes.features, scene.attributes.scalings], axis=1).astype(np.int64)
        bias = decoded.networks["hyper"][0][1].astype(np.int64)
        for i, column in enumerate(values.T):
            total += code_length(np.full(300, bias[i]), np.full(300, bias[d.attribute_width + i]), column)
        offsets = scene.attributes.offsets.reshape(300, -1).astype(np.int64)
        for i, (column, kept) in enumerate(zip(offsets.T, np.repeat(scene.masks, 3, axis=1).T, strict=True)):
            place = values.shape[1] + i
            scale = np.full(kept.sum(), bias[d.attribute_width + place])
            total += code_length(np.full(kept.sum(), bias[place]), scale, column[kept])
        assert measures.bits["attributes"] == pytest.approx(total)


def test_steps_that_depend_on_the_anchor_stay() -> None:
    scene = scene_of(300, varying=True)
    assert (scene.attributes.steps != scene.attributes.steps[0]).any()
    assert with_constants(scene, scene.dimensions.slices) is None
    assert smallest(scene, "packed") is scene
    with pytest.raises(ValueError, match="slices"):
        with_constants(scene, (25, 25))


def test_encode_takes_the_smallest(tmp_path) -> None:
    scene = scene_of(60)
    write_folder(scene, tmp_path / "scene")
    sizes = {}
    for options in ((), ("--smallest",), ("--smallest", "--positions", "packed")):
        assert main(["encode", str(tmp_path / "scene"), "-o", str(tmp_path / "a.c3gs"), *options]) == 0
        data = (tmp_path / "a.c3gs").read_bytes()
        parsed = parse(data).scene
        sizes[options] = len(data), parsed.frame is None, parsed.position_model is None
        assert {n: digest(parsed)[1][n] for n in SAME} == {n: digest(scene)[1][n] for n in SAME}
    plain, few, kept = sizes.values()
    assert plain[1:] == (False, False)
    assert few[1:] == (True, True)
    assert kept[1:] == (True, False)
    assert few[0] < kept[0] < plain[0]


def test_a_scene_without_anchors_stays() -> None:
    assert smallest(packed(random_scene(5, 0, MAIN_SMALLEST, chunk_size=256), None, None), "packed").frame is not None
