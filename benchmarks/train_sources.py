"""Trains the scenes of the suite's trained vectors again: vectors/valid/trained-*.c3gs.

python -m benchmarks.train_sources [NAME]

The generator decodes and encodes the existing vectors. A training run gives the same file only on the same machine with
the same libraries. The present vectors were trained for an earlier layout, and converted with the same values. After a
training, `conformance generate` updates the manifest.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from refcodec.bitstream import codec
from refcodec.encoder.quantise import packed
from refcodec.folder.read import read_folder
from refcodec.photographs.photographs import read_photographs
from refcodec.train.command import train
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied

from .results import ROOT

# Of each training run: lambda_r, steps, anchors at first and at most, and the form of positions and weights.
TRAININGS = {"caliterra": (0.004, 800, 1500, 2500, "packed"), "snowmiku": (0.01, 1000, 4000, 5000, "raw")}


def main() -> None:
    """Trains the named sources, or all."""
    for name in sys.argv[1:] or TRAININGS:
        *values, form = TRAININGS[name]
        keys = ("rate.lambda_r", "steps", "start.anchors", "growth.most")
        settings = varied(TrainSettings(), dict(zip(keys, values, strict=True)))
        photographs = read_photographs(ROOT / "examples" / "photographs" / name, (160, 120))
        with tempfile.TemporaryDirectory() as folder:
            scene = Path(folder) / "scene"
            train(photographs, settings, scene, threads=1, device="cpu", resume=False, progress=True)
            data = codec.emit(packed(read_folder(scene), form, form))
        (ROOT / "vectors" / "valid" / f"trained-{name}.c3gs").write_bytes(data)
        print(f"{name}: {len(data)} bytes")


if __name__ == "__main__":
    main()
