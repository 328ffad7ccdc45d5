"""Which lines and conditions of SPEC.md's blocks the vectors reach: `python -m spec --coverage`.

The second decoder, which is made from the blocks, runs with a probe at each statement of its functions, and with two at
each condition: for true and for false. A condition is an operand of `and`, `or` and `not`, or else the whole test of a
statement, of a comprehension or of REQUIRE. A place that no vector reaches is a hole, unless `argued` gives a reason.
A third kind of probe keeps the extremes of the integers that 7.11 bounds. A fourth one shows whether a comparison of
order was decided at its bound: by the last numbers with which it holds, and by the first ones with which it fails.
"""

import ast
import copy
import os
import re
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

from tqdm import tqdm

from conformance import spec_decoder
from conformance.cases.cameras import expected
from conformance.manifest import VECTORS, GaussiansOf, Manifest, Vector, load
from conformance.quantities import QUANTITIES
from conformance.spec_decoder import Names, program
from conformance.spec_decoder.program import SPEC

from . import elements, neighbours

LINE, TRUE, FALSE = "is not run", "is never true", "is never false"
AT, BEYOND = "never just holds", "never just fails"
KINDS = {"statements": {LINE}, "outcomes of conditions": {TRUE, FALSE}, "bounds of comparisons": {AT, BEYOND}}
ANY_FILE = "any file"
# Functions of images: wrong ones are planted there, and an image vector shows each.
IMAGES = {"ROTATION", "PRODUCT", "PROJECT", "PIXEL"}
# Functions that compare real numbers, which have no next number.
REAL = IMAGES | {"GAUSSIANS", "NORMALISED", "LOGISTIC"}
# Places that need no vector, by function, text and what does not happen there, with the reason.
ARGUED = {
    ("LOGISTIC", "x > -700", FALSE): "a guard for exp: the result is 0 within every tolerance",
    ("ROUND_F32", "n < 0", BEYOND): "0 was returned before",
    ("at", "i < size", BEYOND): "no neighbour is below its point",
    ("CONTRACT", "q <= unit * unit", BEYOND): "the contraction of this length changes nothing",
    ("CHECK_HEADER", "lower['level'] >= level['level']", BEYOND): "the numbers of levels differ by ten",
}

# A quantity is reached if its largest magnitude has as many bits as its bound, or one less, or more than 32: no
# narrower type than that of 7.11 holds it.
SLACK, NARROW = 1, 32
# Why no vector reaches another quantity.
TOO_LARGE = {
    "u (s - 1)": "planes of 1024 are a trial, not a vector",
    "raw bits of a substream": "half a gigabyte",
    "grid exponent of any row, as a sum before the check": "the blocks stop at the first row out of range",
}


