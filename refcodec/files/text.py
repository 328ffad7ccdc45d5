"""Text from outside, as it may be shown: names of files, what other programs said, values of documents."""

from __future__ import annotations

import os
import shlex

# Lines and tabs may stay where the text is a block of lines.
_LAYOUT = "\n\t"


def printable(text: str, most: int | None = None, lines: bool = False) -> str:
    r"""Returns a text in which every character can be shown, and none steers a terminal or breaks a line.

    A character that Python does not call printable (escapes, control characters, marks that turn the direction of
    text, halves of surrogate pairs) becomes what Python writes for it, such as ``\x1b``.

    Args:
        text: anything.
        most: the most characters of the result, or None. A longer one ends with the number of those left out.
        lines: whether line feeds and tabs stay.
    """
    kept = _LAYOUT if lines else ""
    # No more is looked at than may be shown.
    found = text if most is None else text[:most]
    shown = "".join(c if c.isprintable() or c in kept else c.encode("unicode_escape").decode() for c in found)
    if most is None or (len(shown) <= most and len(found) == len(text)):
        return shown
    return f"{shown[:most]}... ({len(text)} characters)"


def shell_word(text: str) -> str:
    """Returns a text as a word of a shell's command line, which can be shown: printable() leaves it as it is.

    A text that is not printable is quoted as bash, zsh and ksh do it.
    """
    if printable(text) == text:
        return shlex.quote(text)
    escaped = "".join(
        chr(byte) if 0x20 <= byte < 0x7F and byte not in b"'\\" else f"\\x{byte:02x}" for byte in os.fsencode(text)
    )
    return f"$'{escaped}'"
