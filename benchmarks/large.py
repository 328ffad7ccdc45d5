"""Large scenes with the symbols of a trained one, as files that are kept under out/.

A large scene repeats the anchors of a trained one. Each copy has its own chunks, so the cells of a chunk differ and its
positions are packed. All symbols and contexts are those of the trained scene. Two parts grow to the size of a large
scene, so that decoding has the same work:

- F_h and CARM get the hidden units that the encoder chooses for 421,600 anchors. The new units are copies of the
  trained ones, with zero weights in the next layer. Thus all outputs are those of the trained networks.
- The planes get the size that the encoder chooses for the number of anchors, by interpolation. Rounding changes the
  contexts and the bytes slightly.
"""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.codec import derive_steps, emit, parse
from refcodec.bitstream.dimensions import RENDER_MODELS, RENDERING, STATIC
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.networks import ACTIVATION_MAX, Layer
from refcodec.bitstream.planes import assemble_planes
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.bitstream.splat import OUTPUT_BITS
from refcodec.encoder.positions import morton_order, position_model
from refcodec.encoder.sizes import CHUNK_SIZE, choose_lanes, choose_plane_size, choose_width
from refcodec.files.stage import write_file

from .results import ROOT

# The folder of cached files, which Git ignores.
KEPT = ROOT / "out" / "benchmarks"
# The trained scene, and the number of anchors of the paper's largest one.
TRAINED = ROOT / "vectors" / "valid" / "trained-snowmiku.c3gs"
PAPER_ANCHORS = 421_600


def large(anchors: int, kept: Path = KEPT, static: bool = False) -> Path:
    """Returns the file of a scene with a number of anchors, which is cached by its source and the text of this module.

    anchors: at least 1. static: whether it is made static.
    """
    source = TRAINED.read_bytes()
    made_of = source + f"{anchors} {static}".encode() + Path(__file__).read_bytes()
    path = kept / f"{TRAINED.stem}-{anchors}-{hashlib.sha256(made_of).hexdigest()[:16]}.c3gs"
    if not path.exists():
        scene = parse(source).scene
        write_file(path, large_file(made_static(scene, 3) if static else scene, anchors))
    return path


def large_file(trained: Scene, anchors: int) -> bytes:
    """Returns the file of a scene with a number of anchors and the symbols of a trained scene."""
    copy = _grown(take_anchors(trained, morton_order(trained.positions)), anchors)
    rows = np.arange(anchors) % copy.anchor_count
    starts = range(0, anchors, copy.anchor_count)
    copies = [chunk_ranges(min(copy.anchor_count, anchors - start), CHUNK_SIZE) for start in starts]
    sizes = tuple(len(chunk) for chunks in copies for chunk in chunks)
    model = position_model(copy.positions[: len(rows)], CHUNK_SIZE)
    return emit(replace(take_anchors(copy, rows), chunk_anchors=sizes, position_model=model))


def _grown(scene: Scene, anchors: int) -> Scene:
    """Returns a scene with the same symbols, raw weights, and the widths, planes and lanes of a large scene."""
    d, width = scene.dimensions, choose_width(PAPER_ANCHORS)
    networks, widths = dict(scene.networks), {}
    if not d.plane_channels:
        raise ValueError("the trained scene has no planes")
    for name in ("hyper", "carm"):
        widths[name] = tuple(max(hidden, width) for hidden in getattr(d, f"{name}_width"))
        named = {network: layers for network, layers in networks.items() if network.partition(".")[0] == name}
        networks |= {network: widened(layers, widths[name]) for network, layers in named.items()}
    size = max(choose_plane_size(anchors), d.plane_size)
    planes = scene.planes if size == d.plane_size else resized_planes(scene.planes, size)
    dimensions = replace(d, hyper_width=widths["hyper"], carm_width=widths["carm"], plane_size=size)
    grown = replace(
        scene,
        profile=MAIN,
        chunk_size=CHUNK_SIZE,
        dimensions=dimensions,
        lanes=choose_lanes(anchors, 2.0 * d.attribute_width),
        networks=networks,
        planes=planes,
        weight_scales=None,
        weight_forms=None,
        ancillary=(),
    )
    a = grown.attributes
    return replace(grown, attributes=Attributes(a.features, a.scalings, a.offsets, derive_steps(grown)))


