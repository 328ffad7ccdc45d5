"""scene.json and render.json: the types of their values, and a reader that names the field of a fault."""

from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from msgspec import Meta, Struct

from ..bitstream.dimensions import Dimensions
from ..bitstream.frame import FRAME_RANGE_BOUND, FRAME_SHIFT_MAX, MATRIX_BOUND, TRANSLATION_BOUND
from ..bitstream.header import ALPHA_MOST, BASE_STEP_MAX, BASE_STEP_MIN, MAJOR, ORIGIN_BOUND, SCALE_EXPONENT_MAX, Lanes
from ..bitstream.positions import CELL_INDEX, HALVES, POSITION_MODELS
from ..bitstream.tables import TOTAL
from ..bitstream.weights import CARM_SHIFT_MAX, PLANE_SHIFT_MAX
from ..files.documents import DocumentError, FieldError, checked, read_json
from .layout import FORMAT, SceneFolderError

T = TypeVar("T")

# From half of the least number of float32 on, and below the numbers that it rounds to infinity.
_TINY, _HUGE = 2.0**-150, 2.0**128 - 2.0**103
# SPEC 5.17 counts cameras in 16 bits.
CAMERAS_MAX = (1 << 16) - 1

Bit = Annotated[int, Meta(ge=0, le=1)]
Byte = Annotated[int, Meta(ge=0, le=255)]
Short = Annotated[int, Meta(ge=0, le=65535)]
Length = Annotated[int, Meta(ge=1, le=(1 << 32) - 1)]
Number = Annotated[float, Meta(gt=-_HUGE, lt=_HUGE)]
Positive = Annotated[float, Meta(gt=_TINY, lt=_HUGE)]
Origin = Annotated[int, Meta(gt=-ORIGIN_BOUND, lt=ORIGIN_BOUND)]
Cell = Annotated[int, Meta(gt=-MATRIX_BOUND, lt=MATRIX_BOUND)]
Move = Annotated[int, Meta(gt=-TRANSLATION_BOUND, lt=TRANSLATION_BOUND)]
Shift = Annotated[int, Meta(ge=0, le=FRAME_SHIFT_MAX)]
Low = Annotated[int, Meta(ge=-FRAME_RANGE_BOUND, lt=FRAME_RANGE_BOUND)]
High = Annotated[int, Meta(ge=-FRAME_RANGE_BOUND, le=FRAME_RANGE_BOUND)]
Step = Annotated[float, Meta(ge=BASE_STEP_MIN, le=BASE_STEP_MAX)]
Frequencies = Annotated[list[Annotated[int, Meta(ge=0, le=TOTAL)]], Meta(min_length=HALVES, max_length=HALVES)]


def single(value: Any) -> Any:
    """Returns the float32 value nearest to a number, or a tuple of those of its numbers. Others stay as they are."""
    if isinstance(value, tuple):
        return tuple(map(single, value))
    return float(np.float32(value)) if isinstance(value, float) else value


# SPEC [R6.5-1]
class RenderFields(Struct):
    """SPEC 6.5."""

    background: tuple[Byte, Byte, Byte]
    up_axis: Annotated[int, Meta(ge=0, le=5)]
    near_plane: Positive
    distance_unit: Positive
    alpha_max: Annotated[float, Meta(gt=_TINY, le=ALPHA_MOST)]
    low_pass: Annotated[float, Meta(ge=0, lt=_HUGE)]
    colour_primaries: Byte
    transfer_characteristics: Byte
    render_model: Byte


class CameraFields(Struct):
    """SPEC 5.17."""

    name: str
    width: Length
    height: Length
    focal: tuple[Number, Number]
    principal_point: tuple[Number, Number]
    rotation: tuple[Number, Number, Number, Number]
    translation: tuple[Number, Number, Number]


class RenderFile(Struct):
    """render.json. camera: that of earlier folders, which have one."""

    render: RenderFields
    cameras: Annotated[list[CameraFields], Meta(max_length=CAMERAS_MAX)] | None = None
    camera: CameraFields | None = None
    voxel: Positive | None = None


