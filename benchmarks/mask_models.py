"""Other models of the masks, by ideal code lengths: python -m benchmarks.mask_models, after benchmarks.packing scenes

They are static frequencies by other contexts, and logits of a network. It writes a section of RESULTS.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from refcodec.bitstream import codec
from refcodec.bitstream.conventions import Int64
from refcodec.encoder.quantise import packed

from .packing import SCENES
from .results import machine, table, write_section

NOTE = """
None is taken. K more outputs of F_h would cost for the most part what the logits save: 33 weights each. The rest is a
small share of a file."""


def static_bytes(context: Int64, kept: Int64) -> float:
    """Bytes of masks under the frequency of a kept offset in each context; both are [N, K]."""
    _, index = np.unique(context, return_inverse=True)
    index = index.reshape(-1)
    share = np.bincount(index, weights=kept.reshape(-1)) / np.bincount(index)
    each = share[index.reshape(kept.shape)]
    return float(-np.log2(np.where(kept == 1, each, 1 - each)).sum()) / 8


def logit_bytes(contexts: np.ndarray, kept: Int64, before: Int64) -> float:
    """Bytes of masks whose logits a network makes of F_h's contexts [n, .], without the network's own bytes.

    The network has 32 hidden units and is fitted to the masks, with a table by offset and count of those kept before.
    """
    torch.manual_seed(0)
    inputs, bits = torch.from_numpy(contexts.astype(np.float32) / 256), torch.from_numpy(kept.astype(np.float32))
    network = torch.nn.Sequential(
        torch.nn.Linear(inputs.shape[1], 32), torch.nn.ReLU(), torch.nn.Linear(32, kept.shape[1])
    )
    learnt = torch.nn.Parameter(torch.zeros(kept.shape[1], kept.shape[1]))
    columns, counts = torch.arange(kept.shape[1]), torch.from_numpy(before)
    optimiser = torch.optim.Adam([*network.parameters(), learnt], lr=0.01)
    nats = torch.zeros(())
    for _ in range(600):
        optimiser.zero_grad()
        logits = network(inputs) + learnt[columns, counts]
        nats = torch.nn.functional.binary_cross_entropy_with_logits(logits, bits, reduction="sum")
        nats.backward()
        optimiser.step()
    return float(nats.detach()) / np.log(2) / 8


def row(name: str, work: Path) -> list[str]:
    """Sizes of one scene's masks."""
    scene = packed(codec.parse((work / f"{name}-grid.c3gs").read_bytes()).scene, "packed", "packed")
    kept, k = scene.masks.astype(np.int64), scene.dimensions.offset_count
    column, before = np.arange(k)[None], np.cumsum(kept, axis=1) - kept
    history = (kept << column).cumsum(axis=1) - (kept << column)
    previous = np.vstack([np.zeros((1, k), np.int64), kept[:-1]])
    now, seen = column * k + before, column << k | history
    sizes = [
        static_bytes(now, kept),
        2 * len(scene.mask_model),
        static_bytes(seen, kept),
        2 * len(np.unique(seen)),
        static_bytes(now * 2 + previous, kept),
        logit_bytes(codec.Coding(scene).contexts(), kept, before),
    ]
    return [name, *(f"{size:,.0f}" for size in sizes)]


def main() -> None:
    """Measures and writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=Path("benchmark-runs"))
    work = parser.parse_args().work
    torch.set_num_threads(1)
    head = ["scene", "now", "model, bytes", "by all kept bits before", "model, bytes", "by the anchor before as well"]
    lines = [
        "`python -m benchmarks.mask_models`, after `python -m benchmarks.packing scenes`",
        "",
        machine("torch"),
        "",
    ]
    lines += [*table([*head, "logits from F_h's contexts"], [row(name, work) for name in SCENES]), *NOTE.splitlines()]
    write_section("packing-masks", "Models of the masks that were tried", lines)


if __name__ == "__main__":
    main()
