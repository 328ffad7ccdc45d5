"""refcodec: reference encoder and decoder of the C3GS bitstream (SPEC.md, version 0).

The names of the front door are in refcodec.api. Each is imported when it is first used, so that `import refcodec` loads
no other package. Type checkers and editors read them in __init__.pyi.
"""

import importlib

__version__ = "0.1.0"

# What refcodec.api offers. The front door is above all rooms that it uses, so no import statement stands here.
__all__ = [
    "BitstreamError",
    "BoundPassedError",
    "Camera",
    "File",
    "Scene",
    "Splats",
    "__version__",
    "decode",
    "encode",
    "gaussians",
    "open",
    "render",
]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(importlib.import_module(".api", __name__), name)
    # The room of rendering has the name of a function, and is called like it. Import bound the name by now.
    return globals().setdefault(name, found)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
