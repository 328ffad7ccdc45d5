"""The second decoder: the Python blocks of SPEC.md as a program, with the standard library only.

`blocks` has their names. The modules are what a program needs besides.
"""

import hashlib
from dataclasses import dataclass

from . import support
from .errors import C3GSError
from .program import Names, blocks, names

__all__ = ["C3GSError", "Decoded", "Names", "blocks", "decode", "names", "verdict"]

# SPEC 9.3: the parts of the canonical reconstruction, in their order; only static scenes have the last one
PARTS = ("positions", "masks", "planes", "features", "scalings", "offsets", "weights", "splat")


@dataclass(frozen=True)
class Decoded:
    """A decoded file.

    digests: hexadecimal SHA-256 of the scene, as `whole`, and of each part, by name. reconstruction: the bytes that the
    digest of the scene is of, and behind them the parts (9.3).
    """

    digests: dict[str, str]
    reconstruction: bytes

    @property
    def digest(self) -> str:
        """The digest of the scene."""
        return self.digests["whole"]


# SPEC 9.3, Annex H
def decode(data: bytes) -> Decoded:
    """Decodes a file. Raises C3GSError if it is refused."""
    support.HASHED.clear()
    try:
        decoded = blocks.DECODE_FILE(list(data))
    except blocks.Refused as refused:
        raise C3GSError(*refused.args) from None
    *parts, scene = list(support.HASHED)[-len(decoded["parts"]) - 1 :]
    digests = {"whole": hashlib.sha256(scene).hexdigest()}
    digests |= {name: hashlib.sha256(part).hexdigest() for name, part in zip(PARTS, parts, strict=False)}
    return Decoded(digests, scene + b"".join(parts))


def verdict(space: Names, data: bytes) -> tuple[Names | None, tuple[str, int] | None]:
    """Decodes a file. Returns (what DECODE_FILE returns, None), or (None, (name, offset) of the error).

    space: what `names` returns. The digests are lists of bytes: of the parts, of the scene, and of each chunk.
    """
    try:
        return space["DECODE_FILE"](list(data)), None
    except space["Refused"] as refused:
        name, offset = refused.args
        return None, (name, offset)
