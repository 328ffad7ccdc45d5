"""The apparent kind of a file that is not a scene, by its first bytes, and the command that takes it."""

import re

_CONVERT = "refcodec convert takes splats of this kind"
# Patterns of the first eight bytes, and the kinds.
_KINDS = [
    (rb"ply[\r\n]", f"a PLY file: {_CONVERT}, refcodec fit takes points"),
    (rb"\x1f\x8b|NGSP", f"an SPZ file: {_CONVERT}"),
    (rb"PK\x03\x04", f"a ZIP archive, such as a SOG file: {_CONVERT}"),
    (rb"glTF", f"a .glb file: {_CONVERT}"),
    (rb"\s*<", "a web page"),
    (rb"\x89PNG|\xff\xd8\xff", "an image"),
    (rb"[\t\r\n -~]{8}", "text: refcodec fit takes a points3D.txt"),
]


def looks_like(beginning: bytes) -> str | None:
    """Returns the apparent kind of a file, in words for a message, or None. beginning: its first eight bytes."""
    return next((words for pattern, words in _KINDS if re.match(pattern, beginning)), None)
