"""The inputs of a viewer from the decoder in WebAssembly: Gaussians, cameras and metadata, as in refcodec."""

import json
import struct
import subprocess
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_files import FILES, SCENES, UNDRAWN
from hypothesis import given, settings
from hypothesis import strategies as st
from random_scenes import random_scene
from web_program import MISSING, NODE, PROGRAM, Decoder

from conformance.cases import static
from conformance.cases.scenes import MAIN_DIMENSIONS
from conformance.manifest import VECTORS, load
from conformance.runner.gaussians import difference
from refcodec import statuses
from refcodec.bitstream import cameras, codec, metadata
from refcodec.bitstream.cameras import NamedCamera
from refcodec.bitstream.reconstruction import digest, reconstruct
from refcodec.bitstream.reconstruction import gaussians as splat_of
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.bitstream.splat import HARMONICS, LENGTHS, LOGIT, MEAN, QUATERNION
from refcodec.encoder.layers import coarse_layers
from refcodec.encoder.positions import pack_positions
from refcodec.rendering.camera import Camera, default_camera
from refcodec.rendering.gaussians import Gaussians, gaussians, gaussians_document

pytestmark = [pytest.mark.no_cover, pytest.mark.skipif(NODE is None, reason=MISSING)]

# SPEC [G14.3-1]
TOLERANCE = 1e-4
TYPES = {
    "positions": ("<f4", 3),
    "scales": ("<f4", 3),
    "rotations": ("<f4", 4),
    "colours": ("<f4", 3),
    "opacities": ("<f4", 1),
    "anchors": ("<u4", 1),
    "offsets": ("u1", 1),
}
MANIFEST = load(VECTORS / "manifest.json")
VALID = [v for v in MANIFEST.vectors if v.operation == "decode" and v.klass == "valid"]


# ----------------------------------------------------------------------------------------------------- Gaussians ---


def at_place(place: list[float]) -> Camera:
    return Camera("", 1, 1, 1.0, 1.0, 0.0, 0.0, np.eye(3), -np.array(place, np.float64))


def document(scene: Scene, place: list[float]) -> str:
    """What the reference in binary64 sees."""
    values, unit = reconstruct(scene), scene.render.distance_unit
    seen_by = gaussians(values, scene.masks, scene.networks, at_place(place), unit, np.float64)
    return json.dumps(gaussians_document(seen_by))


def seen(views: list[dict[str, Any]]) -> Gaussians:
    """The Gaussians of views, one behind the other."""
    arrays = {
        name: np.concatenate([np.frombuffer(bytes.fromhex(view[name]), kind).reshape(-1, width) for view in views])
        for name, (kind, width) in TYPES.items()
    }
    assert all(view["arrays"] == ["count", *TYPES] for view in views)
    return Gaussians(
        arrays["positions"],
        arrays["scales"],
        arrays["rotations"],
        arrays["opacities"][:, 0],
        arrays["colours"],
        arrays["anchors"][:, 0].astype(np.int64),
        arrays["offsets"][:, 0].astype(np.int64),
    )


LARGER = {
    "main": random_scene(51, 300, MAIN_DIMENSIONS, chunk_size=256),
    "narrow": random_scene(52, 40, replace(MAIN_DIMENSIONS, render_width=3)),
}


