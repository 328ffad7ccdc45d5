"""Trains the scenes of the suite's trained vectors again: vectors/valid/trained-*.c3gs.

python -m benchmarks.train_sources [NAME]

The generator decodes and encodes the existing vectors. A training run gives the same file only on the same machine with
the same libraries. The present vectors were trained for an earlier layout, and converted with the same values. After a
training, `conformance generate` updates the manifest.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from refcodec.bitstream import codec
from refcodec.encoder.quantise import packed
from refcodec.folder.read import read_folder
from refcodec.photographs.photographs import read_photographs
from refcodec.train.command import train
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied

ROOT = Path(__file__).resolve().parents[1]
VALID = ROOT / "vectors" / "valid"


@dataclass(frozen=True)
class Source:
    """A training run: photographs, size of images, settings, and the form of positions and weights."""

    photographs: str
    size: tuple[int, int]
    settings: TrainSettings
    form: str


def _settings(rate: float, steps: int, anchors: int, most: int) -> TrainSettings:
    """Returns settings. rate: lambda_r. anchors: initial number. most: largest number."""
    return varied(
        TrainSettings(), {"rate.lambda_r": rate, "steps": steps, "start.anchors": anchors, "growth.most": most}
    )


TRAININGS = {
    "caliterra": Source("caliterra", (160, 120), _settings(0.004, 800, 1500, 2500), "packed"),
    "snowmiku": Source("snowmiku", (160, 120), _settings(0.01, 1000, 4000, 5000), "raw"),
}


def main() -> int:
    """Trains the named sources, or all."""
    for name in sys.argv[1:] or TRAININGS:
        source = TRAININGS[name]
        photographs = read_photographs(ROOT / "examples" / "photographs" / source.photographs, source.size)
        with tempfile.TemporaryDirectory() as folder:
            scene = Path(folder) / "scene"
            train(photographs, source.settings, scene, threads=1, device="cpu", resume=False, progress=True)
            data = codec.emit(packed(read_folder(scene), source.form, source.form))
        (VALID / f"trained-{name}.c3gs").write_bytes(data)
        print(f"{name}: {len(data)} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
