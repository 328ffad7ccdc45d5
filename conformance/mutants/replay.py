"""Planted bugs tried fast: of a wrong decoder only what it changes is run, the rest is what the right decoder did.

The right decoder is run once for each vector. Its larger steps are wrapped, and the result of each call is kept, with
the statements that it ran. A wrong decoder is the same package, with the code of some functions or the values of some
names replaced in place. While all results are those of the right decoder, a call that does not run what is changed is
answered from what is kept. From the first other result on, everything is run.
"""

from __future__ import annotations

import gc
import pickle
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any

from . import places
from .loading import NAME, load
from .mutant import MODULES, PACKAGE, Mutant

# (module, function or class.method) of the steps. Each leaves nothing behind but its result.
STEPS = (
    ("codec", "read_header"),
    ("codec", "read_directory"),
    ("codec", "check_section"),
    ("codec", "read_frame"),
    ("codec", "read_weights"),
    ("codec", "read_planes"),
    ("codec", "join_quadrants"),
    ("codec", "read_index"),
    ("chunks", "ChunkReader.read"),
    ("context", "ContextSource.__call__"),
    ("networks", "Network.__call__"),
    ("weights", "_derive_layer"),
    ("weights", "read_grids"),
    ("reconstruction", "canonical_parts"),
)
# A call: its number among those of the call that it is in, behind that one's key. Sets of places are bits of integers.
Key = tuple[int, ...]
Result = tuple[bool, bytes]
OUTSIDE: Key = ()


class SameError(Exception):
    """What is left cannot differ from what the right decoder did."""


@dataclass
class Kept:
    """What the right decoder did with a file.

    results: of each call, whether it ended with an error of the format, and what it gave, pickled. own, ran: of each
    call the places that it ran itself, and those that its inner calls ran too. left: for each outermost call the places
    that are run from it on. lines: how many were run.
    """

    results: dict[Key, Result] = field(default_factory=dict)
    own: dict[Key, int] = field(default_factory=dict)
    ran: dict[Key, int] = field(default_factory=dict)
    left: list[int] = field(default_factory=list)
    lines: int = 0

    def finish(self) -> None:
        """Sums up what inner calls ran."""
        self.ran = dict(self.own)
        for key in sorted(self.ran, key=len, reverse=True):
            if key:
                self.ran[key[:-1]] |= self.ran[key]
        outermost = [self.ran[key] for key in sorted(self.ran) if len(key) == 1]
        self.left = [0] * (len(outermost) + 1)
        for number in reversed(range(len(outermost))):
            self.left[number] = self.left[number + 1] | outermost[number]


