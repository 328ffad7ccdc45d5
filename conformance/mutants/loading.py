"""A wrong decoder in this process: the blocks of SPEC.md with another text."""

from __future__ import annotations

from functools import cache
from types import CodeType

from ..spec_decoder.program import Names, code, names
from .mutant import PATH, Mutant, definitions, span, text

_unchanged_code = cache(code)


def _functions(code: CodeType) -> dict[str, list[tuple[object, ...]]]:
    """Returns what each function of the blocks does, by qualified name, and the top level as "<module>"."""
    values = [value for value in code.co_consts if not isinstance(value, CodeType)]
    functions: dict[str, list[tuple[object, ...]]] = {
        code.co_qualname: [(code.co_code, code.co_names, code.co_varnames, values)]
    }
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            for name, content in _functions(inner).items():
                functions[name] = functions.get(name, []) + content
    return functions


@cache
def _unchanged(place: str) -> dict[str, list[tuple[object, ...]]]:
    first, end = span(definitions()[place])
    return _functions(compile(text()[first:end], PATH, "exec", dont_inherit=True))


def changed(mutant: Mutant) -> set[str] | None:
    """Returns the qualified names of the functions that a mutant changes, or None if it changes a constant.

    The mutant decodes a file as the unchanged decoder does if that calls none of these functions for it.
    """
    try:
        new = _functions(compile(mutant.statement, mutant.id, "exec", dont_inherit=True))
    except SyntaxError:
        return None
    old = _unchanged(mutant.place)
    names = {name for name in old if new.get(name) != old[name]}
    return None if "<module>" in names else names


def load(mutant: Mutant | None) -> Names:
    """Returns the names of a mutant's blocks, or of the unchanged ones.

    Raises whatever the changed text raises when it is executed.
    """
    if mutant is None:
        return names(_unchanged_code())
    return names(compile(mutant.source, f"<{mutant.id}>", "exec", dont_inherit=True))
