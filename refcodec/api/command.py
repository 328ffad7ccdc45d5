"""Commands: functions of the API whose signature and docstring are their command lines, too.

A parameter is a word of the command: `lambda_r` is `--lambda`, and one without a default is an operand. Its annotation
states the values that it may have (kinds.py), which are checked here for both. The section `Args` of the docstring is
its help. Nothing here needs NumPy.
"""

from __future__ import annotations

import builtins
import contextlib
import inspect
import os
import re
import sys
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, wraps
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TypedDict, TypeVar, get_args, get_origin

from ..statuses import DONE, UsageError
from . import kinds

if TYPE_CHECKING:
    from ..bitstream.bounds import Limits
    from ..bitstream.errors import BitstreamError

P = ParamSpec("P")
R = TypeVar("R")

# Words whose Python name is a keyword, or says more.
SPELLED = {"lambda_r": "lambda", "from_scene": "from", "evaluate": "eval"}
# The help of words that many commands have.
_COMMON = {
    "file": "a C3GS file: a path, or a URL with the extra `http`",
    "photographs": "a COLMAP or NeRF folder of photographs with cameras",
    "meta": "write a metadata entry (SPEC.md 6.14), such as title=Kitchen, or the entries of a TOML file; an empty "
    "value removes the entry; repeatable",
    "output": "the scene folder to write",
    "size": "size of the photographs: WxH, longest side, or full for unscaled (default: the training size)",
    "progress": "show progress on stderr even if it is not a terminal",
    "max_anchors": "refuse a file of more anchors (exit status 64)",
    "max_work": "refuse a file that may take more work, in units of SPEC.md 13.1 (exit status 64)",
    "max_memory": "refuse a file that may take more memory by its tables; K, M and G are allowed (exit status 64; "
    "default: 4G for a URL)",
}
# Packages of extras. The last ones have extras of their own name, whichever command needs them.
_OWN = ("ray", "tensorboard")
_PACKAGES = ("torch", "numba", "scipy", "PIL", "skimage", "matplotlib", "bjontegaard", "zstandard", *_OWN)


@dataclass(frozen=True)
class Word:
    """A word of a command.

    name: of the parameter. text: its help. required: whether it has no default. kind: None if a text is its own value,
    or if no text has one. choices: all values, if they are few. many: whether it can be given repeatedly. flag: whether
    it is given without a value. others: whether a program may give values that no text has, such as a scene.
    """

    name: str
    text: str = ""
    default: Any = None
    required: bool = False
    kind: kinds.WordKind | None = None
    choices: tuple[str, ...] = ()
    many: bool = False
    flag: bool = False
    others: bool = False

    @property
    def option(self) -> str:
        """Its spelling on a command line."""
        return "--" + SPELLED.get(self.name, self.name).replace("_", "-")

    def read(self, text: Any) -> Any:
        """Returns the value of a text, or those of several. Raises UsageError."""
        if isinstance(text, list):
            return [*map(self.read, text)]
        if self.kind is None:
            return text
        with contextlib.suppress(ValueError):
            if self.kind.right(value := self.kind.read(text)):
                return value
        raise self._error(text)

    def checked(self, value: Any) -> Any:
        """Returns a value, as a list if it may be given repeatedly. Raises UsageError if it is not allowed."""
        if self.many and isinstance(value, str | os.PathLike):
            value = [value]
        for each in value if self.many and isinstance(value, list | tuple) else [value]:
            if self.others and not isinstance(each, str | os.PathLike):
                continue
            wrong = self.kind is not None and not self.kind.right(each)
            other = self.choices and not (isinstance(each, str) and each in self.choices)
            if wrong or other or (self.flag and not isinstance(each, bool)):
                raise self._error(each)
        return value

    def _error(self, value: object) -> UsageError:
        allowed = self.kind.allowed if self.kind else " or ".join(self.choices or ("true", "false"))
        return UsageError(f"{self.option} must be {allowed}, not {value}")


