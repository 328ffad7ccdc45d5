"""Time and memory of each decoder for the worst known files of each decoding step, against SPEC.md 13.1.

python -m benchmarks worst [--write]

It takes a quarter of an hour, and needs `cc`.
"""

import shutil
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from conformance.cases.checksums import repair
from conformance.cases.target import Target
from refcodec.bitstream import codec
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.batches import GROUP_ANCHORS
from refcodec.bitstream.bounds import all_work
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.dimensions import Dimensions, mask_contexts, weight_count
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Header, Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.positions import EMPTY_MODELS, HALVES, POSITION_MODELS, PositionModel, cell_positions
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import STEP_LENGTH, TOTAL, tables_file
from refcodec.encoder.weights import weight_scales
from refcodec.statuses import REJECTED

from .decoders import Decoder, c_decoder
from .resident import Usage, usage
from .results import ROOT, Arguments, machine, mib, table

OPTIONS: Arguments = {}
SMALL = ROOT / "vectors" / "tiny-example.c3gs"
# Runs SPEC.md's blocks on a file.
BLOCKS = """
import sys
from pathlib import Path
from conformance import spec_decoder
spec_decoder.verdict(spec_decoder.names(), Path(sys.argv[1]).read_bytes())
"""
# A run of at least this many seconds is measured once.
LONG = 2.0
FRAME = Frame(
    np.eye(3, dtype=np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64), np.full(3, -1 << 17), np.full(3, 1 << 17)
)
# SPEC 8.5: the scale index of the narrowest models, so that a symbol of 0 takes almost no bits.
NARROW = -40


def _positions(count: int) -> np.ndarray:
    """Returns positions in the order of their cells, float16 [count, 3]."""
    code = np.arange(count)
    cell = np.zeros((count, 3), np.int64)
    for bit in range(16):
        for axis in range(3):
            cell[:, axis] |= (code >> (3 * bit + axis) & 1) << bit
    return cell_positions(cell + (1 << 15), 24)[0]


def _position_model() -> PositionModel:
    """Returns a model that codes full trees in almost no bits."""
    frequency = np.ones((POSITION_MODELS, HALVES), np.uint16)
    frequency[list(EMPTY_MODELS), 0] = 0
    for model in range(POSITION_MODELS):
        # A full node has the symbol 15 twice.
        likely = {0: 15, 5: 15}.get(model % 6, 1)
        frequency[model, likely] += TOTAL - int(frequency[model].sum())
    return PositionModel(24, frequency)


