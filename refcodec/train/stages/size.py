"""Size: photographs are halved at first, because coarse anchors need no fine pixels; the time buys more steps."""

from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from ...rendering.camera import Camera
from ..stage import Stage

# The least pixels of a halved photograph. Fewer save little: anchors take most of the time (benchmarks/RESULTS.md).
PIXELS = 20000


class Size(Stage):
    """Halves the width and the height of the photographs."""

    name = "size"

    def halves(self, camera: Camera, done: int | None = None) -> bool:
        """Whether a camera's photographs are halved after `done` steps, or now."""
        # Photographs with a hull are mostly renderings. One scene gained from full size (RESULTS.md, closed studies).
        half = self.run.clock.mode(self.name, done) == "half" and self.run.scaffold.within != "hull"
        return half and (camera.width // 2) * (camera.height // 2) >= PIXELS

    def viewed(self, camera: Camera, photograph: Tensor) -> tuple[Camera, Tensor]:
        """The camera and the photograph (views.pixels) of a step."""
        if not self.halves(camera):
            return camera, photograph
        width, height = camera.width // 2, camera.height // 2
        halved = adaptive_avg_pool2d(photograph.permute(2, 0, 1), (height, width)).permute(1, 2, 0)
        return camera.resized(width, height), halved.contiguous()
