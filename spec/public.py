"""Makes spec/public.txt: the names of `import refcodec` with their types, and the commands with their options."""

import argparse
import hashlib
import inspect
import re
from collections.abc import Iterator
from functools import cached_property

from conformance.cli.main import make_parser as conformance_parser
from refcodec import api
from refcodec.cli.parser import make_parser
from refcodec.gsplat import C3gsCompression

from .made import ROOT, Made

PAGE, CHANGES = ROOT / "spec" / "public.txt", ROOT / "CHANGELOG.md"
_HEAD = """\
What is public. `python -m spec` writes this file, and refuses a change that CHANGELOG.md does not state.
CHANGELOG.md at the last change: {news}

"""


def commands() -> dict[str, argparse.ArgumentParser]:
    """Returns the parsers of all commands by name, such as `refcodec encode`."""
    parsers: dict[str, argparse.ArgumentParser] = {}
    for parser in (make_parser(), conformance_parser()):
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                parsers |= {f"{parser.prog} {name}": command for name, command in action.choices.items()}
    return parsers


def _members(name: str, thing: type) -> Iterator[str]:
    for member, kind in inspect.get_annotations(thing).items():
        if not member.startswith("_"):
            yield f"{name}.{member}: {kind}"
    for member, value in vars(thing).items():
        if member.startswith("_"):
            continue
        getter = value.func if isinstance(value, cached_property) else getattr(value, "fget", None)
        if getter is not None:
            yield f"{name}.{member}: {inspect.signature(getter).return_annotation}"
        elif callable(getattr(thing, member)):
            yield f"{name}.{member}{inspect.signature(getattr(thing, member))}"


def lines() -> Iterator[str]:
    """Yields a line for each name and each command."""
    things = {name: getattr(api, name) for name in api.__all__} | {"gsplat.C3gsCompression": C3gsCompression}
    for name, thing in sorted(things.items()):
        yield f"{name}{inspect.signature(thing)}"
        if isinstance(thing, type):
            yield from _members(name, thing)
    for name, parser in sorted(commands().items()):
        words = [
            "|".join(action.option_strings) or str(action.metavar or action.dest)
            for action in parser._actions
            if not isinstance(action, argparse._HelpAction)
        ]
        yield " ".join([name, *words])


def _news() -> str:
    """Returns a hash of the first part of CHANGELOG.md, which is about what is not released."""
    first = re.split(r"^## ", CHANGES.read_text(encoding="utf-8"), maxsplit=2, flags=re.MULTILINE)[1]
    return hashlib.sha256(first.encode()).hexdigest()[:16]


def made() -> Iterator[Made]:
    """Yields the list. Exits if it changed and CHANGELOG.md did not."""
    # Annotations are strings, which signatures quote.
    body, news = "".join(f"{line}\n" for line in lines()).replace("'", ""), _news()
    old = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    if not old.endswith(f"\n\n{body}"):
        if f": {news}\n" in old:
            raise SystemExit("what is public has changed: state it in CHANGELOG.md, then run python -m spec")
        old = _HEAD.format(news=news) + body
    yield Made.text(PAGE, old)
