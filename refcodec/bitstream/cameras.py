"""Clauses 5.17 and 6.15: named cameras, an ancillary section.

A violation in such a section is a warning and never refuses a file.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import construct as cs
import numpy as np
from numpy.typing import NDArray

from . import syntax
from .scene import Ancillary

F64 = NDArray[np.float64]

# SPEC 6.15
CAMERAS = b"cAMs"


def rotation_matrix(quaternion: F64) -> F64:
    """SPEC 14.4, ROTATION: returns the matrices, float64 [..., 3, 3], of unit quaternions w, x, y, z, [..., 4]."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


@dataclass(frozen=True)
class NamedCamera:
    """SPEC 5.17 and 14.2: a camera.

    width, height, focal, principal_point: pixels.
    rotation: a quaternion w, x, y, z, from the world to the camera.
    translation: from the world to the camera, world units.
    """

    name: str = "default"
    width: int = 800
    height: int = 600
    focal: tuple[float, float] = (700.0, 700.0)
    principal_point: tuple[float, float] = (400.0, 300.0)
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def matrix(self) -> F64:
        """SPEC 14.2: returns the rotation from the world to the camera, float64 [3, 3]."""
        quaternion = np.array(self.rotation, np.float64)
        # Scaled first, because every finite nonzero quaternion is allowed and squares of large numbers overflow.
        quaternion /= np.abs(quaternion).max()
        return rotation_matrix(quaternion / np.linalg.norm(quaternion))

    def fault(self) -> str | None:
        """SPEC 6.15: returns the violation in the camera, or None."""
        numbers = (*self.focal, *self.principal_point, *self.rotation, *self.translation)
        if not all(map(math.isfinite, numbers)):
            return "a number is NaN or infinite"
        if min(self.width, self.height, *self.focal) <= 0:
            return "its width, height or focal length is not above 0"
        if not any(self.rotation):
            return "its rotation is a quaternion of zeros"
        return None


def parse_cameras(content: bytes) -> tuple[list[NamedCamera], list[str]]:
    """SPEC 5.17 and 6.15: returns the valid cameras of a section, and its violations as text."""
    valid: list[NamedCamera] = []
    problems: list[str] = []
    names: set[bytes] = set()
    number = 0
    try:
        head, at = syntax.parse("Cameras", content)
        if head.reserved:
            problems.append("its reserved field is not 0")
        for number in range(head.count):
            fields, size = syntax.parse("Camera", content, at)
            end = at + 4 + fields.length
            # A later minor version may have added fields.
            if fields.length % 4 or not at + size <= end <= len(content):
                problems.append(f"the length of camera {number} is {fields.length}, which is not what its fields take")
                return valid, problems
            at = end
            camera, fault = _camera(fields)
            if fields.name in names:
                fault = fault or "its name is that of an earlier one"
            if any(fields.padding):
                problems.append(f"the padding of camera {number} is not zero")
            names.add(fields.name)
            if camera is None or fault:
                problems.append(f"camera {number}: {fault}")
            else:
                valid.append(camera)
    except cs.ConstructError:
        problems.append(f"it ends within camera {number}")
    else:
        if at != len(content):
            problems.append(f"{len(content) - at} bytes follow the last camera")
    return valid, problems


def _camera(fields: Any) -> tuple[NamedCamera | None, str | None]:
    """Returns a camera, or None if its name is not text, and its violation or None."""
    try:
        name = fields.name.decode()
    except UnicodeDecodeError:
        return None, "its name is not text"
    numbers = (tuple(fields[key]) for key in ("focal", "principal_point", "rotation", "translation"))
    camera = NamedCamera(name, fields.width, fields.height, *numbers)
    return camera, camera.fault()


def build_camera(fields: dict[str, Any]) -> bytes:
    """SPEC 5.17.1: returns the bytes of a camera, unchecked. fields: by name, apart from the lengths."""
    whole = {"name_length": len(fields["name"]), **fields, "length": 0}
    return syntax.build("Camera", {**whole, "length": len(syntax.build("Camera", whole)) - 4})


def emit_cameras(cameras: list[NamedCamera]) -> bytes:
    """SPEC 5.17: returns the bytes of a section. Raises ValueError for cameras that SPEC 6.15 does not allow."""
    head = syntax.build("Cameras", {"count": len(cameras), "reserved": 0})
    content = head + b"".join(build_camera({**vars(camera), "name": camera.name.encode()}) for camera in cameras)
    problems = parse_cameras(content)[1]
    if problems:
        raise ValueError(f"the cameras cannot be written: {problems[0]} (SPEC.md 6.15)")
    return content


def camera_sections(stated: Sequence[NamedCamera]) -> tuple[Ancillary, ...]:
    """Returns a section with the cameras, or no section for no cameras. Raises ValueError as emit_cameras."""
    return (Ancillary(CAMERAS, 0, emit_cameras([*stated])),) if stated else ()


def with_cameras(sections: Iterable[Ancillary], stated: Sequence[NamedCamera]) -> tuple[Ancillary, ...]:
    """Returns ancillary sections with their cameras replaced. Raises ValueError as emit_cameras."""
    return (*(section for section in sections if section.type != CAMERAS), *camera_sections(stated))


def cameras(sections: Iterable[Ancillary]) -> list[NamedCamera]:
    """Returns the valid cameras of all sections. The first one is the default view."""
    chosen = (section for section in sections if section.type == CAMERAS and not section.mode)
    return [camera for section in chosen for camera in parse_cameras(section.content)[0]]