class GridFields(Struct):
    """SPEC 6.4."""

    origin: tuple[Origin, Origin, Origin]
    scale_mantissa: Annotated[int, Meta(ge=1, le=65535)]
    scale_exponent: Annotated[int, Meta(ge=-SCALE_EXPONENT_MAX, le=SCALE_EXPONENT_MAX)]


class FrameFields(Struct):
    """SPEC 5.7."""

    matrix: tuple[tuple[Cell, Cell, Cell], tuple[Cell, Cell, Cell], tuple[Cell, Cell, Cell]]
    translation: tuple[Move, Move, Move]
    shift: tuple[Shift, Shift, Shift]
    low: tuple[Low, Low, Low]
    high: tuple[High, High, High]


class PositionModelFields(Struct):
    """SPEC 5.15."""

    cell_shift: Annotated[int, Meta(ge=0, le=CELL_INDEX)]
    frequency: Annotated[list[Frequencies], Meta(min_length=POSITION_MODELS, max_length=POSITION_MODELS)]


class AncillaryFields(Struct):
    """SPEC 5.4: an ancillary section, whose content is in a file of its own."""

    type: Annotated[str, Meta(pattern=r"\A[a-z][A-Za-z]{3}\Z")]
    mode: Byte
    after: Annotated[int, Meta(ge=0, le=5)]
    file: str


class SceneFile(Struct):
    """scene.json. The optional fields are choices of the encoder where they are missing.

    SPEC 15.3: the minor version and unknown header bytes are those of the source. A folder of version 0 has the same
    members.
    """

    version: Annotated[int, Meta(ge=0, le=MAJOR)]
    profile: str
    dimensions: Dimensions
    chunk_size: int
    lanes: Lanes
    base_step: tuple[Step, Step, Step]
    grid: GridFields
    render: RenderFields
    plane_shift: Annotated[int, Meta(ge=0, le=PLANE_SHIFT_MAX)]
    carm_shift: list[Annotated[int, Meta(ge=0, le=CARM_SHIFT_MAX)]]
    mask_model: list[Annotated[int, Meta(ge=1, lt=TOTAL)]]
    ancillary: list[AncillaryFields]
    anchor_count: Annotated[int, Meta(ge=0, lt=1 << 32)] = 0
    frame: FrameFields | None = None
    position_model: PositionModelFields | None = None
    weight_scales: list[tuple[Byte, Byte, Byte]] | None = None
    weight_forms: list[Bit] | None = None
    chunk_anchors: list[Length] | None = None
    position_forms: list[Bit] | None = None
    minor: Short = 0
    later: list[Byte] = []
    digest: dict[str, Any] | None = None
    fingerprint: Any = None


class FolderDocument(Generic[T]):
    """scene.json or render.json. root: its JSON value. values: the same, checked."""

    file: Path
    again: str
    root: dict[str, Any]
    values: T

    def __init__(self, file: Path, kind: type[T], form: str = FORMAT, again: str = "decode again") -> None:
        """Reads the file. form: the required value of "format". again: the last remedy in every message.

        Raises SceneFolderError if it is not JSON, has another format, or a field that is missing or not allowed.
        """
        self.file, self.again = file, again
        try:
            self.root = read_json(file)
        except DocumentError as error:
            raise SceneFolderError(file, f"it is not JSON ({error})", f"restore it, or {again}") from None
        if not isinstance(self.root, dict) or self.root.get("format") != form:
            raise SceneFolderError(file, f'its "format" is not "{form}"', f"give a folder of refcodec, or {again}")
        try:
            self.values = checked(self.root, kind)
        except FieldError as error:
            raise self.fault(error.name, error.problem) from None

    def fault(self, name: str, problem: str) -> SceneFolderError:
        """Returns the error about a field. problem: its predicate, such as "is missing"."""
        return SceneFolderError(self.file, f'"{name}" {problem}', f"correct the field, or {self.again}")

    def sized(self, name: str, count: int) -> list[Any]:
        """Returns a list whose length must be `count`. Raises SceneFolderError."""
        values: list[Any] = getattr(self.values, name)
        if len(values) != count:
            raise self.fault(name, f"has {len(values)} values, but must have {count}")
        return values