class _Names(dict[str, Any]):
    """The names in annotations. Those that only type checkers import stand for values that no text has."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, None) or getattr(typing, name, object)


def _alternatives(hint: Any) -> list[Any]:
    if get_origin(hint) in (typing.Union, UnionType):
        return [each for part in get_args(hint) for each in _alternatives(part) if each is not NoneType]
    return [hint]


def _kind(hint: Any) -> kinds.WordKind | None:
    """Returns the kind of a type, or of the items of a sequence."""
    item = get_args(hint)[0] if get_origin(hint) is Sequence else hint
    return item.__metadata__[0] if get_origin(item) is Annotated else None


def _word(name: str, hint: Any, text: str = "", default: Any = None) -> Word:
    """Returns the word of a parameter. hint: its type; the first alternative is what a text can be."""
    first, *others = _alternatives(hint)
    kind, many = _kind(first), get_origin(first) is Sequence
    if many:
        (first,) = get_args(first)
    choices = get_args(first) if get_origin(first) is Literal else ()
    required = default is inspect.Parameter.empty
    default = None if required else default
    return Word(
        name,
        text or _COMMON.get(name, ""),
        default,
        required,
        kind,
        choices,
        many,
        first is bool,
        None in map(_kind, others),
    )


def _signature(function: Callable[..., Any]) -> inspect.Signature:
    """Returns the signature of a function, with each word of its `**words`."""
    signature, parameters = inspect.signature(function), list[inspect.Parameter]()
    for parameter in signature.parameters.values():
        group = {parameter.name: parameter}
        if parameter.kind is parameter.VAR_KEYWORD:
            words = function.__globals__[parameter.annotation.removeprefix("Unpack[").removesuffix("]")]
            group = {
                name: parameter.replace(
                    name=name, kind=parameter.KEYWORD_ONLY, default=None, annotation=hint.__forward_arg__
                )
                for name, hint in words.__annotations__.items()
            }
        parameters += group.values()
    return signature.replace(parameters=parameters)


@cache
def words(function: Callable[..., Any]) -> dict[str, Word]:
    """Returns the words of a command by the names of their parameters."""
    scope = vars(sys.modules[function.__module__])
    groups = filter(typing.is_typeddict, scope.values())
    scopes = [scope, *(vars(sys.modules[group.__module__]) for group in groups)]
    texts: dict[str, str] = {}
    for group in [thing for names in scopes for thing in names.values() if typing.is_typeddict(thing)]:
        texts |= dict(_entries(group))
    texts |= dict(_entries(function))
    made: list[Word] = []
    for name, parameter in inspect.signature(function).parameters.items():
        hint, default = eval(parameter.annotation, {}, _Names(scope)), parameter.default
        if parameter.kind is parameter.VAR_POSITIONAL:
            hint = Sequence[hint]  # type: ignore[valid-type]
        if name == "limits":
            limits = {"max_anchors": kinds.Count, "max_work": kinds.Work, "max_memory": kinds.Bytes}
            made += [_word(key, kind) for key, kind in limits.items()]
        elif not any(kind in _alternatives(hint) for kind in kinds.PYTHON):
            made.append(_word(name, hint, texts.get(name, ""), default))
    return {word.name: word for word in made}


def sections(thing: object) -> dict[str, str]:
    """Returns the docstring of a command by its sections. "" is the text before them, whose first line is a summary."""
    parts = re.split(r"^(Args|Examples|Returns|Raises):\n", inspect.getdoc(thing) or "", flags=re.MULTILINE)
    return {"Args": "", "Examples": "", "": parts[0].strip(), **dict(zip(parts[1::2], parts[2::2], strict=True))}


def _entries(thing: object) -> Iterator[tuple[str, str]]:
    """Yields the names and texts of the section `Args`."""
    for entry in re.split(r"^    (?=\w)", sections(thing)["Args"], flags=re.MULTILINE)[1:]:
        name, _, about = entry.partition(":")
        yield name, " ".join(about.split()).rstrip(".")


class ReadingWords(TypedDict, total=False):
    """How a file is read.

    limits: what it may use, None for everything. Set limits for files of unknown origin. progress: whether progress is
    shown on stderr even if it is not a terminal.
    """

    limits: Limits | None
    progress: bool


@dataclass(frozen=True, eq=False)
class Report:
    """What a command did, for programs and for people.

    values: facts, by name. lines: those that the command prints; str() has them, too. notes: further lines, for stderr.
    error: the verdict on a file, if it did not end the work. status: the exit status.
    """

    lines: Iterable[str] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    notes: Sequence[str] = ()
    error: BitstreamError | None = None
    status: int = DONE

    def __str__(self) -> str:
        return "\n".join(self.lines)


class MissingPackageError(ModuleNotFoundError, UsageError):
    """A package of an extra is not installed. The text has the command that installs it."""


def missing(user: str, extra: Mapping[str, str], error: ModuleNotFoundError) -> ModuleNotFoundError:
    """Returns the error for a failed import, which names the extra. A module of no extra is a fault, and stays one.

    extra: the extras of packages; "" is that of all others.
    """
    package = (error.name or "").split(".")[0]
    if package not in _PACKAGES:
        return error
    needed = package if package in _OWN else extra.get(package, extra[""])
    return MissingPackageError(f"{user} needs {package}: pip install 'refcodec[{needed}]'", name=error.name)


@dataclass(frozen=True)
class Command:
    """What a command line has besides the words of its function.

    extra: the extra that it needs, or those, or "". operands: words that are given without their options. requires:
    words of which it needs one. writes: whether it has outputs.
    """

    name: str
    extra: str
    operands: tuple[str, ...]
    requires: tuple[str, ...]
    writes: bool


def command(
    extra: str | Mapping[str, str] = "",
    *,
    operands: tuple[str, ...] = (),
    requires: tuple[str, ...] = (),
    writes: bool = False,
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Makes a function a command: the values of its words are checked, and missing packages are named.

    extra: the extra that it needs, or as for `missing`. The others are as in Command.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        name, signature = SPELLED.get(function.__name__, function.__name__), _signature(function)
        extras = {"": extra} if isinstance(extra, str) else extra

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            known = words(call)
            try:
                bound = signature.bind(*args, **kwargs)
            except TypeError as error:
                raise TypeError(f"{name}: {error}; it takes {', '.join(signature.parameters)}") from None
            for key, value in [*bound.arguments.items()]:
                if value is None and signature.parameters[key].default is not inspect.Parameter.empty:
                    del bound.arguments[key]
                elif key in known:
                    bound.arguments[key] = known[key].checked(value)
            try:
                return function(*bound.args, **bound.kwargs)
            except ModuleNotFoundError as error:
                raise missing(name, extras, error) from None

        call.__signature__ = signature  # type: ignore[attr-defined]
        call.command = Command(name, extras[""], operands, requires, writes)  # type: ignore[attr-defined]
        return call

    return decorate


def is_given(value: object) -> bool:
    """Whether a word has another value than None, False and (), which stand for none. 0 is one."""
    return value is not None and value is not False and not (isinstance(value, tuple) and not value)


def apply_only(words: Mapping[str, object], names: Iterable[str], what: str) -> None:
    """Raises UsageError for the first given word of some. what: states what they apply to."""
    for name in names:
        if is_given(words.get(name)):
            raise UsageError(f"{Word(name).option} applies only to {what}")


def only_one(**given: object) -> None:
    """Raises UsageError if more than one of some words is given."""
    names = [Word(name).option for name, value in given.items() if is_given(value)]
    if len(names) > 1:
        raise UsageError(f"{names[1]} is not allowed with {names[0]}")
