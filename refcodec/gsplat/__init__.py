"""A compression for gsplat's trainer, with the interface of gsplat's PngCompression. Only its methods load torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from torch import Tensor

    from ..formats.splats import Splats

FILE = "scene.c3gs"
# gsplat's names of the arrays of Splats.
KEYS = {"means": "mean", "scales": "scale", "quats": "quaternion", "opacities": "opacity", "sh0": "base", "shN": "rest"}


@dataclass
class C3gsCompression:
    """Writes splats as scene.c3gs: what `refcodec convert --fast` makes of a PLY file of them.

    The order of the Gaussians changes, as PngCompression's does. Those that no picture can show, those of little effect
    and those with NaN are left out. Other keys than those of `compress` are refused.

    psnr: of pictures of the decoded splats to those of the given ones, dB, from 20 to 70.
    cameras: those whose pictures count, where people look from: for each a camera-to-world matrix [4, 4], intrinsics
    [3, 3] in pixels, and its width and height in pixels. The default is around and among the splats, with up -y.
    verbose: whether progress is shown on stderr, and the result on stdout.
    """

    psnr: float = 46.0
    cameras: Sequence[tuple[ArrayLike, ArrayLike, tuple[int, int]]] = ()
    verbose: bool = True

    def compress(self, compress_dir: str | Path, splats: Mapping[str, Tensor]) -> None:
        """Writes scene.c3gs to a folder that exists. The splats stay as they are.

        splats: tensors of any device, before activation: means [N, 3], scales [N, 3], quats [N, 4] w, x, y, z,
        opacities [N], sh0 [N, 1, 3] and shN [N, K, 3] with K 0, 3, 8 or 15. Raises ValueError for others, and OSError.
        """
        import torch

        from ..bitstream.codec import emit
        from ..bitstream.header import RenderInfo
        from ..bitstream.scene import take_anchors
        from ..convert import fast
        from ..convert.pictures import chosen_cameras
        from ..convert.views import near_plane
        from ..files.stage import write_file
        from ..folder.places import progress_bar
        from ..formats.common import Options
        from ..formats.table import checked
        from ..rendering.camera import STATED, Camera, level_up, nearest_axis

        held, n = [checked(_splats(splats))], len(splats["means"])
        cameras = []
        for pose, lens, size in self.cameras:
            at, k, turn = np.asarray(pose, np.float64), np.asarray(lens), np.asarray(pose, np.float64)[:3, :3].T
            cameras.append(Camera("", *size, k[0, 0], k[1, 1], k[0, 2], k[1, 2], turn, -turn @ at[:3, 3]))
        up = Options().up if (level := level_up(cameras)) is None else level
        chosen = chosen_cameras(cameras, held[0], up, str(fast.SIDE), fast.VIEWS)
        render = RenderInfo(up_axis=nearest_axis(up), near_plane=near_plane(held[0]))
        # The trainer compresses without gradients, but the entropy model is learned.
        with progress_bar({"progress": self.verbose}) as show, torch.enable_grad():
            made = fast.converted(held, chosen, render, STATED if cameras else 1, self.psnr, progress=show)
            scene = made.scene if n else take_anchors(made.scene, slice(0))
            data = emit(scene, progress=show)
        write_file(Path(compress_dir) / FILE, data)
        if self.verbose:
            print(f"{FILE}: {len(data):,} bytes, {scene.anchor_count:,} of {n:,} Gaussians, {fmean(made.psnr):.1f} dB")

    def decompress(self, compress_dir: str | Path) -> dict[str, Tensor]:
        """SPEC 9.4: returns the tensors of the Gaussians in scene.c3gs, as for compress, float32 on the CPU.

        Raises BitstreamError, ValueError for a scene that is not static, and OSError.
        """
        import torch

        from ..api.opening import open
        from ..rendering.gaussians import static_splats

        with open(Path(compress_dir) / FILE) as file:
            splats = vars(static_splats(file.decode().coded))
        splats["base"] = splats["base"][:, None]
        return {name: torch.from_numpy(np.ascontiguousarray(splats[own])) for name, own in KEYS.items()}


def _splats(tensors: Mapping[str, Tensor]) -> Splats:
    """Returns gsplat's tensors as Gaussians, without copies on the CPU; one Gaussian for none. Raises ValueError."""
    from ..formats.harmonics import REST
    from ..formats.splats import Splats, narrowed

    shapes = {name: tuple(own.shape) for name, own in tensors.items()}
    n, k = shapes.get("means", (0,))[0], [*shapes.get("shN", ()), 0, 0][1]
    ends = (3,), (3,), (4,), (), (1, 3)
    right = dict(zip(KEYS, [*((n, *end) for end in ends), (n, k, 3)], strict=True))
    if shapes != right or k not in REST:
        raise ValueError(f"the tensors have the shapes {shapes}, but must have {right}, with 0, 3, 8 or 15 harmonics")
    if not n:
        one = {KEYS[name]: np.zeros((1, *shape[1:])) for name, shape in shapes.items()}
        return narrowed(**one | {"base": one["base"][:, 0], "quaternion": np.ones((1, 4))})
    arrays = {own: tensors[name].detach().cpu().float().numpy() for name, own in KEYS.items()}
    return Splats(**arrays | {"base": arrays["base"][:, 0]})
