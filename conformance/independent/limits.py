"""Clause 11: profiles and levels."""

from .errors import require
from .syntax import Fields

# SPEC 11.1: for each dimension the bounds of Tiny and of Main. The bounds of a list are those of each item
PROFILE_BOUNDS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "offset_count": ((1, 10), (10, 10)),
    "slice_count": ((1, 4), (4, 4)),
    "slice_width": ((1, 16), (5, 20)),
    "plane_channels": ((1, 8), (8, 8)),
    "frequency_count": ((1, 10), (10, 10)),
    "plane_size": ((2, 32), (2, 256)),
    "hyper_layers": ((1, 2), (1, 1)),
    "hyper_width": ((1, 64), (16, 128)),
    "sarm_layers": ((1, 2), (2, 2)),
    "sarm_width": ((1, 16), (16, 16)),
    "carm_layers": ((0, 2), (1, 1)),
    "carm_width": ((1, 64), (16, 128)),
    "render_width": ((1, 64), (50, 50)),
}
CHUNK_SIZE_BOUNDS = ((1, 65536), (256, 65536))
MAIN = 1
MAIN_SLICES = [5, 10, 15, 20]
# SPEC 11.2: for each profile, and each of its levels, the largest anchor_count and the largest plane_size
LEVELS: tuple[dict[int, tuple[int, int]], ...] = (
    {0: (4096, 32)},
    {1: (131072, 128), 2: (1048576, 256), 3: (16777216, 256)},
)


# SPEC 11.1, 11.2, 10.1 step 2
def check_profile(header: Fields) -> None:
    """Check the profile, the level, the dimensions, anchor_count and chunk_size."""
    at = header.offsets
    profile, level, anchors, size = (header[name] for name in ("profile", "level", "anchor_count", "plane_size"))
    require(profile < len(LEVELS), "header.profile", at["profile"])
    levels = LEVELS[profile]
    require(level in levels, "header.level", at["level"])
    for name, bounds in PROFILE_BOUNDS.items():
        low, high = bounds[profile]
        items = header[name] if isinstance(header[name], list) else [header[name]]
        for n, item in enumerate(items):
            require(low <= item <= high, "header.dimension", at[name] + n)
    require((header["carm_layers"] == 0) == (header["slice_count"] == 1), "header.dimension", at["carm_layers"])
    require(profile != MAIN or header["slice_width"] == MAIN_SLICES, "header.dimension", at["slice_width"])
    most_anchors, largest_plane = levels[level]
    require(size <= largest_plane, "header.dimension", at["plane_size"])
    require(anchors <= most_anchors, "header.anchor_count", at["anchor_count"])
    lower = any(number < level and anchors <= limit[0] and size <= limit[1] for number, limit in levels.items())
    require(not lower, "header.level_not_minimal", at["level"])
    low, high = CHUNK_SIZE_BOUNDS[profile]
    require(low <= header["chunk_size"] <= high, "header.chunk_size", at["chunk_size"])
