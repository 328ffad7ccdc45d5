"""Stands for `python -m refcodec` in the tests of jobs: train, encode and eval, without scenes.

Like `refcodec train`, it writes a line to stderr every step, stops at SIGINT with its result so far, its state and
status 130, and resumes. FAKE_STEP is the time of a step in milliseconds, FAKE_FAIL the lambda_r that fails.
"""

import argparse
import json
import os
import signal
import sys
import time
from pathlib import Path


def train(given: argparse.Namespace, output: Path) -> int:
    if os.environ.get("FAKE_FAIL") == f"{given.lambda_r:g}":
        print("it went wrong", file=sys.stderr)
        return 70
    stopped = []
    signal.signal(signal.SIGINT, lambda *_: stopped.append(1))
    state, steps = Path(f"{output}.train-state"), given.steps or 1
    if state.exists() != given.resume or (given.resume and not state.read_text().isdigit()):
        return 64
    done = int(state.read_text()) if given.resume else 0
    while done < steps and not stopped:
        time.sleep(int(os.environ.get("FAKE_STEP", "0")) / 1000)
        done += 1
        print(f"step {done}", file=sys.stderr, flush=True)
    output.mkdir(parents=True, exist_ok=True)
    # Smaller files at higher rates.
    size = round((1 + given.seed / 10) * 1000 / (given.lambda_r or 1e-4) ** 0.5)
    report = {"steps": done, "bytes": size}
    (output / "training.json").write_text(json.dumps(report))
    if done < steps:
        state.write_text(str(done))
        return 130
    state.unlink(missing_ok=True)
    return 0


def main() -> int:
    parser = argparse.ArgumentParser()
    for name in ("module", "command", "input"):
        parser.add_argument(name)
    parser.add_argument("photographs", nargs="?")
    parser.add_argument("-o", dest="output", type=Path)
    parser.add_argument("--lambda", dest="lambda_r", type=float)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--resume", action="store_true")
    given, _ = parser.parse_known_args()
    if given.command == "train":
        return train(given, given.output)
    if given.command == "encode":
        given.output.write_bytes(bytes(json.loads(Path(given.input, "training.json").read_text())["bytes"]))
        return 0
    file = Path(given.input)
    size = file.stat().st_size if file.is_file() else 10**6
    mean = {"psnr": 20 + size / 1000, "ssim": 0.9, "psnr_3dgs": 20.5, "ssim_3dgs": 0.91}
    images = [{"image": f"{i}.jpg", **mean, "psnr": mean["psnr"] + i - 1} for i in range(3)]
    parts = {"header": 100, "attributes": size - 100}
    print(json.dumps({"bytes": size, "anchors": 30, "parts": parts, "mean": mean, "images": images}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
