"""Which lines and conditions of SPEC.md's blocks the vectors reach: `python -m spec --coverage`.

The second decoder, which is made from the blocks, runs with a probe at each statement of its functions, and with two at
each condition: for true and for false. A condition is an operand of `and`, `or` and `not`, or else the whole test of a
statement, of a comprehension or of REQUIRE. A place that no vector reaches is a hole, unless `argued` gives a reason.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

from tqdm import tqdm

from conformance import spec_decoder
from conformance.cases.cameras import expected
from conformance.manifest import VECTORS, GaussiansOf, Manifest, Vector, load
from conformance.spec_decoder import Names, blocks

from .decoder import TARGET

LINE, TRUE, FALSE = "is not run", "is never true", "is never false"
# Functions of images, which no vector has: tests/render compares the renderer with them.
IMAGES = {"ROTATION", "PRODUCT", "PROJECT", "PIXEL"}
# Places that need no vector, by function, text and what does not happen there, with the reason.
ARGUED = {
    ("LOGISTIC", "x > -700", FALSE): "a guard for exp: the result is 0 within every tolerance",
}


@dataclass(frozen=True)
class Site:
    """A place of blocks.py that a probe watches. text: of the statement's first line, or of the condition."""

    function: str
    line: int
    text: str
    kind: str

    def argued(self) -> str | None:
        """Returns why no vector need reach it, or None."""
        if self.function in IMAGES:
            return "images: tests/render"
        return ARGUED.get((self.function, self.text, self.kind))


class _Probes(ast.NodeTransformer):
    """Adds the probes. sites: by the numbers of the probes."""

    def __init__(self, source: str) -> None:
        self.sites: list[Site] = []
        self._lines = source.splitlines()
        self._functions: list[str] = []

    def _site(self, node: ast.AST, text: str, kind: str) -> int:
        self.sites.append(Site(self._functions[-1], node.lineno, text, kind))  # type: ignore[attr-defined]
        return len(self.sites) - 1

    def _condition(self, node: ast.expr) -> ast.expr:
        """Returns a test with probes at its operands."""
        if isinstance(node, ast.BoolOp):
            node.values = [self._condition(value) for value in node.values]
            return node
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            node.operand = self._condition(node.operand)
            return node
        text = ast.unparse(node)
        number = self._site(node, text, TRUE)
        self._site(node, text, FALSE)
        name, at = ast.Name("_condition", ast.Load()), ast.Constant(number)
        return ast.Call(name, [at, self.visit(node)], [])

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self._functions.append(node.name)
        self.generic_visit(node)
        self._functions.pop()
        return node

    def visit_If(self, node: ast.If) -> ast.AST:
        return self._tested(node)

    def visit_While(self, node: ast.While) -> ast.AST:
        return self._tested(node)

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        return self._tested(node)

    def _tested(self, node: ast.If | ast.While | ast.IfExp) -> ast.AST:
        test, node.test = node.test, ast.Constant(True)
        self.generic_visit(node)
        node.test = self._condition(test) if self._functions else test
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        return self._condition(node)

    def visit_comprehension(self, node: ast.comprehension) -> ast.AST:
        tests, node.ifs = node.ifs, []
        self.generic_visit(node)
        node.ifs = [self._condition(test) for test in tests]
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        if isinstance(node.func, ast.Name) and node.func.id == "REQUIRE":
            node.args = [self._condition(node.args[0]), *(self.visit(argument) for argument in node.args[1:])]
            return node
        return self.generic_visit(node)

    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        if self._functions:
            for name in ("body", "orelse"):
                statements = getattr(node, name, None)
                if isinstance(statements, list):
                    setattr(node, name, [each for one in statements for each in self._watched(one)])
        return node

    def _watched(self, node: ast.stmt) -> Iterator[ast.stmt]:
        """Yields a statement behind its probe."""
        if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            number = self._site(node, self._lines[node.lineno - 1].strip(), LINE)
            yield ast.parse(f"_seen[{number}] = 1").body[0]
        yield node


def probed() -> tuple[Names, bytearray, list[Site]]:
    """Returns the names of a second decoder with probes, what they have seen, and their sites."""
    source = TARGET.read_text(encoding="utf-8")
    probes = _Probes(source)
    tree = ast.fix_missing_locations(probes.visit(ast.parse(source)))
    seen = bytearray(len(probes.sites))

    def condition(number: int, value: Any) -> Any:
        seen[number if value else number + 1] = 1
        return value

    space: Names = {"__name__": blocks.__name__, "__package__": blocks.__package__, "_seen": seen}
    space["_condition"] = condition
    exec(compile(tree, str(TARGET), "exec"), space)
    return space, seen, probes.sites


@cache
def _probed() -> tuple[Names, bytearray, list[Site]]:
    return probed()


def reached(data: bytes, camera: dict[str, Any] | None = None) -> list[int]:
    """Returns the numbers of the probes that a file reaches. camera: for which its Gaussians are computed, or None."""
    space, seen, _ = _probed()
    seen[:] = bytes(len(seen))
    if camera is None:
        spec_decoder.verdict(space, data)
    else:
        expected(data, camera, space)
    return [number for number, each in enumerate(seen) if each]


def _reached(vector: Vector) -> tuple[str, list[int]]:
    camera = vector.expectation.camera if isinstance(vector.expectation, GaussiansOf) else None
    return vector.id, reached((VECTORS / vector.input.path).read_bytes(), camera)


def vectors_of(manifest: Manifest, jobs: int) -> list[list[str]]:
    """Returns the identifiers of the vectors that reach each probe, by its number. jobs: the number of processes.

    Loading the second decoder counts as the vector "any file".
    """
    _, seen, sites = probed()
    found: list[list[str]] = [["any file"] if each else [] for each in seen]
    assert len(found) == len(sites)
    longest_first = sorted(manifest.vectors, key=lambda vector: -vector.input.size)
    with ProcessPoolExecutor(jobs) as pool:
        results = pool.map(_reached, longest_first)
        for name, numbers in tqdm(results, total=len(longest_first), unit="vector", disable=None):
            for number in numbers:
                found[number].append(name)
    return found


def report(sites: list[Site], found: list[list[str]]) -> tuple[list[str], int]:
    """Returns the lines of the report, and the number of holes. found: the result of vectors_of."""
    lines, holes = [], 0
    for name, kinds in (("statements", {LINE}), ("outcomes of conditions", {TRUE, FALSE})):
        own = [(site, vectors) for site, vectors in zip(sites, found, strict=True) if site.kind in kinds]
        missed = [site for site, vectors in own if not vectors]
        argued = [site for site in missed if site.argued()]
        holes += len(missed) - len(argued)
        once = sum(len(vectors) == 1 and vectors != ["any file"] for _, vectors in own)
        lines.append(
            f"{name}: {len(own)}, of which the vectors reach {len(own) - len(missed)} ({once} by one vector alone); "
            f"{len(argued)} argued, {len(missed) - len(argued)} open"
        )
        lines += [f"  {s.function}, line {s.line}: {s.text} {s.kind}" for s in missed if not s.argued()]
    return lines, holes


def main(jobs: int | None = None) -> int:
    """Prints the report. Returns 1 if there is a hole, else 0."""
    _, _, sites = _probed()
    lines, holes = report(sites, vectors_of(load(), jobs or os.cpu_count() or 1))
    print("\n".join(lines))
    return 1 if holes else 0
