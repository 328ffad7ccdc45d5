"""The Python API of `import refcodec`, for programs and notebooks.

open    opens a file, a URL or bytes, and reads on demand
decode  decodes a file to a Scene
encode  encodes a Scene to the bytes of a file
gaussians  decodes a static file to plain Gaussians
render  renders the image of a camera
"""

from ..bitstream.bounds import BoundPassedError
from ..bitstream.errors import BitstreamError
from ..formats.splats import Splats
from ..rendering.camera import Camera
from .opening import File, decode, gaussians, open
from .scenes import Scene, encode, render

__all__ = [
    "BitstreamError",
    "BoundPassedError",
    "Camera",
    "File",
    "Scene",
    "Splats",
    "decode",
    "encode",
    "gaussians",
    "open",
    "render",
]
