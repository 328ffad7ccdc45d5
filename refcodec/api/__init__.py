"""The front door: what `import refcodec` offers to programs and notebooks.

open    a file, a URL or bytes, of which only what is asked for is read
decode  a file, as a Scene
encode  a Scene, as the bytes of a file
render  what a camera sees of a Scene, as an image
"""

from ..bitstream.bounds import BoundPassedError
from ..bitstream.errors import BitstreamError
from ..render.camera import Camera
from .opening import File, decode, open
from .scenes import Scene, encode, render

__all__ = ["BitstreamError", "BoundPassedError", "Camera", "File", "Scene", "decode", "encode", "open", "render"]
