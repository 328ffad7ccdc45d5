"""Proofs of SPEC.md's integer arithmetic for all inputs, with the SMT solver z3: `python -m spec --proofs`.

The blocks themselves run, on integers that are terms of z3 with an interval. At a comparison that both outcomes can
have, the run divides into two paths. On each path the integers of 7.11 are compared with their bounds, and the amounts
of shifts with the widths of their types. A function that one proof has bounded is replaced by that bound in the next
one. Thus a change of a block, a constant or a bound in SPEC.md changes the proofs.
"""

from __future__ import annotations

import ast
import builtins
import math
import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from typing import Any

import z3

from conformance.spec_decoder import blocks

from .coverage import IMAGES, QUANTITIES
from .decoder import SPEC, TAIL, module

# Where else the quantities of 7.11 are computed.
SITES = QUANTITIES | {
    ("DERIVE_ROW", "worst"): "sum of the second rule, if the first one holds",
    ("group", "hyper[n][total + c] + ds"): "mean, scale index",
    ("DECODE_CHUNK", "16 + sum([PAD4(x) for x in lengths])"): QUANTITIES[
        "PARSE_PLANES", "20 + sum([PAD4(n) for n in lengths])"
    ],
}
# RSHIFT_ROUND adds the rounding term, which a bound of 7.11 includes.
ROUNDED = ("RSHIFT_ROUND", "a + (1 << s >> 1)")
SCALED = "ROUND_SCALED(x, e) of a weight or bias x, if x * 2^e is below ACCUMULATOR_BOUND in magnitude"
MORTON = "number of a cell along the Morton curve"
# The widest type of 7.11, for shifts of other integers.
WIDTH = 64
# Functions whose shifts have no type, with the reason.
UNTYPED = {
    "I": "reads a field of at most 8 bytes; a decoder reads it as its type",
    "ADD_F32": "7.11: wider than any type; a decoder uses the binary32 addition",
    "ROUND_SCALED": "7.11: by up to 149 places to the right, which gives 0; left shifts are beyond the limits",
}
# Of a query, in units of z3, so that the result does not depend on the machine.
EFFORT = 20_000_000


# Where a proof by induction starts elsewhere than a block.
STARTS = {
    "    r = 0\n    for bit in": "    r = _start\n    for bit in",
    "    nodes, whole = [(0, 0, 0)], True": "    nodes, whole = _start or [(0, 0, 0)], True",
}


class Dead(Exception):
    """No input takes this path, or the file is refused on it."""


class Failed(Exception):
    """A proof fails."""


@dataclass
class Row:
    """A row of 7.11. bound: of the magnitude."""

    name: str
    bound: int
    below: int
    signed: bool
    bits: int


class Num:
    """An integer: a term of z3, within an interval. zeros: so many lowest bits are 0."""

    def __init__(self, term: Any, low: int, high: int, zeros: int = 0) -> None:
        self.term, self.low, self.high, self.zeros = term, low, high, zeros
        self.row: Row | None = None
        self.magnitude: Any = None
        self.factors, self.tight = 1, False

    def __add__(self, other: Any) -> Any:
        if isinstance(other, list):
            return NotImplemented
        low, high = ends(other)
        return number(self.term + raw(other), self.low + low, self.high + high, min(self.zeros, twos(other)))

    def __sub__(self, other: Any) -> Any:
        low, high = ends(other)
        return number(self.term - raw(other), self.low - high, self.high - low, min(self.zeros, twos(other)))

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __neg__(self) -> Any:
        return number(-self.term, -self.high, -self.low, self.zeros)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Num):
            return times(self, other)
        corners = self.low * other, self.high * other
        return number(self.term * other, min(corners), max(corners), self.zeros + twos(other)) if other else 0

    __radd__, __rmul__ = __add__, __mul__

    def __lshift__(self, amount: int) -> Any:
        return self * (1 << amount)

    def __rshift__(self, amount: int) -> Any:
        return self // (1 << amount)

    def __floordiv__(self, other: Any) -> Any:
        return quotient(self, other)

    def __mod__(self, other: Any) -> Any:
        if isinstance(other, Num):
            return self - self // other * other
        first = self.low // other
        if first == self.high // other:
            return self - first * other
        return number(self.term % other, 0, other - 1)

    def __and__(self, mask: int) -> Any:
        return self % (mask + 1) if mask & (mask + 1) == 0 else fresh(0, mask, "masked")

    def __or__(self, other: Any) -> Any:
        for a, b in ((self, other), (other, self)):
            if Path.now.holds(b >= 0) and Path.now.holds(b < 1 << min(twos(a), 99)):
                return a + b
        raise Failed(f"{self.term} | {raw(other)}: both may have the same bit")

    __ror__ = __or__

    def __lt__(self, other: Any) -> Any:
        return below(self, other, 1)

    def __le__(self, other: Any) -> Any:
        return below(self, other, 0)

    def __gt__(self, other: Any) -> Any:
        return below(other, self, 1)

    def __ge__(self, other: Any) -> Any:
        return below(other, self, 0)

    def __eq__(self, other: Any) -> Any:
        if other is None:
            return False
        low, high = ends(other)
        if self.high < low or high < self.low:
            return False
        return Truth(self.term == raw(other), ((self, low, high),), ())

    def __ne__(self, other: Any) -> Any:
        same = self == other
        return ~same if isinstance(same, Truth) else not same

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        if self.low <= 0 <= self.high:
            off = ((self, self.low + (self.low == 0), self.high - (self.high == 0)),)
            return bool(Truth(self.term != 0, off, ((self, 0, 0),)))
        return True


@dataclass(eq=False)
class Truth:
    """A condition. true, false: (integer, low, high) for integers whose intervals that outcome narrows."""

    term: Any
    true: tuple[tuple[Any, int, int], ...]
    false: tuple[tuple[Any, int, int], ...]

    def __invert__(self) -> Truth:
        return Truth(z3.Not(self.term), self.false, self.true)

    def __bool__(self) -> bool:
        return Path.now.decide(self)

    def __eq__(self, other: Any) -> Any:
        return Truth(self.term == (other.term if isinstance(other, Truth) else bool(other)), (), ())


def raw(x: Any) -> Any:
    return x.term if isinstance(x, Num) else x


def ends(x: Any) -> tuple[int, int]:
    return (x.low, x.high) if isinstance(x, Num) else (x, x)


def twos(x: Any) -> int:
    return x.zeros if isinstance(x, Num) else (x & -x).bit_length() - 1 if x else 99


def number(term: Any, low: int, high: int, zeros: int = 0) -> Any:
    _, low, high = Path.now.known.get(term.get_id(), (term, low, high))
    return low if low == high else Num(term, low, high, zeros)


def fresh(low: int, high: int, name: str = "x") -> Any:
    """Returns any integer from low to high."""
    if low == high:
        return low
    found = Num(z3.FreshInt(name), low, high)
    found.tight = name not in ("extreme", "shifted")
    Path.now.assume(z3.And(found.term >= low, found.term <= high))
    return found


def below(a: Any, b: Any, strict: int) -> Any:
    """a < b, or a <= b if strict is 0."""
    (a0, a1), (b0, b1) = ends(a), ends(b)
    if a1 <= b0 - strict:
        return True
    if a0 > b1 - strict:
        return False
    true = (a, a0, min(a1, b1 - strict)), (b, max(b0, a0 + strict), b1)
    false = (a, max(a0, b0 + 1 - strict), a1), (b, b0, min(b1, a1 - 1 + strict))
    return Truth(raw(a) < raw(b) if strict else raw(a) <= raw(b), true, false)