@dataclass(frozen=True)
class Site:
    """A place of SPEC.md's blocks that a probe watches. text: of the statement's first line, or of the condition."""

    function: str
    line: int
    text: str
    kind: str

    def argued(self) -> str | None:
        """Returns why no vector need reach it, or None."""
        if self.function in IMAGES:
            return "images: tests/conformance/test_renderers.py"
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

    def visit(self, node: ast.AST) -> Any:
        """Returns a node of a function with its probes. An expression of QUANTITIES also keeps its extremes."""
        if not self._functions and not isinstance(node, (ast.Module, ast.FunctionDef)):
            return node
        key = None
        if isinstance(node, ast.expr) and isinstance(getattr(node, "ctx", ast.Load()), ast.Load):
            key = self._functions[-1], ast.unparse(node)
        node = super().visit(node)
        if key in QUANTITIES:
            assert isinstance(node, ast.expr)
            node = ast.Call(ast.Name("_extreme", ast.Load()), [ast.Constant(QUANTITIES[key]), node], [])
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self._functions.append(node.name)
        self.generic_visit(node)
        self._functions.pop()
        return node

    def _tested(self, node: ast.If | ast.While | ast.IfExp) -> ast.AST:
        test, node.test = node.test, ast.Constant(True)
        self.generic_visit(node)
        node.test = self._condition(test)
        return node

    def visit_If(self, node: ast.If) -> ast.AST:
        return self._tested(node)

    def visit_While(self, node: ast.While) -> ast.AST:
        return self._tested(node)

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        return self._tested(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        return self._condition(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        """Returns a comparison of order with probes at its bound. It may be one of several, as in a < b < c."""
        pairs = list(zip([node.left, *node.comparators], node.ops, node.comparators, strict=False))
        ordered = all(isinstance(op, (ast.Lt, ast.LtE, ast.Gt, ast.GtE)) for op in node.ops)
        if not ordered or self._functions[-1] in REAL:
            return self.generic_visit(node)
        parts: list[ast.expr] = []
        for left, op, right in pairs:
            text = ast.unparse(ast.Compare(left, [op], [right]))
            number = self._site(node, text, AT)
            self._site(node, text, BEYOND)
            low, high = (left, right) if isinstance(op, (ast.Lt, ast.LtE)) else (right, left)
            strict = ast.Constant(isinstance(op, (ast.Lt, ast.Gt)))
            operands = [self.visit(copy.deepcopy(each)) for each in (low, high)]
            parts.append(ast.Call(ast.Name("_bound", ast.Load()), [ast.Constant(number), *operands, strict], []))
        return parts[0] if len(parts) == 1 else ast.BoolOp(ast.And(), parts)

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


@dataclass(frozen=True)
class Probed:
    """A second decoder with probes.

    names: as those of spec_decoder.names. seen: a byte for each site, 1 if it was reached. extremes: the least and the
    greatest value of each quantity of QUANTITIES that was computed. Callers may reset both.
    """

    names: Names
    seen: bytearray
    sites: list[Site]
    extremes: dict[str, tuple[int, int]]


def probed() -> Probed:
    """Returns a second decoder with probes."""
    source = program.source(SPEC.read_text(encoding="utf-8"))
    probes = _Probes(source)
    tree = probes.visit(ast.parse(source))
    seen = bytearray(len(probes.sites))
    extremes: dict[str, tuple[int, int]] = {}

    def condition(number: int, value: Any) -> Any:
        seen[number if value else number + 1] = 1
        return value

    def bound(number: int, low: int, high: int, strict: bool) -> bool:
        slack = high - low - strict
        if -1 <= slack <= 0:
            seen[number - slack] = 1
        return slack >= 0

    def extreme(quantity: str, value: int) -> int:
        least, greatest = extremes.get(quantity, (value, value))
        if value <= least or value >= greatest:
            extremes[quantity] = min(least, value), max(greatest, value)
        return value

    code = compile(ast.fix_missing_locations(tree), str(SPEC), "exec")
    space = program.names(code, _seen=seen, _condition=condition, _bound=bound, _extreme=extreme)
    return Probed(space, seen, probes.sites, extremes)


_probed = cache(probed)


def reached(data: bytes, camera: dict[str, Any] | None = None) -> tuple[list[int], dict[str, tuple[int, int]]]:
    """Returns the numbers of the probes that a file reaches, and the extremes of its quantities.

    camera: for which its Gaussians are computed, or None to decode the file.
    """
    own = _probed()
    own.seen[:] = bytes(len(own.seen))
    own.extremes.clear()
    if camera is None:
        spec_decoder.verdict(own.names, data)
    else:
        expected(data, camera, own.names)
    return [number for number, each in enumerate(own.seen) if each], dict(own.extremes)


def _reached(vector: Vector) -> tuple[str, list[int], dict[str, tuple[int, int]]]:
    camera = vector.expectation.camera if isinstance(vector.expectation, GaussiansOf) else None
    return vector.id, *reached((VECTORS / vector.input.path).read_bytes(), camera)


def of_vectors(manifest: Manifest, jobs: int) -> tuple[list[list[str]], dict[str, tuple[int, int]]]:
    """Returns the identifiers of the vectors that reach each probe, by its number, and the extremes of all quantities.

    jobs: the number of processes. Loading the second decoder counts as the vector ANY_FILE.
    """
    reaching: list[list[str]] = [[ANY_FILE] if each else [] for each in probed().seen]
    extremes: dict[str, tuple[int, int]] = {}
    longest_first = sorted(manifest.vectors, key=lambda vector: -vector.input.size)
    with ProcessPoolExecutor(jobs) as pool:
        results = pool.map(_reached, longest_first)
        for name, numbers, own in tqdm(results, total=len(longest_first), unit="vector", disable=None):
            for number in numbers:
                reaching[number].append(name)
            for quantity, (least, greatest) in own.items():
                before = extremes.get(quantity, (least, greatest))
                extremes[quantity] = min(least, before[0]), max(greatest, before[1])
    return reaching, extremes


def report(sites: list[Site], reaching: list[list[str]]) -> tuple[list[str], int]:
    """Returns lines on statements and conditions, and the number of holes. reaching: as of_vectors returns it."""
    lines, holes = [], 0
    for name, kinds in KINDS.items():
        own = [(site, vectors) for site, vectors in zip(sites, reaching, strict=True) if site.kind in kinds]
        missed = [site for site, vectors in own if not vectors]
        argued = [site for site in missed if site.argued()]
        holes += len(missed) - len(argued)
        once = sum(len(vectors) == 1 and vectors != [ANY_FILE] for _, vectors in own)
        lines.append(
            f"{name}: {len(own)}, of which the vectors reach {len(own) - len(missed)} ({once} by one vector alone); "
            f"{len(argued)} argued, {len(missed) - len(argued)} open"
        )
        lines += [f"  {s.function}, line {s.line}: {s.text} {s.kind}" for s in missed if not s.argued()]
    return lines, holes


def extremes_of(text: str, extremes: dict[str, tuple[int, int]]) -> tuple[list[str], int]:
    """Returns lines on the quantities of 7.11, and how many of them no vector reaches without a reason.

    A line has the bits of the largest magnitude in the vectors, and those of the bound.

    text: SPEC.md. extremes: as of_vectors returns them.
    """
    table = re.search(r"^### 7\.11 .*?(?=^### )", text, re.MULTILINE | re.DOTALL)
    assert table is not None
    bounds = dict(re.findall(r"^\| (.+?) \| [\d.]+ \| .+? \| 2\^(\d+) \|", table[0], re.MULTILINE))
    lines, unreached = [], 0
    for quantity, bound in bounds.items():
        if quantity not in extremes:
            lines.append(f"  no probe: {quantity}")
            continue
        least, greatest = extremes[quantity]
        own, bits = max(-least, greatest).bit_length(), int(bound)
        reason = "" if own >= min(bits - SLACK, NARROW + 1) else TOO_LARGE.get(quantity, "open")
        unreached += reason == "open"
        lines.append(f"  {own:2} of {bits} bits, {least} to {greatest}: {quantity}{reason and f' ({reason})'}")
    head = f"quantities of 7.11: {len(bounds)}, {len(extremes)} of them with a probe, {unreached} open"
    return [head, *lines], unreached


def main(jobs: int | None = None) -> int:
    """Prints the report. Returns 1 if there is a hole, else 0."""
    manifest, text = load(), SPEC.read_text(encoding="utf-8")
    reaching, extremes = of_vectors(manifest, jobs or os.cpu_count() or 1)
    reports = [report(_probed().sites, reaching), extremes_of(text, extremes), elements.report(text, manifest)]
    reports.append(neighbours.report(manifest))
    print("\n".join(line for lines, _ in reports for line in lines))
    return 1 if any(holes for _, holes in reports) else 0
