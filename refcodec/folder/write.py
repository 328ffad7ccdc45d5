"""Writer of scene folders, for scenes, and for files that are decoded by blocks of chunks."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.attributes import KINDS
from ..bitstream.batches import Progress, no_progress
from ..bitstream.errors import BitstreamError
from ..bitstream.header import MAJOR
from ..bitstream.limits import PROFILES
from ..bitstream.reader import Opened
from ..bitstream.reconstruction import StreamDigest, chunk_digest, reconstruct
from ..bitstream.scene import Scene, take_anchors
from ..bitstream.streaming import pieces
from ..files.stage import new_file
from ..files.text import counted
from . import layout
from .arrays import RowsFile, write_arrays, write_networks
from .ply import CloudFile

# The number of anchors that are reconstructed and written at once.
_ROWS = 8192


@dataclass(frozen=True, eq=False)
class Written:
    """The result of decoding a file into a folder.

    anchors: the number of written anchors.
    damage: the first error of each dropped chunk, by number. lost: the anchor count of each of them.
    error: the first error in the parts of the file that were read, or None.
    digests: the chunk digests, if certain chunks were wanted.
    """

    anchors: int
    damage: dict[int, BitstreamError]
    lost: dict[int, int]
    error: BitstreamError | None
    digests: list[str]

    def losses(self, chunks: int) -> Iterator[str]:
        """Yields a line for each dropped chunk, and a sum. chunks: those of the file."""
        for number, error in sorted(self.damage.items()):
            yield f"chunk {number} with {counted(self.lost[number], 'anchor')} is dropped: {error}"
        if self.damage:
            lost = counted(sum(self.lost.values()), "anchor")
            yield f"{len(self.damage)} of {chunks} chunks and {lost} are lost, and {self.anchors:,} are written"
        elif self.error:
            yield "no chunk is damaged, but another part of the file is"


def write_folder(scene: Scene, path: str | Path) -> None:
    """Writes a scene folder as a whole, or leaves it as it was. Errors: as for replace_scene."""

    def write(folder: Path) -> None:
        _write_files(folder, scene.anchor_count, scene, _blocks(scene), lambda: scene)

    layout.replace_scene(Path(path), write)


def decode_folder(
    opened: Opened,
    path: str | Path,
    numbers: range | None = None,
    *,
    keep_going: bool = False,
    progress: Progress = no_progress,
) -> Written:
    """Decodes a file into a scene folder, in memory that does not grow with the number of anchors.

    Args:
        opened: the file.
        path: the folder. It is written as a whole, or left as it was (replace_scene).
        numbers: the wanted chunk numbers, rising. None stands for the whole file, of which everything is checked.
        keep_going: drop a chunk with an error and note it in scene.json, and report an error behind the chunks. The
            good chunks of a damaged file are read twice, because the anchor count comes first in the written files.
        progress: receives the progress.

    Raises:
        BitstreamError: the first error of the file, without keep_going.
        SceneFolderError: as for write_folder.
    """
    index = opened.index
    wanted: Sequence[int] = range(len(index)) if numbers is None else numbers
    damage: dict[int, BitstreamError] = {}
    behind: list[BitstreamError] = []
    digests: list[str] = []

    def close() -> None:
        try:
            opened.close()
        except BitstreamError as error:
            if not keep_going:
                raise
            behind.append(error)

    def write_chunks(folder: Path, chosen: Sequence[int], noted: dict[int, BitstreamError] | None, again: bool) -> None:
        sizes: list[int] = []
        forms: list[int] = []

        def blocks() -> Iterator[Scene]:
            for piece in pieces(opened, chosen, damage=noted, progress=progress):
                sizes.extend(piece.chunk_anchors or ())
                forms.extend(piece.position_forms or ())
                if numbers is None:
                    yield from _blocks(piece)
                else:
                    yield from (take_anchors(piece, slice(chunk.start, chunk.stop)) for chunk in piece.chunks)

        def whole() -> Scene:
            if numbers is None and not again:
                close()
            return replace(opened.scene([]), chunk_anchors=tuple(sizes), position_forms=tuple(forms))

        count = sum(len(index[number].anchors) for number in chosen)
        digests[:] = _write_files(folder, count, opened.scene([]), blocks(), whole, damage, numbers)

    def write(folder: Path) -> None:
        write_chunks(folder, wanted, damage if keep_going else None, False)
        if damage:
            for file in folder.iterdir():
                file.unlink()
            write_chunks(folder, [number for number in wanted if number not in damage], None, True)

    layout.replace_scene(Path(path), write)
    lost = {number: len(index[number].anchors) for number in damage}
    anchors = sum(len(index[number].anchors) for number in wanted) - sum(lost.values())
    return Written(anchors, damage, lost, next(iter([*damage.values(), *behind]), None), digests)


def _write_files(
    path: Path,
    count: int,
    head: Scene,
    blocks: Iterable[Scene],
    whole: Callable[[], Scene],
    damage: dict[int, BitstreamError] | None = None,
    numbers: range | None = None,
) -> list[str]:
    """Writes the files of a scene folder. Returns the digests of the blocks if `numbers` is given.

    Args:
        path: the folder.
        count: N, the number of anchors.
        head: a scene with the dimensions.
        blocks: the anchors in order, in scenes.
        whole: called when all anchors are written; returns the scene, whose anchors are ignored.
        damage, numbers: as for decode_folder. scene.json has them.
    """
    d, digest = head.dimensions, StreamDigest()
    chunks: list[str] = []
    with new_file(path / layout.PLY_FILE) as ply, new_file(path / layout.CODED_FILE) as arrays:
        cloud = CloudFile(ply, count, d.offset_count, d.features)
        coded = RowsFile(arrays, {name: (a.dtype, a.shape[1:]) for name, a in _coded(head).items()}, count)
        for block in blocks:
            values = reconstruct(block)
            digest.add(block)
            cloud.add(values, block.masks)
            coded.add(_coded(block))
            if numbers is not None:
                chunks.append(chunk_digest(block))
    scene = whole()
    write_networks(path / layout.NETWORKS_FILE, scene.networks)
    write_arrays(path / layout.PLANES_FILE, {"planes": scene.planes})
    for number, section in enumerate(scene.ancillary):
        _put(path / layout.ancillary_name(number, section.type), section.content)
    document = _scene_document(scene, count, digest.finish_parts(scene))
    if numbers is not None:
        document["chunks"] = [numbers.start, numbers.stop]
    if damage:
        document["dropped_chunks"] = [
            {"chunk": number, **json.loads(error.to_json())} for number, error in sorted(damage.items())
        ]
    document["fingerprint"] = layout.fingerprint(document)
    _put(path / layout.SCENE_FILE, _json_text(document).encode())
    return chunks


def _blocks(scene: Scene) -> Iterator[Scene]:
    """Yields the anchors of a scene in order, in blocks."""
    for first in range(0, scene.anchor_count, _ROWS):
        yield take_anchors(scene, slice(first, first + _ROWS))


def _coded(scene: Scene) -> dict[str, NDArray[Any]]:
    """Returns the arrays of coded.safetensors."""
    a = scene.attributes
    return {
        "positions": scene.positions.view(np.uint16),
        "masks": scene.masks.astype(np.uint8),
        "steps": a.steps,
        **{kind: getattr(a, kind) for kind in KINDS},
    }


def _put(path: Path, content: bytes) -> None:
    with new_file(path) as file:
        file.write(content)


def _short(value: Any) -> Any:
    """Returns a value for JSON. A float gets the shortest text that gives the same float32; a tuple becomes a list."""
    if isinstance(value, tuple):
        return [_short(v) for v in value]
    return float(str(np.float32(value))) if isinstance(value, float) else value


def _scene_document(scene: Scene, count: int, digest: tuple[str, dict[str, str]]) -> dict[str, Any]:
    """Returns the values of scene.json. count: N. digest: those of the scene and of its parts."""
    return {
        "format": layout.FORMAT,
        "version": MAJOR,
        "profile": PROFILES[scene.profile].name,
        "anchor_count": count,
        "dimensions": vars(scene.dimensions),
        "chunk_size": scene.chunk_size,
        "lanes": vars(scene.lanes),
        "base_step": _short(scene.base_step),
        "grid": vars(scene.grid),
        "render": {name: _short(value) for name, value in vars(scene.render).items()},
        "frame": scene.frame and {f.name: getattr(scene.frame, f.name).tolist() for f in fields(scene.frame)},
        "plane_shift": scene.plane_shift,
        "carm_shift": scene.carm_shift.tolist(),
        "mask_model": scene.mask_model.tolist(),
        **_coding_document(scene),
        "ancillary": [
            {"type": a.type.decode("ascii"), "mode": a.mode, "after": a.after, "file": layout.ancillary_name(n, a.type)}
            for n, a in enumerate(scene.ancillary)
        ],
        "digest": {"whole": digest[0], **digest[1]},
    }


def _coding_document(scene: Scene) -> dict[str, Any]:
    """Returns the coding parameters. The encoder chooses missing ones."""
    coding: dict[str, Any] = {}
    if model := scene.position_model:
        coding["position_model"] = {"cell_shift": model.cell_shift, "frequency": model.frequency.tolist()}
    for name in ("weight_scales", "chunk_anchors", "position_forms", "weight_forms"):
        if (value := getattr(scene, name)) is not None:
            coding[name] = np.asarray(value).tolist()
    if scene.minor or scene.later:
        coding |= {"minor": scene.minor, "later": list(scene.later)}
    return coding


def _json_text(document: dict[str, Any]) -> str:
    """Returns indented JSON with each list of numbers on one line."""
    text = json.dumps(document, indent=2, allow_nan=False)
    return (
        re.sub(r"\[[^\[\]{}]*\]", lambda m: " ".join(m.group().split()).replace("[ ", "[").replace(" ]", "]"), text)
        + "\n"
    )
