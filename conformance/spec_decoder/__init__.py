"""The second decoder: the Python blocks of SPEC.md as a program, with the standard library only.

`python -m spec` extracts `blocks` from SPEC.md. The other modules are what a program needs besides.
"""

from __future__ import annotations

import runpy
from typing import Any

Names = dict[str, Any]


def names() -> Names:
    """Returns the names that `blocks` defines, in a new dictionary which its functions use: a caller may replace them.

    `blocks` has the Python blocks of SPEC.md, the constants of 2.5, the errors of 10.3, the tables of chapter 11 and
    those of Annex A.
    """
    return runpy.run_module(f"{__name__}.blocks")


def verdict(space: Names, data: bytes) -> tuple[Names | None, tuple[str, int] | None]:
    """Decodes a file. Returns (what DECODE_FILE returns, None), or (None, (name, offset) of the error).

    space: what `names` returns. The digests are lists of bytes: of the seven parts, of the scene, and of each chunk.
    """
    try:
        return space["DECODE_FILE"](list(data)), None
    except space["Refused"] as refused:
        name, offset = refused.args
        return None, (name, offset)
