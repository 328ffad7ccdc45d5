"""Views of a scene: cameras around it, and images of it as PNG and GIF (SPEC.md chapter 14)."""

import io
from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from ..bitstream.cameras import NamedCamera, cameras
from ..bitstream.dimensions import RENDERING, STATIC
from ..bitstream.header import RenderInfo
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction, reconstruct
from ..bitstream.scene import Scene
from ..folder.uncompressed import Uncompressed
from ..formats.common import LINEAR, is_shown
from ..formats.splats import Splats
from .camera import Camera, axis_direction, check_camera, default_camera, looking, scene_up
from .gaussians import Gaussians, check_render_model, gaussians, static_gaussians, static_splats
from .rasterise import image

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

# The longest side in pixels of an image from a file's own camera. A file may state 65535, and such an image would not
# fit in memory.
SIDE_MAX = 4096
# The orbit: its elevation above the scene in degrees, and its distance in radii of the scene.
ELEVATION = 25.0
DISTANCE = 2.2
# Images per second in the animation of an orbit.
FRAME_RATE = 15
# The program name in images.
MARK = "refcodec"


def spiral(count: int, lowest: float, highest: float) -> tuple[F64, F64]:
    """Returns points that are spread evenly over a part of a sphere: sines of their elevations, and turns in radians.

    Both are float64 [count]. They follow the spiral of the golden angle. lowest, highest: sines of the elevations.
    """
    number = np.arange(count, dtype=np.float64)
    return lowest + (highest - lowest) * (number + 0.5) / count, number * np.pi * (3 - np.sqrt(5))


class View:
    """A scene that cameras look at.

    info: its render information. camera: its default view. up: a unit vector, float64 [3] (scene_up). values: its
    float32 values. masks: bool [N, K]. networks: the rendering networks. splats: the Gaussians of a static scene, else
    None. Raises RenderModelError.
    """

    info: RenderInfo
    masks: NDArray[np.bool_]
    camera: NamedCamera
    up: F64
    values: Reconstruction
    networks: dict[str, list[Layer]]
    splats: Splats | None

    def __init__(self, scene: Scene | Uncompressed) -> None:
        check_render_model(scene.render)
        stated = stated_cameras(scene)
        self.info, self.masks, self.camera = scene.render, scene.masks, next(iter(stated), NamedCamera())
        self.up = scene_up(self.info.up_axis, stated)
        self.values = reconstruct(scene) if isinstance(scene, Scene) else scene.values
        self.networks = {name: scene.networks[name] for name in RENDERING}
        self.splats = None
        if isinstance(scene, Scene) and self.info.render_model == STATIC:
            self.splats = static_splats(scene)

    def gaussians(self, camera: Camera) -> Gaussians:
        """Returns the Gaussians for a camera (SPEC 14.3, 14.6)."""
        if self.splats is not None:
            return static_gaussians(self.splats, self.masks, camera)
        return gaussians(self.values, self.masks, self.networks, camera, self.info.distance_unit)

    def draw(self, camera: Camera) -> F32:
        """Returns the image of a camera as it is displayed: sRGB, float32 [height, width, 3], 1 for white.

        Raises ValueError as rasterise.
        """
        blended = self.blended(camera)
        return encoded(blended) if self.info.transfer_characteristics == LINEAR else blended

    def blended(self, camera: Camera) -> F32:
        """SPEC 14.5: returns the image of a camera before any conversion. As draw."""
        check_camera(camera)
        return image(self.gaussians(camera), camera, self.info)

    @cached_property
    def extent(self) -> tuple[F64, float]:
        """Returns the middle of the scene, float64 [3], and its radius, both in world units.

        The median and the quantile leave out the few anchors that are far out in the background.
        """
        positions = self.values.positions.astype(np.float64)
        if not len(positions):
            positions = np.zeros((1, 3))
        middle = np.median(positions, axis=0)
        return middle, max(float(np.quantile(np.linalg.norm(positions - middle, axis=1), 0.9)), 1e-6)

    def around(self, name: str, height: float, turn: float, distance: float) -> Camera:
        """Returns a camera that looks at the middle of the scene, with the lens of own_camera.

        height: its elevation above the scene in radians. turn: its angle around the scene's upward axis, in radians.
        distance: from the middle, world units.
        """
        middle, _ = self.extent
        up, side = self.up, np.roll(axis_direction(self.info.up_axis), 1)
        side = side - (side @ up) * up
        side /= np.linalg.norm(side)
        front = np.cross(up, side)
        away = np.cos(height) * (np.cos(turn) * side + np.sin(turn) * front) + np.sin(height) * up
        rotation = looking(-away, up)
        lens = own_camera(self.camera)
        return replace(lens, name=name, rotation=rotation, translation=-rotation @ (middle + distance * away))

    def orbit(self, frames: int) -> list[Camera]:
        """Returns cameras on a circle around the scene that look at its middle, with the lens of own_camera."""
        _, radius = self.extent
        return [
            self.around(orbit_name(number), np.radians(ELEVATION), 2 * np.pi * number / frames, DISTANCE * radius)
            for number in range(frames)
        ]


