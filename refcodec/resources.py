"""Files that belong to the project and lie outside its packages in a checkout: SPEC.md, the vectors."""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def find(name: str, package: Path = PACKAGE) -> Path:
    """A file or folder of the project: in the package, in the `data` of an installed one, or in the checkout around it.

    package: the folder of the package that ships it. Raises FileNotFoundError if it is in none of them.
    """
    for folder in (package, package / "data", package.parent):
        if (folder / name).exists():
            return folder / name
    raise FileNotFoundError(2, "it belongs to the project and is not there: install the package again", name)
