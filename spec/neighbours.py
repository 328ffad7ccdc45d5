"""Which neighbouring checks of SPEC.md's blocks a vector has both faults of: a part of `python -m spec --coverage`.

Neighbours are checks that the second decoder makes one after the other, in any file that it accepts. A decoder that
swaps them gives another error if a file has both faults. The second decoder decodes each refused vector, and goes on at
a check that fails: the first such check and each later one are a pair.
"""

import ast
import json
import multiprocessing
import re
import resource
import signal
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import FrameType

from conformance.manifest import VECTORS, Accepted, Manifest, Rejected
from conformance.spec_decoder import program, verdict
from conformance.spec_decoder.program import SPEC

# A check: the name of its function, its error, and the offset as text. Checks with the same ones are one here.
Check = tuple[str, str, str]
# Pairs of neighbours in their order, and a vector for pairs of checks that it has both faults of.
Pairs = tuple[dict[tuple[Check, Check], None], dict[tuple[Check, Check], str]]
# Seconds of processor time and bytes of memory for a file, which may state any size behind its first fault.
SECONDS, BYTES = 1.0, 2 << 30
# The largest accepted vectors that show neighbours, in bytes.
LARGEST = 4096
# Neighbours of which no vector shows both faults, with the reason: a pattern of both errors with their offsets.
ARGUED: dict[str, str] = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))


class _Checks(ast.NodeTransformer):
    """Gives each check a number. The decoder notes each with the offset of its error, if it fails, and goes on."""

    def __init__(self) -> None:
        self.checks: list[Check] = []
        self._function = ""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        outer, self._function = self._function, node.name
        self.generic_visit(node)
        self._function = outer
        return node

    def _note(self, error: str, offset: str, condition: ast.expr, passing: ast.expr, failing: ast.expr) -> ast.Expr:
        self.checks.append((self._function, error, offset))
        number, fails = ast.Constant(len(self.checks) - 1), ast.IfExp(condition, passing, failing)
        return ast.Expr(ast.Call(ast.Name("_note", ast.Load()), [number, fails], []))

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        match node.value:
            case ast.Call(ast.Name("REQUIRE"), [condition, ast.Constant(str(error)), at]):
                return self._note(error, ast.unparse(at), condition, ast.Constant(None), at)
        return self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST:
        match node.body:
            case [ast.Return(ast.Constant(str(error)))] | [ast.Assign(_, ast.Constant(str(error)))] if "." in error:
                return self._note(error, "", node.test, ast.Constant(0), ast.Constant(None))
        return self.generic_visit(node)


def _stop(number: int, frame: FrameType | None) -> None:
    raise TimeoutError


def pairs(manifest: Manifest) -> Pairs:
    """Returns the pairs of neighbours, and the vectors. A process of its own does it, whose limits end with it."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(_pairs, manifest).result()


def _pairs(manifest: Manifest) -> Pairs:
    made, noted = _Checks(), list[tuple[Check, int | None]]()
    tree = ast.fix_missing_locations(made.visit(ast.parse(program.source(SPEC.read_text(encoding="utf-8")))))
    space = program.names(compile(tree, str(SPEC), "exec"), _note=lambda n, at: noted.append((made.checks[n], at)))
    signal.signal(signal.SIGPROF, _stop)
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    neighbours, found = dict[tuple[Check, Check], None](), dict[tuple[Check, Check], str]()
    for vector in manifest.vectors:
        accepted = isinstance(vector.expectation, Accepted)
        if not isinstance(vector.expectation, Rejected) and not (accepted and vector.input.size <= LARGEST):
            continue
        noted.clear()
        data = (VECTORS / vector.input.path).read_bytes()
        # The timer may end between any two steps: also those that stop it are inside.
        with suppress(Exception):
            try:
                signal.setitimer(signal.ITIMER_PROF, 0 if accepted else SECONDS)
                verdict(space, data)
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
        if accepted:
            neighbours |= dict.fromkeys(pairwise(check for check, _ in noted))
        fails = [each for each in noted if each[1] is not None]
        for later in fails[1:]:
            if later != fails[0]:
                found.setdefault((fails[0][0], later[0]), vector.id)
    return neighbours, found


def report(manifest: Manifest) -> tuple[list[str], int]:
    """Returns lines on neighbours, each with the vector that has both faults or the reason, and how many have none."""
    neighbours, found = pairs(manifest)
    lines, unmet = [], 0
    for one, other in neighbours:
        # Only of the end of the file, the function tells whether it is that of a section or of a chunk.
        chunk = "DECODE_CHUNK " if other[:2] == ("DECODE_CHUNK", "section.truncated") else ""
        text = f"{' '.join(one[1:])} / {chunk}{' '.join(other[1:])}"
        reason = next((reason for pattern, reason in ARGUED.items() if re.fullmatch(pattern, text)), "open")
        unmet += (one, other) not in found and reason == "open"
        lines.append(f"  {text}: {found.get((one, other), reason)}")
    missing = sum(pair not in found for pair in neighbours) - unmet
    return [f"neighbouring checks: {len(neighbours)}, {missing} argued, {unmet} open", *lines], unmet
