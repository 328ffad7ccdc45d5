"""Speed and memory of the rasteriser as training uses it: an image, the L1 loss, and the gradients of all inputs.

OMP_WAIT_POLICY=PASSIVE python -m benchmarks.rasteriser

Draws two made-up scenes with the rasteriser and with a plain one that torch differentiates, on one thread and on two,
each time in a process of its own, in turns, and writes a section of RESULTS.md.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import torch
from torch.nn.functional import normalize

from refcodec.render import constants, projection, rasterise
from refcodec.render.camera import Camera
from refcodec.train import splat

from .resident import resident
from .results import machine, table, write_section

# Gaussians, width, height; the first one loads and compiles what the others use.
SCENES = {"tiny": (100, 40, 30), "S": (20_000, 200, 150), "L": (100_000, 400, 300)}
SETTINGS = rasterise.Settings(background=(0.1, 0.2, 0.3))
# A Gaussian's median deviation in pixels.
DEVIATION = 1.5
# Iterations of a process: at least so many, and for at least so many seconds.
ITERATIONS, SECONDS = 2, 4.0
STAGES = {
    "project": ["project_gaussians"],
    "sort, list": ["sort_by_depth", "list_tiles"],
    "blend": ["blend_tiles"],
    "unblend": ["unblend_tiles"],
    "unproject": ["unproject_gaussians"],
}
# Pixels along a side of the plain rasteriser's tile, and values of one of its tensors: the fastest power of four.
TILE, BATCH = 16, 1 << 22

Draw = Callable[..., torch.Tensor]


def made_up(name: str) -> tuple[list[torch.Tensor], Camera]:
    """Means, quaternions, lengths, opacities and colours, float32, and a camera that sees nearly all of them."""
    count, width, height = SCENES[name]
    chance = torch.Generator().manual_seed(0)
    focal = 0.9 * width
    z = 2 + 4 * torch.rand(count, generator=chance)
    x, y = ((torch.rand(count, generator=chance) * 1.1 - 0.55) * size / focal * z for size in (width, height))
    quaternion = normalize(torch.randn(count, 4, generator=chance), dim=-1)
    lengths = (DEVIATION * z / focal)[:, None] * torch.exp(0.5 * torch.randn(count, 3, generator=chance))
    opacity = torch.sigmoid(1.5 * torch.randn(count, generator=chance))
    colour = torch.rand(count, 3, generator=chance)
    c, s = np.cos(0.1), np.sin(0.1)
    rotation, translation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), np.array([0.05, -0.02, 0.1])
    mean = ((torch.stack([x, y, z], -1).double() - torch.from_numpy(translation)) @ torch.from_numpy(rotation)).float()
    camera = Camera(name, width, height, focal, focal, width / 2, height / 2, rotation, translation)
    return [mean, quaternion, lengths, opacity, colour], camera


def project_with_torch(
    mean: torch.Tensor, quaternion: torch.Tensor, lengths: torch.Tensor, camera: Camera
) -> tuple[torch.Tensor, ...]:
    """SPEC 14.4: (u, v) [n, 2], the covariance's xx, xy, yy, and depth, in float32."""
    world, shift = torch.from_numpy(camera.rotation).float(), torch.from_numpy(camera.translation).float()
    p = mean @ world.T + shift
    size, focal, centre = (
        torch.tensor(v) for v in ((camera.width, camera.height), (camera.fx, camera.fy), (camera.cx, camera.cy))
    )
    z = p[:, 2:]
    slope = p[:, :2] / z
    beyond = projection.BEYOND * size / focal
    limited = torch.minimum(torch.maximum(slope, -centre / focal - beyond), (size - centre) / focal + beyond)
    rows = (focal / z)[..., None] * (world[:2] - limited[..., None] * world[2])
    w, x, y, k = normalize(quaternion, dim=-1).unbind(-1)
    turned = torch.stack(
        [
            *(1 - 2 * (y * y + k * k), 2 * (x * y - w * k), 2 * (x * k + w * y)),
            *(2 * (x * y + w * k), 1 - 2 * (x * x + k * k), 2 * (y * k - w * x)),
            *(2 * (x * k - w * y), 2 * (y * k + w * x), 1 - 2 * (x * x + y * y)),
        ],
        -1,
    ).reshape(-1, 3, 3)
    half = rows @ (turned * lengths[:, None, :])
    xx, yy = ((half * half).sum(-1) + SETTINGS.low_pass).unbind(-1)
    return slope * focal + centre, xx, (half[:, 0] * half[:, 1]).sum(-1), yy, z[:, 0]


