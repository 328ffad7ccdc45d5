"""Makes ARCHITECTURE.md's table of packages and their imports."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from .made import ROOT, Made

PAGE = ROOT / "ARCHITECTURE.md"


def _in(package: str, names: str) -> tuple[str, ...]:
    return tuple(f"{package}.{name}" for name in names.split())


# The packages (rooms) by the parts of ARCHITECTURE.md's table. Each may import earlier ones.
PARTS = {
    "format": ("refcodec", *_in("refcodec", "files pages native bitstream encoder folder inspect")),
    "scenes": _in("refcodec", "formats rendering export photographs viewer evaluate train convert experiments"),
    "front doors": _in("refcodec", "api gsplat cli"),
    "conformance": (
        *("conformance.spec_decoder", "conformance"),
        *_in("conformance", "cases runner report fuzz mutants cli"),
        *("spec", "benchmarks", "release"),
    ),
}
ROOMS = tuple(room for rooms in PARTS.values() for room in rooms)
PACKAGES = tuple(dict.fromkeys(room.partition(".")[0] for room in ROOMS))


@cache
def modules() -> dict[str, Path]:
    """Returns the modules of the project by name."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    }


def room(module: str) -> str:
    """Returns the room of a module. A package's __main__ belongs to its commands."""
    if module in ("refcodec.__main__", "conformance.__main__"):
        module = module.replace(".__main__", ".cli.__main__")
    return max((name for name in ROOMS if f"{module}.".startswith(f"{name}.")), key=len)


def docstring(module: str) -> str:
    """Returns a module's docstring, or an empty string."""
    return ast.get_docstring(ast.parse(modules()[module].read_text(encoding="utf-8"))) or ""


@cache
def imports(module: str) -> dict[str, set[str]]:
    """Returns the project's modules that a module imports, with the names imported from each."""
    named: dict[str, set[str]] = defaultdict(set)
    path = modules()[module]
    package = (module if path.name == "__init__.py" else module.rpartition(".")[0]).split(".")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                named[alias.name].add("")
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*above, node.module or ""]).strip(".")
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                if inner in modules():
                    named[inner].add("")
                else:
                    named[source].add(alias.name)
    return {name: names for name, names in named.items() if name in modules()}


def uses() -> dict[str, set[str]]:
    """Returns the other rooms that each room imports, except `refcodec` itself, which all may import."""
    used: dict[str, set[str]] = {name: set() for name in ROOMS}
    for module in modules():
        used[room(module)] |= {room(name) for name in imports(module)} - {room(module), "refcodec"}
    return used


def table() -> str:
    """Returns the table: part, first sentence of the docstring, and imported rooms of each room."""
    graph = uses()
    rows = ["| part | package | purpose | imports |", "|---|---|---|---|"]
    for part, rooms in PARTS.items():
        for name in rooms:
            purpose = docstring(name).partition("\n\n")[0].replace("\n", " ")
            below = ", ".join(f"`{other.removeprefix('refcodec.')}`" for other in ROOMS if other in graph[name])
            rows.append(f"| {part} | [`{name}`]({name.replace('.', '/')}) | {purpose} | {below or '-'} |")
    return "\n".join(rows)


def made() -> Iterator[Made]:
    """Yields ARCHITECTURE.md with the current table."""
    text = PAGE.read_text(encoding="utf-8")
    pattern = re.compile(r"(<!-- generated:rooms -->\n).*?(<!-- /generated -->)", re.DOTALL)
    yield Made.text(PAGE, pattern.sub(lambda match: f"{match[1]}\n{table()}\n\n{match[2]}", text))