def made_static(scene: Scene, degree: int = 1) -> Scene:
    """Returns a static scene with the symbols of a view-dependent one. degree: of its harmonics.

    The hidden layers are those of the rendering networks for the distance 1 and no direction. The last layers are
    fitted to the outputs there. The new harmonics are small, so that colours depend on the view.
    """
    d, values, colours = scene.dimensions, reconstruct(scene), RENDER_MODELS[STATIC][1][degree]
    up = 2.0 ** np.floor(np.log2(ACTIVATION_MAX / np.abs(values.features).max()))
    networks = dict(scene.networks)
    for name in RENDERING:
        (weight, bias), (last, last_bias) = scene.networks[name]
        own, offset = weight[:, : d.features].astype(np.float64), bias + weight[:, -1]
        hidden = np.maximum(values.features @ own.T + offset, 0)
        wanted = (hidden @ last.T + last_bias).reshape(len(hidden), d.offset_count, -1)
        if name == "opacity":
            shown = np.clip(np.tanh(wanted), 1e-3, 0.99)
            wanted = np.log(shown / (1 - shown))
        elif name == "covariance":
            wanted[..., :3] = -np.log1p(np.exp(-wanted[..., :3]))
        else:
            base = (1 / (1 + np.exp(-wanted)) - 0.5) / 0.28209479177387814
            wanted = np.concatenate([base, *(0.1 * np.roll(base, i, axis=2) for i in range(1, colours // 3))], axis=2)
        wide = 2.0 ** np.floor(np.log2(ACTIVATION_MAX / hidden.max()))
        inputs = np.concatenate([np.minimum(np.rint(hidden * wide), ACTIVATION_MAX), np.ones((len(hidden), 1))], axis=1)
        outputs = wanted.reshape(len(hidden), -1) * (1 << OUTPUT_BITS)
        least = np.eye(inputs.shape[1])
        fitted = np.linalg.solve(inputs.T @ inputs + least, inputs.T @ outputs).T.astype(np.float32)
        first = (own * wide / up).astype(np.float32), (offset * wide).astype(np.float32)
        networks[name] = [first, (np.ascontiguousarray(fitted[:, :-1]), fitted[:, -1].copy())]
    return replace(
        scene,
        dimensions=replace(d, view_inputs=0, colour_outputs=colours),
        base_step=(scene.base_step[0] * float(up), *scene.base_step[1:]),
        render=replace(scene.render, render_model=STATIC),
        networks=networks,
        weight_scales=None,
        weight_forms=None,
    )


def widened(layers: list[Layer], widths: tuple[int, ...]) -> list[Layer]:
    """Returns the layers of a network with the same outputs and more hidden units.

    widths: of its hidden layers, none smaller than before.
    """
    wider, inputs = [], layers[0][0].shape[1]
    for (weight, bias), units in zip(layers, (*widths, len(layers[-1][1])), strict=True):
        rows = np.arange(units) % len(bias)
        # Weights for the new units of the previous layer are 0, so the exponent of each row does not change.
        more = np.zeros((units, inputs - weight.shape[1]), np.float32)
        wider.append((np.concatenate([weight[rows], more], axis=1), bias[rows]))
        inputs = units
    return wider


def resized_planes(planes: NDArray[np.int16], size: int) -> NDArray[np.int16]:
    """Returns sub-planes of another size, int16 [5, ch, size, size], by bilinear interpolation of the joined planes."""
    first, second = assemble_planes(planes)
    one, two = _resized(first, size), _resized(second, 2 * size)
    halves = slice(0, size), slice(size, 2 * size)
    return np.stack([one, *(two[:, rows, columns] for rows in halves for columns in halves)])


def _resized(plane: NDArray[np.int16], size: int) -> NDArray[np.int16]:
    """Returns a plane [ch, s, s] as [ch, size, size] with the same corners."""
    at = np.linspace(0, plane.shape[-1] - 1, size)
    low = np.minimum(at.astype(int), plane.shape[-1] - 2)
    share = at - low
    rows = plane[:, low] * (1 - share[:, None]) + plane[:, low + 1] * share[:, None]
    return np.rint(rows[:, :, low] * (1 - share) + rows[:, :, low + 1] * share).astype(np.int16)
