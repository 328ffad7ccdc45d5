"""How much contexts could save, by linear prediction in closed form: no training, and no bytes of networks.

  python -m benchmarks.lengths.bounds caliterra.c3gs large.train-state --work FOLDER

A channel is predicted by least squares from a context. Its bits are those of a Gaussian distribution of what is left,
of which the rounding is a part. That is neither a lower nor an upper bound of a network's length: networks also change
scales, and are not linear. The differences between contexts are what counts.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from refcodec.bitstream.context import positional_encoding
from refcodec.encoder.sizes import choose_plane_size
from refcodec.train.rate_model.hyperprior import VectorMatrix
from refcodec.train.rate_model.units import GAMMA_UNIT

from ..results import table
from .neighbours import nearest_before, nearest_coarser, nearest_of_all
from .scenes import Coded, read

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
BOUNDS_FILE = "bounds.jsonl"
# Of the least squares: so that channels that are constant do no harm.
RIDGE = 1e-3
# Slices that are tried, of the paper's features.
OTHER_SLICES = {
    "slices 10 40": (10, 40),
    "slices 25 25": (25, 25),
    "slices 5 x 10": (10,) * 5,
    "slices 10 x 5": (5,) * 10,
    "slices 50 x 1": (1,) * 50,
}
# Into so many parts anchors are dealt: each is predicted from the rest.
FOLDS = 5


def left_over(values: F64, context: F64) -> F64:
    """What predictions from a context [n, c], with a constant, leave of values [n, d].

    An anchor is predicted by the least squares of the others, without every FOLDS-th one to which it belongs: many
    inputs for few anchors then save no bits that they would not save.
    """
    read = np.concatenate([context, np.ones((len(values), 1))], axis=1)
    square, product = read.T @ read + RIDGE * np.eye(read.shape[1]), read.T @ values
    left = np.empty_like(values)
    for first in range(FOLDS):
        own, given = read[first::FOLDS], values[first::FOLDS]
        left[first::FOLDS] = given - own @ np.linalg.solve(square - own.T @ own, product - own.T @ given)
    return left


def kilobytes(left: F64) -> float:
    """1,000 bytes of all symbols under Gaussian distributions of what is left, one for each channel."""
    variance = (left * left).mean(axis=0) + 1 / 12
    return float(0.5 * np.log2(2 * np.pi * np.e * variance).sum() * len(left) / 8 / 1000)


def features(columns: F64, slices: tuple[int, ...], context: F64) -> float:
    """1,000 bytes of features that read the slices before and a context."""
    total, done = 0.0, 0
    for width in slices:
        total += kilobytes(left_over(columns[:, done : done + width], np.hstack([columns[:, :done], context])))
        done += width
    return total


def mean_of(columns: F64, index: I64) -> F64:
    """The mean of the columns of neighbours int64 [n, k], as far as there are any."""
    some = (index >= 0)[:, :, None]
    centred = columns - columns.mean(axis=0)
    return np.asarray((centred[np.maximum(index, 0)] * some).sum(axis=1) / np.maximum(some.sum(axis=1), 1))


def cell_means(columns: F64, places: I64, size: int) -> F64:
    """The mean of the others in one's cell of a grid of size^2 over the first two axes: planes that cost nothing."""
    cell = np.minimum(places[:, :2] * size >> 16, size - 1)
    _, number, count = np.unique(cell[:, 1] * size + cell[:, 0], return_inverse=True, return_counts=True)
    centred = columns - columns.mean(axis=0)
    total = np.zeros((len(count), columns.shape[1]))
    np.add.at(total, number, centred)
    return np.asarray((total[number] - centred) / np.maximum(count[number] - 1, 1)[:, None])


