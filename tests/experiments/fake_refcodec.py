"""A substitute for refcodec with simulated training and evaluation. The tests of demo, rd and experiment run it.

Like `refcodec train`, it writes a line to stderr every few steps, stops at SIGINT with its result so far and status
130, and resumes. FAKE_STEP is the time of a step in milliseconds.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from pathlib import Path

from PIL import Image

from conformance.cases.scenes import random_scene
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.reconstruction import digest
from refcodec.cli import main as cli
from refcodec.folder.write import write_folder
from refcodec.inspect.summary import document


def train(argv: list[str]) -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("photographs")
    parser.add_argument("-o", dest="output", required=True, type=Path)
    parser.add_argument("--lambda", dest="lambda_r", type=float)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--size")
    for name in ("--threads", "--seed", "--preset", "--device", "--background", "--holdout", "--anchors", "--voxel"):
        parser.add_argument(name)
    parser.add_argument("--set", action="append")
    parser.add_argument("--up")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--progress", action="store_true")
    arguments = parser.parse_args(argv)
    if os.environ.get("FAKE_FAIL") == f"{arguments.lambda_r:g}":
        print("it went wrong", file=sys.stderr)
        return 70
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    signal.signal(signal.SIGINT, stop)
    state = Path(f"{arguments.output}.train-state")
    if state.exists() and not arguments.resume:
        print("there is a state", file=sys.stderr)
        return 64
    done = int(state.read_text()) if arguments.resume else 0
    history = []
    while done < arguments.steps and not stopped:
        time.sleep(int(os.environ.get("FAKE_STEP", "0")) / 1000)
        done += 1
        history.append({"step": done, "seconds": done / 10, "psnr": 20 + done / 10, "anchors": 30, "bytes": 1000})
        print(f"step {done}", file=sys.stderr, flush=True)
    # Fewer anchors at higher rates.
    scene = random_scene(
        73,
        30 if not arguments.lambda_r else max(5, int(0.1 / arguments.lambda_r)),
        gain=0.3,
        base_step=(0.5, 0.125, 0.25),
    )
    scene.networks["opacity"][-1][1][:] = 5
    if arguments.lambda_r:
        write_folder(scene, arguments.output)
    else:
        arguments.output.mkdir(exist_ok=True)
        (arguments.output / "hidden.c3gs").write_bytes(emit(scene))
    sizes = {"positions": 360, "attributes": 7320, "masks": 0, "planes": 0, "weights": 2000}
    report = {
        "settings": {},
        "steps": done,
        "seconds": done / 10,
        "anchors": scene.anchor_count,
        "bytes": sizes,
        "history": history,
    }
    (arguments.output / "training.json").write_text(json.dumps(report))
    if done < arguments.steps:
        state.write_text(str(done))
        return 130
    state.unlink(missing_ok=True)
    return 0


def evaluate(argv: list[str]) -> int:
    """Grey images, and figures that rise with the size of the file."""
    from refcodec.photographs.photographs import TEST_EVERY, parse_size, read_photographs  # noqa: PLC0415

    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("photographs")
    parser.add_argument("--size")
    parser.add_argument("--holdout", type=int, default=TEST_EVERY)
    parser.add_argument("--images", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args(argv)
    file = arguments.scene if arguments.scene.is_file() else arguments.scene / "hidden.c3gs"
    facts = document(file.read_bytes(), digest(parse(file.read_bytes()).scene))
    mean = {"psnr": 20 + facts["bytes"] / 1000, "ssim": 0.9, "psnr_3dgs": 20.5, "ssim_3dgs": 0.91}
    rows = []
    size = parse_size(arguments.size)
    for photograph in read_photographs(arguments.photographs, size, holdout=arguments.holdout).test:
        camera = photograph.camera
        rows.append({"image": camera.name, **mean})
        if arguments.images:
            arguments.images.mkdir(exist_ok=True)
            Image.new("RGB", (camera.width, camera.height), (90, 90, 90)).save(
                arguments.images / f"{Path(camera.name).stem}.png"
            )
    parts = {section["name"]: section["bytes"] for section in facts["sections"]}
    print(
        json.dumps(
            {
                "bytes": facts["bytes"],
                "anchors": facts["header"]["anchor_count"],
                "parts": parts,
                "mean": mean,
                "images": rows,
            }
        )
    )
    return 0


def main() -> int:
    name, *rest = sys.argv[1:]
    return {"train": train, "eval": evaluate}[name](rest) if name in ("train", "eval") else cli.main([name, *rest])


if __name__ == "__main__":
    sys.exit(main())
