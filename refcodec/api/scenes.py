"""A scene for programs and notebooks: its values, bytes and images."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera, cameras
from ..bitstream.codec import emit
from ..bitstream.dimensions import STATIC
from ..bitstream.metadata import metadata
from ..bitstream.reconstruction import Reconstruction, digest, reconstruct
from ..bitstream.scene import Scene as CodedScene
from ..bitstream.scene import take_anchors
from ..formats.splats import Splats
from ..inspect.elements import outline_of
from ..inspect.parts import part_bytes
from ..pages import notebook
from ..rendering.camera import Camera, check_camera, default_camera, scene_up
from ..rendering.gaussians import Gaussians, gaussians_of, static_splats
from .command import missing

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

    from ..rendering.view import View

F32 = NDArray[np.float32]

# The most anchors of a scene that a notebook renders. Larger ones are shown as some points.
DRAWN_ANCHORS = 50_000


class Scene:
    """A scene of N anchors with K offsets each. It has a representation for notebooks.

    A scene is immutable, and its arrays are read-only. To change one, create another:
    `Scene(dataclasses.replace(scene.coded, ...))`.

    coded: every number of the file, as integers (refcodec.bitstream.scene.Scene).
    """

    coded: CodedScene

    def __init__(self, coded: CodedScene, sizes: Mapping[str, int] | None = None) -> None:
        """coded: the integers. sizes: bytes of each part of their file, or None."""
        self.coded = read_only(coded)
        self._sizes = None if sizes is None else dict(sizes)

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Scene:
        """Returns the scene of a folder from `refcodec decode`, `train` or `fit`.

        Raises refcodec.folder.layout.SceneFolderError for every error in it. The folder of an uncompressed scene
        must be encoded first (`refcodec encode`).
        """
        from ..folder.read import read_folder

        return cls(read_folder(os.fspath(folder)))

    def write(self, folder: str | os.PathLike[str]) -> None:
        """Writes the scene as a folder of files that other programs read, such as point_cloud.ply.

        The write is atomic. Raises refcodec.folder.layout.SceneFolderError if the folder has other contents, and
        OSError.
        """
        from ..folder.write import write_folder

        write_folder(self.coded, os.fspath(folder))

    @property
    def anchor_count(self) -> int:
        """N."""
        return self.coded.anchor_count

    @property
    def offset_count(self) -> int:
        """K, the offsets of each anchor. Each offset that `masks` keeps has a Gaussian."""
        return self.coded.dimensions.offset_count

    @cached_property
    def values(self) -> Reconstruction:
        """SPEC 9: the float32 values of all anchors, bit-exact on every machine."""
        values: Reconstruction = read_only(reconstruct(self.coded))
        return values

    @property
    def positions(self) -> F32:
        """Positions of the anchors, float32 [N, 3], world units."""
        return self.values.positions

    @property
    def features(self) -> F32:
        """Features of the anchors, float32 [N, F]. They are inputs of the rendering networks."""
        return self.values.features

    @property
    def scalings(self) -> F32:
        """Scalings of the anchors, float32 [N, 6], natural logarithms of world units.

        The first three are the unit of the offsets, the others that of the Gaussians' axes.
        """
        return self.values.scalings

    @property
    def offsets(self) -> F32:
        """Offsets of the anchors, float32 [N, K, 3], in units of exp(scalings[:, :3]). Masked ones are 0."""
        return self.values.offsets

    @property
    def masks(self) -> NDArray[np.bool_]:
        """The kept offsets, bool [N, K]."""
        return self.coded.masks

    @property
    def metadata(self) -> dict[str, str]:
        """SPEC 6.14: the description of the file, such as title, author and licence."""
        return metadata(self.coded.ancillary)

    @property
    def cameras(self) -> list[Camera]:
        """SPEC 6.15: the cameras of the file. The first one is the default view."""
        return named_cameras(cameras(self.coded.ancillary))

    @property
    def camera(self) -> Camera:
        """The default view: the first camera of the file, or one at the world's origin without cameras."""
        return next(iter(self.cameras), default_camera(NamedCamera()))

    @property
    def up(self) -> NDArray[np.float64]:
        """SPEC 6.5: the up direction of the scene, a unit vector, float64 [3]. The file's cameras refine it."""
        return scene_up(self.coded.render.up_axis, cameras(self.coded.ancillary))

    @property
    def sizes(self) -> dict[str, int]:
        """Bytes of each part of the file. Their sum is the length of the file.

        A scene without a file is encoded once for them.
        """
        if self._sizes is None:
            data = emit(self.coded)
            self._sizes = part_bytes(data, outline_of(data))
        return dict(self._sizes)

    def save(self, file: str | os.PathLike[str] | SupportsWrite[bytes]) -> None:
        """SPEC 4.3: writes the scene as a C3GS file, the bytes that `refcodec.encode` returns.

        file: a path, or a file object in binary mode. The file of a path is replaced when the new one is complete.
        Raises ValueError and TypeError as `encode`, and OSError.
        """
        from ..files.stage import write_file

        data = emit(self.coded)
        if isinstance(file, str | os.PathLike):
            write_file(Path(file), data)
        else:
            file.write(data)

    def digest(self) -> str:
        """SPEC 9.3: returns the SHA-256 of the canonical reconstruction, in hexadecimal.

        It is the same for all decoders and machines.
        """
        return digest(self.coded)[0]

    def gaussians(self, camera: Camera | None = None) -> Gaussians:
        """SPEC 14.3 and 14.6: returns the Gaussians that a camera sees.

        camera: None for the default view. The mean, the lengths of the axes, the quaternion, the opacity and the colour
        of a Gaussian are float32 [n, ...], and anchor and offset say where it comes from. Raises ValueError for an
        invalid camera, and for a scene whose render model is not known (SPEC 6.5).
        """
        camera = camera or self.camera
        check_camera(camera)
        return gaussians_of(self.coded, camera, None if self.coded.render.render_model == STATIC else self.values)

    @cached_property
    def splats(self) -> Splats:
        """SPEC 9.4: the plain Gaussians of a static scene, bit-exact on every machine. See `refcodec.splats`.

        Raises ValueError for a scene that is not static.
        """
        splats: Splats = read_only(static_splats(self.coded))
        return splats

    def render(self, camera: Camera | None = None) -> NDArray[np.uint8]:
        """SPEC chapter 14: returns the image of a camera, uint8 [height, width, 3]: red, green and blue.

        It needs the extra `render`. The first image of a process includes seconds of compilation.

        Args:
            camera: None for the default view. `camera.resized(width, height)` returns one with another image size.

        Raises:
            ValueError: the image has more than 100,000,000 pixels (refcodec.rendering.camera.PIXELS_MAX), or the camera
                is invalid.
            ModuleNotFoundError: a package of the extra is missing.
        """
        view = self._view
        from ..rendering.view import eight_bits, own_camera

        return eight_bits(view.draw(camera or own_camera(view.camera)))

    def orbit(self, frames: int) -> list[Camera]:
        """Returns cameras on a circle around the scene that look at its middle. It needs the extra `render`."""
        return self._view.orbit(frames)

    @cached_property
    def _view(self) -> View:
        try:
            from ..rendering.view import View
        except ModuleNotFoundError as error:
            raise missing("drawing", {"": "render"}, error) from None
        return View(self.coded)

    def __repr__(self) -> str:
        kept = int(self.masks.sum())
        return f"<refcodec.Scene: {self.anchor_count:,} anchors, {kept:,} of {self.masks.size:,} offsets kept>"

    def _repr_html_(self) -> str:
        """Returns the HTML for a notebook: a table of anchors, offsets and bytes by part, and a small picture."""
        facts = [
            ("anchors", f"{self.anchor_count:,}"),
            ("offsets kept", f"{int(self.masks.sum()):,} of {self.masks.size:,}"),
            ("features", f"{self.coded.dimensions.features}"),
            *self.metadata.items(),
        ]
        return notebook.table("C3GS scene", facts, self._sizes, self._picture())

    def _picture(self) -> bytes | notebook.Points | None:
        """Returns an image of the scene as PNG, or some of its points if it cannot be drawn."""
        if drawn := small_picture(self):
            return drawn
        some = self._some_gaussians()
        return notebook.points(some.mean, some.colour, self.coded.render.up_axis)

    def _some_gaussians(self) -> Gaussians:
        """Returns at most notebook.POINTS Gaussians, from anchors across the scene."""
        step = max(1, -(-self.anchor_count // notebook.POINTS))
        seen = Scene(take_anchors(self.coded, slice(None, None, step))).gaussians(self.camera)
        some = slice(None, None, max(1, -(-len(seen.mean) // notebook.POINTS)))
        return Gaussians(**{name: values[some] for name, values in vars(seen).items()})


def read_only(value: Any) -> Any:
    """Returns a dataclass, dictionary, list or tuple with read-only views of its arrays. Other values are unchanged."""
    if isinstance(value, np.ndarray):
        view = value.view()
        view.flags.writeable = False
        return view
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: read_only(getattr(value, field.name)) for field in fields(value)})
    if isinstance(value, dict):
        return {key: read_only(item) for key, item in value.items()}
    if type(value) in (list, tuple):
        return type(value)(map(read_only, value))
    return value


def named_cameras(stated: list[NamedCamera]) -> list[Camera]:
    """Returns cameras of a file, with their names."""
    return [replace(default_camera(camera), name=camera.name) for camera in stated]


def small_picture(scene: Scene) -> bytes | None:
    """Returns a small image of the default view as PNG, or None if the scene is large or cannot be drawn."""
    if scene.anchor_count > DRAWN_ANCHORS:
        return None
    # The extra `render` is missing, or the scene cannot be drawn.
    with contextlib.suppress(ModuleNotFoundError, ValueError):
        from ..rendering.view import png

        return png(scene.render(_small(next(iter(scene.cameras or scene.orbit(1))))))
    return None


def _small(camera: Camera) -> Camera:
    """Returns the camera with its image scaled to a longest side of notebook.SIDE."""
    longer = max(camera.width, camera.height)
    return camera.resized(
        max(camera.width * notebook.SIDE // longer, 1), max(camera.height * notebook.SIDE // longer, 1)
    )