@pytest.mark.requirement("G14.3-1")
@pytest.mark.parametrize("name", [*SCENES, *LARGER])
def test_gaussians_are_those_of_the_reference(decoder: Decoder, name: str) -> None:
    """One chunk after the other, two anchors after the other, and all at once: the same arrays, near the reference."""
    scene = {**SCENES, **LARGER}[name]
    file = FILES.get(name) or codec.emit(scene)
    positions = reconstruct(scene).positions.astype(np.float64)
    within = positions[len(positions) // 2].tolist() if len(positions) else [0.0, 0.0, 0.0]
    for place in ([0.5, -0.25, 6.0], within, [12.0, -7.0, 9.0]):
        answer = decoder.ask(file, "views", place=place)
        drawn = seen(answer["all"])
        assert name not in LARGER or len(drawn.mean) > 9
        assert difference(document(scene, place), json.dumps(gaussians_document(drawn)), TOLERANCE) is None
        for way in ("few", "single", "out"):
            if answer[way]:
                assert all(
                    np.array_equal(a, b) for a, b in zip(*map(_columns, (drawn, seen(answer[way]))), strict=True)
                )


@pytest.mark.requirement("G14.6-1")
@pytest.mark.parametrize("degree", range(4))
def test_plain_gaussians_are_those_of_the_reference(decoder: Decoder, degree: int) -> None:
    """They are those that the file gives, and for PlayCanvas the properties of PLY files of 3DGS."""
    data = static.of_degree(degree)
    scene = codec.parse(data).scene
    numbers = splat_of(scene)
    answer = decoder.ask(data, "plain")
    assert answer["count"] == len(numbers) > 5
    arrays = {
        name: np.frombuffer(bytes.fromhex(text), "<f4").reshape(len(numbers), -1)
        for name, text in answer.items()
        if isinstance(text, str)
    }
    assert np.array_equal(arrays["positions"], numbers[:, MEAN])
    assert np.array_equal(arrays["harmonics"], numbers[:, HARMONICS])
    wide = numbers.astype(np.float64)
    assert np.allclose(arrays["scales"], np.exp(wide[:, LENGTHS]), rtol=1e-6, atol=0)
    unit = wide[:, QUATERNION] / np.linalg.norm(wide[:, QUATERNION], axis=1, keepdims=True)
    assert np.allclose(arrays["rotations"], unit, atol=1e-6)
    assert np.allclose(arrays["opacities"][:, 0], 1 / (1 + np.exp(-wide[:, LOGIT])), rtol=1e-6, atol=0)
    harmonics = numbers[:, HARMONICS].reshape(len(numbers), -1, 3)
    rest = harmonics[:, 1:].transpose(0, 2, 1).reshape(len(numbers), -1)
    for name, columns in (("f_dc", harmonics[:, 0]), ("f_rest", rest), ("rot", unit), ("scale", numbers[:, LENGTHS])):
        own = [arrays.pop(f"{name}_{i}") for i in range(columns.shape[1])]
        assert all(np.allclose(a[:, 0], b, rtol=1e-5, atol=1e-5) for a, b in zip(own, columns.T, strict=True))
    assert set(arrays) == {"positions", "scales", "rotations", "opacities", "harmonics", "x", "y", "z", "opacity"}


def enlarged(g: Gaussians, scene: Scene, there: int) -> Gaussians:
    """SPEC E.2: returns the Gaussians of the first chunks of a scene, longer where others are missing."""
    positions, found, mean = reconstruct(scene).positions, np.zeros((2, len(g.mean))), g.mean.astype(np.float64)
    for number, chunk in enumerate(scene.chunks):
        own = positions[chunk.start : chunk.stop].astype(np.float64)
        low, high = own.min(axis=0), own.max(axis=0)
        sides = np.maximum(high - low, (high - low).max() * 1e-3 or 1)
        within = ((mean >= low) & (mean <= high)).all(axis=1)
        found[:, within] += np.array([[number < there], [1]]) * (len(chunk) / sides.prod())
    share = np.divide(found[0], found[1], out=np.zeros(len(mean)), where=found[1] > 0)
    share = np.maximum(share, scene.chunks[there - 1].stop / scene.anchor_count)
    area = np.sort(g.lengths.astype(np.float64), axis=1)[:, 1:].prod(axis=1)
    middle = np.sort(area)[len(area) // 2]
    factor = np.sqrt(1 + (share**-0.5 - 1) * np.sqrt(np.divide(middle, area, out=np.zeros_like(area), where=area > 0)))
    return replace(g, lengths=g.lengths * factor.astype(np.float32)[:, None])


def test_gaussians_of_a_part_are_enlarged_as_e2_advises(decoder: Decoder) -> None:
    """Those of the first chunks by what is missing around them, and those of a whole scene not at all."""
    trained = codec.parse((VECTORS / "valid" / "trained-snowmiku.c3gs").read_bytes()).scene
    scene = codec.parse(codec.emit(pack_positions(trained, coarse_layers(trained)))).scene
    for there in range(1, len(scene.chunks) + 1):
        answer = decoder.ask(codec.emit(scene), "enlarged", place=[0.0, 0.0, 0.0], there=there)
        before, after = seen(answer["before"]), seen(answer["after"])
        assert np.allclose(after.lengths, enlarged(before, scene, there).lengths, rtol=1e-5, atol=0)
        longer = (after.lengths > before.lengths).all(axis=1)
        assert longer.any() == (there < len(scene.chunks))


def _columns(splats: Gaussians) -> list[Any]:
    return list(vars(splats).values())


def test_slots_count_kept_offsets(decoder: Decoder) -> None:
    for name, scene in SCENES.items():
        answer = decoder.ask(FILES[name], "views", place=[1.0, 2.0, 3.0])
        sums = [0, *np.cumsum(scene.masks.sum(axis=1)).tolist()]
        assert answer["slots"] == sums
        positions = reconstruct(scene).positions
        for number, (chunk, rows) in enumerate(zip(answer["added"], scene.chunks, strict=True)):
            start, end = rows.start, rows.stop
            own = positions[start:end]
            assert {key: chunk[key] for key in ("number", "start", "end", "slot", "kept")} == {
                "number": number,
                "start": start,
                "end": end,
                "slot": sums[start],
                "kept": sums[end] - sums[start],
            }
            assert np.array_equal(np.array([chunk["low"], chunk["high"]]), [own.min(axis=0), own.max(axis=0)])
        # All were seen from there last.
        assert not any(answer["changes"])


@pytest.mark.parametrize("text", ["", "[]", "null", '{"rotation": [[1, 0, 0]], "translation": [0, 0, 0]}'])
def test_the_program_refuses_what_is_no_camera(text: str, tmp_path: Path) -> None:
    camera = tmp_path / "camera.json"
    camera.write_text(text)
    words = ["gaussians", VECTORS / "tiny-example.c3gs", camera, tmp_path / "output"]
    done = subprocess.run([str(NODE), PROGRAM, *words], capture_output=True, text=True, check=False)
    assert done.returncode == statuses.USAGE
    assert done.stderr == f"c3gs: {camera} is no camera\n"


@pytest.mark.requirement("G6.5-1")
def test_other_render_models_are_decoded_but_not_drawn(decoder: Decoder, tmp_path: Path) -> None:
    """The header has the fields of RenderInfo and the numbers of the rendering networks."""
    data, message = (
        codec.emit(UNDRAWN),
        "render_model is 7, but this version draws only 0 and 1; use a later version (SPEC.md 6.5)",
    )
    assert decoder.verdict(data) == (digest(UNDRAWN)[0], -1)
    answer = decoder.ask(data, "drawing")
    assert answer["error"] == ["RenderModelError", message]
    assert {name: answer["header"][name] for name in asdict(UNDRAWN.render)} == {
        **asdict(UNDRAWN.render),
        "background": list(UNDRAWN.render.background),
    }
    assert (answer["header"]["view_inputs"], answer["header"]["colour_outputs"]) == (8, 27)
    file, camera = tmp_path / "scene.c3gs", tmp_path / "camera.json"
    file.write_bytes(data)
    camera.write_text('{"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [0, 0, 0]}')
    words = [str(NODE), PROGRAM, "gaussians", file, camera, tmp_path / "output"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (statuses.USAGE, f"c3gs: {message}\n")
    assert not (tmp_path / "output").exists()


def test_wrong_calls_are_refused() -> None:
    """Wrong arrays, indices and places get an error of their own. A right call works after them."""
    program = Path(__file__).with_name("refuse_web.mjs")
    done = subprocess.run(
        [str(NODE), program, VECTORS / "valid" / "cameras.c3gs"], capture_output=True, text=True, check=True
    )
    answer = json.loads(done.stdout)
    others = {name: kind for name, kind in answer.items() if kind not in ("TypeError", "RangeError")}
    assert others == {"right": "right", "not static": "RenderModelError"}


def test_the_examples_of_the_manual_run(tmp_path: Path) -> None:
    """Those that are not whole pages."""
    path = tmp_path / "scene.c3gs"
    path.write_bytes(codec.emit(random_scene(54, 12, chunk_size=1, keep=1.0)))
    program = Path(__file__).with_name("readme_web.mjs")
    done = subprocess.run([str(NODE), program, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["ran"] == 5
    assert answer["drawn"] > 0


# ------------------------------------------------------------------------------------------ cameras and metadata ---


def listed(sections: tuple[Ancillary, ...] | list[Ancillary]) -> dict[str, Any]:
    """The cameras and the metadata of sections, as JSON has them."""
    stated = [asdict(camera) for camera in cameras.cameras(sections)]
    whole: dict[str, Any] = json.loads(json.dumps({"cameras": stated, "metadata": metadata.metadata(sections)}))
    return whole


def assert_ancillary(decoder: Decoder, data: bytes) -> dict[str, Any]:
    answer, expected = decoder.ask(data, "ancillary"), listed(codec.parse_ancillary(data))
    assert answer["before"] == {"cameras": [], "metadata": {}}
    for way in (answer["read"], answer["decoded"]):
        # JavaScript writes large numbers as integers, with other digits.
        for camera in way["cameras"]:
            camera.update({key: list(map(float, value)) for key, value in camera.items() if isinstance(value, list)})
        assert way == expected
    return expected


def test_cameras_and_metadata_of_the_vectors(decoder: Decoder) -> None:
    kept = [
        assert_ancillary(decoder, MANIFEST.path(vector).read_bytes())
        for vector in VALID
        if any(section.type in (cameras.CAMERAS, metadata.METADATA) for section in sections_of(vector))
    ]
    assert any(one["cameras"] for one in kept)
    assert any(one["metadata"] for one in kept)


def sections_of(vector: Any) -> list[Ancillary]:
    return codec.parse_ancillary(MANIFEST.path(vector).read_bytes())


GOOD = {
    b"mETa": metadata.emit_metadata({"title": "a title", "com.example": "\ufeffé", "__proto__": "x"}),
    b"cAMs": cameras.emit_cameras(
        [
            NamedCamera(),
            NamedCamera("\ufeffzwei", 7, 5, (1.5, 2.5), (3.0, 2.0), (0.0, -2.0, 1e20, 3.0), (1.0, 2.0, 3.0)),
        ]
    ),
}


@st.composite
def sections(draw: st.DrawFn) -> tuple[Ancillary, ...]:
    """Sections of metadata and of cameras, most of them with faults, at any places."""
    made = []
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from(list(GOOD)))
        content = bytearray(draw(st.sampled_from([GOOD[kind], bytes(4)])))
        for _ in range(draw(st.integers(0, 3))):
            content[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
        end = draw(st.integers(0, len(content)) | st.just(len(content)))
        rest = draw(st.sampled_from([b"", b"\0", b"more"]))
        mode = draw(st.sampled_from([0, 0, 0, 1]))
        made.append(Ancillary(kind, mode, bytes(content[:end]) + rest, draw(st.integers(0, 5))))
    return tuple(sorted(made, key=lambda section: section.after))


@settings(max_examples=60)
@given(sections())
def test_what_is_wrong_is_passed_over(decoder: Decoder, drawn: tuple[Ancillary, ...]) -> None:
    """SPEC 5.16, 5.16.1 and 5.17: what obeys them is read, whatever is wrong besides."""
    assert_ancillary(decoder, codec.emit(replace(SCENES["smallest"], ancillary=drawn)))


@pytest.mark.parametrize(("length", "read"), [(72, 3), (60, 2), (56, 1), (73, 1), (200, 1), (0xFFFFFFFC, 1), (0, 1)])
def test_cameras_state_their_length(decoder: Decoder, length: int, read: int) -> None:
    """SPEC 5.17.1: a camera may have more fields. A wrong length ends the section: here that of camera 1."""
    named = [cameras.emit_cameras([NamedCamera(name)])[4:] for name in ("zero", "one!", "two!")]
    assert {len(camera) for camera in named} == {64}
    content = struct.pack("<HH", 3, 0) + named[0] + struct.pack("<I", length) + named[1][4:] + bytes(12) + named[2]
    data = codec.emit(replace(SCENES["smallest"], ancillary=(Ancillary(b"cAMs", 0, content, 0),)))
    assert len(assert_ancillary(decoder, data)["cameras"]) == read


def test_long_sections_are_passed_over(decoder: Decoder) -> None:
    """SPEC 6.14 limits metadata. What is more than a caller allows is not held."""
    for length in (1 << 16, (1 << 16) + 1):
        content = GOOD[b"mETa"].ljust(length, b"\0")
        data = codec.emit(replace(SCENES["smallest"], ancillary=(Ancillary(b"mETa", 0, content, 0),)))
        assert bool(assert_ancillary(decoder, data)["metadata"]) == (length == 1 << 16)
    content = GOOD[b"cAMs"] + bytes(1 << 20)
    data = codec.emit(replace(SCENES["smallest"], ancillary=(Ancillary(b"cAMs", 0, content, 0),)))
    assert len(assert_ancillary(decoder, data)["cameras"]) == 2
    assert decoder.ask(data, "ancillary", options={"maxMemory": 1 << 20})["read"]["cameras"] == []


# -------------------------------------------------------------------------------------------------------- places ---


@settings(max_examples=30)
@given(st.data())
def test_places_and_matrices_of_cameras(decoder: Decoder, data: st.DataObject) -> None:
    """The centre and the two matrices put a point where SPEC 14.2 and 14.4 put it in the image."""
    numbers = st.floats(-8, 8, width=32)
    rotation = data.draw(st.tuples(numbers, numbers, numbers, numbers).filter(any))
    stated = NamedCamera("c", 640, 480, (500.0, 350.0), (300.0, 250.0), rotation, data.draw(st.tuples(*[numbers] * 3)))
    camera = default_camera(stated)
    answer = decoder.ask(b"", "camera", camera=asdict(stated), near=0.5, far=100.0)
    assert np.allclose(answer["centre"], camera.centre, atol=1e-5)
    to_world, projection = (np.array(answer[name]).reshape(4, 4).T for name in ("matrix", "projection"))
    own = np.array([0.25, -0.5, 3.0])
    point = camera.rotation.T @ (own - camera.translation)
    clip = projection @ np.linalg.inv(to_world) @ np.append(point, 1)
    u, v = (clip[:2] / clip[3] * [1, -1] + 1) / 2 * [stated.width, stated.height]
    assert np.allclose([u, v], [500 * 0.25 / 3 + 300, 350 * -0.5 / 3 + 250], atol=1e-3)
    depth = projection @ [0, 0, -0.5, 1], projection @ [0, 0, -100, 1]
    assert np.allclose([clip[2] / clip[3] for clip in depth], [-1, 1])


def test_places_within_objects(decoder: Decoder) -> None:
    """A camera's place is carried into the frame of the object that draws the scene."""
    matrix = np.array([[0, -2, 0, 5], [2, 0, 0, -1], [0, 0, 3, 2], [0, 0, 0, 1]], np.float64)
    inside = np.array([0.5, -1.5, 2.5, 1])
    place = np.eye(4)
    place[:, 3] = matrix @ inside
    camera = {"matrixWorld": {"elements": place.T.ravel().tolist()}}
    placed = {"matrixWorld": {"elements": matrix.T.ravel().tolist()}}
    for own in (camera, (matrix @ inside)[:3].tolist(), dict(zip("xyz", (matrix @ inside)[:3].tolist(), strict=True))):
        assert np.allclose(decoder.ask(b"", "centre", camera=own, object=placed)["centre"], inside[:3])


@pytest.mark.parametrize("axis", range(6))
def test_what_is_up_turns_to_y(decoder: Decoder, axis: int) -> None:
    matrix = np.array(decoder.ask(b"", "upright", axis=axis)["matrix"]).reshape(4, 4).T
    up = np.zeros(4)
    up[axis // 2] = -1 if axis % 2 else 1
    assert (matrix @ up).tolist() == [0, 1, 0, 0]
    assert np.array_equal(matrix @ matrix.T, np.eye(4))
    assert np.linalg.det(matrix) == pytest.approx(1)


def test_changes_are_ways_over_distances(decoder: Decoder) -> None:
    """A chunk that was never seen comes first. Near chunks come before far ones."""
    answer = decoder.ask(FILES["raw"], "changes", first=[0.0, 0.0, 50.0], second=[1.0, 0.0, 50.0])
    *seen_before, last = answer["changes"]
    assert last is None
    for change, chunk in zip(seen_before, answer["added"], strict=False):
        low, high = np.array(chunk["low"]), np.array(chunk["high"])
        away = np.linalg.norm(np.maximum(np.maximum(low - [1, 0, 50], [1, 0, 50] - high), 0))
        assert change == pytest.approx(1 / max(away, np.linalg.norm(high - low) / 4))
