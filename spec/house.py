"""The rooms of the project and who uses whom, from the imports: ARCHITECTURE.md's table and drawing."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from .made import ROOT, Made

PAGE = ROOT / "ARCHITECTURE.md"
# Rooms from the ground up. Each may use those before it.
ROOMS = (
    "refcodec",
    "refcodec.files",
    "refcodec.native",
    "refcodec.bitstream",
    "refcodec.encoder",
    "refcodec.folder",
    "refcodec.inspect",
    "refcodec.render",
    "refcodec.api",
    "refcodec.export",
    "refcodec.photographs",
    "refcodec.viewer",
    "refcodec.evaluate",
    "refcodec.train",
    "refcodec.convert",
    "refcodec.experiments",
    "refcodec.cli",
    "conformance.independent",
    "conformance",
    "conformance.cases",
    "conformance.runner",
    "conformance.diagnosis",
    "conformance.report",
    "conformance.fuzz",
    "conformance.mutants",
    "conformance.cli",
    "conformance.unseen",
    "spec",
    "benchmarks",
)
PACKAGES = tuple(dict.fromkeys(room.partition(".")[0] for room in ROOMS))


@cache
def modules() -> dict[str, Path]:
    """The modules of the project by their names."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    }


def room(module: str) -> str:
    """The room of a module. A package's __main__ is of its commands."""
    module = (
        module.replace(".__main__", ".cli.__main__")
        if module in ("refcodec.__main__", "conformance.__main__")
        else module
    )
    return max((name for name in ROOMS if f"{module}.".startswith(f"{name}.")), key=len)


def docstring(module: str) -> str:
    """A module's docstring, or nothing."""
    return ast.get_docstring(ast.parse(modules()[module].read_text(encoding="utf-8"))) or ""


@cache
def imports(module: str) -> dict[str, set[str]]:
    """The project's modules that a module imports, each with the names that it takes of it."""
    found: dict[str, set[str]] = defaultdict(set)
    path = modules()[module]
    package = (module if path.name == "__init__.py" else module.rpartition(".")[0]).split(".")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                found[alias.name].add("")
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*above, node.module or ""]).strip(".")
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                if inner in modules():
                    found[inner].add("")
                else:
                    found[source].add(alias.name)
    return {name: names for name, names in found.items() if name in modules()}


def uses() -> dict[str, set[str]]:
    """Of each room the other rooms that it uses. The package's own room, which all may use, is left out."""
    found: dict[str, set[str]] = {name: set() for name in ROOMS}
    for module in modules():
        found[room(module)] |= {room(name) for name in imports(module)} - {room(module), "refcodec"}
    return found


def drawing() -> str:
    """The rooms as a graph. An arrow that follows from two others is left out."""
    graph = uses()
    # What a room reaches, from the ground up.
    reached: dict[str, set[str]] = {}
    for name in ROOMS:
        below = graph[name] & set(reached)
        reached[name] = below.union(*(reached[other] for other in below))
    lines = ["```mermaid", "flowchart BT"]
    for package in PACKAGES:
        names = [name for name in ROOMS if name == package or name.startswith(f"{package}.")]
        drawn = [name for name in names if name != "refcodec"]
        lines.append(f"  subgraph {package}_ [{package}]")
        lines += [f"    {name}[{name.rpartition('.')[2]}]" for name in drawn]
        lines.append("  end")
    for name in ROOMS:
        far = {below for other in graph[name] for below in reached[other]}
        lines += [f"  {name} --> {below}" for below in ROOMS if below in graph[name] - far]
    return "\n".join([*lines, "```"])


def table() -> str:
    """A row for each room: what it is for, in the words of its own first line, and what it uses."""
    graph = uses()
    rows = ["| room | what it is for | uses |", "|---|---|---|"]
    for name in ROOMS:
        what = docstring(name).partition("\n\n")[0].replace("\n", " ")
        below = ", ".join(f"`{other.removeprefix('refcodec.')}`" for other in ROOMS if other in graph[name])
        rows.append(f"| [`{name}`]({name.replace('.', '/')}) | {what} | {below or '-'} |")
    return "\n".join(rows)


def made() -> Iterator[Made]:
    """ARCHITECTURE.md, with its generated parts renewed."""
    text = PAGE.read_text(encoding="utf-8")
    for name, content in (("rooms", table()), ("drawing", drawing())):
        pattern = re.compile(rf"(<!-- generated:{name} -->\n).*?(<!-- /generated -->)", re.DOTALL)
        text = pattern.sub(lambda found, content=content: f"{found[1]}\n{content}\n\n{found[2]}", text)  # type: ignore[misc]
    yield Made.text(PAGE, text)
