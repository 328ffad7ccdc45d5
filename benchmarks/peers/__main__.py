"""Peers in one harness.

python -m benchmarks.peers train PHOTOGRAPHS -o SPLAT.ply          a plain 3DGS, as an ordinary PLY file
python -m benchmarks.peers run PHOTOGRAPHS FOLDER --method 3dgs    runs of a method, one JSON file each
python -m benchmarks.peers table FOLDER                            one table and one plot of all runs in a folder
python -m benchmarks.peers.scene SPLAT.ply -o FOLDER               renders photographs of a splat, in NeRF's format

A finished run is not repeated, and an interrupted one is resumed. splat-transform writes SPZ and SOG; `run` prints the
command that installs it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numba
import torch

from refcodec.files.documents import DocumentError
from refcodec.files.outputs import check_apart
from refcodec.files.text import printable
from refcodec.photographs.photographs import PhotographError, read_photographs
from refcodec.statuses import DONE, INTERRUPTED, USAGE, UsageError
from refcodec.train.settings_file import SettingsError

from ..results import SEEDS, machine, write_section
from .cells import experiment_name, experiment_records
from .convert import ToolError
from .figures import Record, Scene, scenes
from .runs import METHODS, PLAIN, UNCODED, Run, perform, records, splat_settings, train_splats
from .table import PLOT_FILE, TABLE_FILE, TableError, commands, plot, report, tools, with_seeds, without

# The name of a method in the table.
BASELINE = "3DGS, SPZ, 4000 steps"
RESULTS_NOTE = (
    "One thread each. Every eighth image is held out, or the 25 of playbot's own split. PSNR and SSIM are those of",
    "eight-bit images, by scikit-image. SPZ 4 and SOG 2 are decoded before rendering. Bytes are those of the file,",
    "processor seconds those of the training. A spread is the standard deviation of the seeds. All methods draw with a",
    "low-pass filter of 0.1 square pixels.",
    "playbot is rendered from a splat of 31,000 Gaussians, PLAYBOT by Stephane Agullo (https://sa3d.fr), CC-BY-4.0, by",
    "`python -m benchmarks.peers.scene playbot_lod3.ply -o playbot --views 100 --tests 25 --size 400 --up=-y`.",
)


def _train(arguments: argparse.Namespace) -> int:
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    own = (arguments.photographs, PLAIN, arguments.most, arguments.seed, arguments.size, arguments.steps)
    settings = splat_settings(Run(*own, tuple(arguments.set)))
    photographs = read_photographs(arguments.photographs, arguments.size, seed=arguments.seed)
    check_apart([arguments.output], [arguments.photographs, *photographs.places()])
    trainer = train_splats(photographs, settings, arguments.output, arguments.resume)
    if trainer is None:
        print("interrupted: repeat the command with --resume", file=sys.stderr)
        return INTERRUPTED
    print(f"{arguments.output}: {len(trainer.result()['mean'])} Gaussians, {trainer.seconds:.0f} s of the processor")
    return DONE


def _run(arguments: argparse.Namespace) -> int:
    for seed in arguments.seeds:
        for strength in arguments.strengths:
            run = Run(
                arguments.photographs,
                arguments.method,
                strength,
                seed,
                arguments.size,
                arguments.steps,
                tuple(arguments.set),
            )
            if perform(run, arguments.folder) is None:
                print("interrupted: repeat the command to resume", file=sys.stderr)
                return INTERRUPTED
    return DONE


def _sections(
    arguments: argparse.Namespace, every: list[Record], found: list[Scene]
) -> list[tuple[str, str, list[str]]]:
    """Yields the sections of RESULTS.md: name, title and lines, one for each size.

    Raises TableError.
    """
    least, few = arguments.seeds, arguments.seeds < SEEDS
    certain = with_seeds(found, least)
    if not arguments.baseline.startswith(UNCODED):
        certain = without(certain, UNCODED)
    if not certain:
        raise TableError(f"no method has {least} seeds")
    words = [
        "python -m benchmarks.peers table FOLDER",
        *(f"--experiment {experiment_name(f)}" for f in arguments.experiment),
        "--results",
        *([f"--seeds {least}"] if few else []),
    ]
    title, every_size = "Peers in one harness", sorted({scene.size for scene in certain})
    groups = [(f"peers-{size}", f"{title}, {size} pixels", [size]) for size in every_size]
    if few:
        groups = [("peers-few", f"{title}, few seeds", every_size)]
    made = []
    for place, name, sizes in groups:
        runs = [record for record in every if record["size"] in sizes]
        head = [
            "```",
            *commands(runs, least),
            " ".join(words),
            "```",
            "",
            machine("torch"),
            *RESULTS_NOTE,
            *tools(runs),
            "",
        ]
        shown = [scene for scene in certain if scene.size in sizes]
        made.append((place, name, [*head, *report(shown, arguments.baseline)]))
    return made


def _table(arguments: argparse.Namespace) -> int:
    every = records(arguments.folder)
    cells = [cell for folder in arguments.experiment for cell in experiment_records(folder)]
    found = scenes([*every, *cells])
    lines = report(found, arguments.baseline)
    if arguments.results:
        for place, title, section in _sections(arguments, every, found):
            write_section(place, title, section)
    (arguments.folder / TABLE_FILE).write_text("\n".join(lines) + "\n", encoding="utf-8")
    plot(found, arguments.folder / PLOT_FILE)
    print("\n".join(lines))
    return DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    subcommands = parser.add_subparsers(required=True)

    def command(name: str, work: object, help_: str) -> argparse.ArgumentParser:
        found = subcommands.add_parser(name, help=help_, description=help_)
        found.set_defaults(work=work)
        return found

    train = command("train", _train, "trains a plain 3DGS and writes an ordinary PLY file")
    train.add_argument("photographs", type=Path)
    train.add_argument("-o", "--output", type=Path, required=True)
    train.add_argument("--most", type=int, default=16000, help="largest number of Gaussians (16000)")
    train.add_argument("--seed", type=int, default=0)
    train.add_argument("--resume", action="store_true", help="continues from the saved state")
    run = command("run", _run, "runs a method on photographs, for each strength and seed")
    run.add_argument("photographs", type=Path)
    run.add_argument("folder", type=Path)
    run.add_argument("--method", choices=METHODS, required=True)
    run.add_argument(
        "--strengths", type=float, nargs="+", required=True, help="3dgs: largest numbers of Gaussians; others: lambda_r"
    )
    run.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="0 1 2")
    for either in (train, run):
        either.add_argument("--size", type=int, default=200, help="longest side in pixels (200)")
        either.add_argument("--steps", type=int, default=2000, help="2000")
        either.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="changes a setting")
    table = command("table", _table, "writes the table and the plot of all runs in a folder")
    table.add_argument("folder", type=Path)
    table.add_argument(
        "--experiment",
        type=Path,
        action="append",
        default=[],
        metavar="FOLDER",
        help="adds the cells of an experiment, as `refcodec experiment -o` made them",
    )
    table.add_argument("--baseline", default=BASELINE, help=f"the method to compare with ({BASELINE})")
    table.add_argument("--results", action="store_true", help="also writes a section of benchmarks/RESULTS.md")
    table.add_argument(
        "--seeds", type=int, default=SEEDS, help=f"fewest seeds of a row there ({SEEDS}); below, it is another section"
    )
    return parser


def main(words: list[str] | None = None) -> int:
    """Runs one command. Returns its exit status."""
    arguments = _parser().parse_args(words)
    try:
        return int(arguments.work(arguments))
    except (
        PhotographError,
        SettingsError,
        DocumentError,
        ToolError,
        TableError,
        UsageError,
        ValueError,
        OSError,
    ) as error:
        print(printable(str(error), lines=True), file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
