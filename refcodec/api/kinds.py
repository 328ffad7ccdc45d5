"""The kinds of values that the words of commands have, as text and in Python. Nothing here needs NumPy."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Annotated, Any, Literal, get_args

from ..bitstream import source


@dataclass(frozen=True)
class WordKind:
    """The values of a word.

    metavar, allowed: for its help and its errors. read: makes a value of a text, and raises ValueError. right: whether
    a value is allowed.
    """

    metavar: str
    allowed: str = "a text"
    read: Callable[[str], Any] = str
    right: Callable[[Any], bool] = lambda value: isinstance(value, str)


def _number(read: type, metavar: str, allowed: str, low: float, high: float = math.inf) -> WordKind:
    def right(value: Any) -> bool:
        number = isinstance(value, Integral if read is int else Real) and not isinstance(value, bool)
        # NaN is not between any numbers.
        return number and low <= value <= high and value != math.inf

    return WordKind(metavar, allowed, read, right)


def _path(metavar: str) -> WordKind:
    return WordKind(metavar, "a path", str, _is_path)


def _is_path(value: Any) -> bool:
    try:
        return isinstance(value, str | os.PathLike) and b"\0" not in os.fsencode(value)
    except UnicodeEncodeError:
        return False


def _byte_count(text: str) -> int:
    """K, M and G stand for 2^10, 2^20 and 2^30."""
    match = re.fullmatch(r"([0-9]{1,18})([KMG]?)", text.upper())
    return int(match[1]) << {"": 0, "K": 10, "M": 20, "G": 30}[match[2]] if match else 0


def _range(text: str) -> range:
    match = re.fullmatch(r"([0-9]{1,9}):([0-9]{1,9})", text)
    return range(int(match[1]), int(match[2])) if match else range(0)


def _is_range(value: Any) -> bool:
    return isinstance(value, range) and 0 <= value.start < value.stop and value.step == 1


StrPath = source.StrPath
Place = source.Place
# A path whose name in help is that of the word.
AnyPath = Annotated[StrPath, _path("")]
FilePath = Annotated[StrPath, _path("FILE")]
Folder = Annotated[StrPath, _path("DIR")]
SceneFolder = Annotated[StrPath, _path("SCENE_DIR")]
LogPath = Annotated[StrPath, _path("FILE.csv|DIR")]
Cameras = Annotated[StrPath, _path("default|orbit|PHOTOGRAPHS|CAMERA.json")]
Size = Annotated[str, WordKind("WxH", "a text such as 400x300, 400 or full")]
Colour = Annotated[str, WordKind("C", "white, black or R,G,B")]
Key = Annotated[str, WordKind("KEY")]
Pattern = Annotated[str, WordKind("PATTERN")]
Change = Annotated[str, WordKind("NAME=VALUE")]
Meta = Annotated[str, WordKind("KEY=VALUE|FILE")]
SplatCameras = Annotated[StrPath, _path("FILE|PHOTOGRAPHS")]
FitCameras = Annotated[StrPath, _path("PHOTOGRAPHS")]
Count = Annotated[int, _number(int, "N", "a whole number of at least 0", 0)]
Positive = Annotated[int, _number(int, "N", "a whole number of at least 1", 1)]
Frames = Annotated[int, _number(int, "N", "a whole number from 1 to 100000", 1, 100_000)]
# The range of all random generators.
Seed = Annotated[int, _number(int, "S", "a whole number from 0 to 2^63 - 1", 0, (1 << 63) - 1)]
Degree = Annotated[int, _number(int, "{0,1,2,3}", "a whole number from 0 to 3", 0, 3)]
SpzBits = Annotated[int, _number(int, "{4,5,6,7,8}", "a whole number from 4 to 8", 4, 8)]
Port = Annotated[int, _number(int, "N", "a whole number from 0 to 65535", 0, 65535)]
Lambda = Annotated[float, _number(float, "L", "a number from 0 to 1", 0, 1)]
# Of scenes that get a codec, and of a fit.
CodedLambda = Annotated[float, _number(float, "L", "a number above 0 and at most 1", math.ulp(0.0), 1)]
FitLambda = Annotated[float, _number(float, "L", "a number from 0.000001 to 1", 1e-6, 1)]
Length = Annotated[float, _number(float, "V", "a number above 0", math.ulp(0.0), sys.float_info.max)]
Decibels = Annotated[float, _number(float, "DB", "a number from 20 to 70", 20, 70)]
Offset = Annotated[
    str, WordKind("X,Y,Z", "three numbers such as 5e5,5.4e6,0", right=lambda text: place(text) is not None)
]
# SPEC 13.1
Work = Annotated[int, _number(int, "UNITS", "a whole number of at least 0", 0)]
Bytes = Annotated[int, WordKind("BYTES", "a number of bytes such as 800M", _byte_count, get_args(Positive)[1].right)]
Chunks = Annotated[range, WordKind("A:B", "A:B with A below B", _range, _is_range)]
Preset = Literal["fast", "paper"]
Device = Literal["cpu", "cuda"]
# SPEC 6.5: the index of an axis is its number.
Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
# Receives text as it is made. That of a command is stdout.
Write = Callable[[str], object]
# Stages of a training (refcodec.train.stage.Stage). A command has none.
Stages = Sequence[Any]
# The kinds of words that only Python has.
PYTHON = (Write, Stages)


def place(text: Any) -> Any:
    """Returns three numbers, float64 [3], or None for another text and for None."""
    import numpy as np

    words = text.split(",") if isinstance(text, str) else []
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return None
    return np.array(numbers) if len(numbers) == 3 and all(map(math.isfinite, numbers)) else None


def axis_number(up: str | None) -> int | None:
    """SPEC 6.5: returns the number of an up axis."""
    return None if up is None else get_args(Axis).index(up)