def measure(
    scene: Coded, note: Callable[[dict[str, list[float]]], None] = lambda found: None
) -> dict[str, list[float]]:
    """1,000 bytes of features and of scalings under contexts by name. note: told after each what is known by then."""
    count_f, count_s, _ = scene.counts
    columns = scene.symbols.numpy().astype(np.float64)
    own, scalings = columns[:, :count_f], columns[:, count_f : count_f + count_s]
    both = columns[:, : count_f + count_s]
    nothing, base = np.zeros((scene.count, 0)), choose_plane_size(scene.count)
    gamma = positional_encoding(scene.places[:, 2], VectorMatrix.frequencies) / GAMMA_UNIT
    found = {}

    def add(name: str, context: F64) -> None:
        found[name] = [features(own, scene.slices, context), kilobytes(left_over(scalings, context))]
        note(found)

    found["nothing"] = [features(own, (count_f,), nothing), kilobytes(left_over(scalings, nothing))]
    add("slices (S)", nothing)
    found["scalings after features"] = [found["slices (S)"][0], kilobytes(left_over(scalings, own))]
    done, chain = own, 0.0
    for i in range(count_s):
        chain += kilobytes(left_over(scalings[:, i : i + 1], done))
        done = np.hstack([done, scalings[:, i : i + 1]])
    found["scalings one by one after features"] = [found["slices (S)"][0], chain]
    found["features after scalings"] = [features(own, scene.slices, scalings), found["nothing"][1]]
    for name, slices in OTHER_SLICES.items():
        if sum(slices) == count_f:
            found[name] = [features(own, slices, nothing), found["nothing"][1]]
    for name, order in (
        ("features of most bits first", np.argsort(-own.var(axis=0))),
        ("features of fewest bits first", np.argsort(own.var(axis=0))),
    ):
        found[name] = [features(own[:, order], scene.slices, nothing), found["nothing"][1]]
    note(found)
    add("S, gamma", gamma)
    add("S, others of a cell of B x B", cell_means(both, scene.places, base))
    add("S, others of a cell of 2B x 2B, and of B x B", np.hstack(
        [cell_means(both, scene.places, 2 * base), cell_means(both, scene.places, base)]
    ))  # fmt: skip
    plane = cKDTree(scene.places[:, :2].astype(np.float64)).query(scene.places[:, :2], k=list(range(2, 10)))[1]
    add("S, 8 nearest of all along two axes", mean_of(both, plane))
    add("S, 8 nearest of all in space", mean_of(both, nearest_of_all(scene.cells, 8)))
    add("S, nearest one before", mean_of(both, nearest_before(scene.cells, 1)))
    before = mean_of(both, nearest_before(scene.cells, 4))
    add("S, 4 nearest before", before)
    add("S, 4 nearest before, gamma", np.hstack([before, gamma]))
    add("S, 3 nearest of a coarser level", mean_of(both, nearest_coarser(scene.cells, 3)))
    add("S, the anchor before in the file", np.vstack([np.zeros((1, both.shape[1])), both[:-1]]))
    return found


def rows(found: dict[str, list[float]]) -> list[list[str]]:
    """A row for each context: KB, and the change of both kinds together against slices alone."""
    whole = sum(found["slices (S)"])
    lines = []
    for name, (f, s) in found.items():
        lines.append([name, f"{f:.1f}", f"{s:.1f}", f"{100 * ((f + s) / whole - 1):+.1f} %"])
    return lines


def main() -> None:
    """Measures, prints and keeps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument(
        "--counts", type=int, nargs="+", default=[0], help="that many anchors that lie together; 0: all"
    )
    args = parser.parse_args()
    torch.set_num_threads(1)
    for path in args.scenes:
        whole = read(path)
        for count in args.counts:
            scene = whole.together(count, 0) if count else whole

            def note(found: dict[str, list[float]], scene: Coded = scene) -> None:
                with (args.work / BOUNDS_FILE).open("a") as stream:
                    stream.write(json.dumps({"scene": scene.name, "anchors": scene.count, "found": found}) + "\n")

            found = measure(scene, note)
            print("\n".join([f"{scene.name}, {scene.count:,} anchors", *table(HEAD, rows(found))]), flush=True)


HEAD = ["context", "features, KB", "scalings, KB", "both, against S"]

if __name__ == "__main__":
    main()
