"""Finds files of the project that lie outside its packages in a checkout, such as SPEC.md and the vectors."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def find(name: str, package: Path = PACKAGE) -> Path:
    """Returns the path of a file or folder of the project.

    It is searched in the package, then in the folder `data` of the package, and then in the folder around it. The
    second is its place in an installed package, and the third in a checkout. package: the folder of the package that
    ships it. Raises FileNotFoundError if it is in none of them.
    """
    for folder in (package, package / "data", package.parent):
        if (folder / name).exists():
            return folder / name
    raise FileNotFoundError(2, "it belongs to the project and is not there: install the package again", name)
