"""A wrong decoder as a package of this process: the second decoder's modules, one of them with another text."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from functools import cache
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType

from .mutant import PACKAGE, Mutant

NAME = "wrong_decoder"


@cache
def _code(module: str) -> CodeType:
    path = PACKAGE / f"{module}.py"
    return compile(path.read_text(encoding="utf-8"), str(path), "exec", dont_inherit=True)


class _Package(MetaPathFinder, Loader):
    """Finds and loads the modules below NAME."""

    def __init__(self, mutant: Mutant | None) -> None:
        self._changed = {m.module: m for m in (mutant, *mutant.also)} if mutant else {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        package, _, module = fullname.partition(".")
        if package != NAME:
            return None
        # The origin becomes __file__, from which the decoder finds its tables.
        spec = ModuleSpec(fullname, self, origin=str(PACKAGE / f"{module or '__init__'}.py"), is_package=not module)
        spec.has_location = True
        return spec

    def exec_module(self, module: ModuleType) -> None:
        name = module.__name__.partition(".")[2] or "__init__"
        wrong = self._changed.get(name)
        code = compile(wrong.source, f"<{wrong.id}>", "exec", dont_inherit=True) if wrong else _code(name)
        exec(code, module.__dict__)


def _functions(code: CodeType) -> dict[str, list[tuple[object, ...]]]:
    """What each function of a module does, by qualified name; "<module>" too."""
    values = [value for value in code.co_consts if not isinstance(value, CodeType)]
    found: dict[str, list[tuple[object, ...]]] = {
        code.co_qualname: [(code.co_code, code.co_names, code.co_varnames, values)]
    }
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            for name, parts in _functions(inner).items():
                found[name] = found.get(name, []) + parts
    return found


def changed(mutant: Mutant) -> set[str] | None:
    """The functions that a mutant changes, as "module.name"; None if that is more than functions.

    A file for which the unchanged decoder calls none of them is decoded by the mutant in the same way.
    """
    try:
        new = _functions(compile(mutant.source, mutant.id, "exec", dont_inherit=True))
    except SyntaxError:
        return None
    old = _functions(_code(mutant.module))
    names = {name for name in old if new.get(name) != old[name]}
    return None if "<module>" in names else {f"{mutant.module}.{name}" for name in names}


def load(mutant: Mutant | None) -> ModuleType:
    """The package with the mutant's module, all of its modules new; None gives the decoder unchanged.

    Whatever the changed text raises while it is imported comes through.
    """
    finder = _Package(mutant)
    sys.meta_path.insert(0, finder)
    try:
        for name in [name for name in sys.modules if name == NAME or name.startswith(f"{NAME}.")]:
            del sys.modules[name]
        return importlib.import_module(NAME)
    finally:
        sys.meta_path.remove(finder)
