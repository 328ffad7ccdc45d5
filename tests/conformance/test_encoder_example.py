"""The encoder of examples/encoder, written from SPEC.md only, makes the files of refcodec."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_program import Program
from random_scenes import random_scene
from web_program import MISSING, NODE, asked

from conformance.manifest import VECTORS, Accepted, Vector, load
from conformance.runner import encoders
from refcodec.bitstream import codec, reconstruction
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.reconstruction import step_values
from refcodec.bitstream.scene import Scene
from refcodec.encoder.masks import mask_model
from refcodec.encoder.positions import pack_positions
from refcodec.encoder.weights import pack_weights
from spec.example import document

ROOT = Path(__file__).resolve().parents[2]
ENCODER = ROOT / "examples" / "encoder" / "encoder.mjs"
SERVER = Path(__file__).with_name("encode_example.mjs")

FILES = [v for v in load().vectors if isinstance(v.expectation, Accepted) and v.operation == "decode"]
# What Annex B says how to choose.
CHOSEN = {
    *("mask_model", "cell_shift", "position_model", "position_forms"),
    *("weight_scales", "weight_forms", "chunk_anchors"),
}
# Static, view-dependent, of several chunks, all masked, without anchors, of packed and raw chunks.
FREE = (
    *("valid-static-packed", "valid-plain", "valid-chunks-uneven"),
    *("valid-masks-none", "valid-empty", "valid-cells-mixed"),
)

Encoder = Callable[[dict[str, Any]], bytes]


@pytest.fixture(scope="module")
def encode(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Encoder]:
    """The file that the example makes of a scene as text. ValueError: what it refuses. One process makes all files."""
    if NODE is None:
        pytest.skip(MISSING)
    path = tmp_path_factory.mktemp("encoder") / "scene"
    with asked(SERVER) as ask:

        def encoded(scene: dict[str, Any]) -> bytes:
            path.write_text(json.dumps(scene), encoding="utf-8")
            if said := ask(str(path)):
                raise ValueError(said)
            return path.with_name("scene.c3gs").read_bytes()

        yield encoded


def _read(vector: Vector) -> bytes:
    return (VECTORS / vector.input.path).read_bytes()


def _of_version_0(data: bytes) -> bytes:
    """The file without the fields of a later minor version, which no encoder of version 0 writes (E15.2-2)."""
    return codec.emit(replace(codec.parse(data).scene, minor=0, later=b""))


def _chosen(scene: Scene) -> bytes:
    """The file of refcodec for a scene whose coding parameters are those of Annex B."""
    scene = replace(scene, mask_model=mask_model(scene.masks), chunk_anchors=None, minor=0, later=b"")
    return codec.emit(pack_weights(pack_positions(scene)))


@pytest.mark.parametrize("name", FREE)
def test_annex_b(encode: Encoder, c_decoder: Program, name: str) -> None:
    """What is left out is chosen as by refcodec, and all three decoders find the same scene."""
    data = _read(next(v for v in FILES if v.id == name))
    scene = {key: value for key, value in document(data).items() if key not in CHOSEN}
    made = encode(scene)
    assert made == _chosen(codec.parse(data).scene)
    assert encoders.examine(made).good
    assert c_decoder.verdict(made) == (reconstruction.digest(codec.parse(made).scene)[0], -1)
    # Given raw positions and weights, the order of the anchors is kept, and so is the scene.
    raw = encode({**scene, "position_model": None, "weight_scales": None})
    assert c_decoder.verdict(raw) == (reconstruction.digest(codec.parse(data).scene)[0], -1)


@pytest.mark.slow
def test_all_files(encode: Encoder) -> None:
    """With the coding parameters of the file, and, of valid files, with those that Annex B chooses."""
    for vector in FILES:
        data = _read(vector)
        scene = document(data)
        assert encode(scene) == _of_version_0(data), vector.id
        if vector.klass == "valid":
            free = {key: value for key, value in scene.items() if key not in CHOSEN}
            assert encode(free) == _chosen(codec.parse(data).scene), vector.id


def test_values_are_quantised(encode: Encoder) -> None:
    """SPEC B.7: without step indices the attributes are values, which need not be multiples of their steps."""
    data = codec.emit(random_scene(7, 40, chunk_size=16, lanes=Lanes(1, 1, 2)))
    scene = document(data)
    steps = [step_values(base) for base in scene["base_step"]]
    for anchor in scene["anchors"]:
        step = [float(of[q]) for of, q in zip(steps, anchor.pop("step_index"), strict=True)]
        for kind, size, change in zip(("features", "scalings", "offsets"), step, (0.25, -0.25, 0.25), strict=True):
            anchor[kind] = ((np.array(anchor[kind]) + change) * size).tolist()
        masked = np.array(anchor["mask"]) == 0
        anchor["offsets"] = np.where(masked[:, None], 0, anchor["offsets"]).tolist()
    assert encode(scene) == data


def test_refusals(encode: Encoder) -> None:
    """It says what is wrong, and where SPEC.md says so."""
    scene = document((VECTORS / "tiny-example.c3gs").read_bytes())
    first = scene["anchors"][0]
    packed = document((VECTORS / "tiny-packed.c3gs").read_bytes())
    networks = scene["networks"]
    heavy = [{**layer, "bias": [1e9] * len(layer["bias"])} for layer in networks["sarm"]]
    for wrong, said in (
        ({**scene, "networks": {**networks, "sarm": heavy}}, "R6.8-4"),
        ({**scene, "networks": {**networks, "sarm": networks["hyper"]}}, "layers of sarm .*5.8"),
        ({**scene, "anchors": [{**first, "position": [1e6, 0, 0]}]}, "not a finite f16.*B.1"),
        ({**scene, "anchors": [{**first, "step_index": [0, 0, 0]}]}, "step_index is 0,0,0, but F_h gives .*7.8"),
        ({**scene, "anchors": [{**first, "features": [2**23] * 5}]}, "R8.5-1"),
        ({**scene, "profile": 2}, "no level of profile 2.*11.2"),
        ({**scene, "chunk_size": 2**32}, "out of range"),
        ({**packed, "anchors": packed["anchors"][::-1]}, "order of cells.*7.12"),
    ):
        with pytest.raises(ValueError, match=said):
            encode(wrong)


@pytest.mark.skipif(NODE is None, reason=MISSING)
def test_the_commands_of_its_first_lines(tmp_path: Path) -> None:
    """From a file to its scene as text, and back."""
    scene, again = tmp_path / "scene.json", tmp_path / "again.c3gs"
    example = VECTORS / "tiny-example.c3gs"
    with scene.open("w", encoding="utf-8") as text:
        subprocess.run([sys.executable, "-m", "spec.example", str(example)], cwd=ROOT, stdout=text, check=True)
    assert scene.read_text(encoding="utf-8") == example.with_suffix(".json").read_text(encoding="utf-8")
    subprocess.run([str(NODE), str(ENCODER), str(scene), str(again)], cwd=tmp_path, check=True)
    assert again.read_bytes() == example.read_bytes()
    scene.write_text("{}")
    done = subprocess.run([str(NODE), str(ENCODER), str(scene), str(again)], capture_output=True, check=False)
    assert done.returncode == 1
    done = subprocess.run([str(NODE), str(ENCODER), str(scene)], capture_output=True, check=False)
    assert done.returncode == 64
    assert b"usage" in done.stderr
