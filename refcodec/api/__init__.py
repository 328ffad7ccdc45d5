"""The Python API of `import refcodec`, and the command line.

- A command of the command line is a function here, of the same name and with the same words (`eval` is `evaluate`).
  The command line parses the words, calls the function, and prints its result. Everything else is decided here.
- `command` reads the words of a function from its signature and its docstring. `kinds` has the values of words.
- `refcodec.folder.places` opens what a command reads, a path, a URL, bytes or a file object, within `Limits`, the only
  count of memory, and checks what it writes, before any work. `shown` is a scene to draw. A function states how many
  copies of a scene it holds where it opens the file.
- `opening` and `scenes` are for programs: an open file, and a scene with its values, bytes and images.
- An error that the caller can put right is a UsageError, that of a file a BitstreamError.
- Each name is loaded when it is first used. Help and `import refcodec` need neither NumPy nor any extra.
"""

from __future__ import annotations

# Type checkers read the names here.
import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..bitstream.bounds import BoundPassedError, Limits
    from ..bitstream.errors import BitstreamError
    from ..formats.splats import Splats
    from ..rendering.camera import Camera
    from ..statuses import UsageError
    from .coding import decode, digest, encode, migrate, reconstruct, validate
    from .command import Report
    from .converting import convert
    from .drawing import evaluate, gaussians, render
    from .experiments import demo, experiment, rd
    from .exporting import export
    from .learning import fit, train
    from .looking import explain, inspect
    from .opening import File, open, splats
    from .scenes import Scene
    from .viewing import view

# The commands by their modules. A command line imports only its own module.
COMMANDS = {
    "coding": ("encode", "decode", "digest", "reconstruct", "validate", "migrate"),
    "looking": ("explain", "inspect"),
    "drawing": ("gaussians", "render", "evaluate"),
    "exporting": ("export",),
    "viewing": ("view",),
    "learning": ("train", "fit"),
    "converting": ("convert",),
    "experiments": ("demo", "rd", "experiment"),
}
_HOMES = {
    **{f".{module}": names for module, names in COMMANDS.items()},
    ".command": ("Report",),
    ".opening": ("File", "open", "splats"),
    ".scenes": ("Scene",),
    "..bitstream.bounds": ("BoundPassedError", "Limits"),
    "..bitstream.errors": ("BitstreamError",),
    "..formats.splats": ("Splats",),
    "..rendering.camera": ("Camera",),
    "..statuses": ("UsageError",),
}
__all__ = ["BitstreamError", "BoundPassedError", "Camera", "File", "Limits", "Report", "Scene", "Splats", "UsageError"]
__all__ += ["convert", "decode", "demo", "digest", "encode", "evaluate", "experiment", "explain", "export", "fit"]
__all__ += ["gaussians", "inspect", "migrate", "open"]
__all__ += ["rd", "reconstruct", "render", "splats", "train", "validate", "view"]


def __getattr__(name: str) -> object:
    home = next((home for home, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault(name, getattr(importlib.import_module(home, __name__), name))


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
