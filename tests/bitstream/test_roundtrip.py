"""Round trips (SPEC.md 4.3): parse(emit(scene)) is the scene, and emit(parse(file)) is the file."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray
from random_scenes import random_scene

from conformance.cases.scenes import CONSTANT, MAIN_DIMENSIONS, PLANELESS, TINY_DIMENSIONS, UNENCODED, with_steps
from conformance.fuzz.strategies import scenes
from refcodec.bitstream import batches, codec, reconstruction
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Ancillary, Scene, check_types
from refcodec.encoder.quantise import packed

# Ancillary sections are compared without their places: those behind the last critical section are one place. The others
# may be None for the encoder's choice.
CHOICES = {"ancillary", "chunk_anchors", "position_forms", "weight_forms"}
NAMES = [field.name for field in fields(Scene) if field.name not in CHOICES] + ["chunks"]


def plain(value: Any) -> Any:
    """A value with the bytes of arrays, in which 0 and -0 differ."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    items = vars(value) if is_dataclass(value) else value
    return {name: plain(item) for name, item in items.items()} if isinstance(items, dict) else value


def assert_round_trip(scene: Scene) -> None:
    """Every field comes back bit for bit, and so do the bytes and the canonical reconstruction."""
    data = codec.emit(scene)
    parsed = codec.parse(data).scene
    assert codec.emit(parsed) == data
    for name in NAMES:
        assert plain(getattr(parsed, name)) == plain(getattr(scene, name)), name
    before, after = ([(a.type, a.mode, a.content) for a in each.ancillary] for each in (scene, parsed))
    assert after == before
    assert reconstruction.digest(parsed) == reconstruction.digest(scene)


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


def of_plane_size(size: int) -> Scene:
    return random_scene(size, 3, replace(TINY_DIMENSIONS, plane_size=size, plane_channels=1))


def all_masked_but_one() -> Scene:
    scene = random_scene(2, 12, chunk_size=5, keep=0.0)
    scene.masks[7, 1] = True
    scene.attributes.offsets[7, 1] = 5, -6, 7
    return scene


def longest_escapes(sign: int) -> Scene:
    """The narrowest distributions and the largest symbols: every value is an escape of the greatest length."""
    scene = random_scene(3, 6, gain=0.0)
    scene.networks["hyper"][-1][1][:] = -320.0
    scene.attributes.features[:] = sign * ATTRIBUTE_SYMBOL_MAX
    scene.attributes.offsets[scene.masks] = sign * ATTRIBUTE_SYMBOL_MAX
    scene.planes[:] = sign * 32767
    return with_steps(scene)


def most_raw_bits(bias: float) -> Scene:
    """The widest distributions: sixteen raw bits a value."""
    scene = random_scene(4, 9, gain=0.0, spread=100000)
    scene.networks["hyper"][-1][1][17:34] = bias
    scene.networks["sarm"][-1][1][1] = bias
    return with_steps(scene)


def extreme_weights(sign: int) -> Scene:
    """Every row at the accumulator bound: the largest outputs of F_h, SARM and CARM, for means and scales alike."""
    scene = random_scene(10, 9, chunk_size=4)
    for layers in scene.networks.values():
        for weight, bias in layers:
            weight[:] = sign * min(1023, ((1 << 24) - 1) // (1023 * weight.shape[1]))
            bias[:] = 0
    scene.positions[:3] = 65504, -65504, 2.0**-24
    return with_steps(scene)


def equal_weights(value: float) -> Scene:
    scene = random_scene(11, 9, chunk_size=4)
    for layers in scene.networks.values():
        for weight, bias in layers:
            weight[:], bias[:] = value, value
    return with_steps(scene)


def largest_planes() -> Scene:
    scene = random_scene(6, 0, replace(MAIN_DIMENSIONS, plane_size=256), lanes=Lanes(8, 0, 0), gain=0.0)
    scene.networks["sarm"][-1][1][1] = 20
    return scene


# Repeated ones, empty ones, private ones, before each critical section and behind the last.
SECTIONS = [Ancillary(b"noTE", after, bytes(after), after) for after in range(6)]
SECTIONS[3:3] = [Ancillary(b"noTE", 255, b"abc", 3), Ancillary(b"prIv", 9, b"\x0borg.example" + bytes(300), 3)]
SPECIAL: dict[str, Callable[[], Scene]] = {
    **{
        f"{n} anchors in chunks of {size}": lambda n=n, size=size: random_scene(n, n, chunk_size=size)  # type: ignore[misc]
        for n, size in ((0, 1), (1, 1), (8, 1), (2, 4), (7, 4), (8, 4), (9, 4), (9, 8), (9, 65536))
    },
    **{f"planes of {size}": lambda size=size: of_plane_size(size) for size in (2, 3, 4, 5, 31, 32)},  # type: ignore[misc]
    **{
        f"2^{n} lanes": lambda n=n: random_scene(n, 40, chunk_size=17, lanes=Lanes(n, n, n))  # type: ignore[misc]
        for n in range(9)
    },
    **{
        f"{d}, {form}": lambda d=d, form=form: packed(random_scene(5, 9, d, chunk_size=4), form, form)  # type: ignore[misc]
        for d in (PLANELESS, UNENCODED, CONSTANT)
        for form in ("raw", "packed")
    },
    # 32 features in one slice, 10 offsets, width 32: a scene of Main without a hyperprior.
    "Scaffold-GS": lambda: packed(
        random_scene(6, 300, Dimensions(10, (32,), 0, 0, 0, (), (), (), 32), profile=MAIN, chunk_size=256), None, None
    ),
    "Main": lambda: random_scene(5, 700, MAIN_DIMENSIONS, chunk_size=256),
    "the largest planes": largest_planes,
    "no offset": lambda: random_scene(1, 12, chunk_size=5, keep=0.0),
    "every offset": lambda: random_scene(1, 12, chunk_size=5, keep=1.0),
    "all masked but one": all_masked_but_one,
    "the largest symbols": lambda: longest_escapes(1),
    "the smallest symbols": lambda: longest_escapes(-1),
    "most raw bits": lambda: most_raw_bits(150.0),
    "scales beyond the tables": lambda: most_raw_bits(1e6),
    "the largest weights": lambda: extreme_weights(1),
    "the smallest weights": lambda: extreme_weights(-1),
    # Weights that are zero in integers, of either sign and subnormal, come back bit for bit.
    **{f"weights of {x}": lambda x=x: equal_weights(x) for x in (1e-45, -1e-45, -0.0, 2.0**-126)},  # type: ignore[misc]
    "ancillary sections": lambda: replace(random_scene(7, 3), ancillary=tuple(SECTIONS)),
}


@pytest.mark.requirement("D12.1-1")
@pytest.mark.parametrize("name", SPECIAL)
def test_special_scenes(name: str) -> None:
    assert_round_trip(SPECIAL[name]())


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
    parsed = codec.parse(data).scene
    assert reconstruction.digest(parsed) == reconstruction.digest(scene)
    assert codec.emit(parsed) == data


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
