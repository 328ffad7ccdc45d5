"""The numbers that a decoder computes for anchors, by name: the values of `inspect --anchor` and of probes.

A probe is a line of a trace, `probe NAME[ANCHOR] NUMBERS`, with integers that spaces separate (conformance/README.md).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..bitstream.attributes import step_indices
from ..bitstream.codec import Coding
from ..bitstream.context import contract, frame_coordinates, positional_encoding, query, rescale
from ..bitstream.conventions import Int64
from ..bitstream.planes import assemble_planes
from ..bitstream.positions import position_integers
from ..bitstream.scene import Scene

PROBE = "probe "


@dataclass(frozen=True)
class Quantity:
    """Numbers of some anchors.

    name: of the probe. what: its words in `inspect --anchor`. clause: of SPEC.md, which computes it. values: int64
    [anchors, numbers].
    """

    name: str
    what: str
    clause: str
    values: Int64


def geometry(scene: Scene, at: slice) -> Iterator[Quantity]:
    """Yields the results of clauses 7.4 and 7.5 in order. at: the anchors."""
    p = position_integers(scene.positions[at])
    yield Quantity("P", "P of x, y, z", "7.4", p)
    if scene.frame is None:
        return
    v = frame_coordinates(scene.frame, p)
    w = contract(v)
    u = rescale(scene.frame, w)
    for name, clause, values in (("v", "7.5.1", v), ("w", "7.5.2", w), ("u", "7.5.3", u)):
        yield Quantity(name, name, clause, values)
    d = scene.dimensions
    for r, plane in enumerate(assemble_planes(scene.planes) if d.plane_channels else (), 1):
        samples = query(plane, u[:, :2], scene.plane_shift)
        yield Quantity(f"samples.r{r}", f"samples of the plane of r = {r}", "7.5.4", samples)
    yield Quantity("gamma", "positional encoding", "7.5.5", positional_encoding(u[:, 2], d.frequency_count))


def predictions(scene: Scene, coding: Coding, at: slice) -> list[Quantity]:
    """Returns the outputs of F_h: means, scale indices, and the outputs for the step indices. at: the anchors."""
    width = scene.dimensions.attribute_width
    hyper = coding.model.hyper(coding.contexts(at)).astype(np.int64)
    return [
        Quantity("means", "means that F_h gives", "7.7", hyper[:, :width]),
        Quantity("scales", "scale indices that F_h gives", "7.7", hyper[:, width : 2 * width]),
        Quantity("step_outputs", "outputs for the step indices", "7.8", hyper[:, 2 * width :]),
    ]


def slices(scene: Scene, coding: Coding, at: slice, mean: Int64, scale: Int64) -> Iterator[tuple[Quantity, Quantity]]:
    """Yields means and scale indices of each slice, with the outputs of CARM added. mean, scale: outputs of F_h."""
    features, done = scene.attributes.features[at].astype(np.int64), 0
    for i, columns in enumerate(scene.dimensions.slices):
        change = np.zeros((len(features), 2 * columns), np.int64)
        if i:
            change = coding.model.carm_correction(i, features[:, :done])
        part, what = slice(done, done + columns), f"slice {i}: mean and scale index of each channel"
        yield (
            Quantity(f"slice.{i}.means", what, "7.9", mean[:, part] + change[:, :columns]),
            Quantity(f"slice.{i}.scales", what, "7.9", scale[:, part] + change[:, columns:]),
        )
        done += columns


def before_symbols(scene: Scene, coding: Coding, at: slice) -> list[Quantity]:
    """Returns the values of anchors that precede the symbols of their attributes. at: the anchors."""
    return [*geometry(scene, at), *predictions(scene, coding, at)]


def of_slices(scene: Scene, coding: Coding, at: slice, known: list[Quantity]) -> list[list[Quantity]]:
    """Returns of each slice from 1 on its means and scale indices, known before its symbols.

    known: from before_symbols.
    """
    by_name = {q.name: q.values for q in known}
    return [list(pair) for pair in slices(scene, coding, at, by_name["means"], by_name["scales"])][1:]


def step_numbers(known: list[Quantity]) -> Quantity:
    """Returns the step indices. known: from before_symbols."""
    outputs = next(q.values for q in known if q.name == "step_outputs")
    what = "step indices of features, scalings, offsets"
    return Quantity("steps", what, "7.8", step_indices(outputs).astype(np.int64))


def lines(quantities: list[Quantity], first: int) -> Iterator[str]:
    """Yields the probes of some quantities, anchor after anchor. first: the number of the first anchor."""
    if not quantities:
        return
    for n in range(len(quantities[0].values)):
        for q in quantities:
            yield f"{PROBE}{q.name}[{first + n}]{''.join(f' {value}' for value in q.values[n].tolist())}\n"
