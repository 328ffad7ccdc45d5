"""How functions are compiled with numba: kept in a cache where one can be written, and in memory alone elsewhere."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache

# numba says in several lines that processes could not compile one after the other where there is no shared memory. No
# process of this program shares its functions with another.
warnings.filterwarnings("ignore", r"\s*Could not obtain multiprocessing lock")


class _Cache(FunctionCache):
    """numba's cache on disk. One that cannot be read or written costs time and ends nothing."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Returns what was compiled for some types before, or None."""
        try:
            return super().load_overload(sig, target_context)
        except OSError:
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps what was compiled for some types, if there is room."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


def _has_place() -> bool:
    """Whether numba may look for a folder for its cache.

    It takes NUMBA_CACHE_DIR, the folder of the module, or the user's cache. It would make the last one in the folder at
    hand, with the name ~, for a user without a home.
    """
    given = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    return bool(given) or os.path.isabs(os.path.expanduser("~")) or os.access(Path(__file__).parent, os.W_OK)


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Returns a decorator that compiles a function when it is called, with NumPy's rules for division by zero.

    options: further ones of numba.njit, such as parallel. What is compiled is kept for the next start, if there is a
    folder that can be written: NUMBA_CACHE_DIR, the package's own, or the user's cache.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = njit(error_model="numpy", **options)(function)
        if _has_place():
            # numba raises this if no folder can be written.
            with contextlib.suppress(RuntimeError):
                dispatcher._cache = _Cache(function)
        return dispatcher

    return decorate


@compiled()
def _nothing() -> None:
    """Shows whether there is a cache. It is never called."""


def is_kept() -> bool:
    """Whether what is compiled is kept for the next start."""
    return isinstance(_nothing._cache, _Cache)
