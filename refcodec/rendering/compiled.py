"""How functions are compiled with numba: kept in a cache where one can be written, and only in memory elsewhere.

The cache is a folder of the user, or NUMBA_CACHE_DIR. numba's own place is the package's, from which pip does not
remove it: what stays of a package that is uninstalled hides another one. Each module has a folder there, and in it one
for each state of what its functions are compiled of: their source, that of the functions that they call, constants of
other modules, and the versions of refcodec, Python and numba. The folders that were used last stay.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import njit

from .. import __version__

# So many folders of a module stay: of other versions, and of sources before they were changed.
KEPT = 4
# The free bytes of a disk without which nothing is kept: all functions take about a tenth of them.
SPACE_LEAST = 256 << 20
_PACKAGE = __name__.partition(".")[0]
# Where programs of other systems than Linux keep what they can make again.
_CACHES = {"darwin": "~/Library/Caches", "win32": os.environ.get("LOCALAPPDATA", "~")}

# Without shared memory, numba warns in several lines that processes cannot take turns to compile. No process of this
# program shares its functions with another.
warnings.filterwarnings("ignore", r"\s*Could not obtain multiprocessing lock")


@functools.cache
def stamp(module: str) -> str:
    """Returns a digest of all that the functions of a module are compiled of. Raises OSError without its source.

    It is taken when the first of them is defined: what the module imports, and the constants before it.
    """
    source = sys.modules[module]
    digest = hashlib.sha256(Path(str(source.__file__)).read_bytes())
    for name, value in sorted(vars(source).items()):
        home = getattr(value, "__module__", None) or ""
        if callable(value) and not isinstance(value, type) and home.startswith(f"{_PACKAGE}."):
            # Functions of another module, which may be inlined.
            if home not in (module, __name__):
                digest.update(stamp(home).encode())
        elif isinstance(value, np.ndarray):
            digest.update(name.encode() + value.tobytes())
        elif isinstance(value, (bool, int, float, str, tuple, np.generic)) and not name.startswith("__"):
            digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()


def root() -> Path | None:
    """Returns where the folders of modules are, or None for a user without a home."""
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(own)
    place = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser(_CACHES.get(sys.platform, "~/.cache")))
    return place / _PACKAGE if place.is_absolute() else None


@functools.cache
def _folder(module: str) -> Path | None:
    """Returns the folder of a module as it is, which is made, or None if there is no place for it."""
    place = root()
    if place is None:
        return None
    try:
        versions = f"{stamp(module)} {sys.implementation.cache_tag} {numba.__version__}"
        folder = place / module / f"{__version__}-{hashlib.sha256(versions.encode()).hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        # Used now.
        os.utime(folder)
        used = sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        if shutil.disk_usage(folder).free < SPACE_LEAST:
            return None
    except OSError:
        return None
    for old in used[KEPT:]:
        # A process that uses it compiles again.
        shutil.rmtree(old, ignore_errors=True)
    return folder


class Place:
    """Where numba keeps a function: a locator, as numba.config.CACHE_LOCATOR_CLASSES names them."""

    def __init__(self, function: Any, folder: Path) -> None:
        self._function, self._folder = function, folder

    @classmethod
    def from_function(cls, function: Any, file: str) -> Place | None:
        folder = _folder(function.__module__)
        return None if folder is None else cls(function, folder)

    def ensure_cache_path(self) -> None:
        """Makes the folder, if another process has removed it. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Returns what the sources are known by."""
        return self._folder.name

    def get_disambiguator(self) -> str:
        """Returns what tells functions of one name apart: the line."""
        return str(self._function.__code__.co_firstlineno)


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Returns a decorator that compiles a function when it is called, with NumPy's rules for division by zero.

    options: further ones of numba.njit, such as parallel. What is compiled is kept for the next start, if there is a
    folder that can be written: NUMBA_CACHE_DIR, or the user's cache.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        # Functions of other packages keep numba's own places.
        config: Any = numba.config
        before, config.CACHE_LOCATOR_CLASSES = config.CACHE_LOCATOR_CLASSES, f"{__name__}.{Place.__name__}"
        try:
            return njit(error_model="numpy", cache=_folder(function.__module__) is not None, **options)(function)
        finally:
            config.CACHE_LOCATOR_CLASSES = before

    return decorate


def is_kept() -> bool:
    """Whether what is compiled is kept for the next start."""
    return _folder(__name__) is not None
