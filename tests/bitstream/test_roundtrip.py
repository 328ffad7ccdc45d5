"""Round trips (SPEC.md 4.3): parse(emit(scene)) is the scene, and emit(parse(file)) is the file."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from conformance.cases.scenes import (
    CONSTANT,
    MAIN_DIMENSIONS,
    PLANELESS,
    TINY_DIMENSIONS,
    UNENCODED,
    random_scene,
    with_steps,
)
from conformance.fuzz.strategies import scenes
from refcodec.bitstream import batches, codec, reconstruction
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Ancillary, Scene, check_types
from refcodec.encoder.quantise import packed


def assert_round_trip(scene: Scene) -> None:
    """Every field comes back bit for bit, and so do the bytes and the canonical reconstruction."""
    data = codec.emit(scene)
    found = codec.parse(data).scene
    assert codec.emit(found) == data
    for name in ("planes", "positions", "masks", "mask_model", "carm_shift"):
        assert getattr(found, name).tobytes() == getattr(scene, name).tobytes(), name
    for name in ("features", "scalings", "offsets", "steps"):
        assert np.array_equal(getattr(found.attributes, name), getattr(scene.attributes, name)), name
    for name in (
        "profile",
        "dimensions",
        "chunk_size",
        "lanes",
        "base_step",
        "grid",
        "render",
        "plane_shift",
        "minor",
        "later",
        "chunks",
        "frame" if scene.frame is None else "profile",
    ):
        assert getattr(found, name) == getattr(scene, name), name
    # Places behind the last critical section are one place.
    assert [(a.type, a.mode, a.content) for a in found.ancillary] == [
        (a.type, a.mode, a.content) for a in scene.ancillary
    ]
    for name in ("matrix", "translation", "shift", "low", "high") if scene.frame is not None else ():
        assert np.array_equal(getattr(found.frame, name), getattr(scene.frame, name)), name
    for name, layers in scene.networks.items():
        for ours, theirs in zip(layers, found.networks[name], strict=True):
            assert [v.tobytes() for v in ours] == [v.tobytes() for v in theirs], name
    assert reconstruction.digest(found) == reconstruction.digest(scene)


@pytest.mark.no_cover
@pytest.mark.requirement("D15.4-1", "E15.2-1")
@given(scenes())
def test_any_scene(scene: Scene) -> None:
    assert_round_trip(scene)


@pytest.mark.no_cover
@given(scenes(max_anchors=60))
@settings(max_examples=15)
def test_more_anchors(scene: Scene) -> None:
    assert_round_trip(scene)


@pytest.mark.parametrize("anchors", [0, 1, 2, 7, 8, 9])
@pytest.mark.parametrize("chunk_size", [1, 4, 8, 65536])
def test_anchor_counts_and_chunks(anchors: int, chunk_size: int) -> None:
    assert_round_trip(random_scene(anchors, anchors, chunk_size=chunk_size))


@pytest.mark.parametrize("d", [PLANELESS, UNENCODED, CONSTANT])
@pytest.mark.parametrize("form", ["raw", "packed"])
def test_without_planes_or_frequencies(d: Dimensions, form: str) -> None:
    assert_round_trip(packed(random_scene(5, 9, d, chunk_size=4), form, form))


def test_the_default_dimensions_of_scaffold_gs() -> None:
    """32 features in one slice, 10 offsets, width 32: a scene of Main without a hyperprior."""
    d = Dimensions(10, (32,), 0, 0, 0, (), (), (), 32)
    assert_round_trip(packed(random_scene(6, 300, d, profile=MAIN, chunk_size=256), None, None))


@pytest.mark.parametrize("size", range(2, 33))
def test_plane_sizes(size: int) -> None:
    assert_round_trip(random_scene(size, 3, replace(TINY_DIMENSIONS, plane_size=size, plane_channels=1)))


@pytest.mark.parametrize("log2", range(9))
def test_lanes(log2: int) -> None:
    assert_round_trip(random_scene(log2, 40, chunk_size=17, lanes=Lanes(log2, log2, log2)))


@pytest.mark.parametrize("keep", [0.0, 1.0])
def test_no_offset_and_every_offset(keep: float) -> None:
    assert_round_trip(random_scene(1, 12, chunk_size=5, keep=keep))


def test_all_masked_but_one() -> None:
    scene = random_scene(2, 12, chunk_size=5, keep=0.0)
    scene.masks[7, 1] = True
    scene.attributes.offsets[7, 1] = 5, -6, 7
    assert_round_trip(scene)


@pytest.mark.parametrize("value", [ATTRIBUTE_SYMBOL_MAX, -ATTRIBUTE_SYMBOL_MAX])
def test_longest_escapes(value: int) -> None:
    """The narrowest distributions and the largest symbols: every value is an escape of the greatest length."""
    scene = random_scene(3, 6, gain=0.0)
    scene.networks["hyper"][-1][1][:] = -320.0
    scene.attributes.features[:] = value
    scene.attributes.offsets[scene.masks] = value
    scene.planes[:] = np.sign(value) * 32767
    assert_round_trip(with_steps(scene))


@pytest.mark.parametrize("bias", [150.0, 1e6])
def test_most_raw_bits(bias: float) -> None:
    """The widest distributions: sixteen raw bits a value."""
    scene = random_scene(4, 9, gain=0.0, spread=100000)
    scene.networks["hyper"][-1][1][17:34] = bias
    scene.networks["sarm"][-1][1][1] = bias
    assert_round_trip(with_steps(scene))


@pytest.mark.parametrize("sign", [1, -1])
def test_extreme_weights(sign: int) -> None:
    """Every row at the accumulator bound: the largest outputs of F_h, SARM and CARM, for means and scales alike."""
    scene = random_scene(10, 9, chunk_size=4)
    for layers in scene.networks.values():
        for weight, bias in layers:
            weight[:] = sign * min(1023, ((1 << 24) - 1) // (1023 * weight.shape[1]))
            bias[:] = 0
    scene.positions[:3] = 65504, -65504, 2.0**-24
    assert_round_trip(with_steps(scene))


@pytest.mark.parametrize("value", [1e-45, -1e-45, -0.0, 2.0**-126])
def test_tiny_weights(value: float) -> None:
    """Weights that are zero in integers, of either sign and subnormal, come back bit for bit."""
    scene = random_scene(11, 9, chunk_size=4)
    for layers in scene.networks.values():
        for weight, bias in layers:
            weight[:], bias[:] = value, value
    assert_round_trip(with_steps(scene))


def test_every_chunk_size() -> None:
    """The same scene in chunks of each size: other bytes, the same reconstruction."""
    digests = set()
    for size in range(1, 9):
        scene = random_scene(12, 7, chunk_size=size)
        assert_round_trip(scene)
        digests.add(reconstruction.digest(scene)[0])
    assert len(digests) == 1


@pytest.mark.parametrize("together", [(1, 65536), (2, 65536), (1024, 1), (1024, 11), (1024, 12), (3, 13)])
def test_grouping(monkeypatch: pytest.MonkeyPatch, together: tuple[int, int]) -> None:
    """However many chunks and anchors are coded side by side, chunks that pass the limit alone included."""
    scene = random_scene(13, 40, chunk_size=6, lanes=Lanes(1, 2, 3))
    data = codec.emit(scene)
    monkeypatch.setattr(batches, "GROUP_CHUNKS", together[0])
    monkeypatch.setattr(batches, "GROUP_ANCHORS", together[1])
    assert codec.emit(scene) == data
    found = codec.parse(data).scene
    assert reconstruction.digest(found) == reconstruction.digest(scene)
    assert codec.emit(found) == data


def test_main() -> None:
    assert_round_trip(random_scene(5, 700, MAIN_DIMENSIONS, chunk_size=256))


def test_main_largest_planes() -> None:
    scene = random_scene(6, 0, replace(MAIN_DIMENSIONS, plane_size=256), lanes=Lanes(8, 0, 0), gain=0.0)
    scene.networks["sarm"][-1][1][1] = 20
    assert_round_trip(scene)


@pytest.mark.requirement("D12.1-1")
def test_ancillary_sections_come_back() -> None:
    """Repeated ones, empty ones, private ones, before each critical section and behind the last."""
    sections = [Ancillary(b"noTE", after, bytes(after), after) for after in range(6)]
    sections[3:3] = [Ancillary(b"noTE", 255, b"abc", 3), Ancillary(b"prIv", 9, b"\x0borg.example" + bytes(300), 3)]
    assert_round_trip(replace(random_scene(7, 3), ancillary=tuple(sections)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"chunk_size": 0}, "chunk_size"),
        ({"base_step": (0.0, 1.0, 1.0)}, "base_step"),
        ({"ancillary": (Ancillary(b"no1E", 0, b""),)}, "four letters"),
        ({"ancillary": (Ancillary(b"NOTE", 0, b""),)}, "critical"),
        ({"chunk_anchors": (1, 1)}, "chunks"),
        ({"position_forms": (1,)}, "packed"),
        ({"later": b"\1"}, "header_length"),
        ({"plane_shift": 11}, "plane_shift"),
        ({"positions": np.full((3, 3), np.nan, np.float16)}, "NaN"),
        ({"positions": np.full((3, 3), -0.0, np.float16)}, "-0"),
        ({"masks": np.ones((3, 1), bool)}, "masks"),
    ],
)
def test_what_cannot_be_written_is_refused(change: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        codec.emit(replace(random_scene(8, 3), **change))


def test_symbols_past_their_type_and_stale_steps_are_refused() -> None:
    scene = random_scene(9, 3)
    scene.attributes.features[0, 0] = ATTRIBUTE_SYMBOL_MAX + 1
    with pytest.raises(ValueError, match=r"8\.5"):
        codec.emit(scene)
    scene = random_scene(9, 3)
    scene.attributes.steps[1, 2] ^= 1
    with pytest.raises(ValueError, match="step indices"):
        codec.emit(scene)
    scene = random_scene(9, 3, keep=0.0)
    scene.attributes.offsets[0, 0, 0] = 1
    with pytest.raises(ValueError, match="mask"):
        codec.emit(scene)
    scene = random_scene(9, 3)
    scene.networks["carm.1"][0][0][2, 1] = 1e9
    with pytest.raises(ValueError, match=r"carm\.1\.0.*row 2,"):
        codec.emit(scene)


def test_types_by_an_alias() -> None:
    """NDArray is one from NumPy 2.5 on: an annotation that has its class as a value."""
    alias = SimpleNamespace(__value__=NDArray[np.int32])
    check_types(np.zeros(3), alias)
    with pytest.raises(TypeError, match="must be ndarray"):
        check_types([0], alias)
