"""What a planted bug is, and where the second decoder's sources are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "independent"
# What decodes. The command line around it is judged by the runner, and trace and probes are no part of a verdict.
MODULES = tuple(
    sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem not in ("__init__", "__main__", "trace", "probes"))
)


@dataclass(frozen=True)
class Mutant:
    """One wrong decoder: the second decoder with one module's text changed.

    id is permanent as long as the changed code is; line is where the change begins; old and new are the text there;
    requirements are those of SPEC.md that it breaks, as far as anybody chose them. also: bugs of other modules that the
    same decoder has.
    """

    id: str
    module: str
    line: int
    old: str
    new: str
    what: str
    source: str
    requirements: tuple[str, ...] = ()
    also: tuple[Mutant, ...] = ()


@cache
def text_of(module: str) -> str:
    """The text of a module of the second decoder."""
    return (PACKAGE / f"{module}.py").read_text(encoding="utf-8")
