"""Printable forms of text from outside: file names, output of other programs, document values."""

import os
import shlex

# Line feeds and tabs may stay in a block of lines.
_LAYOUT = "\n\t"


def printable(text: str, most: int | None = None, lines: bool = False) -> str:
    r"""Returns a text whose characters are all printable, so that none controls a terminal or breaks a line.

    A character that Python does not call printable (escapes, control characters, direction marks, surrogates) becomes
    its Python escape, such as ``\x1b``.

    Args:
        text: anything.
        most: the maximum length, or None. A cut text ends with its original length.
        lines: whether line feeds and tabs stay.
    """
    kept = _LAYOUT if lines else ""
    # No more characters are converted than may be shown.
    beginning = text if most is None else text[:most]
    shown = "".join(c if c.isprintable() or c in kept else c.encode("unicode_escape").decode() for c in beginning)
    if most is None or (len(shown) <= most and len(beginning) == len(text)):
        return shown
    return f"{shown[:most]}... ({len(text)} characters)"


def counted(count: int, what: str) -> str:
    """Returns a number with a noun, such as 1 anchor and 2 anchors."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def shell_word(text: str) -> str:
    """Returns a text as a printable word of a shell command line. Other text is quoted as in bash, zsh and ksh."""
    if printable(text) == text:
        return shlex.quote(text)
    escaped = "".join(
        chr(byte) if 0x20 <= byte < 0x7F and byte not in b"'\\" else f"\\x{byte:02x}" for byte in os.fsencode(text)
    )
    return f"$'{escaped}'"
