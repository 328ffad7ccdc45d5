"""An independent decoder of C3GS files, version 0, in plain Python.

It was written from SPEC.md and shares no line with refcodec.
"""

from .codec import decode
from .errors import C3GSError
from .reconstruction import canonical_parts, digest
from .scene import Scene

__all__ = ["C3GSError", "Scene", "canonical_parts", "decode", "digest"]