class Replay:
    """The right decoder with its steps wrapped."""

    def __init__(self) -> None:
        self.package = load(None)
        self.package.tables.load_tables()
        self._modules = {name: sys.modules[f"{NAME}.{name}"] for name in MODULES}
        self.spots = [(s.module, s.lines.start) for s in places.places()]
        self._bit = {spot: 1 << number for number, spot in enumerate(self.spots)}
        self._line_bits = {line: self._bit[spot] for line, spot in places.lines().items()}
        self._recording, self._clean, self._changed = False, True, 0
        self._kept = Kept()
        self._key: Key = OUTSIDE
        self._counts = [0]
        for module, step in STEPS:
            owner: Any = self._modules[module]
            *classes, name = step.split(".")
            for cls in classes:
                owner = getattr(owner, cls)
            setattr(owner, name, self._wrapped(getattr(owner, name)))

    def _wrapped(self, original: Callable[..., Any]) -> Callable[..., Any]:
        def step(*arguments: Any) -> Any:
            if not self._clean:
                return original(*arguments)
            key = (*self._key, self._counts[-1])
            self._counts[-1] += 1
            if self._recording:
                self._kept.own[key] = 0
                return self._run(key, original, arguments)
            kept, changed = self._kept, self._changed
            if len(key) == 1 and not changed & (kept.own[OUTSIDE] | kept.left[min(key[0], len(kept.left) - 1)]):
                raise SameError
            # Where the caller is changed, the arguments may be.
            if key in kept.results and not changed & (kept.ran[key] | kept.own[key[:-1]]):
                failed, content = kept.results[key]
                value = pickle.loads(content)
                if failed:
                    raise self.package.C3GSError(*value)
                return value
            return self._run(key, original, arguments)

        step.original = original  # type: ignore[attr-defined]
        return step

    def _run(self, key: Key, original: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Runs a step. Its result is kept, or compared with the one that was kept."""
        before, self._key = self._key, key
        self._counts.append(0)
        result: Result = False, b""
        try:
            value = original(*arguments)
            if self._clean:
                result = False, pickle.dumps(value)
            return value
        except self.package.C3GSError as error:
            result = True, pickle.dumps((error.name, error.offset))
            raise
        finally:
            self._counts.pop()
            self._key = before
            if self._recording:
                self._kept.results[key] = result
            # An exception of another kind leaves no result, and is no result of the right decoder.
            elif self._clean and result != self._kept.results.get(key):
                self._clean = False

    def record(self, decode: Callable[[ModuleType, bytes], Any], data: bytes, most: int) -> Kept | None:
        """What the right decoder does with a file; None if it runs more than so many lines."""
        kept = self._kept = Kept(own={OUTSIDE: 0})
        self._recording, self._clean, self._key, self._counts = True, True, OUTSIDE, [0]
        modules = {str(PACKAGE / f"{name}.py"): name for name in MODULES}
        bits = self._line_bits

        def line(frame: FrameType, event: str, _argument: object) -> Any:
            if event == "line":
                kept.lines += 1
                kept.own[self._key] |= bits.get((modules[frame.f_code.co_filename], frame.f_lineno), 0)
                if kept.lines > most:
                    raise SameError
            return line

        def call(frame: FrameType, _event: str, _argument: object) -> Any:
            return line if frame.f_code.co_filename in modules else None

        gc.disable()
        before = sys.gettrace()
        sys.settrace(call)
        try:
            decode(self.package, data)
        except SameError:
            return None
        finally:
            # A test's coverage has a trace function, too.
            sys.settrace(before)
            gc.enable()
            self._recording = False
        kept.finish()
        return kept

    def again(self, kept: Kept, changed: int) -> None:
        """Makes ready for a file of which something is kept. changed: the places that differ, as bits.

        SameError ends the decoding where nothing more can differ.
        """
        self._kept, self._changed, self._clean = kept, changed, True
        self._key, self._counts = OUTSIDE, [0]

    def plant(self, mutant: Mutant) -> int | None:
        """Makes the decoder the wrong one, for good. Returns the places that differ; None if it cannot be done so."""
        right = {name: module for name, module in sys.modules.items() if name.partition(".")[0] == NAME}
        try:
            load(mutant)
            wrong = {name: sys.modules[f"{NAME}.{name}"] for name in MODULES}
        except (Exception, SystemExit):
            return None
        finally:
            # Pickles find classes by name.
            for name in [name for name in sys.modules if name.partition(".")[0] == NAME]:
                del sys.modules[name]
            sys.modules.update(right)
        changed = set(places.reach(mutant) or ())
        if any(module == "tables" for module, _ in changed):
            return None
        for name, module in self._modules.items():
            if not self._planted(name, module, wrong[name], changed):
                return None
        bits = [self._bit.get(spot) for spot in changed]
        return None if None in bits or not bits else sum(bit for bit in bits if bit)

    def _planted(self, name: str, module: ModuleType, wrong: ModuleType, changed: set[tuple[str, int]]) -> bool:
        """Replaces code and values of a module in place. Returns whether that was all that differs."""
        if set(vars(module)) != set(vars(wrong)):
            return False
        for key, value in list(vars(module).items()):
            new, own = vars(wrong)[key], _bare(value)
            if isinstance(own, FunctionType):
                if not _replaced(own, _bare(new), changed):
                    return False
            elif isinstance(own, type) and own.__module__ == module.__name__:
                if not _class_replaced(own, new, changed):
                    return False
            elif not key.startswith("__") and _plain(own) and own != new:
                setattr(module, key, new)
                if name == "tables":
                    return False
                changed |= {(s.module, s.lines.start) for s in places.statements(name) if s.function and key in s.names}
        return True


def _bare(value: Any) -> Any:
    """What a step, a cached function, a property or a static method is made of."""
    value = getattr(value, "original", value)
    value = getattr(value, "__wrapped__", value)
    if isinstance(value, property):
        return value.fget
    return value.__func__ if isinstance(value, staticmethod) else value


def _plain(value: Any) -> bool:
    """Whether a value is data, and no function, class or module."""
    if isinstance(value, tuple | frozenset | list):
        return all(_plain(item) for item in value)
    if isinstance(value, dict):
        return all(_plain(item) for pair in value.items() for item in pair)
    return isinstance(value, int | float | str | bytes | type(None))


def _same(a: CodeType, b: CodeType) -> bool:
    """Whether two code objects do the same."""
    shape = [
        (c.co_code, c.co_names, c.co_varnames, c.co_freevars, len(c.co_consts), c.co_exceptiontable) for c in (a, b)
    ]
    if shape[0] != shape[1]:
        return False
    for x, y in zip(a.co_consts, b.co_consts, strict=True):
        if isinstance(x, CodeType) and isinstance(y, CodeType):
            if not _same(x, y):
                return False
        elif type(x) is not type(y) or x != y:
            return False
    return True


def _replaced(right: FunctionType, new: Any, changed: set[tuple[str, int]]) -> bool:
    """Gives a function the code of another one. Returns whether that makes it the same."""
    if not isinstance(new, FunctionType) or right.__code__.co_freevars != new.__code__.co_freevars:
        return False
    if (right.__defaults__, right.__kwdefaults__) != (new.__defaults__, new.__kwdefaults__):
        return False
    module = right.__module__.rpartition(".")[2]
    if module in MODULES and not _same(right.__code__, new.__code__):
        right.__code__ = new.__code__
        own = {(s.module, s.lines.start) for s in places.statements(module) if s.function == right.__qualname__}
        # What is changed is known by its statement, or it is somewhere in the function.
        if not own & changed:
            changed |= own
    return True


def _class_replaced(right: type, new: Any, changed: set[tuple[str, int]]) -> bool:
    """The same of a class's methods. Fields and other values must be the same."""
    if not isinstance(new, type) or set(vars(right)) != set(vars(new)):
        return False
    if list(vars(right).get("__annotations__", ())) != list(vars(new).get("__annotations__", ())):
        return False
    for key, value in list(vars(right).items()):
        own, other = _bare(value), _bare(vars(new)[key])
        if isinstance(own, FunctionType):
            # What dataclasses and named tuples make has no place of its own.
            if own.__code__.co_filename.startswith("<") and not key.startswith("__"):
                continue
            if not own.__code__.co_filename.startswith("<") and not _replaced(own, other, changed):
                return False
        elif not key.startswith("__") and _plain(own) and own != other:
            return False
    return True
