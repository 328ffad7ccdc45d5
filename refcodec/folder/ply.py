"""point_cloud.ply, in the Scaffold-GS checkpoint layout."""

# The encoder is imported where it is used, so that a decode that fails does not wait for it.
# ruff: noqa: PLC0415

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..bitstream.attributes import SCALINGS
from ..bitstream.reconstruction import Reconstruction
from ..files.ply import PlyError, float_columns, names_of, ply_header, read_ply
from ..files.stage import new_file
from .layout import MASK_LOGIT_MIN, SceneFolderError, there

if TYPE_CHECKING:
    from ..encoder.cloud import AnchorCloud

EXPORT, LAYOUT = "export the point cloud again", "give a point_cloud.ply in the layout of Scaffold-GS"


def ply_properties(offset_count: int, features: int) -> list[str]:
    """Returns the property names of a Scaffold-GS point cloud with masks, in file order."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_offset_{i}" for i in range(3 * offset_count)),
        *(f"f_mask_{i}" for i in range(offset_count)),
        *(f"f_anchor_feat_{i}" for i in range(features)),
        "opacity",
        *(f"scale_{i}" for i in range(SCALINGS)),
        *(f"rot_{i}" for i in range(4)),
    ]


def ply_values(r: Reconstruction, masks: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Returns the columns with data, float32 [N, columns], by the stem of their property names.

    The other properties, such as the normals, are constant. masks: bool [N, K].
    """
    return {
        "xyz": r.positions,
        # Component `axis` of offset k is the property axis * K + k.
        "f_offset_": r.offsets.transpose(0, 2, 1).reshape(len(masks), 3 * masks.shape[1]),
        "f_mask_": masks.astype(np.float32),
        "f_anchor_feat_": r.features,
        "scale_": r.scalings,
    }


class CloudFile:
    """A Scaffold-GS point cloud, binary little-endian float32, that is written by blocks of anchors."""

    def __init__(self, file: BinaryIO, count: int, offset_count: int, features: int) -> None:
        """Writes the header. count: N, the number of anchors. features: F. Raises OSError."""
        row = np.dtype([(name, "<f4") for name in ply_properties(offset_count, features)])
        file.write(ply_header({"vertex": (row, count)}))
        self._file = file

    def add(self, r: Reconstruction, masks: NDArray[np.bool_]) -> None:
        """Writes the next anchors. masks: bool [n, K]. Raises OSError."""
        n, values = len(masks), ply_values(r, masks)
        rotation = np.broadcast_to(np.array([1, 0, 0, 0], np.float32), (n, 4))
        zeros = np.zeros((n, 3), np.float32)
        columns = [
            *(values["xyz"], zeros, values["f_offset_"], values["f_mask_"], values["f_anchor_feat_"]),
            *(zeros[:, :1], values["scale_"], rotation),
        ]
        self._file.write(np.concatenate(columns, axis=1).astype("<f4", copy=False).tobytes())


def write_cloud(r: Reconstruction, masks: NDArray[np.bool_], path: str | Path) -> None:
    """Writes anchors as a Scaffold-GS point cloud to a new file.

    masks: bool [N, K]. Raises OSError, also if the path exists.
    """
    with new_file(Path(path)) as file:
        CloudFile(file, len(masks), masks.shape[1], r.features.shape[1]).add(r, masks)


class PlyColumns:
    """The vertex properties of a PLY file, as float32 columns. count: the number of vertices."""

    data: NDArray[Any]
    count: int

    def __init__(self, file: Path) -> None:
        """Reads the file. Raises SceneFolderError."""
        self.file = file
        try:
            self.data = read_ply(file)["vertex"]
        except KeyError:
            raise SceneFolderError(file, "it has no vertices", LAYOUT) from None
        except (PlyError, OSError) as error:
            raise SceneFolderError(file, f"it is not a readable PLY file ({error})", EXPORT) from None
        self.count = len(self.data)

    def names(self, stem: str) -> list[str]:
        """Returns the properties whose names are a stem and a number, ordered by number.

        The stem "xyz" stands for the properties x, y and z. Raises SceneFolderError if a number is missing.
        """
        known = names_of(self.data)
        if stem == "xyz":
            return [name for name in ("x", "y", "z") if name in known]
        numbered = [name for name in known if re.fullmatch(re.escape(stem) + r"\d+", name)]
        numbered.sort(key=lambda name: int(name[len(stem) :]))
        if [name[len(stem) :] for name in numbered] != [str(i) for i in range(len(numbered))]:
            raise SceneFolderError(self.file, f"the properties {stem}* are not numbered from 0", EXPORT)
        return numbered

    def check_number(self, stem: str, names: Sequence[str], wanted: int, advice: str) -> None:
        """Raises SceneFolderError, with a remedy, unless a stem has the wanted number of properties."""
        if len(names) != wanted:
            raise SceneFolderError(self.file, f"it has {len(names)} properties {stem}*, but must have {wanted}", advice)

    def array(self, names: Sequence[str]) -> NDArray[np.float32]:
        """Returns some properties as float32 [N, columns]."""
        return float_columns(self.data, names)


def read_cloud(path: str | Path) -> AnchorCloud:
    """Returns the anchors of a point_cloud.ply of Scaffold-GS, HAC, CAT-3DGS or a scene folder.

    The masks come from the properties f_mask_*:

    - Without these properties, every offset is kept.
    - If they are all 0 or 1, they are the masks.
    - Otherwise they are the logits of HAC and CAT-3DGS. An offset is kept if the sigmoid of its logit is above 0.01.
      CAT-3DGS also weighs the sigmoid with view counts, which the file does not have.

    Raises SceneFolderError if the file cannot be read, or a property is missing, or a value is not finite.
    """
    from ..encoder.cloud import AnchorCloud

    file = Path(path)
    if not there(file, LAYOUT):
        raise SceneFolderError(file, "there is no such file", LAYOUT)
    columns = PlyColumns(file)
    names = {stem: columns.names(stem) for stem in ("xyz", "f_offset_", "f_mask_", "f_anchor_feat_", "scale_")}
    count = len(names["f_offset_"]) // 3
    wanted = {"xyz": 3, "f_offset_": 3 * max(count, 1), "scale_": SCALINGS, "f_mask_": count if names["f_mask_"] else 0}
    for stem, number in wanted.items():
        columns.check_number(stem, names[stem], number, LAYOUT)
    if not names["f_anchor_feat_"]:
        raise SceneFolderError(file, "it has no properties f_anchor_feat_*", LAYOUT)
    arrays = {stem: columns.array(n) for stem, n in names.items()}
    for stem, array in arrays.items():
        if not np.isfinite(array).all():
            raise SceneFolderError(file, f"a value of {stem} is NaN or infinite", f"remove that anchor, or {EXPORT}")
    mask = arrays["f_mask_"]
    binary = bool(((mask == 0) | (mask == 1)).all())
    return AnchorCloud(
        positions=arrays["xyz"],
        features=arrays["f_anchor_feat_"],
        scalings=arrays["scale_"],
        offsets=np.ascontiguousarray(arrays["f_offset_"].reshape(columns.count, 3, count).transpose(0, 2, 1)),
        masks=(mask > (0 if binary else MASK_LOGIT_MIN)) if names["f_mask_"] else np.ones((columns.count, count), bool),
    )
