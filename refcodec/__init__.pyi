"""The names that refcodec imports when they are first used. tests/api/test_front_door.py compares them."""

from .api import BitstreamError as BitstreamError
from .api import BoundPassedError as BoundPassedError
from .api import Camera as Camera
from .api import File as File
from .api import Scene as Scene
from .api import Splats as Splats
from .api import decode as decode
from .api import encode as encode
from .api import gaussians as gaussians
from .api import open as open
from .api import render as render

__version__: str