PRODUCT = z3.Function("product", z3.IntSort(), z3.IntSort(), z3.IntSort())


def times(a: Num, b: Num) -> Any:
    """A product of two integers. z3 knows only that it depends on both, and linear bounds of it that always hold."""
    path = Path.now
    if path.powers is not None:
        # Both are affine in one number, whose square is another.
        k, square = path.powers
        (c, d), (e, f) = [[z3.simplify(z3.substitute(x.term, (k, z3.IntVal(v)))).as_long() for v in (0, 1)] for x in (a, b)]
        corners = [x * y for x in ends(a) for y in ends(b)]
        return Num(c * e + (c * (f - e) + (d - c) * e) * k + (d - c) * (f - e) * square, min(corners), max(corners))
    if path.tight and a.factors + b.factors > 2:
        if a.high - a.low < b.high - b.low:
            a, b = b, a
        return a * path.value(b)
    if path.tight:
        path.tighten(a)
        path.tighten(b)
    corners = [x * y for x in ends(a) for y in ends(b)]
    low, high = (min(corners), max(corners)) if a is not b else (0 if a.low <= 0 <= a.high else min(corners), max(corners))
    p = z3.simplify(PRODUCT(a.term, b.term) if a.term.get_id() <= b.term.get_id() else PRODUCT(b.term, a.term))
    path.assume(z3.And(p >= low, p <= high))
    for x, y in ((a, b), (b, a)):
        path.assume(z3.Or(x.term < 0, z3.And(p >= y.low * x.term, p <= y.high * x.term)))
        path.assume(z3.Or(x.term > 0, z3.And(p <= y.low * x.term, p >= y.high * x.term)))
        if x.magnitude is not None:
            most = max(-y.low, y.high)
            path.assume(z3.And(p <= most * raw(x.magnitude), p >= -most * raw(x.magnitude)))
    for i, j in product(ends(a), ends(b)):
        rest = p - i * b.term - j * a.term + i * j
        path.assume(rest >= 0 if (i == a.low) == (j == b.low) else rest <= 0)
    found = Num(p, low, high)
    found.factors = 2
    if a is b:
        path.squares.append((a, found))
    return found