def stated_cameras(scene: Scene | Uncompressed) -> list[NamedCamera]:
    """Returns the cameras that a scene states. The first one is the default view."""
    return cameras(scene.ancillary) if isinstance(scene, Scene) else [*scene.cameras]


def orbit_name(number: int) -> str:
    """Returns the name of a camera of View.orbit."""
    return f"orbit-{number:04d}"


def own_camera(stated: NamedCamera) -> Camera:
    """Returns the camera that a file states, with fewer pixels if a side of its image is longer than SIDE_MAX."""
    camera = default_camera(stated)
    longer = max(camera.width, camera.height)
    if longer <= SIDE_MAX:
        return camera
    return camera.resized(max(camera.width * SIDE_MAX // longer, 1), max(camera.height * SIDE_MAX // longer, 1))


# SPEC [G6.5-2]
def encoded(linear: F32) -> F32:
    """Returns the sRGB values, 0 to 1, of an image of linear light, float32 [height, width, 3]."""
    c = np.clip(linear, 0, 1)
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** np.float32(1 / 2.4) - 0.055).astype(np.float32)


def foreign_colours(info: RenderInfo) -> list[str]:
    """SPEC 6.5: returns a remark on colours that are drawn as if they were those of sRGB, or none."""
    if is_shown(info, LINEAR):
        return []
    codes = f"{info.colour_primaries} and {info.transfer_characteristics}"
    return [f"its colours have the codes {codes} of ITU-T H.273, and are drawn as those of sRGB"]


def eight_bits(image: F32) -> U8:
    """SPEC 14.5: returns an image as uint8, 255 for 1."""
    return np.floor(np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def pfm(image: F32) -> bytes:
    """Returns an image, float32 [height, width, 3], as a PFM file: its numbers as they are, the lowest row first."""
    height, width, _ = image.shape
    return b"PF\n%d %d\n-1.0\n" % (width, height) + image[::-1].astype("<f4").tobytes()


def png(pixels: U8) -> bytes:
    """Returns an image, uint8 [height, width, 3], as a PNG file, marked as written by refcodec."""
    text = PngInfo()
    text.add_text("Software", MARK)
    # ITU-T H.273: primaries and transfer of sRGB, RGB, full range.
    text.add(b"cICP", bytes([1, 13, 0, 1]))
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "PNG", pnginfo=text)
    return data.getvalue()


def gif(frames: Iterable[U8]) -> bytes:
    """Returns images, uint8 [height, width, 3], as an endless animation, marked as written by refcodec."""
    first, *rest = (Image.fromarray(frame).quantize(dither=Image.Dither.NONE) for frame in frames)
    data = io.BytesIO()
    duration = 1000 // FRAME_RATE
    first.save(data, "GIF", save_all=True, append_images=rest, duration=duration, loop=0, comment=MARK.encode())
    return data.getvalue()
