"""Rendering (SPEC.md chapter 14): cameras, Gaussians, images.

All modules but `camera` and `gaussians` need the extra `render`.

`refcodec.render` is this package, and also the function of the API: `refcodec.render(scene, camera)` draws.
"""

import sys
from types import ModuleType
from typing import Any


class _Room(ModuleType):
    """A package that can be called. Python binds it to the name of the function when one of its modules is imported."""

    def __call__(self, scene: Any, camera: Any = None) -> Any:
        """As refcodec.api.render."""
        return scene.render(camera)


sys.modules[__name__].__class__ = _Room
