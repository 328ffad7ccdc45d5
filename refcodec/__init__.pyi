"""The names that refcodec imports when they are first used."""

from . import api as api
from .api import BitstreamError as BitstreamError
from .api import BoundPassedError as BoundPassedError
from .api import Camera as Camera
from .api import File as File
from .api import Limits as Limits
from .api import Report as Report
from .api import Scene as Scene
from .api import Splats as Splats
from .api import UsageError as UsageError
from .api import decode as decode
from .api import encode as encode
from .api import open as open
from .api import splats as splats

__version__: str
