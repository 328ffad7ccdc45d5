"""Proofs of SPEC.md's integer arithmetic for all inputs, with the SMT solver z3: `python -m spec --proofs`.

The blocks themselves run, on integers that are terms of z3 with an interval. At a comparison that both outcomes can
have, the run divides into two paths. On each path the integers of 7.11 are compared with their bounds, and the amounts
of shifts with the widths of their types. A function that one proof has bounded is replaced by that bound in the next
one. Thus a change of a block, a constant or a bound in SPEC.md changes the proofs.
"""

import ast
import builtins
import math
import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import z3

from conformance.spec_decoder import blocks, program
from conformance.spec_decoder.program import SPEC

from .coverage import IMAGES, QUANTITIES
from .symbolic import (
    WIDTH,
    DeadError,
    Memory,
    Num,
    Path,
    Row,
    Truth,
    UnprovedError,
    ends,
    extreme,
    fresh,
    magnitude,
    narrow,
    quotient,
    raw,
)

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
# Functions whose shifts have no type, with the reason.
UNTYPED = {
    "I": "reads a field of at most 8 bytes; a decoder reads it as its type",
    "ADD_F32": "7.11: wider than any type; a decoder uses the binary32 addition",
    "ROUND_SCALED": "7.11: by up to 149 places to the right, which gives 0; left shifts are beyond the limits",
}


# Where a proof by induction starts elsewhere than a block.
STARTS = {
    "    r = 0\n    for bit in": "    r = _start\n    for bit in",
    "    nodes, whole = [(0, 0, 0)], True": "    nodes, whole = _start or [(0, 0, 0)], True",
}


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
        visited = super().visit(node)
        if not self.functions or not isinstance(node, ast.expr) or self.functions[0] in IMAGES:
            return visited
        key = self.functions[-1], self.texts.get(id(node), "")
        if key in SITES or key == ROUNDED:
            name = ast.Constant(SITES.get(key, ""))
            more = [ast.Name("a", ast.Load())] if key == ROUNDED else []
            return ast.Call(ast.Name("_quantity", ast.Load()), [name, visited, *more], [])
        return visited

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
        self.texts = {
            id(node): ast.unparse(node) for node in loads if isinstance(node, (ast.BinOp, ast.Call, ast.Name))
        }
        return compile(ast.fix_missing_locations(self.visit(tree)), "SPEC.md", "exec")


@dataclass
class Specification:
    """What the proofs need of SPEC.md."""

    text: str
    source: str
    code: Any
    shifts: list[tuple[str, str, int | None]]
    rows: dict[str, Row]


@cache
def specification(text: str) -> Specification:
    """Returns the marked blocks and the rows of 7.11. text: SPEC.md."""
    source = program.source(text).removesuffix(program.TAIL)
    for old, new in STARTS.items():
        if source.count(old) != 1:
            raise UnprovedError(f"the blocks have changed: {old}")
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
    return Specification(text, source, marks.marked(source), marks.shifts, rows)


class Proof:
    """A proof: what runs on each path, and what was found."""

    def __init__(self, name: str, text: str) -> None:
        self.name, self.spec, self.memory = name, specification(text), Memory()
        self.paths, self.seconds, self.fault = 0, 0.0, ""
        self.reached: set[str] = set()
        # The ends of integers that other proofs need, by name, and how often a sum has a term, by quantity.
        self.limits: dict[str, tuple[int, int]] = {}
        self.repeated: dict[str, int] = {}
        self.shifted: set[int] = set()

    def quantity(self, name: str, x: Any, summand: Any = None) -> Any:
        """Compares an integer with its row of 7.11: the named one, or that of a summand of a rounded number."""
        row = self.spec.rows[name] if name else getattr(summand, "row", None)
        if row is None:
            return x
        path = Path.now
        total = x * self.repeated[name] if name in self.repeated else x
        text = f"{row.name}: not {-row.bound if row.signed else 0} to {row.bound}"
        path.oblige(total <= row.bound, text)
        path.oblige(total >= (-row.bound if row.signed else 0), text)
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
            key = path.key(a), path.key(b), left
            if key not in path.shifted:
                path.shifted[key] = x = fresh(min(corners), max(corners), "shifted")
                if not left:
                    path.assume(
                        z3.If(raw(a) < 0, z3.And(raw(a) <= raw(x), raw(x) < 0), z3.And(raw(x) >= 0, raw(x) <= raw(a)))
                    )
            return path.shifted[key]
        return a * (1 << b) if left else (quotient(a, 1 << b) if isinstance(a, Num) else a >> b)

    def run(self) -> None:
        """Runs all paths. Raises UnprovedError if an integer can exceed its bound."""
        space = program.names(
            self.spec.code,
            _quantity=lambda name, x, *_: x,
            _shift=lambda _, a, b, left: a << b if left else a >> b,
            _start=0,
        )
        space |= {"_quantity": self.quantity, "_shift": self.shift, "abs": magnitude, "len": length}
        space |= {"max": lambda *x: extreme(1, *x), "min": lambda *x: extreme(-1, *x)}
        space |= {"REQUIRE": lambda truth, *_: Path.now.must(truth), "REFUSE": refuse}
        left: list[list[Any]] = [[]]
        own = dict(space)
        while left:
            Path.now = path = Path(self.memory, left.pop())
            self.paths += 1
            space.update(own)
            with suppress(DeadError):
                BODIES[self.name](self, space)
            left += path.others


