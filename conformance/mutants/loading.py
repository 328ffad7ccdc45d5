"""A wrong decoder in this process: the blocks of SPEC.md with another text."""

from functools import cache

from ..spec_decoder.program import Names, code, names
from .mutant import Mutant, used_at_load


@cache
def unchanged() -> Names:
    """Returns the names of the unchanged blocks, the same ones for each call."""
    return names(code())


def load(mutant: Mutant | None) -> Names:
    """Returns the names of a mutant's blocks, or of the unchanged ones.

    To be called once in a process: what the blocks need only to decode is changed in the unchanged ones, because it
    takes a third of the time. Raises whatever the changed text raises when it is executed.
    """
    if mutant is None:
        return unchanged()
    if mutant.place in used_at_load():
        return names(compile(mutant.source, f"<{mutant.id}>", "exec", dont_inherit=True))
    exec(compile(mutant.statement, f"<{mutant.id}>", "exec", dont_inherit=True), unchanged())
    return unchanged()
