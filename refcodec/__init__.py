"""refcodec: reference encoder and decoder of the C3GS bitstream (SPEC.md, version 0).

The names for files and scenes are here, and the commands in refcodec.api. Each is imported when it is first used, so
that `import refcodec` loads no other package. Type checkers and editors read the names in __init__.pyi.
"""

import importlib

__version__ = "1.0.0rc1"

__all__ = ["BitstreamError", "BoundPassedError", "Camera", "File", "Limits", "Report", "Scene", "Splats", "UsageError"]
__all__ += ["__version__", "api", "decode", "encode", "open", "splats"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # The front door is above all rooms that it uses, so no import statement stands here.
    api = importlib.import_module(".api", __name__)
    return globals().setdefault(name, api if name == "api" else getattr(api, name))


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