def scene(d: Dimensions, anchors: int, *, kept: bool = True, symbol: int = 0) -> Scene:
    """Returns a scene with one lane, chunks of 16,384 anchors, and symbols that take almost no bits.

    kept: whether offsets have symbols. symbol: of all attributes.
    """
    networks = {
        name: [(np.zeros(shape, np.float32), np.zeros(shape[0], np.float32)) for shape in shapes]
        for name, shapes in d.network_shapes().items()
    }
    width, size = d.attribute_width, d.plane_size
    networks["hyper"][-1][1][width : 2 * width] = NARROW
    networks["hyper"][-1][1][2 * width :] = STEP_LENGTH // 2
    if d.plane_channels:
        networks["sarm"][-1][1][1] = NARROW
    masks = np.full((anchors, d.offset_count), kept)
    model = np.full(mask_contexts(d.offset_count), TOTAL - 1 if kept else 1, np.uint16)
    # SPEC [R6.10-5]: a chunk has at least a byte per 16 anchors, so the first mask of each anchor takes half a bit.
    model[0] = round(TOTAL * (0.7 if kept else 0.3))
    offsets = np.where(masks[:, :, None], symbol, 0).repeat(3, axis=2).astype(np.int32)
    return Scene(
        profile=MAIN,
        dimensions=d,
        chunk_size=16384,
        lanes=Lanes(0, 0, 0),
        base_step=(1.0, 0.03125, 0.125),
        grid=PositionGrid(),
        render=RenderInfo(),
        frame=FRAME if d.has_frame else None,
        plane_shift=0,
        carm_shift=np.zeros(d.carm_inputs, np.uint8),
        networks=networks,
        planes=np.zeros((5, d.plane_channels, size, size), np.int16),
        mask_model=model,
        positions=np.concatenate(
            [np.zeros((0, 3), np.float16), *(_positions(len(c)) for c in chunk_ranges(anchors, 16384))]
        ),
        masks=masks,
        attributes=Attributes(
            np.full((anchors, d.features), symbol, np.int32),
            np.full((anchors, 6), symbol, np.int32),
            offsets,
            np.full((anchors, 3), STEP_LENGTH // 2, np.uint8),
        ),
        position_model=_position_model(),
        weight_scales=weight_scales(networks),
    )


def _weights(d: Dimensions) -> Scene:
    """Returns a scene without anchors, whose weights take almost no bits."""
    made = scene(d, 0)
    networks = {n: [(np.zeros_like(w), np.zeros_like(b)) for w, b in layers] for n, layers in made.networks.items()}
    return replace(made, networks=networks, weight_scales=np.zeros_like(made.weight_scales))


WIDE = Dimensions(16, (64, 64), 0, 0, 0, (), (), (), 1)
FEW = Dimensions(16, (1,), 0, 0, 0, (), (), (), 1)
# For each step: the substream that gets a wrong CRC-32, and a function that makes the scene, large or small.
CASES: dict[str, tuple[str, Callable[[bool], Scene]]] = {
    "planes, one lane": (
        "planes.r1",
        lambda large: scene(Dimensions(1, (1,), 16 if large else 2, 0, 256 if large else 128, (), (1,), (), 1), 0),
    ),
    "weights, one lane": (
        "weights",
        lambda large: _weights(
            Dimensions(16, (8,) * 16, 16, 16, 2, (128, 128), (32, 32), (128, 128), 128)
            if large
            else Dimensions(8, (8,) * 4, 4, 4, 2, (64,), (16,), (64,), 64)
        ),
    ),
    "positions and masks, one lane": ("masks[chunk 0]", lambda large: scene(FEW, 65536 if large else 4096, kept=False)),
    "attributes, one lane": ("attributes[chunk 0]", lambda large: scene(WIDE, 65536 if large else 1024)),
    "attributes, escapes": ("attributes[chunk 0]", lambda large: scene(WIDE, 2048 if large else 1024, symbol=5)),
}


def files(large: bool) -> dict[str, bytes]:
    """Returns for each step the worst accepted file, and one that its last check refuses."""
    made = {}
    for name, (path, make) in CASES.items():
        data = codec.emit(make(large))
        at = Target(data).substreams[path].start
        made[f"{name}, valid"] = data
        made[f"{name}, rejected"] = repair(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    return made


def memory_bound(header: Header, size: int) -> int:
    """SPEC.md 13.1: returns 4 m + 64 MiB for a decoder that holds at most 65,536 anchors. size: of the file."""
    d, n = header.dimensions, min(header.anchor_count, GROUP_ANCHORS)
    width, inputs = d.attribute_width, 2 * d.plane_channels + 2 * d.frequency_count
    stages = [
        65552,
        6 * weight_count(d),
        10 * d.plane_channels * d.plane_size**2,
        28 * header.chunk_count,
        n * (4 * (2 * width + 3) + 4 * width + 2 * inputs + d.offset_count + 6),
        n * (12 + d.offset_count + 4 * width),
        size,
    ]
    return 4 * sum(stages) + (64 << 20)


def decoders() -> dict[str, Decoder]:
    """Returns the command of each decoder, with FILE and OUT, and its environment. Raises OSError without `cc`."""
    refcodec = [sys.executable, "-m", "refcodec", "validate", "FILE"]
    made: dict[str, Decoder] = {
        "kernel": (refcodec, {"REFCODEC_PATH": "native", "REFCODEC_THREADS": "1"}),
        "NumPy": (refcodec, {"REFCODEC_PATH": "numpy"}),
        "C": ([str(c_decoder()), "digest", "FILE"], {"C3GS_TABLES": str(tables_file())}),
    }
    if shutil.which("node"):
        made["WebAssembly"] = ["node", str(ROOT / "refcodec" / "web" / "cli.js"), "decode", "FILE", "OUT"], {}
    return made


def least(decoder: Decoder, file: Path) -> Usage:
    """Runs a decoder three times, or once if it takes long. Returns what the run of the least processor time took.

    Raises ValueError for another status than that of an accepted or rejected file.
    """
    words, environment = decoder
    with tempfile.TemporaryDirectory() as folder:
        command = [{"FILE": str(file), "OUT": f"{folder}/out"}.get(word, word) for word in words]
        runs = [usage(command, environment)]
        while len(runs) < 3 and runs[0].processor < LONG:
            runs.append(usage(command, environment))
    if runs[0].status > REJECTED:
        raise ValueError(f"{' '.join(command)} ends with {runs[0].status}")
    return min(runs, key=lambda run: run.processor)


def rows(large: bool, wanted: dict[str, Decoder]) -> list[str]:
    """Measures decoders on the files of a size. Returns the lines of their table."""
    made: dict[str, list[str]] = {}
    most = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "file.c3gs")
        for title, decoder in wanted.items():
            small, worst = least(decoder, SMALL), 0.0
            for name, data in files(large).items():
                file.write_bytes(data)
                header, spent = codec.parse_container(data), least(decoder, file)
                units = all_work(header) / 1e9
                each = max(spent.processor - small.processor, 0) / units
                worst = max(worst, each)
                print(title, name, f"{each:.2f} s", sep=" | ", file=sys.stderr, flush=True)
                if name.endswith(", valid"):
                    own = [name.removesuffix(", valid"), f"{len(data):,}", f"{units:.4f}"]
                    row = made.setdefault(name, [*own, mib(memory_bound(header, len(data)))])
                    row.append(f"{each:.2f} s, {mib(max(spent.peak - small.peak, 0))} MiB")
            most.append(f"{worst:.2f} s")
    head = ["file", "bytes", "10^9 units", "allowed MiB", *wanted]
    return table(head, [*made.values(), ["most, with rejected files", "", "", "", *most]])


def section(_: Namespace) -> list[str]:
    """Returns the lines of the section. Raises OSError without `cc`, and ValueError if a decoder fails."""
    blocks: dict[str, Decoder] = {"blocks of SPEC.md": ([sys.executable, "-c", BLOCKS, "FILE"], {})}
    return [
        "`python -m benchmarks worst`",
        "",
        machine(),
        "s: processor seconds for 10^9 units (SPEC.md 13.1) with one thread, the least of three runs. s and MiB are",
        "less those of the same process for a file of 5 anchors. Allowed: 4 m + 64 MiB of SPEC.md 13.1. The rejected",
        "files have a wrong CRC-32 of symbols in the named step. SPEC.md's blocks decode smaller files.",
        "",
        *rows(True, decoders()),
        "",
        *rows(False, blocks),
    ]
