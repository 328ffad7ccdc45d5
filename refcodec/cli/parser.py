"""The parser of the command line. The commands, their words and their help are those of refcodec.api."""

import argparse
import importlib
import inspect
import sys
from collections.abc import Callable, Iterable
from typing import Any, NoReturn

from .. import __version__, api, statuses
from ..api.command import SPELLED, Word, is_given, sections, words
from ..files.outputs import HELP
from ..files.terminal import note
from ..statuses import UsageError

Function = Callable[..., Any]

# The modules of refcodec.api and their commands, as they are spelled.
GROUPS = {module: tuple(SPELLED.get(name, name) for name in names) for module, names in api.COMMANDS.items()}
# Options that have another name now.
FORMER = {"--rate": "--lambda", "--rates": "--lambdas"}

EXITS = """\
exit status:
  0   accepted, or done
  1   the file is rejected      } the last line on stderr is JSON:
  2   the file is not supported } code, name, offset, path, clause, requirement
  64  wrong usage, or a file or folder that cannot be read or written
  70  internal error
  71  out of memory; not a verdict on the file
"""


class _Parser(argparse.ArgumentParser):
    """An argument parser that exits with the status of wrong usage. argparse's own status 2 would read as a verdict."""

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        note(f"{self.prog}: {message}")
        self.exit(statuses.USAGE)


class _Version(argparse.Action):
    """Prints the version and the decoding path. Only this option loads the native kernel for it."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from ..native.library import describe  # noqa: PLC0415 (slow)

        print(f"refcodec {__version__}, {describe()}")
        parser.exit()


def make_parser(groups: Iterable[str] = GROUPS) -> argparse.ArgumentParser:
    """Returns the parser with the commands of some groups. Its help lists them."""
    modules = {group: importlib.import_module(f"{api.__name__}.{group}") for group in groups}
    functions = {group: [getattr(module, name) for name in api.COMMANDS[group]] for group, module in modules.items()}
    overview = ""
    for group, module in modules.items():
        overview += f"{str(module.__doc__)[:-1].lower()}:\n"
        overview += "".join(f"  {made.command.name:<12} {_summary(made)}\n" for made in functions[group]) + "\n"
    parser = _Parser(
        prog="refcodec",
        usage="refcodec [-h] [--version] COMMAND ...",
        description="Reference encoder and decoder of C3GS, a bitstream for learned 3D Gaussian scenes.",
        epilog=f"{overview}refcodec COMMAND --help describes a command.\n\n"
        f"examples:\n  refcodec validate scene.c3gs\n  refcodec decode scene.c3gs -o scene\n\n{EXITS}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--version", action=_Version, nargs=0, default=argparse.SUPPRESS, help="show version and path, and exit"
    )
    commands = parser.add_subparsers(prog="refcodec", metavar="COMMAND", help=argparse.SUPPRESS)
    for function in (function for made in functions.values() for function in made):
        _add(commands, function)
    return parser


def _summary(function: Function) -> str:
    text = sections(function)[""].partition("\n")[0].rstrip(".")
    return text[0].lower() + text[1:]


def _add(commands: Any, function: Function) -> None:
    """Adds a command. Its help ends with the rules for outputs and the exit statuses."""
    about, command = sections(function), function.command  # type: ignore[attr-defined]
    summary, _, notes = about[""].partition("\n")
    examples = [f"  refcodec {line.strip()}\n" for line in about["Examples"].splitlines() if line.startswith("    ")]
    parts = ["examples:\n" + "".join(examples).rstrip(), notes.strip(), HELP if command.writes else "", EXITS]
    parser = commands.add_parser(
        command.name,
        description=summary,
        epilog="\n\n".join(filter(None, parts)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        argument_default=argparse.SUPPRESS,
    )
    for word in words(function).values():
        _add_word(parser, word, word.name in command.operands, command.requires == (word.name,))
    parser.set_defaults(function=function)


def _add_word(parser: argparse.ArgumentParser, word: Word, operand: bool, required: bool) -> None:
    metavar = word.kind.metavar if word.kind else f"{{{','.join(word.choices)}}}" if word.choices else ""
    options: dict[str, Any] = {"help": _help(word), "metavar": metavar or word.name.upper()}
    if operand or (word.required and word.name != "output"):
        parser.add_argument(word.name, nargs="+" if word.many else None if word.required else "?", **options)
        return
    if word.flag:
        options = {"help": _help(word), "action": "store_true"}
    elif word.many:
        options |= {"nargs": "+"} if word.default else {"action": "append"}
    names = ["-o", word.option] if word.name == "output" else [word.option]
    parser.add_argument(*names, dest=word.name, required=word.required or required, **options)


def _help(word: Word) -> str:
    shown = is_given(word.default) and "(default" not in word.text
    default = " ".join(map(str, word.default)) if isinstance(word.default, tuple) else word.default
    return (f"{word.text} (default: {default})" if shown else word.text).replace("%", "%%")


def parse(argv: list[str]) -> tuple[Function, dict[str, Any]]:
    """Returns the function of a command line, and its arguments. Raises UsageError, and SystemExit after help."""
    name = next((word for word in argv if not word.startswith("-")), None)
    parser = make_parser([group for group, names in GROUPS.items() if name in names] or GROUPS)
    for word in argv:
        if new := FORMER.get(former := word.partition("=")[0]):
            raise UsageError(f"{former} is called {new} now")
    given = vars(parser.parse_args(argv or ["--help"]))
    if "function" not in given:
        parser.error("a command is required: refcodec --help lists them")
    function = given.pop("function")
    known, command = words(function), function.command
    arguments = {key: known[key].read(value) for key, value in given.items()}
    if command.requires and not any(key in arguments for key in command.requires):
        raise UsageError(f"{command.name} needs {' or '.join(known[key].option for key in command.requires)}")
    if limits := {key: arguments.pop(key) for key in ("max_anchors", "max_work", "max_memory") if key in arguments}:
        from ..bitstream.bounds import Limits  # noqa: PLC0415 (NumPy)

        arguments["limits"] = Limits(**{key.removeprefix("max_"): value for key, value in limits.items()})
    if "write" in inspect.signature(function).parameters:
        arguments["write"] = sys.stdout.write
    return function, arguments
