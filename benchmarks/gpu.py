"""Times training on a GPU beside the CPU, phase by phase, and decoding the files that both make.

python -m benchmarks gpu [--size 400] [--steps 4000] [--write]

It needs an NVIDIA GPU, nvcc, torch for CUDA and gsplat (`pip install '.[train,cuda]'`), but no network: the photographs
are those of caliterra in examples/. gsplat is compiled when it is first imported, which takes minutes.
"""

import time
from argparse import Namespace
from statistics import median

import torch

from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Scene
from refcodec.encoder.quantise import packed
from refcodec.photographs.photographs import PhotographSet, parse_size, read_photographs
from refcodec.statuses import UsageError
from refcodec.train.command import report
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.trainer import Trainer

from .results import ROOT, Arguments, machine, table

OPTIONS: Arguments = {
    "--size": {"default": "400", "help": "longest side of the photographs (400)"},
    "--steps": {"type": int, "default": 4000, "help": "of each of the two training runs (4000)"},
}
HEAD = ["device", "phase", "steps", "median ms of a step"]


def timed(photographs: PhotographSet, settings: TrainSettings, device: str) -> tuple[list[list[str]], str]:
    """Trains on a device. Returns a row of HEAD for each phase of the schedule, and a line about the file.

    Raises ValueError without the device.
    """
    trainer, spent = Trainer(photographs, settings, device), dict[str, list[float]]()
    while trainer.clock.done < settings.steps:
        phase, began = trainer.clock.phase(trainer.clock.done) or "start", time.perf_counter()
        trainer.step()
        if device == "cuda":
            torch.cuda.synchronize()
        spent.setdefault(phase, []).append(1e3 * (time.perf_counter() - began))
    scene = trainer.result()
    assert isinstance(scene, Scene)
    data, psnr = emit(packed(scene, None, None)), report(trainer, scene)["psnr"]
    began = time.perf_counter()
    reconstruct(parse(data).scene)
    seconds = time.perf_counter() - began
    line = f"{device}: {len(data):,} bytes, {psnr:.2f} dB, decoded on the CPU in {seconds:.2f} s."
    return [[device, phase, str(len(ms)), f"{median(ms):.2f}"] for phase, ms in spent.items()], line


def section(options: Namespace) -> list[str]:
    """Returns the lines of the section. Raises UsageError if there is no GPU or no gsplat."""
    # As `refcodec train` does.
    torch.set_num_threads(1)
    photographs = read_photographs(ROOT / "examples" / "photographs" / "caliterra", parse_size(options.size))
    settings = varied(TrainSettings(), {"steps": options.steps, "size": options.size})
    try:
        cuda, cpu = (timed(photographs, settings, device) for device in ("cuda", "cpu"))
    except (ValueError, ModuleNotFoundError) as error:
        raise UsageError(f"{error}; pip install '.[train,cuda]' on a machine with an NVIDIA GPU") from None
    command = f"python -m benchmarks gpu --size {options.size} --steps {options.steps} --write"
    gpu = f"GPU: {torch.cuda.get_device_name()}, CUDA {torch.version.cuda}."
    return [f"`{command}`", "", machine("torch"), gpu, cuda[1], cpu[1], "", *table(HEAD, [*cpu[0], *cuda[0]])]
