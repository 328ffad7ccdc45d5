"""The help of all commands, as a part of the page `commands`."""

import argparse
import os
from unittest import mock

from spec.public import commands

# The columns of the help.
_COLUMNS = 100


def sections() -> str:
    """Returns a section for each command, in Markdown."""
    # The help is as wide as the terminal, and coloured on some.
    with mock.patch.dict(os.environ, {"COLUMNS": str(_COLUMNS + 2), "NO_COLOR": "1"}):
        return "\n".join(_section(name, parser) for name, parser in commands().items())


def _section(name: str, parser: argparse.ArgumentParser) -> str:
    return f"## {name}\n\n```text\n{parser.format_help().rstrip()}\n```\n"
