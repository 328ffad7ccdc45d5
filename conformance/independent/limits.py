"""Clause 11: profiles and levels."""

from typing import NamedTuple

from .conventions import FEATURES_MAX
from .dimensions import Dimensions, work
from .errors import require

# SPEC 11.1: for each dimension the bounds of Tiny and of Main. The bounds of a list are those of each item
PROFILE_BOUNDS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "offset_count": ((1, 10), (1, 16)),
    "plane_channels": ((0, 8), (0, 16)),
    "frequency_count": ((0, 10), (0, 16)),
    "render_width": ((1, 64), (1, 128)),
    "plane_size": ((2, 32), (2, 256)),
    "slice_count": ((1, 4), (1, 16)),
    "hyper_layers": ((0, 2), (0, 2)),
    "sarm_layers": ((1, 2), (1, 2)),
    "carm_layers": ((0, 2), (0, 2)),
    "slice_width": ((1, 16), (1, 64)),
    "hyper_width": ((1, 64), (1, 128)),
    "sarm_width": ((1, 16), (1, 32)),
    "carm_width": ((1, 64), (1, 128)),
}
# SPEC [R11.1-2]: without planes these two are 0
OF_PLANES = ("plane_size", "sarm_layers")
CHUNK_SIZE_BOUNDS = ((1, 65536), (256, 16384))


# SPEC 11.2
class Level(NamedTuple):
    """The largest anchor_count, the largest plane_size and the most work of a level."""

    anchors: int
    plane_size: int
    work: int


# SPEC 11.2: for each profile its levels
LEVELS: tuple[dict[int, Level], ...] = (
    {0: Level(4096, 32, 1 << 28)},
    {1: Level(131072, 128, 1 << 33), 2: Level(1048576, 256, 1 << 36), 3: Level(16777216, 256, 1 << 40)},
)


# SPEC [R11.1-2]
def _check_dimensions(header: Dimensions, profile: int) -> None:
    at, error = header.offsets, "header.dimension"
    for name, bounds in PROFILE_BOUNDS.items():
        low, high = bounds[profile]
        items = header[name] if isinstance(header[name], list) else [header[name]]
        for n, item in enumerate(items):
            require(low <= item <= high or (item == 0 and name in OF_PLANES), error, at[name] + n)
    require(header.features <= FEATURES_MAX, error, at["slice_width"])
    for name in OF_PLANES:
        require((header[name] == 0) == (header["plane_channels"] == 0), error, at[name])
    require(header.framed or header["hyper_layers"] == 0, error, at["hyper_layers"])
    require(header["slice_count"] > 1 or header["carm_layers"] == 0, error, at["carm_layers"])


# SPEC 11.1, 11.2, 10.1
def check_profile(header: Dimensions) -> Level:
    """Check the profile, the level, the dimensions, anchor_count and chunk_size. Return the level."""
    at = header.offsets
    profile, anchors, size = (header[name] for name in ("profile", "anchor_count", "plane_size"))
    require(profile < len(LEVELS), "header.profile", at["profile"])
    levels = LEVELS[profile]
    require(header["level"] in levels, "header.level", at["level"])
    own = levels[header["level"]]
    _check_dimensions(header, profile)
    require(size <= own.plane_size, "header.dimension", at["plane_size"])
    require(anchors <= own.anchors, "header.anchor_count", at["anchor_count"])
    needed = work(header)
    lower = [level for number, level in levels.items() if number < header["level"]]
    held = any(anchors <= level.anchors and size <= level.plane_size and needed <= level.work for level in lower)
    require(not held, "header.level_not_minimal", at["level"])
    low, high = CHUNK_SIZE_BOUNDS[profile]
    require(low <= header["chunk_size"] <= high, "header.chunk_size", at["chunk_size"])
    return own


# SPEC [R11.2-3]
def check_work(header: Dimensions, level: Level) -> None:
    """Check the work of the file."""
    require(work(header) <= level.work, "header.work", header.offsets["anchor_count"])