def refuse(*_: Any) -> None:
    raise DeadError


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
        key = Path.now.key(at)
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
        key = size, Path.now.key(at)
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
    Path.now.within(unsigned, 0, 2 * half, "U")
    Path.now.within(signed, -half, half, "I")


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
    path, loop = Path.now, list[int]()
    k = fresh(0, 1 << WIDTH // 2, "k")
    path.powers = k.term, z3.FreshInt("square")
    a = fresh(0, (1 << WIDTH - 1) - 1, "a")
    if path.take(lambda: ["start", "step"]) == "start":
        b["range"] = lambda *given: loop.extend(given) or []  # type: ignore[func-returns-value]
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
    layer = b["DERIVE_ROW"]([0] * INPUTS, 0)
    if layer is None:
        raise DeadError
    w, bias, e = layer
    inputs = [fresh(-b["ACTIVATION_MAX"], b["ACTIVATION_MAX"], "a") for _ in w]
    out = b["NETWORK"]([[layer]], inputs)[0]
    site = next(n for n, own in enumerate(proof.spec.shifts) if own[0] == "DERIVE_ROW")
    path.oblige(magnitude(out) <= row.bound, "an output")
    products = sum([x * a for x, a in zip(w, inputs, strict=True)])
    half = quotient(proof.shift(site, 1, e, True), 2)
    for partial in (products, products + bias, products + half, products + bias + half):
        path.within(partial, -row.bound, row.bound + 1, "a partial sum")
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
    contracted = b["CONTRACT"](v)
    q = sum([x * x for x in v])
    Path.now.tighten(q)
    isqrt(q)
    for w in contracted:
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
    side = fresh(2, 2 * size, "side")
    plane = Many(1, lambda: Many(side, lambda: Many(side, lambda: fresh(-symbol, symbol, "symbol"))))
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

    def values(_: Any, __: Any, parameters: Any, limit: int) -> list[Any]:
        for mean, scale in parameters:
            proof.quantity("mean, scale index", mean)
            proof.quantity("mean, scale index", scale)
        return [fresh(-limit, limit, "symbol") for _ in parameters]

    outputs = lambda *_: Many(0, lambda: within(proof, "accumulator of a row"))  # noqa: E731
    b |= {"NETWORK": outputs, "DECODE_VALUES": values, "GAUSS": None, "CLAMP": lambda x, *_: x}
    Path.now.split = 0
    shift = fresh(0, b["CARM_SHIFT_MAX"], "carm_shift")
    b["DECODE_ATTRIBUTES"](None, {"hyper": None, 1: None}, [shift], [1, 1], [None], [[1]])


# ---- 8: the entropy coder


@proves("READ_BITS: k bits, from any bit of a byte")
def _bits(_: Proof, b: dict[str, Any]) -> None:
    path = Path.now
    k = path.take(lambda: list(range(max(b["RAW_MAX"], b["ESCAPE_PREFIX_MAX"]) + 1)))
    at = path.take(lambda: list(range(8)))
    stream = {"raw": Many(1 << 48, lambda: fresh(0, 255, "byte")), "raw_at": at}
    value = b["READ_BITS"](stream, k)
    path.within(value, 0, 1 << k, "READ_BITS")
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
    stream: dict[str, Any] = {"state": [x], "words": [word], "word_at": 0}
    decoded = b["DECODE_SYMBOL"](stream, 0, frequencies)
    return decoded, stream["state"][0], stream["word_at"]


def model(b: dict[str, Any], total: int) -> list[Any]:
    """Returns the frequencies of the symbols before the coded one, of it, and of those behind it."""
    frequencies = [fresh(0, total, "frequency") for _ in range(3)]
    Path.now.must(sum(frequencies) == total)
    return frequencies


@proves("DECODE_SYMBOL: 8.2, and states from STATE_MIN to 2^32 - 1")
def _decode_symbol(_: Proof, b: dict[str, Any]) -> None:
    """The symbols before the coded one act as one with the sum of their frequencies, and so do those behind it."""
    path = Path.now
    x, word = fresh(b["STATE_MIN"], (1 << 32) - 1, "state"), fresh(0, 0xFFFF, "word")
    decoded, x, _words = symbol(b, x, word, model(b, 1 << b["PRECISION"]))
    path.within(x, b["STATE_MIN"], 1 << 32, "a state")
    assert decoded in (0, 1, 2)


@proves("rANS: a step of the encoder, then one of the decoder (Annex B.4, 8.2)")
def _rans(proof: Proof, b: dict[str, Any]) -> None:
    """The symbols before the coded one act as one with the sum of their frequencies, and so do those behind it."""
    path = Path.now
    text = " ".join(proof.spec.text.partition("### B.4 ")[2].partition("### B.5 ")[0].split())
    steps = re.search(
        r"1\. If `([^`]+)` is at least f, put out the word x & (0x\w+), and shift x right by (\d+)\..*?"
        r"2\. Set x to `([^`]+)`\.", text)  # fmt: skip
    if steps is None:
        raise UnprovedError("Annex B.4 does not have the two steps of the encoder")
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
    path.within(x, b["STATE_MIN"], 1 << 32, "the encoder's state")
    decoded, back, taken = symbol(b, x, word, frequencies)
    path.oblige(decoded == 1, "another symbol")
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
        path.within(c, 0, 2 << done, "a coordinate")
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
    path.within(m, 1 << 30, 1 << 31, "m")
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
            raise DeadError
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


# "0, or a to b" in 11.1.
ABSENT = ("plane_size", "sarm_layers")


def highest(b: dict[str, Any]) -> dict[str, int]:
    """Returns the last level of Main. The limits of the others are lower."""
    *lower, top = [level for level in b["LEVELS"] if level["profile"] == 1]
    if any(level[name] > top[name] for level in lower for name in top):
        raise UnprovedError("a lower level has a higher limit")
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
            Path.now.must(x >= (0 if name in ABSENT else low))
    return v


COUNTERS = ("slice_count", "hyper_layers", "sarm_layers", "carm_layers")


@proves("CHECK_HEADER: limits of the fields")
def _header(proof: Proof, b: dict[str, Any]) -> None:
    path, top = Path.now, highest(b)
    v = header(
        b, dict.fromkeys(COUNTERS, 0) | {"slice_count": max(x[2] for x in b["BOUNDS"][1] if x[0] == "slice_count")}
    )
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


def sizes(b: dict[str, Any], names: tuple[str, ...]) -> dict[str, list[Any]]:
    """Returns the fields of a header, on a path for each number of items of the lists that these fields count."""
    bounds = {name: (low, high) for name, low, high in b["BOUNDS"][1]}
    counts = {name: bounds[name][1] for name in COUNTERS}
    for name in names:
        low, high = bounds[name]
        choices = list(range(high, (0 if name in ABSENT else low) - 1, -1))
        counts[name] = Path.now.take(lambda choices=choices: choices)  # type: ignore[misc]
    v = header(b, counts)
    # As the proof of CHECK_HEADER shows.
    Path.now.must(sum(v["slice_width"]) <= b["FEATURES_MAX"])
    return v


@proves("SHAPES: no layer has more than ROWS rows or INPUTS inputs")
def _shapes(_: Proof, b: dict[str, Any]) -> None:
    """With the most layers: a network with fewer has the same first inputs and last rows."""
    v = sizes(b, ("slice_count",))
    for name, layers in b["SHAPES"](v):
        for rows, inputs in layers:
            Path.now.oblige(rows <= ROWS, "more rows than ROWS")
            if name not in b["RENDERING"] or v["view_inputs"][0] == 0:
                Path.now.oblige(inputs <= INPUTS, "more inputs than INPUTS")


@proves("WORK: 11.2")
def _work(_: Proof, b: dict[str, Any]) -> None:
    """The weights of SARM have a bound of their own: they share no list of widths with the others."""
    count, path = b["WEIGHT_COUNT"], Path.now
    high = {name: high for name, _, high in b["BOUNDS"][1]}
    items = {name: high[counter] for name, _, counter in b["LISTS"] if counter in high}
    sarm = count({name: [high[name]] * items.get(name, 1) for name in high}, ["sarm"])
    if path.take(lambda: [True, False]):
        path.oblige(
            count(sizes(b, ("sarm_layers",)), ["sarm"]) <= sarm, "more weights of SARM than with the most layers"
        )
        return
    b["WEIGHT_COUNT"] = lambda v, names: fresh(0, sarm, "sarm") if names == ["sarm"] else count(v, names)
    v = sizes(b, ("slice_count", "hyper_layers", "carm_layers"))
    path.must(v["anchor_count"][0] <= highest(b)["anchor_count"])
    b["WORK"](v)


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
    state: dict[str, Any] = {"index": {"models": [0], "cell_shift": 0, "masks": []}, "frame": None, "planes": []}
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
    """A header has as many entries as its length allows, and the sections before the last have the greatest length."""
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
    raw = Many((raw_at + 7) // 8, lambda: fresh(0, 255, "byte"))
    b["END"](stream | {"raw": raw, "raw_at": raw_at, "symbols": [], "symbol_crc": 0})


LIMITS: dict[tuple[str, str], dict[str, tuple[int, int]]] = {}


def limits_of(start: str, proof: Proof) -> dict[str, tuple[int, int]]:
    """Returns the limits that another proof finds in the same blocks. start: of its name."""
    key = start, proof.spec.source
    if key not in LIMITS:
        now, name = Path.now, next(name for name in BODIES if name.startswith(start))
        other = Proof(name, proof.spec.text)
        other.run()
        Path.now, LIMITS[key] = now, other.limits
    return LIMITS[key]


def shifts(proofs: list[Proof]) -> tuple[list[str], str]:
    """Returns the shifts whose amounts are not proved, and a summary."""
    places = proofs[0].spec.shifts
    followed = set().union(*(proof.shifted for proof in proofs))
    known = {n for n, (_, _, amount) in enumerate(places) if amount is not None}
    argued = {n for n, (function, *_) in enumerate(places) if function in UNTYPED} - known
    wrong = {n for n in known if not 0 <= (places[n][2] or 0) < WIDTH} | set(
        range(len(places))
    ) - known - followed - argued
    summary = (
        f"{len(places)} shifts: {len(known)} by a constant, {len(followed - known)} followed, {len(argued)} argued"
    )
    return [": ".join(places[n][:2]) for n in sorted(wrong)], summary


def prove(name: str, text: str) -> Proof:
    """Returns the proof of that name, with its fault, if any. text: SPEC.md."""
    began = time.process_time()
    proof = Proof(name, text)
    try:
        proof.run()
    except UnprovedError as failed:
        proof.fault = str(failed)
    proof.seconds = time.process_time() - began
    return proof


def main() -> int:
    """Proves everything. Prints a line for each proof, and returns 1 if one fails, else 0."""
    text, proofs = SPEC.read_text(encoding="utf-8"), []
    for name in BODIES:
        proof = prove(name, text)
        proofs.append(proof)
        queries, paths = proof.memory.queries, proof.paths
        method = f"z3: {paths} paths, {queries} queries" if queries else f"intervals: {paths} paths"
        print(
            f"{name:84}  {method:30}  {proof.seconds:6.1f} s  {'failed: ' + proof.fault if proof.fault else 'proved'}",
            flush=True,
        )
    missing = set(proofs[0].spec.rows).difference(*(proof.reached for proof in proofs))
    open_shifts, summary = shifts(proofs)
    steps = {name: " ".join(body.__doc__.split()) for name, body in BODIES.items() if body.__doc__}
    lines = [f"7.11: {len(proofs[0].spec.rows)} rows, {len(missing)} of them without a proof"]
    lines += [f"  no proof: {name}" for name in sorted(missing)]
    lines += [summary, *(f"  not proved: {name}" for name in open_shifts)]
    lines += [f"  argued: {function}: {reason}" for function, reason in UNTYPED.items()]
    lines += ["how, and what z3 does not check:", *(f"  {name}: {text}" for name, text in steps.items())]
    print("\n".join(lines))
    return 1 if missing or open_shifts or any(proof.fault for proof in proofs) else 0
