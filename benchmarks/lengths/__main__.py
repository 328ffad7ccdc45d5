"""Measures other entropy models by code lengths, on fixed symbols of trained scenes.

  python -m benchmarks.lengths run FOLDER --question widths --scenes caliterra.c3gs --seeds 0 1 2
  python -m benchmarks.lengths note FOLDER trained-scene
  python -m benchmarks.lengths table FOLDER --results

FOLDER keeps what was measured, so that a run that is given again goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import torch

from .fit import fit
from .questions import QUESTIONS
from .report import FILE, note_training, write
from .scenes import read


def run(work: Path, question: str, paths: list[Path], seeds: list[int], counts: list[int], only: list[str]) -> None:
    """Measures what is not yet in the folder, and adds a line to its file for each."""
    work.mkdir(parents=True, exist_ok=True)
    store = work / FILE
    known = {
        (e["scene"], e["variant"], e["seed"])
        for e in map(json.loads, store.read_text().splitlines() if store.exists() else [])
    }
    for path in paths:
        whole = read(path)
        for seed in seeds:
            for count in counts or [0]:
                scene = whole.together(count, 0) if count else whole
                for name, variant in QUESTIONS[question].variants.items():
                    if (only and name not in only) or (scene.name, repr(variant), seed) in known:
                        continue
                    fitted = variant.fitted(scene.slices)
                    if fitted is None:
                        print(f"{scene.name}, {name}: left out, its slices are of other features", flush=True)
                        continue
                    start = time.process_time()
                    lengths = fit(scene, fitted, seed)
                    entry = {
                        "scene": scene.name,
                        "anchors": scene.count,
                        "file": scene.whole,
                        "sections": scene.sizes,
                        "question": question,
                        "variant": repr(variant),
                        "seed": seed,
                        "seconds": time.process_time() - start,
                        **lengths.document(),
                    }
                    with store.open("a") as stream:
                        stream.write(json.dumps(entry) + "\n")
                    print(f"{scene.name}, {name}, seed {seed}: {lengths.total:,.0f} bytes", flush=True)


def main() -> None:
    """Runs one of the two commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="measure one question")
    running.add_argument("work", type=Path)
    running.add_argument("--question", choices=QUESTIONS, required=True)
    running.add_argument("--scenes", type=Path, nargs="+", required=True)
    running.add_argument("--seeds", type=int, nargs="+", default=[0])
    running.add_argument("--counts", type=int, nargs="+", default=[], help="that many anchors of each scene, not all")
    running.add_argument("--only", nargs="+", default=[], help="these entropy models alone")
    making = commands.add_parser("table", help="print the tables")
    making.add_argument("work", type=Path)
    making.add_argument("--results", action="store_true", help="write them as a section of RESULTS.md")
    noting = commands.add_parser("note", help="keep what trained folders report of themselves")
    noting.add_argument("work", type=Path)
    noting.add_argument("folders", type=Path, nargs="+")
    args = parser.parse_args()
    torch.set_num_threads(1)
    if args.command == "run":
        run(args.work, args.question, args.scenes, args.seeds, args.counts, args.only)
    elif args.command == "note":
        for folder in args.folders:
            note_training(args.work, folder)
    else:
        write(args.work, args.results)


if __name__ == "__main__":
    main()
