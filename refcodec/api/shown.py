"""The scene that a command draws or exports: a file, the folder of a scene, or a scene."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import NamedCamera, cameras
from ..bitstream.codec import emit, parse, parse_ancillary, parse_container
from ..bitstream.header import RenderInfo
from ..bitstream.metadata import metadata
from ..bitstream.scene import Ancillary
from ..bitstream.scene import Scene as CodedScene
from ..bitstream.source import Place, StrPath
from ..encoder.quantise import packed
from ..files.terminal import note
from ..folder.georeference import stated_offset
from ..folder.layout import check_scene_folder
from ..folder.places import COPIES, SPLAT_COPIES, check_cloud, progress_bar, read_whole, shown_name
from ..folder.read import read_folder
from ..folder.uncompressed import Uncompressed, is_uncompressed, read_uncompressed
from ..rendering.camera import scene_up
from ..statuses import UsageError, refusing
from .command import ReadingWords
from .scenes import Scene

if TYPE_CHECKING:
    from ..photographs.photographs import PhotographSet


class Shown:
    """A scene to draw. name: for messages. folder: the path of its folder. data: the bytes of its file. Or None."""

    name: str
    folder: Path | None
    data: bytes | None

    def __init__(self, place: Place | Scene, words: ReadingWords, copies: int = COPIES, program: int = 0) -> None:
        """copies, program: of the scene that the command holds, and the bytes of its further packages.

        Raises BitstreamError for a file whose container is rejected, BoundPassedError, UsageError and OSError.
        """
        self._words, self.folder, self.data = words, None, None
        self.name = shown_name(place)
        if isinstance(place, Scene):
            self.scene = place.coded
        elif isinstance(place, str | os.PathLike) and os.path.isdir(place):
            self.folder = Path(place)
            check_cloud(self.folder, words, program)
            check_scene_folder(self.folder)
            plain = is_uncompressed(self.folder)
            self.scene = read_uncompressed(self.folder) if plain else read_folder(self.folder)
        else:
            self.data = read_whole(place, words, copies, program, SPLAT_COPIES)
            parse_container(self.data)

    @cached_property
    def scene(self) -> CodedScene | Uncompressed:
        """The scene. That of a file is decoded when it is first used. Raises BitstreamError."""
        with progress_bar(self._words) as progress:
            return parse(self.data or b"", progress=progress).scene

    @property
    def render(self) -> RenderInfo:
        """The render information (SPEC 6.5), without decoding."""
        return self.scene.render if self.data is None else parse_container(self.data).render

    @property
    def cameras(self) -> list[NamedCamera]:
        """The cameras that the scene states, without decoding. The first one is the default view."""
        plain = self.uncompressed
        return cameras(self.ancillary) if plain is None else [*plain.cameras]

    @property
    def ancillary(self) -> Sequence[Ancillary]:
        """The ancillary sections, without decoding. An uncompressed scene has none."""
        if self.data is not None:
            return parse_ancillary(self.data)
        return self.scene.ancillary if isinstance(self.scene, CodedScene) else ()

    @property
    def up(self) -> NDArray[np.float64]:
        """SPEC 6.5: the up direction of the scene, a unit vector, float64 [3]."""
        return scene_up(self.render.up_axis, self.cameras)

    @property
    def uncompressed(self) -> Uncompressed | None:
        """The scene, if it is an uncompressed one."""
        return self.scene if self.data is None and isinstance(self.scene, Uncompressed) else None

    def coded(self) -> CodedScene:
        """Returns the scene. Raises UsageError for an uncompressed one."""
        if isinstance(self.scene, CodedScene):
            return self.scene
        raise UsageError(f"{self.name} is an uncompressed scene: encode it with refcodec encode, and give the file")

    def file(self) -> bytes:
        """Returns the bytes of the file. A scene is encoded. Raises UsageError for an uncompressed one."""
        if self.data is None:
            scene = self.coded()
            self.data = encoded(self.name, packed(scene, None, None) if self.folder else scene, self._words)
        return self.data

    def remark(self, *notes: str) -> None:
        """Prints messages on stderr."""
        for line in notes:
            note(f"refcodec: {line}")

    def photographs(
        self, folder: StrPath, words: dict[str, Any], compared: bool = False
    ) -> tuple[PhotographSet, list[str]]:
        """Returns photographs as trained_photographs, with the background of the scene. Raises UsageError."""
        from ..photographs.as_trained import trained_photographs

        camera = next(iter(self.cameras), NamedCamera())
        background = words.get("background") or ",".join(map(str, self.render.background))
        words = {**words, "background": background}
        offset = stated_offset(metadata(self.ancillary))
        return trained_photographs(folder, self.folder, camera, words, offset, self.name if compared else "")


def encoded(name: str, scene: CodedScene, words: ReadingWords) -> bytes:
    """Returns the file of a scene, and shows progress. name: of the scene. Raises UsageError."""
    with refusing(f"{name} cannot be encoded"), progress_bar(words) as show:
        return emit(scene, progress=show)


def note_compiling() -> None:
    """Reports on stderr if the rasteriser is compiled at each start. Needs the extra `render`."""
    from ..rendering.compiled import is_kept

    if not is_kept():
        note(
            "refcodec: compiled code cannot be stored, so compiling takes some seconds at each start: "
            "set NUMBA_CACHE_DIR to a writable folder"
        )