def quotient(a: Any, b: Any) -> Any:
    """a // b for positive b. a // b < c holds exactly if a < c * b: powers of two c narrow the interval."""
    path = Path.now
    low_b, high_b = ends(b)
    if low_b <= 0:
        path.oblige(b > 0, "a divisor is not positive")
        low_b = 1
    corners = [x // y for x in ends(a) for y in (low_b, high_b)]
    low, high = min(corners), max(corners)
    if isinstance(b, int):
        return number(raw(a) / b, low, high)
    key = a.term.get_id(), b.term.get_id()
    if key in path.quotients:
        return path.quotients[key]
    while high > 0 and path.holds(below(a, b * (1 << (high.bit_length() - 1)), 1)):
        high = (1 << (high.bit_length() - 1)) - 1
    while low < 0 and path.holds(below(b * -(1 << ((-low - 1).bit_length() - 1)) if low < -1 else 0, a, 0)):
        low = -(1 << ((-low - 1).bit_length() - 1)) if low < -1 else 0
    while low >= 0 and 1 << low.bit_length() <= high and path.holds(below(b * (1 << low.bit_length()), a, 0)):
        low = 1 << low.bit_length()
    q = fresh(low, high, "quotient")
    if isinstance(q, Num):
        back = q * b
        path.assume(z3.And(raw(back) <= raw(a), raw(a) < raw(back) + raw(b)))
    path.quotients[key] = q
    return q


def extreme(sign: int, *given: Any) -> Any:
    """max of integers, or min if sign is -1."""
    items = list(given[0]) if len(given) == 1 else list(given)
    if not any(isinstance(x, Num) for x in items):
        return (max if sign > 0 else min)(items)
    spans = [ends(x) if sign > 0 else (-ends(x)[1], -ends(x)[0]) for x in items]
    low, high = max(s[0] for s in spans), max(s[1] for s in spans)
    left = [x for x, s in zip(items, spans, strict=True) if s[1] > low] or [
        x for x, s in zip(items, spans, strict=True) if s[1] == low
    ]
    if all((ends(x)[0] if sign > 0 else -ends(x)[1]) < low for x in left):
        left.append(sign * low)
    if len(left) == 1:
        return left[0]
    found = fresh(*((low, high) if sign > 0 else (-high, -low)), "extreme")
    for x in left:
        Path.now.assume(raw(found) >= raw(x) if sign > 0 else raw(found) <= raw(x))
    Path.now.assume(z3.Or([raw(found) == raw(x) for x in left]))
    return found


def magnitude(x: Any) -> Any:
    """abs of an integer."""
    low, high = ends(x)
    if low >= 0 or high <= 0:
        return x if low >= 0 else -x
    if x.magnitude is None:
        x.magnitude = extreme(1, x, -x)
        x.magnitude.low = 0
    return x.magnitude


class Path:
    """A path through a block. taken: the outcomes where it divides."""

    now: Path

    def __init__(self, proof: Proof, taken: list[Any]) -> None:
        self.proof, self.taken, self.at = proof, taken, 0
        self.others: list[list[Any]] = []
        self.squares: list[tuple[Num, Num]] = []
        self.tight, self.split, self.typed = False, WIDTH, True
        self.powers: Any = None
        self.solver = z3.Solver()
        self.solver.set("rlimit", EFFORT)
        # The terms whose values the path has chosen.
        self.known: dict[int, tuple[Any, int, int]] = {}
        self.shifted: dict[Any, Any] = {}
        self.quotients: dict[Any, Any] = {}
        self.asked: Any = ()
        self.model: Any = None

    def assume(self, term: Any) -> None:
        self.solver.add(term)

    def check(self, *terms: Any) -> Any:
        self.proof.queries += 1
        self.solver.push()
        self.solver.add(*terms)
        found = self.solver.check()
        self.model = self.solver.model() if found == z3.sat else None
        self.solver.pop()
        return found

    def holds(self, truth: Any) -> bool:
        """Whether a condition holds for all inputs of the path."""
        if isinstance(truth, bool):
            return truth
        # Paths that divide later ask the same first.
        self.asked = self.at, self.asked[1] + 1 if self.asked and self.asked[0] == self.at else 0
        key = *map(str, self.taken[: self.at]), self.asked[1]
        if key not in self.proof.answers:
            self.proof.answers[key] = self.check(z3.Not(truth.term)) == z3.unsat
        return self.proof.answers[key]

    def oblige(self, truth: Any, text: str) -> None:
        if not self.holds(truth):
            inputs = self.model or {}
            example = ", ".join(sorted(f"{d}={inputs[d]}" for d in inputs if "!" in str(d)))[:300] if inputs else ""
            raise Failed(f"{text}{example and ' with '}{example}")

    def must(self, truth: Any) -> None:
        """Assumes a condition: other inputs are refused."""
        if isinstance(truth, Truth):
            self.assume(truth.term)
            for x, low, high in truth.true:
                narrow(x, low, high)
        elif not truth:
            raise Dead

    def take(self, choices: Callable[[], list[Any]]) -> Any:
        """Returns the outcome at a division: one of choices(), which other paths take, too."""
        if self.at == len(self.taken):
            first, *rest = choices() or [None]
            self.others += [[*self.taken, x] for x in rest]
            self.taken.append(first)
            if first is None:
                raise Dead
        self.at += 1
        return self.taken[self.at - 1]

    def decide(self, truth: Truth) -> bool:
        both = {True: truth, False: ~truth}
        outcome = self.take(lambda: [x for x, own in both.items() if self.check(own.term) != z3.unsat])
        self.must(both[outcome])
        return outcome

    def value(self, x: Any) -> int:
        """Divides the path by the values of an integer."""
        if isinstance(x, int):
            return x

        def values() -> list[int]:
            found: list[int] = []
            while self.check(*[x.term != v for v in found]) == z3.sat:
                found.append(self.model.eval(x.term, model_completion=True).as_long())
            return found

        outcome = self.take(values)
        self.assume(x.term == outcome)
        self.known[x.term.get_id()] = x.term, outcome, outcome
        narrow(x, outcome, outcome)
        return outcome

    def tighten(self, x: Num) -> None:
        """Narrows an interval to the least powers of two that hold."""
        if x.tight:
            return
        x.tight = True
        while x.low < 0 and self.holds(x >= -(half := -x.low // 2)):
            x.low = -half
        while x.high > 0 and self.holds(x <= (half := 1 << (x.high - 1).bit_length() - 1 if x.high > 1 else 0)):
            x.high = half


def narrow(x: Any, low: int, high: int) -> None:
    if isinstance(x, Num):
        x.low, x.high = max(x.low, low), min(x.high, high)
        if x.low > x.high:
            raise Dead


class Marks(ast.NodeTransformer):
    """Wraps the quantities of 7.11 and the shifts of the blocks. shifts: (function, text, constant amount or None)."""

    def __init__(self, constants: dict[str, int]) -> None:
        self.constants = constants
        self.functions: list[str] = []
        self.shifts: list[tuple[str, str, int | None]] = []

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self.functions.append(node.name)
        self.generic_visit(node)
        self.functions.pop()
        return node

    def visit(self, node: ast.AST) -> Any:
        found = super().visit(node)
        if not self.functions or not isinstance(node, ast.expr) or self.functions[0] in IMAGES:
            return found
        key = self.functions[-1], self.texts.get(id(node), "")
        if key in SITES or key == ROUNDED:
            name = ast.Constant(SITES.get(key, ""))
            more = [ast.Name("a", ast.Load())] if key == ROUNDED else []
            return ast.Call(ast.Name("_quantity", ast.Load()), [name, found, *more], [])
        return found

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        left, text = isinstance(node.op, ast.LShift), self.texts[id(node)]
        amount = ast.unparse(node.right)
        self.generic_visit(node)
        if not isinstance(node.op, (ast.LShift, ast.RShift)) or not self.functions or self.functions[0] in IMAGES:
            return node
        try:
            known = eval(amount, {"__builtins__": {}}, self.constants)
        except NameError:
            known = None
        self.shifts.append((self.functions[-1], text, known))
        values = [ast.Constant(len(self.shifts) - 1), node.left, node.right, ast.Constant(left)]
        return ast.Call(ast.Name("_shift", ast.Load()), values, [])

    def marked(self, source: str) -> Any:
        tree = ast.parse(source)
        loads = (n for n in ast.walk(tree) if isinstance(getattr(n, "ctx", ast.Load()), ast.Load))
        self.texts = {id(node): ast.unparse(node) for node in loads if isinstance(node, (ast.BinOp, ast.Call, ast.Name))}
        return compile(ast.fix_missing_locations(self.visit(tree)), "SPEC.md", "exec")


@dataclass
class Specification:
    """What the proofs need of SPEC.md."""

    text: str
    code: Any
    shifts: list[tuple[str, str, int | None]]
    rows: dict[str, Row]


@cache
def specification(text: str) -> Specification:
    """Returns the marked blocks and the rows of 7.11. text: SPEC.md."""
    source = module(text).removesuffix(TAIL)
    for old, new in STARTS.items():
        if source.count(old) != 1:
            raise Failed(f"the blocks have changed: {old}")
        source = source.replace(old, new)
    constants = {name: eval(value) for name, value in re.findall(r"^([A-Z][A-Z0-9_]+) = ([-+*() 0-9]+)$", source, re.M)}
    marks = Marks(constants)
    clause = text.partition("\n### 7.11 ")[2].partition("\n### ")[0]
    rows = {}
    for name, bound, power, sign, bits in re.findall(
        r"^\| (.+?) \| [\d.]+ \| (.+?) \| 2\^(\d+) \| ([iu])(\d+) \|$", clause, re.MULTILINE
    ):
        value = eval(bound.replace("^", "**"), {"__builtins__": {}}, constants | {"a": 1 << 40})
        rows[name] = Row(name, value, 1 << int(power), sign == "i", int(bits))
    return Specification(text, marks.marked(source), marks.shifts, rows)


class Proof:
    """A proof: what runs on each path, and what was found."""

    def __init__(self, name: str, body: Callable[[Proof, dict[str, Any]], None], text: str) -> None:
        self.name, self.body, self.spec = name, body, specification(text)
        self.paths = self.queries = 0
        self.reached: set[str] = set()
        # The ends of integers that other proofs need, by name, and how often a sum has a term, by quantity.
        self.limits: dict[str, tuple[int, int]] = {}
        self.repeated: dict[str, int] = {}
        self.answers: dict[Any, bool] = {}
        self.shifted: set[int] = set()
        self.note = ""

    def quantity(self, name: str, x: Any, summand: Any = None) -> Any:
        """Compares an integer with its row of 7.11. Without a name, with that of a summand without the rounding term."""
        row = self.spec.rows[name] if name else getattr(summand, "row", None)
        if row is None:
            return x
        path = Path.now
        x = x * self.repeated.get(name, 1)
        path.oblige(x <= row.bound, f"{row.name}: above {row.bound}")
        path.oblige(x >= (-row.bound if row.signed else 0), f"{row.name}: below its least value")
        capacity = row.bits - row.signed
        path.oblige(row.bound < row.below <= 1 << capacity, f"{row.name}: the type does not hold the bound")
        if row.name not in self.reached and path.check() == z3.sat:
            self.reached.add(row.name)
        if isinstance(x, Num):
            x.row = row
        return x

    def limit(self, name: str, x: Any) -> None:
        """Widens the ends of an integer by those that it has on this path."""
        low, high = self.limits.get(name, ends(x))
        self.limits[name] = min(low, ends(x)[0]), max(high, ends(x)[1])

    def shift(self, site: int, a: Any, b: Any, left: bool) -> Any:
        """a << b or a >> b, with b within the width of a's type."""
        path = Path.now
        text = " ".join(self.spec.shifts[site][:2])
        if path.typed and self.spec.shifts[site][0] not in UNTYPED:
            row = a.row if isinstance(a, Num) else None
            path.oblige(b >= 0, f"{text}: a negative amount")
            path.oblige(b < (row.bits if row else WIDTH), f"{text}: the width of the type, or more")
            self.shifted.add(site)
        if isinstance(b, Num):
            narrow(b, 0, b.high)
            if b.high - b.low < path.split:
                b = path.value(b)
        if isinstance(b, Num):
            corners = [x << y if left else x >> y for x in ends(a) for y in ends(b)]
            key = raw(a) if isinstance(a, int) else a.term.get_id(), b.term.get_id(), left
            if key not in path.shifted:
                path.shifted[key] = x = fresh(min(corners), max(corners), "shifted")
                if not left:
                    path.assume(z3.If(raw(a) < 0, z3.And(raw(a) <= raw(x), raw(x) < 0), z3.And(0 <= raw(x), raw(x) <= raw(a))))
            return path.shifted[key]
        return a * (1 << b) if left else (quotient(a, 1 << b) if isinstance(a, Num) else a >> b)

    def run(self) -> None:
        """Runs all paths. Raises Failed if an integer can exceed its bound."""
        space: dict[str, Any] = {"__name__": blocks.__name__, "__package__": blocks.__package__}
        space |= {"_quantity": lambda name, x, *_: x, "_shift": lambda _, a, b, left: a << b if left else a >> b}
        space["_start"] = 0
        exec(self.spec.code, space)
        space |= {"_quantity": self.quantity, "_shift": self.shift, "abs": magnitude, "len": length}
        space |= {"max": lambda *x: extreme(1, *x), "min": lambda *x: extreme(-1, *x)}
        space |= {"REQUIRE": lambda truth, *_: Path.now.must(truth), "REFUSE": refuse}
        left: list[list[Any]] = [[]]
        own = dict(space)
        while left:
            Path.now = path = Path(self, left.pop())
            self.paths += 1
            space.update(own)
            try:
                self.body(self, space)
            except Dead:
                pass
            left += path.others


def refuse(*_: Any) -> None:
    raise Dead


def length(x: Any) -> Any:
    return x.size if hasattr(x, "size") else builtins.len(x)


@dataclass
class Many:
    """A list of any size, whose items are what `item` returns. One of them stands for all."""

    size: Any
    item: Callable[[], Any]
    kept: dict[Any, Any] = field(default_factory=dict)

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            return [self[i] for i in range(at.start, at.stop)] if isinstance(at.stop, int) else self
        key = at if isinstance(at, int) else at.term.get_id()
        if key not in self.kept:
            self.kept[key] = self.item()
        return self.kept[key]

    def __iter__(self) -> Iterator[Any]:
        yield self.item()


def fields(space: dict[str, Any]) -> Many:
    """Makes U and I return any integers of their size, the same at the same place, and returns data."""
    data = Many(1 << 62, lambda: fresh(0, 255, "byte"))
    kept: dict[Any, Any] = {}

    def read(at: Any, size: int, low: int, high: int) -> Any:
        key = size, at if isinstance(at, int) else at.term.get_id()
        if key not in kept:
            kept[key] = fresh(low, high, "field")
        return kept[key]

    space["U"] = lambda _, at, size: read(at, size, 0, (1 << 8 * size) - 1)
    space["I"] = lambda _, at, size: read(at, size, -1 << 8 * size - 1, (1 << 8 * size - 1) - 1)
    return data


def within(proof: Proof, name: str) -> Any:
    """Returns any integer within the bound of a row."""
    row = proof.spec.rows[name]
    return fresh(-row.bound if row.signed else 0, row.bound)


BODIES: dict[str, Callable[[Proof, dict[str, Any]], None]] = {}


def proves(name: str) -> Callable[[Callable[[Proof, dict[str, Any]], None]], Any]:
    def keep(body: Callable[[Proof, dict[str, Any]], None]) -> Any:
        BODIES[name] = body
        return body

    return keep


# ---- lemmas


@proves("U, I: integers of their size")
def _fields(_: Proof, b: dict[str, Any]) -> None:
    size = Path.now.take(lambda: [1, 2, 4, 8])
    data = Many(8, lambda: fresh(0, 255, "byte"))
    unsigned, signed, half = b["U"](data, 0, size), b["I"](data, 0, size), 1 << 8 * size - 1
    Path.now.oblige(unsigned >= 0, "U")
    Path.now.oblige(unsigned < 2 * half, "U")
    Path.now.oblige(signed >= -half, "I")
    Path.now.oblige(signed < half, "I")


def bit_length(a: Any) -> int:
    """BIT_LENGTH, as its proof shows."""
    low, high = ends(a)
    return next(n for n in range(low.bit_length(), high.bit_length() + 1) if n == high.bit_length() or a < 1 << n)


@proves("BIT_LENGTH: the least n with a < 2^n")
def _bit_length(_: Proof, b: dict[str, Any]) -> None:
    a = fresh(0, (1 << WIDTH - 1) - 1, "a")
    n = b["BIT_LENGTH"](a)
    Path.now.oblige(a < 1 << n, "not below 2^n")
    Path.now.oblige(n == 0 or a >= 1 << n - 1, "below 2^(n - 1)")


@proves("ISQRT: r^2 <= a < (r + 1)^2, by induction over its bits")
def _isqrt(proof: Proof, b: dict[str, Any]) -> None:
    """Before bit i, r is a multiple of 2^(i + 1) and r^2 <= a < (r + 2^(i + 1))^2."""
    path, loop = Path.now, []
    k = fresh(0, 1 << WIDTH // 2, "k")
    path.powers = k.term, z3.FreshInt("square")
    a = fresh(0, (1 << WIDTH - 1) - 1, "a")
    if path.take(lambda: ["start", "step"]) == "start":
        b["range"] = lambda *given: loop.extend(given) or []
        b["BIT_LENGTH"] = bit_length
        path.oblige(b["ISQRT"](a) == 0 and loop[1:] == [-1, -1], "the loop does not go from 0 over all bits")
        path.oblige(a < 1 << 2 * (loop[0] + 1), "the first bit is too low")
        return
    bit = path.take(lambda: list(range(WIDTH // 2)))
    r = k * (2 << bit)
    path.must(r * r <= a)
    path.must(a < (r + (2 << bit)) * (r + (2 << bit)))
    b["_start"], b["range"], b["BIT_LENGTH"] = r, lambda *_: [bit], lambda _: 0
    r = b["ISQRT"](a)
    path.oblige(r * r <= a, "r^2 is above a")
    path.oblige(a < (r + (1 << bit)) * (r + (1 << bit)), "(r + 2^bit)^2 is not above a")
    path.oblige(r % (1 << bit) == 0, "r is not a multiple of 2^bit")


@proves("x^2 <= q < (n + 1)^2: |x| <= n")
def _root(_: Proof, __: dict[str, Any]) -> None:
    path = Path.now
    x, n, q = z3.Ints("x n q")
    path.assume(z3.And(n >= 0, x * x <= q, q < (n + 1) * (n + 1)))
    path.oblige(Truth(z3.And(x <= n, x >= -n), (), ()), "|x| is above n")


def isqrt(a: Any) -> Any:
    """ISQRT, as its proof shows. No x with x^2 in a sum of squares is above it."""
    path = Path.now
    low, high = ends(a)
    n = fresh(math.isqrt(low), math.isqrt(high), "root")
    for x, square in path.squares:
        if path.holds(square <= a):
            path.must(x <= n)
            path.must(x >= -n)
    return n


# ---- 7.2, and the binary32 arithmetic of its sums


@proves("ROUND_SCALED: 7.2")
def _round_scaled(proof: Proof, b: dict[str, Any]) -> None:
    """Of x = m * 2^own, for each own + e."""
    path = Path.now
    path.typed, path.split = False, 1 << 10
    m, e = fresh(-(1 << 24) + 1, (1 << 24) - 1, "m"), fresh(0, b["EXPONENT_MAX"], "e")
    own = fresh(-149, 104, "own")
    b["SIGNIFICAND"] = lambda _: (m, own)
    k = path.value(own + e)
    path.must(magnitude(m) * (1 << max(k, 0)) < b["ACCUMULATOR_BOUND"] * (1 << max(-k, 0)))
    proof.quantity(SCALED, b["ROUND_SCALED"](None, e))


@proves("SIGNIFICAND: |m| < 2^24, -149 <= e <= 104")
def _significand(_: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    bits = fresh(0, (1 << 32) - 1, "bits")
    path.must(b["IS_FINITE"](bits))
    m, e = b["SIGNIFICAND"](bits)
    for truth in (magnitude(m) < 1 << 24, e >= -149, e <= 104):
        path.oblige(truth, "SIGNIFICAND")


def significand(_: Any) -> Any:
    """SIGNIFICAND, as its proof shows."""
    return fresh(-(1 << 24) + 1, (1 << 24) - 1, "m"), fresh(-149, 104, "e")


# No layer of an integer network has more inputs, and none has more rows, as the proof of SHAPES shows.
INPUTS, ROWS = 128, 768


@proves("DERIVE_ROW, NETWORK: sums of a row, in any order, and its output")
def _network(proof: Proof, b: dict[str, Any]) -> None:
    """A partial sum is that of inputs some of which are 0, with or without the bias and the rounding term."""
    path, row = Path.now, proof.spec.rows["accumulator of a row"]
    exact = {"SIGNIFICAND": lambda _: None, "ROUND_SCALED": lambda *_: within(proof, SCALED)}
    b.update(exact)
    path.split = 0
    exponent = fresh(0, b["EXPONENT_MAX"], "e")
    b["range"] = lambda *_: [exponent]
    found = b["DERIVE_ROW"]([0] * INPUTS, 0)
    if found is None:
        raise Dead
    w, bias, e = found
    inputs = [fresh(-b["ACTIVATION_MAX"], b["ACTIVATION_MAX"], "a") for _ in w]
    out = b["NETWORK"]([[found]], inputs)[0]
    site = next(n for n, own in enumerate(proof.spec.shifts) if own[0] == "DERIVE_ROW")
    path.oblige(magnitude(out) <= row.bound, "an output")
    products = sum([x * a for x, a in zip(w, inputs, strict=True)])
    half = quotient(proof.shift(site, 1, e, True), 2)
    for partial in (products, products + bias, products + half, products + bias + half):
        path.oblige(partial <= row.bound, "a partial sum")
        path.oblige(partial >= -row.bound, "a partial sum")
    path.oblige(row.bound < 1 << 24, "binary32 does not represent each sum")


@proves("binary32: represents each integer up to 2^24, thus each sum and product of 7.2")
def _binary32(_: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    n = fresh(-(1 << 24), 1 << 24, "n")
    b["BIT_LENGTH"] = bit_length
    bits = b["ROUND_F32"](n, 0)
    m, e = b["SIGNIFICAND"](bits)
    path.oblige(m * (1 << path.value(e + 149)) == n * (1 << 149), "another number")


# ---- 7.4 to 7.9


@proves("POSITION_INTEGER: P of each finite f16")
def _position(_: Proof, b: dict[str, Any]) -> None:
    bits = fresh(0, (1 << 16) - 1, "bits")
    Path.now.must((bits >> 10) & 31 != 31)
    b |= {"FRAME_COORDINATES": lambda *_: refuse()}
    b["CONTEXT"]({}, [], 0, 0, [bits])


@proves("PARSE_FRAME, FRAME_COORDINATES: 7.5.1")
def _frame(proof: Proof, b: dict[str, Any]) -> None:
    Path.now.split = 0
    frame = b["PARSE_FRAME"](fields(b), 0)
    for v in b["FRAME_COORDINATES"](frame, [within(proof, "P") for _ in range(3)]):
        proof.quantity("v", v)


@proves("CONTRACT: 7.5.2")
def _contract(proof: Proof, b: dict[str, Any]) -> None:
    b["ISQRT"] = isqrt
    v = [within(proof, "v") for _ in range(3)]
    found = b["CONTRACT"](v)
    q = sum([x * x for x in v])
    Path.now.tighten(q)
    isqrt(q)
    for w in found:
        proof.quantity("w", w)


@proves("PARSE_FRAME, RESCALE: 7.5.3")
def _rescale(proof: Proof, b: dict[str, Any]) -> None:
    frame = b["PARSE_FRAME"](fields(b), 0)
    for u in b["RESCALE"](frame, [within(proof, "w") for _ in range(3)]):
        Path.now.oblige(magnitude(u) <= 1 << b["UNIT_BITS"], "u")


@proves("QUERY: 7.5.4")
def _query(proof: Proof, b: dict[str, Any]) -> None:
    """The planes have B and 2 B points along a side."""
    path = Path.now
    path.tight, path.split = True, 0
    size = next(most for name, _, most in b["BOUNDS"][1] if name == "plane_size")
    symbol = b["PLANE_SYMBOL_MAX"]
    row = lambda: Many(0, lambda: fresh(-symbol, symbol, "symbol"))  # noqa: E731
    plane = Many(1, lambda: Many(side, lambda: row()))
    side = fresh(2, 2 * size, "side")
    u = [fresh(0, 1 << b["UNIT_BITS"], "u") for _ in range(2)]
    b["QUERY"](plane, u, fresh(0, b["PLANE_SHIFT_MAX"], "plane_shift"))


@proves("GAMMA: 7.5.5")
def _gamma(_: Proof, b: dict[str, Any]) -> None:
    most = next(most for name, _, most in b["BOUNDS"][1] if name == "frequency_count")
    b["SINE"] = Many(0, lambda: fresh(min(blocks.SINE), max(blocks.SINE)))
    for x in b["GAMMA"](fresh(0, 1 << b["UNIT_BITS"], "u"), most):
        Path.now.oblige(magnitude(x) <= b["ACTIVATION_MAX"], "an input of F_h")


@proves("DECODE_ATTRIBUTES: 7.9")
def _attributes(proof: Proof, b: dict[str, Any]) -> None:
    """One anchor with slices of one channel: others have sums of the same kinds."""
    output = lambda *_: Many(0, lambda: within(proof, "accumulator of a row"))  # noqa: E731

    def values(_: Any, __: Any, parameters: Any, limit: int) -> list[Any]:
        for mean, scale in parameters:
            proof.quantity("mean, scale index", mean)
            proof.quantity("mean, scale index", scale)
        return [fresh(-limit, limit, "symbol") for _ in parameters]

    b |= {"NETWORK": output, "DECODE_VALUES": values, "GAUSS": None, "CLAMP": lambda x, *_: x}
    Path.now.split = 0
    shift = fresh(0, b["CARM_SHIFT_MAX"], "carm_shift")
    networks = {"hyper": None, 1: None}
    out = b["NETWORK"]
    b["NETWORK"] = lambda *given: out(*given)
    b["DECODE_ATTRIBUTES"](None, networks, [shift], [1, 1], [None], [[1]])


# ---- 8: the entropy coder


@proves("READ_BITS: k bits, from any bit of a byte")
def _bits(_: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    k = path.take(lambda: list(range(max(b["RAW_MAX"], b["ESCAPE_PREFIX_MAX"]) + 1)))
    at = path.take(lambda: list(range(8)))
    stream = {"raw": Many(1 << 48, lambda: fresh(0, 255, "byte")), "raw_at": at}
    value = b["READ_BITS"](stream, k)
    path.oblige(value >= 0, "READ_BITS")
    path.oblige(value < 1 << k, "READ_BITS")
    path.oblige(stream["raw_at"] == at + k, "raw_at")


def read_bits(stream: dict[str, Any], k: Any) -> Any:
    """READ_BITS, as its proof shows."""
    k = Path.now.value(k)
    stream["raw_at"] += k
    return fresh(0, (1 << k) - 1, "raw")


@proves("READ_ESCAPE: 8.7")
def _escape(proof: Proof, b: dict[str, Any]) -> None:
    path, stream, radius = Path.now, {"raw_at": 0}, fresh(0, 255, "radius")
    b["READ_BITS"] = read_bits
    distance = b["READ_ESCAPE"](stream, radius)
    path.oblige(magnitude(distance) <= radius + proof.spec.rows["n of an escape"].bound, "the distance")
    path.oblige(stream["raw_at"] <= 2 * b["ESCAPE_PREFIX_MAX"] + 2, "the bits of an escape")


@proves("READ_BITS: raw bits of a substream")
def _raw(proof: Proof, b: dict[str, Any]) -> None:
    """Those present, and those read: a symbol counts as 16 units of work (13.1), and has raw bits and an escape."""
    size = fresh(0, b["SECTION_LENGTH_MAX"], "section")
    proof.quantity("raw bits of a substream", 8 * size)
    symbols = fresh(1, max(level["work"] for level in b["LEVELS"]) // 16, "symbols")
    read = symbols * (b["RAW_MAX"] + 2 * b["ESCAPE_PREFIX_MAX"] + 2)
    b["READ_BITS"]({"raw": Many(size, lambda: fresh(0, 255, "byte")), "raw_at": read - 1}, 1)


@proves("SELECT, DECODE_VALUES: 8.5")
def _values(proof: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    models = [m for f in (blocks.GAUSS, blocks.LAPLACE) for columns in f.values() for m in columns]
    radius = fresh(0, max(map(len, models)) // 2 - 1, "radius")
    index = fresh(0, 2 * radius.high + 1, "index")
    path.must(index <= 2 * radius + 1)

    def escape(*_: Any) -> Any:
        most = proof.spec.rows["n of an escape"].bound + radius
        distance = fresh(-most.high, most.high, "distance")
        path.must(magnitude(distance) <= most)
        return distance

    b |= {"READ_BITS": read_bits, "READ_ESCAPE": escape, "DECODE_GROUP": lambda *_: [index]}
    family = Many(0, lambda: Many(0, lambda: Many(2 * radius + 2, lambda: 0)))
    stream = {"raw_at": 0, "symbols": []}
    name = "mean, scale index"
    b["DECODE_VALUES"](stream, family, [(within(proof, name), within(proof, name))], b["WEIGHT_SYMBOL_MAX"])


def symbol(b: dict[str, Any], x: Any, word: Any, frequencies: list[Any]) -> tuple[int, Any, int]:
    """Returns what DECODE_SYMBOL finds: the symbol, the next state, and how many words it took."""
    stream = {"state": [x], "words": [word], "word_at": 0}
    found = b["DECODE_SYMBOL"](stream, 0, frequencies)
    return found, stream["state"][0], stream["word_at"]


def model(b: dict[str, Any], total: int) -> list[Any]:
    """A symbol with those before and behind it, each of which acts as one with the sum of their frequencies."""
    frequencies = [fresh(0, total, "frequency") for _ in range(3)]
    Path.now.must(sum(frequencies) == total)
    return frequencies


@proves("DECODE_SYMBOL: 8.2, and states from STATE_MIN to 2^32 - 1")
def _decode_symbol(_: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    x, word = fresh(b["STATE_MIN"], (1 << 32) - 1, "state"), fresh(0, 0xFFFF, "word")
    found, x, _words = symbol(b, x, word, model(b, 1 << b["PRECISION"]))
    path.oblige(x >= b["STATE_MIN"], "a state below STATE_MIN")
    path.oblige(x < 1 << 32, "a state of 2^32 or more")
    assert found in (0, 1, 2)


@proves("rANS: a step of the encoder, then one of the decoder (Annex B.4, 8.2)")
def _rans(proof: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    text = " ".join(proof.spec.text.partition("### B.4 ")[2].partition("### B.5 ")[0].split())
    steps = re.search(
        r"1\. If `([^`]+)` is at least f, put out the word x & (0x\w+), and shift x right by (\d+)\..*?"
        r"2\. Set x to `([^`]+)`\.", text)  # fmt: skip
    if steps is None:
        raise Failed("Annex B.4 does not have the two steps of the encoder")
    condition, mask, amount, step = steps.groups()
    start, names = fresh(b["STATE_MIN"], (1 << 32) - 1, "state"), {"PRECISION": b["PRECISION"]}
    frequencies = model(b, 1 << b["PRECISION"])
    low, f, _ = frequencies
    path.must(f >= 1)
    names |= {"x": start, "f": f, "low": low}
    word, words = fresh(0, 0xFFFF, "word"), 0
    if eval(condition, {}, names) >= f:
        word, words = start & int(mask, 0), 1
        names["x"] = start >> int(amount)
    x = eval(step, {}, names)
    path.oblige(x >= b["STATE_MIN"], "the encoder's state is below STATE_MIN")
    path.oblige(x < 1 << 32, "the encoder's state is 2^32 or more")
    found, back, taken = symbol(b, x, word, frequencies)
    path.oblige(found == 1, "another symbol")
    path.oblige(taken == words, "the decoder takes a word that the encoder has not put out, or leaves one")
    path.oblige(back == start, "another state")


# ---- 7.12, 7.13


@proves("CELL_NUMBER: 7.12")
def _cell(_: Proof, b: dict[str, Any]) -> None:
    b["BIT_LENGTH"] = bit_length
    b["CELL_NUMBER"](fresh(0, (1 << b["CELL_LEVELS"]) - 1, "c"), fresh(0, b["CELL_INDEX"], "cell_shift"))


@proves("DECODE_CELLS: coordinates below 2^CELL_LEVELS, by induction over the levels")
def _cells(proof: Proof, b: dict[str, Any]) -> None:
    """A level, all of whose children have an anchor: they are those of any node."""
    path, levels = Path.now, b["CELL_LEVELS"]
    done = path.take(lambda: list(range(levels)))
    b["_start"] = [tuple(fresh(0, (1 << done) - 1, "c") for _ in range(3))]
    b |= {"CELL_LEVELS": 1, "DECODE_GROUP": lambda _, models: [15 for _ in models]}
    children, _ = b["DECODE_CELLS"]({"symbols": []}, [None] * b["POSITION_MODELS"], 99)
    for c in (c for child in children for c in child):
        path.oblige(c >= 0, "a coordinate")
        path.oblige(c < 2 << done, "a coordinate")
    proof.quantity(MORTON, builtins.len(children) ** levels - 1)


@proves("PACKED_LAYER: 7.13, the last of ROWS rows")
def _packed(_: Proof, b: dict[str, Any]) -> None:
    before = b["WEIGHT_EXPONENT_MAX"] + (ROWS - 1) * b["WEIGHT_SYMBOL_MAX"]
    most = b["WEIGHT_SYMBOL_MAX"]
    b["ROUND_F32"] = lambda *_: 0
    b["PACKED_LAYER"](fresh(-before, before, "exponent"), [fresh(-most, most, "difference")], [[]], [1])


# ---- 9: reconstruction


@proves("EXPONENTIAL: 9.4, m from 2^30 to 2^31 - 1")
def _exponential(proof: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    m, n = b["EXPONENTIAL"](fresh(-b["SCALING_BOUND"], b["SCALING_BOUND"], "t"))
    path.oblige(m >= 1 << 30, "m is below 2^30")
    path.oblige(m < 1 << 31, "m is 2^31 or more")
    proof.limit("n", n)


def finite(bits: Any) -> None:
    Path.now.oblige(bits % (1 << 31) < 255 << 23, "ROUND_F32: not finite")


@proves("WORLD, ROUND_F32: 9.1")
def _world(proof: Proof, b: dict[str, Any]) -> None:
    limits = limits_of("CHECK_HEADER", proof)
    b["BIT_LENGTH"] = bit_length
    grid = {"origin": [fresh(*limits["origin"])]}
    grid |= {name: fresh(*limits[name]) for name in ("scale_mantissa", "scale_exponent")}
    finite(b["WORLD"](grid, 0, within(proof, "P")))


@proves("STEP_VALUE, ROUND_F32: 9.2")
def _step(proof: Proof, b: dict[str, Any]) -> None:
    b |= {"BIT_LENGTH": bit_length, "STEP": Many(0, lambda: fresh(min(blocks.STEP), max(blocks.STEP), "step"))}
    step = b["STEP_VALUE"](0, fresh(*limits_of("CHECK_HEADER", proof)["base_step"]))
    finite(step)
    proof.limit("step", step)


@proves("VALUE, ROUND_F32: 9.2")
def _value(proof: Proof, b: dict[str, Any]) -> None:
    b["BIT_LENGTH"] = bit_length
    symbol = fresh(-b["ATTRIBUTE_SYMBOL_MAX"], b["ATTRIBUTE_SYMBOL_MAX"], "symbol")
    value = b["VALUE"](symbol, fresh(*limits_of("STEP_VALUE", proof)["step"]))
    finite(value)
    if ends(value) != (0, 0):
        proof.limit("value", value % (1 << 31))
        Path.now.oblige(value % (1 << 31) >= 1 << 23, "a value is subnormal")


@proves("SPLAT, ROUND_F32: 9.4")
def _splat(proof: Proof, b: dict[str, Any]) -> None:
    """With one offset. One call of ROUND_F32 is followed, any."""
    path, rounded = Path.now, b["ROUND_F32"]
    sign = path.take(lambda: [None, 0, 1])
    offset = 0 if sign is None else fresh(*limits_of("VALUE", proof)["value"]) + (sign << 31)
    exponents = limits_of("EXPONENTIAL", proof)["n"]
    kinds = {-b["SCALING_BITS"]: "length", -b["OUTPUT_BITS"]: "output"}
    followed = path.take(lambda: ["product", *kinds.values()])

    def round_f32(n: Any, e: Any) -> Any:
        if (kinds.get(e, "product") if isinstance(e, int) else "product") == followed:
            b["BIT_LENGTH"] = bit_length
            finite(rounded(n, e))
            raise Dead
        return fresh(0, (1 << 32) - 1, "bits")

    b |= {
        "ROUND_F32": round_f32,
        "ADD_F32": lambda *_: 0,
        "ROUND_SCALED": lambda *_: fresh(-1 << 300, 1 << 300, "scaled"),
        "EXPONENTIAL": lambda _: (fresh(1 << 30, (1 << 31) - 1, "m"), fresh(*exponents)),
        "NETWORK": lambda rows, _: [within(proof, "accumulator of a row") for _ in range(rows)],
    }
    networks = dict(zip(b["RENDERING"], (1, 7, 3), strict=True))
    b["SPLAT"](networks, [0] * 3, [0], [0] * 6, [offset] * 3, [1])


@proves("ROUND_F32: weights of a packed layer, 7.13")
def _weights(_: Proof, b: dict[str, Any]) -> None:
    b["BIT_LENGTH"] = bit_length
    exponent = fresh(b["WEIGHT_EXPONENT_MIN"], b["WEIGHT_EXPONENT_MAX"], "e")
    finite(b["ROUND_F32"](fresh(-b["WEIGHT_SYMBOL_MAX"], b["WEIGHT_SYMBOL_MAX"], "n"), -exponent))


# ---- 11 and Annex H


def highest(b: dict[str, Any]) -> dict[str, int]:
    """Returns the last level of Main. The limits of the others are lower."""
    *lower, top = [level for level in b["LEVELS"] if level["profile"] == 1]
    if any(level[name] > top[name] for level in lower for name in top):
        raise Failed("a lower level has a higher limit")
    return top


def header(b: dict[str, Any], counts: dict[str, int]) -> dict[str, list[Any]]:
    """Returns the fields of any header within the bounds of Main. counts: items of its lists."""
    v: dict[str, list[Any]] = {}
    for name, size, count, signed in b["FIRST_FIELDS"]:
        low, high = (-1 << 8 * size - 1, (1 << 8 * size - 1) - 1) if signed else (0, (1 << 8 * size) - 1)
        v[name] = [fresh(low, high, name) for _ in range(count)]
    for name, size, counter in b["LISTS"]:
        v[counter] = [counts[counter]]
        v[name] = [fresh(0, (1 << 8 * size) - 1, name) for _ in range(counts[counter])]
    for name, low, high in b["BOUNDS"][1][:-1]:
        for x in v[name]:
            Path.now.must(x <= high)
            Path.now.must(x >= (0 if name in ("plane_size", "sarm_layers") else low))
    return v


COUNTERS = ("slice_count", "hyper_layers", "sarm_layers", "carm_layers")


@proves("CHECK_HEADER: limits of the fields")
def _header(proof: Proof, b: dict[str, Any]) -> None:
    path, top = Path.now, highest(b)
    v = header(b, dict.fromkeys(COUNTERS, 0) | {"slice_count": max(x[2] for x in b["BOUNDS"][1] if x[0] == "slice_count")})
    v |= {"profile": [1], "level": [top["level"]]}
    b |= {"LEVELS": [top], "SIGNIFICAND": significand, "WORK": lambda _: 0}
    places: dict[str, int] = defaultdict(int)
    b["CHECK_HEADER"]({"value": v, "place": places, "size": places})
    path.oblige(sum(v["slice_width"]) <= b["FEATURES_MAX"], "more features than FEATURES_MAX")
    if v["render_model"][0] == b["STATIC"]:
        path.oblige(v["view_inputs"][0] == 0, "a static scene has view_inputs")
    for name, items in v.items():
        for x in items:
            proof.limit(name, x)


@proves("WORK, SHAPES: 11.2, with any numbers of slices and layers")
def _work(proof: Proof, b: dict[str, Any]) -> None:
    path, bounds = Path.now, {name: (low, high) for name, low, high in b["BOUNDS"][1]}
    counts = {name: path.take(lambda n=name: [*range(bounds[n][1], bounds[n][0] - 1, -1)]) for name in COUNTERS}
    v = header(b, counts)
    path.must(v["anchor_count"][0] <= highest(b)["anchor_count"])
    # As the proof of CHECK_HEADER shows.
    path.must(sum(v["slice_width"]) <= b["FEATURES_MAX"])
    b["WORK"](v)
    for name, layers in b["SHAPES"](v):
        for rows, inputs in layers:
            path.oblige(rows <= ROWS, "more rows than ROWS")
            if name not in b["RENDERING"] or v["view_inputs"][0] == 0:
                path.oblige(inputs <= INPUTS, "more inputs than INPUTS")


@proves("CHECK_SUBSTREAM: 8.1")
def _substream(proof: Proof, b: dict[str, Any]) -> None:
    lanes = 1 << Path.now.take(lambda: list(range(b["LANES_LOG2_MAX"] + 1)))
    b["all"] = lambda _: True
    b["CHECK_SUBSTREAM"](fields(b), 0, fresh(0, b["SECTION_LENGTH_MAX"], "length"), lanes)


def lanes_of(proof: Proof) -> dict[str, list[Any]]:
    limits = limits_of("CHECK_HEADER", proof)
    return {f"{name}_lanes_log2": [fresh(*limits[f"{name}_lanes_log2"])] for name in ("plane", "mask", "attribute")}


@proves("PARSE_PLANES: 6.9")
def _planes(proof: Proof, b: dict[str, Any]) -> None:
    v = lanes_of(proof) | {"plane_channels": [1], "plane_size": [2]}
    b |= {"CHECK_SUBSTREAM": lambda *_: [], "OPEN": lambda *_: None, "DECODE_PLANE": refuse, "any": lambda _: False}
    b["PARSE_PLANES"](fields(b), 0, {"length": fresh(0, b["SECTION_LENGTH_MAX"], "length")}, v, None)


@proves("DECODE_CHUNK: 6.11")
def _chunk(proof: Proof, b: dict[str, Any]) -> None:
    nothing = ("CHECK_SUBSTREAM", "OPEN", "CHECK_END", "CONTEXT")
    b |= dict.fromkeys(nothing, lambda *_: None) | {"CRC32": lambda _: 0, "any": lambda _: False}
    b |= {"DECODE_POSITIONS": lambda *_: ([[0] * 3], None), "DECODE_MASKS": lambda *_: [[1]]}
    b["DECODE_ATTRIBUTES"] = lambda *_: (None, None)
    data = fields(b)
    entry = {"length": b["U"](data, -1, 4), "anchors": 1, "crc": 0, "low": [0] * 3, "high": [0] * 3, "kept": 1}
    state = {"index": {"models": [0], "cell_shift": 0, "masks": []}, "frame": None, "planes": []}
    state["weights"] = {"integers": None, "carm_shift": [], "plane_shift": 0}
    v = lanes_of(proof) | {"offset_count": [1], "frequency_count": [0], "slice_width": [1]}
    b["DECODE_CHUNK"](data, 0, entry, v, state)


@proves("PARSE_WEIGHTS: its lanes")
def _lanes(proof: Proof, b: dict[str, Any]) -> None:
    nothing = dict.fromkeys(("CHECK_SUBSTREAM", "OPEN", "CHECK_END"), lambda *_: None)
    b |= nothing | {"SHAPES": lambda _: [], "DECODE_WEIGHTS": lambda *_: [], "any": lambda _: False}
    v = lanes_of(proof) | {"slice_width": [1], "plane_channels": [1], "render_model": [0]}
    b["PARSE_WEIGHTS"](fields(b), 0, {"length": fresh(0, b["SECTION_LENGTH_MAX"], "length"), "mode": 1}, v)


@proves("PARSE_INDEX: 6.10")
def _index(proof: Proof, b: dict[str, Any]) -> None:
    """With one chunk, whose length counts for the most chunks that a header can state."""
    limits = limits_of("CHECK_HEADER", proof)
    proof.repeated["sum of the entries' lengths"] = limits["chunk_count"][1]
    v = {"offset_count": [1], "chunk_count": [1], "anchor_count": [fresh(*limits["anchor_count"])]}
    v["chunk_size"] = [fresh(*limits["chunk_size"])]
    b |= {"any": lambda _: False, "F16_ORDER": lambda _: 0}
    b["PARSE_INDEX"](fields(b), 0, {"mode": 0}, v, fresh(0, b["SECTION_LENGTH_MAX"], "data_length"))


@proves("PARSE_HEADER, DECODE_FILE: the last of all sections")
def _sections(proof: Proof, b: dict[str, Any]) -> None:
    fields_before = b["FIRST_FIELDS"][: [name for name, *_ in b["FIRST_FIELDS"]].index("section_count")]
    at = 20 + sum(size * count for _, size, count, _ in fields_before)
    b |= {"U": lambda _, place, __: 2 if place == at else 0, "I": lambda *_: 0, "CRC32": lambda _: 0}
    first, second = b["PARSE_HEADER"](Many(1 << 17, lambda: 0), b["HEADER_LENGTH_MAX"], b["MINOR"] + 1)["entries"]
    count = (16 + b["HEADER_LENGTH_MAX"] - first["at"]) // (second["at"] - first["at"])
    before = fresh(0, b["HEADER_LENGTH_MAX"] + (count - 1) * b["PAD4"](b["SECTION_LENGTH_MAX"]), "before")
    entry = {"length": fresh(0, b["SECTION_LENGTH_MAX"], "length"), "type": None, "at": 0}
    h = {"value": {"render_model": [0]}, "entries": [entry], "place": {}}
    b |= {"PARSE_PROLOGUE": lambda _: (before, 0), "PARSE_HEADER": lambda *_: h, "PAD4": refuse}
    b |= dict.fromkeys(("CHECK_HEADER", "CHECK_DIRECTORY"), lambda *_: None)
    b["DECODE_FILE"](Many(0, lambda: 0))


@proves("BYTES, END: their shifts")
def _shifts(_: Proof, b: dict[str, Any]) -> None:
    size = Path.now.take(lambda: [1, 2, 4, 8])
    b["BYTES"](fresh(0, (1 << 8 * size) - 1, "value"), size)
    stream = {"word_at": 0, "words": [], "state": [], "bad_escape": False, "bad_range": False}
    raw_at = fresh(1, b["SECTION_LENGTH_MAX"], "raw_at")
    b["END"](stream | {"raw": Many((raw_at + 7) // 8, lambda: fresh(0, 255, "byte")), "raw_at": raw_at, "symbols": [],
                     "symbol_crc": 0})


@cache
def _limits(start: str, text: str) -> dict[str, tuple[int, int]]:
    name = next(name for name in BODIES if name.startswith(start))
    proof = Proof(name, BODIES[name], text)
    proof.run()
    return proof.limits


def limits_of(start: str, proof: Proof) -> dict[str, tuple[int, int]]:
    """Returns the limits that another proof finds. start: of its name."""
    now = Path.now
    found = _limits(start, proof.spec.text)
    Path.now = now
    return found


def main() -> int:
    """Proves everything. Prints a line for each proof, and returns 1 if one fails, else 0."""
    text = SPEC.read_text(encoding="utf-8")
    return 0 if all([prove(name, text) for name in BODIES]) else 1


def prove(name: str, text: str) -> Proof:
    began = time.process_time()
    proof = Proof(name, BODIES[name], text)
    fault = ""
    try:
        proof.run()
    except Failed as failed:
        fault = str(failed)
    method = f"{proof.paths} paths, {proof.queries} queries"
    print(f"{name:80} {method:28} {time.process_time() - began:6.1f} s  {'FAILED: ' + fault if fault else 'proved'}", sorted(proof.reached), flush=True)
    return not fault
