"""Makes the files that SPEC.md Annex D explains, and their scenes as text, from which an encoder makes the same files.

Simple formulas give all numbers.

python -m spec.example FILE     prints the scene of any file as text
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, emit_cameras
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.limits import TINY
from refcodec.bitstream.metadata import METADATA, emit_metadata
from refcodec.bitstream.planes import no_planes
from refcodec.bitstream.positions import EMPTY_MODELS, HALVES, POSITION_MODELS, PositionModel
from refcodec.bitstream.scene import Ancillary, Scene, take_anchors
from refcodec.encoder.masks import mask_model
from refcodec.encoder.positions import frequencies, morton_order
from refcodec.encoder.weights import weight_scales

from .made import ROOT, Made

VECTORS = ROOT / "vectors"
EXAMPLE, PACKED = VECTORS / "tiny-example.c3gs", VECTORS / "tiny-packed.c3gs"
# The only packed layer of the second file, by network and number.
PACKED_LAYER = ("colour", 1)
DIMENSIONS = Dimensions(2, (2, 3), 1, 2, 4, (4,), (3,), (3,), 2)
ANCHORS = 5


def pattern(count: int, period: int) -> np.ndarray:
    """Returns `count` small integers of both signs, int64: 0, 1, -1, 2, -2 and so on, with a period."""
    n = np.arange(count) % period
    return np.where(n % 2, (n + 1) // 2, -(n // 2))


def example() -> Scene:
    """Returns the scene. It has five anchors in two chunks.

    One third of the offsets is masked. One large feature needs an escape. The first section is metadata, and the last
    one a camera.
    """
    networks = {}
    for number, (name, shapes) in enumerate(DIMENSIONS.network_shapes().items()):
        layers = []
        for out, fan_in in shapes:
            weight = (pattern(out * fan_in, 7 + number) / 4).astype(np.float32).reshape(out, fan_in)
            layers.append((weight, (8 * pattern(out, 5 + number)).astype(np.float32)))
        networks[name] = layers
    # The step indices lie near the middle of the table.
    networks["hyper"][-1][1][-3:] += 32
    count = ANCHORS * 2
    masks = (np.arange(count) % 3 != 2).reshape(ANCHORS, 2)
    offsets = pattern(3 * count, 9).reshape(ANCHORS, 2, 3).astype(np.int32)
    offsets[~masks] = 0
    features = pattern(5 * ANCHORS, 11).reshape(ANCHORS, 5).astype(np.int32)
    features[3, 4] = 1000
    unit = 1 << 16
    scene = Scene(
        profile=TINY,
        dimensions=DIMENSIONS,
        chunk_size=3,
        lanes=Lanes(0, 0, 1),
        base_step=(1.0, 0.03125, 0.25),
        grid=PositionGrid((0, 0, 1 << 24), 3 << 14, -17),
        render=RenderInfo(),
        frame=Frame(
            np.diag([1 << 16, 1 << 17, 1 << 18]),
            np.array([0, -(1 << 38), 0]),
            np.array([25, 25, 25]),
            np.full(3, -2 * unit),
            np.full(3, 2 * unit),
        ),
        plane_shift=4,
        carm_shift=np.zeros(2, np.uint8),
        networks=networks,
        planes=pattern(5 * 16, 13).reshape(5, 1, 4, 4).astype(np.int16),
        mask_model=np.array([10000, 8192, 11000], np.uint16),
        positions=(pattern(3 * ANCHORS, 10) / 2 + 0.25).astype(np.float16).reshape(ANCHORS, 3),
        masks=masks,
        attributes=Attributes(
            features,
            pattern(6 * ANCHORS, 6).reshape(ANCHORS, 6).astype(np.int32),
            offsets,
            np.zeros((ANCHORS, 3), np.uint8),
        ),
        ancillary=(
            Ancillary(METADATA, 0, emit_metadata({"title": "Worked example", "licence": "CC0-1.0"}), 0),
            Ancillary(CAMERAS, 0, emit_cameras([NamedCamera()]), 5),
        ),
    )
    return replace(scene, attributes=replace(scene.attributes, steps=codec.derive_steps(scene)))


def packed() -> Scene:
    """Returns the second scene. It has five anchors in one chunk, no hyperprior, packed positions, a packed layer."""
    d = Dimensions(1, (2,), 0, 0, 0, (), (), (), 2)
    networks = {
        name: [(pattern(out * i, 5).astype(np.float32).reshape(out, i), np.zeros(out, np.float32)) for out, i in shapes]
        for name, shapes in d.network_shapes().items()
    }
    networks["hyper"][-1][1][d.attribute_width : 2 * d.attribute_width] = 8
    networks["hyper"][-1][1][-3:] = 32
    name, layer = PACKED_LAYER
    # The second row is all zero, and the grid exponent of the third differs from that of the first.
    networks[name][layer] = (np.array([[0.5, -0.25], [0, 0], [1.5, 3]], np.float32), np.array([1, 0, -0.5], np.float32))
    forms = [(key, number) == PACKED_LAYER for key, layers in networks.items() for number in range(len(layers))]
    scales = weight_scales(networks)
    scales[~np.array(forms)] = 0
    masks = np.ones((ANCHORS, 1), np.bool_)
    steps = np.full((ANCHORS, 3), 32, np.uint8)
    scene = Scene(
        profile=TINY,
        dimensions=d,
        chunk_size=ANCHORS,
        lanes=Lanes(0, 0, 1),
        base_step=(1.0, 0.125, 0.25),
        grid=PositionGrid(),
        render=RenderInfo(),
        frame=None,
        plane_shift=0,
        carm_shift=np.zeros(0, np.uint8),
        networks=networks,
        planes=no_planes(),
        mask_model=mask_model(masks),
        positions=np.array([[0, 0, 0], [1, 0, 0], [0, 3, 0], [1, 2, 3], [3, 3, 3]], np.float16),
        masks=masks,
        attributes=Attributes(
            pattern(2 * ANCHORS, 7).reshape(ANCHORS, 2).astype(np.int32),
            pattern(6 * ANCHORS, 5).reshape(ANCHORS, 6).astype(np.int32),
            pattern(3 * ANCHORS, 3).reshape(ANCHORS, 1, 3).astype(np.int32),
            steps,
        ),
        weight_scales=scales,
        weight_forms=np.array(forms, np.uint8),
    )
    # No two models are equal, so that a wrong model gives other symbols.
    counts = [1 + np.arange(HALVES) * (model + 1) % 19 for model in range(POSITION_MODELS)]
    rows = [frequencies(count, int(model in EMPTY_MODELS)) for model, count in enumerate(counts)]
    scene = take_anchors(scene, morton_order(scene.positions))
    return replace(scene, position_model=PositionModel(24, np.array(rows, np.uint16)))


def document(data: bytes) -> dict[str, Any]:
    """Returns all numbers of a file except those that follow from others. Names are those of SPEC.md chapter 5.

    A later minor version and its header fields are left out, as an encoder writes the lowest version ([E15.2-2]).
    """
    scene = codec.parse(data).scene
    a = scene.attributes
    model, forms, weight_forms = scene.position_model, scene.position_forms, scene.weight_forms
    anchors = zip(scene.positions, scene.masks, a.steps, a.scalings, a.offsets, a.features, strict=True)
    return {
        "profile": scene.profile,
        "dimensions": asdict(scene.dimensions),
        "chunk_size": scene.chunk_size,
        "lanes_log2": asdict(scene.lanes),
        "base_step": scene.base_step,
        "position_grid": asdict(scene.grid),
        "render_info": asdict(scene.render),
        "frame": scene.frame and {name: value.tolist() for name, value in vars(scene.frame).items()},
        "plane_shift": scene.plane_shift,
        "carm_shift": scene.carm_shift.tolist(),
        "networks": {
            name: [{"weight": weight.tolist(), "bias": bias.tolist()} for weight, bias in layers]
            for name, layers in scene.networks.items()
        },
        "weight_forms": None if weight_forms is None else weight_forms.tolist(),
        "weight_scales": None if scene.weight_scales is None else scene.weight_scales.tolist(),
        "planes": scene.planes.tolist(),
        "mask_model": scene.mask_model.tolist(),
        "cell_shift": model and model.cell_shift,
        "position_model": model and model.frequency.tolist(),
        "chunk_anchors": [len(chunk) for chunk in scene.chunks],
        "position_forms": forms and list(forms),
        "anchors": [
            {
                "position": position.tolist(), "mask": mask.astype(int).tolist(), "step_index": step.tolist(),
                "scalings": scalings.tolist(), "offsets": offsets.tolist(), "features": features.tolist(),
            }
            for position, mask, step, scalings, offsets, features in anchors
        ],
        "ancillary": [
            {"type": s.type.decode(), "mode": s.mode, "content": s.content.hex(), "after": s.after}
            for s in scene.ancillary
        ],
    }  # fmt: skip


def as_text(scene: dict[str, Any]) -> str:
    """Returns a document as JSON, with a line for each name, and for each item of a list of lists or objects."""
    lines = []
    for name, value in scene.items():
        words = json.dumps(value)
        if isinstance(value, list) and value and isinstance(value[0], list | dict):
            words = "[\n" + ",\n".join(f"  {json.dumps(item)}" for item in value) + "\n ]"
        elif name == "networks":
            words = "{\n" + ",\n".join(f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in value.items()) + "\n }"
        lines.append(f" {json.dumps(name)}: {words}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def made() -> Iterator[Made]:
    """Yields the files, each with its scene as text."""
    for path, scene in ((EXAMPLE, example()), (PACKED, packed())):
        data = codec.emit(scene)
        yield Made(path, data)
        yield Made.text(path.with_suffix(".json"), as_text(document(data)))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    try:
        text = as_text(document(Path(sys.argv[1]).read_bytes()))
    except (BitstreamError, OSError) as error:
        sys.exit(f"{sys.argv[1]}: {error}")
    print(text, end="")
