"""How functions are compiled with numba: kept in a cache where one can be written, and only in memory elsewhere.

The cache is a folder of the user, or NUMBA_CACHE_DIR. numba's own place is the package's, from which pip does not
remove it: what stays of a package that is uninstalled hides another one. Each module has a folder there, and in it one
for each state of what its functions are compiled of: their source, that of the functions that they call, constants of
other modules, and the versions of refcodec, Python and numba. The folders that were used last stay.
"""

from __future__ import annotations

import contextlib
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
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic
from numba.misc.appdirs import user_cache_dir

from .. import __version__

# So many folders of a module stay: of other versions, and of sources before they were changed.
KEPT = 4
_PACKAGE = __name__.partition(".")[0]

# Without shared memory, numba warns in several lines that processes cannot take turns to compile. No process of this
# program shares its functions with another.
warnings.filterwarnings("ignore", r"\s*Could not obtain multiprocessing lock")


@functools.cache
def stamp(module: str) -> str:
    """Returns a digest of all that the functions of a module are compiled of. Raises OSError without its source."""
    source = sys.modules[module]
    digest = hashlib.sha256(Path(str(source.__file__)).read_bytes())
    for name, value in sorted(vars(source).items()):
        if isinstance(value, (Dispatcher, _Intrinsic)):
            # Functions of another module, which may be inlined.
            if value.__module__ != module and value.__module__.startswith(f"{_PACKAGE}."):
                digest.update(stamp(value.__module__).encode())
        elif isinstance(value, np.ndarray):
            digest.update(name.encode() + value.tobytes())
        elif isinstance(value, (bool, int, float, str, tuple, np.generic)) and not name.startswith("__"):
            digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()


def root() -> Path | None:
    """Returns where the folders of modules are, or None for a user without a home."""
    place = Path(os.environ.get("NUMBA_CACHE_DIR") or user_cache_dir(_PACKAGE, False))
    return place if place.is_absolute() or os.environ.get("NUMBA_CACHE_DIR") else None


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
    except OSError:
        return None
    for old in used[KEPT:]:
        # A process that uses it compiles again.
        shutil.rmtree(old, ignore_errors=True)
    return folder


class _Place:
    """Where numba keeps a function: a locator of numba's cache."""

    def __init__(self, function: Any, folder: Path) -> None:
        self._function, self._folder = function, folder

    @classmethod
    def from_function(cls, function: Any, file: str) -> _Place | None:
        """Returns the place of a function, or None."""
        folder = _folder(function.__module__)
        return None if folder is None else cls(function, folder)

    def ensure_cache_path(self) -> None:
        """Makes the folder, if another process has removed it. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        """Returns the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Returns what the sources are known by."""
        return self._folder.name

    def get_disambiguator(self) -> str:
        """Returns what tells functions of one name apart: the line."""
        return str(self._function.__code__.co_firstlineno)


class _Impl(CompileResultCacheImpl):
    def __init__(self, function: Callable[..., Any]) -> None:
        self._locator_classes = [_Place]
        super().__init__(function)


class _FunctionCache(FunctionCache):
    _impl_class = _Impl


class _Cache:
    """numba's cache of a function on disk. One that cannot be read or written costs time and ends nothing.

    It is looked for when the function is called first. By then its module has all that its functions are made of.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @functools.cached_property
    def kept(self) -> FunctionCache | None:
        """numba's cache, or None if there is no place for it."""
        # numba raises this if there is none.
        with contextlib.suppress(RuntimeError, OSError):
            return _FunctionCache(self._function)
        return None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Returns what was compiled for some types before, or None."""
        with contextlib.suppress(OSError):
            return self.kept and self.kept.load_overload(sig, target_context)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps what was compiled for some types, if there is room."""
        with contextlib.suppress(OSError):
            if self.kept:
                self.kept.save_overload(sig, data)


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Returns a decorator that compiles a function when it is called, with NumPy's rules for division by zero.

    options: further ones of numba.njit, such as parallel. What is compiled is kept for the next start, if there is a
    folder that can be written: NUMBA_CACHE_DIR, or the user's cache.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(error_model="numpy", **options)(function)
        dispatcher._cache = _Cache(function)
        return dispatcher

    return decorate


def is_kept() -> bool:
    """Whether what is compiled is kept for the next start."""
    return _folder(__name__) is not None