def draw_with_torch(*inputs: torch.Tensor, camera: Camera) -> torch.Tensor:
    """SPEC 14.4 and 14.5 in plain torch: every pixel of a tile against every Gaussian that is listed for it.

    Tiles with lists of about the same length are drawn at a time.
    """
    mean, quaternion, lengths, opacity, colour = inputs
    place, xx, xy, yy, depth = project_with_torch(mean, quaternion, lengths, camera)
    inverse = torch.stack([yy, -xy, xx], -1) / (xx * yy - xy * xy)[:, None]
    across, down = -(-camera.width // TILE), -(-camera.height // TILE)
    with torch.no_grad():
        reach = (2 * (opacity / constants.ALPHA_MIN).clamp(min=1).log()).sqrt()[:, None] * torch.stack(
            [xx, yy], -1
        ).sqrt()
        tiles = torch.tensor([across, down])
        first = torch.minimum(((place - reach) / TILE).floor().long().clamp(min=0), tiles)
        last = torch.minimum(((place + reach) / TILE).floor().long().clamp(min=-1) + 1, tiles)
        wide, high = (last - first).clamp(min=0).unbind(-1)
        held = torch.where((depth > SETTINGS.near_plane) & (opacity >= constants.ALPHA_MIN), wide * high, 0)
        of = torch.repeat_interleave(torch.arange(len(held)), held)
        number = torch.arange(len(of)) - (held.cumsum(0) - held)[of]
        tile = (first[of, 1] + number // wide[of]) * across + first[of, 0] + number % wide[of]
        order = torch.argsort(depth[of], stable=True)
        order = order[torch.argsort(tile[order], stable=True)]
        of, count = of[order], torch.bincount(tile, minlength=across * down)
        begin = count.cumsum(0) - count
        longest = torch.argsort(count, descending=True)
    pixels = (
        torch.stack(torch.meshgrid(torch.arange(TILE), torch.arange(TILE), indexing="xy"), -1).reshape(1, -1, 1, 2)
        + 0.5
    )
    background = torch.tensor(SETTINGS.background)
    parts, done = [], 0
    while done < len(longest):
        most = max(int(count[longest[done]]), 1)
        some = longest[done : done + max(BATCH // (most * TILE * TILE), 1)]
        done += len(some)
        index = torch.arange(most)
        there = index < count[some][:, None]
        members = of[(begin[some][:, None] + index).clamp(max=len(of) - 1)]
        corner = TILE * torch.stack([some % across, some // across], -1)
        d = pixels + corner[:, None, None] - place[members][:, None]
        a, b, c = inverse[members][:, None].unbind(-1)
        dx, dy = d.unbind(-1)
        alpha = opacity[members][:, None] * torch.exp(-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy)
        alpha = torch.where((alpha >= constants.ALPHA_MIN) & there[:, None], alpha.clamp(max=SETTINGS.alpha_max), 0.0)
        with torch.no_grad():
            going = torch.cumprod(1 - alpha, -1) >= constants.TRANSMITTANCE_MIN
        alpha = torch.where(going, alpha, 0.0)
        left = torch.cumprod(1 - alpha, -1)
        before = torch.cat([torch.ones_like(left[..., :1]), left[..., :-1]], -1)
        parts.append((alpha * before) @ colour[members] + left[..., -1:] * background)
    image = torch.cat(parts)[torch.argsort(longest)].reshape(down, across, TILE, TILE, 3).transpose(1, 2)
    return image.reshape(down * TILE, across * TILE, 3)[: camera.height, : camera.width]


def draw_with_rasteriser(*inputs: torch.Tensor, camera: Camera) -> torch.Tensor:
    """As training does."""
    mean, quaternion, lengths, opacity, colour = inputs
    return splat.draw(mean, quaternion, lengths, opacity, colour, camera, SETTINGS)[0]


DRAWERS: dict[str, Draw] = {"rasteriser": draw_with_rasteriser, "plain torch": draw_with_torch}


def iterate(draw: Draw, scene: str, iterations: int, seconds: float) -> tuple[list[float], float]:
    """Seconds of each iteration, and the loss."""
    inputs, camera = made_up(scene)
    target = torch.rand(camera.height, camera.width, 3, generator=torch.Generator().manual_seed(1))
    for value in inputs:
        value.requires_grad_()
    times: list[float] = []
    while len(times) < iterations or sum(times) < seconds:
        for value in inputs:
            value.grad = None
        start = time.perf_counter()
        loss = (draw(*inputs, camera=camera) - target).abs().mean()
        loss.backward()
        times.append(time.perf_counter() - start)
    return times, float(loss.detach())


def measure(name: str, scene: str) -> dict[str, Any]:
    """What a process of its own does and prints."""
    torch.set_num_threads(numba.get_num_threads())
    draw, spent = DRAWERS[name], dict.fromkeys(STAGES, 0.0)

    def timed(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            start = time.perf_counter()
            found = function(*arguments)
            spent[stage] += time.perf_counter() - start
            return found

        return call

    for stage, functions in STAGES.items():
        for function in functions:
            setattr(rasterise, function, timed(stage, getattr(rasterise, function)))
    iterate(draw, "tiny", 1, 0)
    before = resident("VmRSS") / 2**20
    # The first iteration finds caches and memory cold.
    iterate(draw, scene, 1, 0)
    spent.update(dict.fromkeys(STAGES, 0.0))
    times, loss = iterate(draw, scene, ITERATIONS, SECONDS)
    stages = {stage: 1000 * value / len(times) for stage, value in spent.items()}
    return {"times": times, "loss": loss, "peak": resident() / 2**20, "before": before, "stages": stages}


def ask(name: str, scene: str, threads: int) -> dict[str, Any]:
    """measure in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.rasteriser", "--measure", name, scene]
    environment = {**os.environ, "NUMBA_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    print(f"{name}, {scene}, {threads} threads", file=sys.stderr, flush=True)
    return dict(json.loads(done.stdout))


def section(rounds: int) -> list[str]:
    """The section's text."""
    runs: dict[tuple[str, str, int], list[dict[str, Any]]] = {}
    # Compiles, if nothing has yet.
    ask("rasteriser", "tiny", 2)
    for _ in range(rounds):
        for scene in ("S", "L"):
            for name in DRAWERS:
                for threads in (1, 2):
                    runs.setdefault((scene, name, threads), []).append(ask(name, scene, threads))
    rows, split = [], []
    for (scene, name, threads), found in runs.items():
        own = runs[scene, "rasteriser", threads]
        if abs(found[0]["loss"] / own[0]["loss"] - 1) > 1e-4:
            raise AssertionError(f"{name} draws another image")
        times, base = ([t for run in of for t in run["times"]] for of in (found, own))
        peak, scenes = max(run["peak"] for run in found), max(run["peak"] - run["before"] for run in found)
        ratio = f"{statistics.median(times) / statistics.median(base):.1f} times as fast"
        speed = [f"{1 / min(times):.2f}", f"{1 / statistics.median(times):.2f}"]
        memories = [f"{peak:.0f}", f"{scenes:.0f}"]
        rows.append([scene, name, str(threads), *speed, "" if name == "rasteriser" else ratio, *memories])
        if name == "rasteriser":
            run = min(found, key=lambda run: sum(run["stages"].values()))
            stages = list(run["stages"].values())
            rest = 1000 * statistics.fmean(run["times"]) - sum(stages)
            split.append([scene, str(threads), *(f"{v:.1f}" for v in (*stages, rest))])
    sizes = "; ".join(f"{name}: {n:,} Gaussians, {w} x {h} pixels" for name, (n, w, h) in SCENES.items() if n > 100)
    head = ["scene", "", "threads", "iterations a second", "median", "rasteriser, by the median", "peak MiB"]
    return [
        "`OMP_WAIT_POLICY=PASSIVE python -m benchmarks.rasteriser`",
        "",
        machine("numba", "torch"),
        f"{sizes}; median deviation {DEVIATION} pixels.",
        "An iteration is projection, image, L1 loss and the gradients of means, quaternions, lengths, opacities and",
        f"colours. Fastest and median iteration of {rounds} processes each, taken in turns; load average",
        f"{os.getloadavg()[1]:.1f} in the last five minutes, this run included.",
        "",
        *table([*head, "for the scene"], rows),
        "",
        "Plain torch is the tiled rasteriser of benchmarks/rasteriser.py, differentiated by autograd. Peak: the whole",
        "process, with Python, torch and numba; the last column is what of it came after they were loaded.",
        "",
        "Milliseconds of an iteration of the rasteriser, mean of its fastest process:",
        "",
        *table(["scene", "threads", *STAGES, "the rest"], split),
        "",
        "The rest is the loss, its gradient and what torch does around.",
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=2, help="processes of each kind (default: %(default)s)")
    parser.add_argument(
        "--measure", nargs=2, metavar=("NAME", "SCENE"), help="measure one in this process and print it"
    )
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure(*arguments.measure)))
        return
    write_section("rasteriser", "Rasteriser", section(arguments.rounds))


if __name__ == "__main__":
    main()
