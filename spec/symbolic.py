"""Integers that are terms of z3 within an interval, and the paths of a program that computes with them.

A comparison that both outcomes can have divides a path. z3 gets linear facts only: a product is an unknown number with
bounds that follow from those of its factors, a quotient one with its remainder. Thus what is proved holds, and a
failure can come from a fact that is missing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import z3

# Of a query, in units of z3, so that the result does not depend on the machine.
EFFORT = 20_000_000
# The widest type of 7.11, for shifts of integers that it does not list.
WIDTH = 64


class DeadError(Exception):
    """No input takes this path, or the file is refused on it."""


class UnprovedError(Exception):
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
        raise UnprovedError(f"{self.term} | {raw(other)}: both may have the same bit")

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

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, other: Any) -> Any:
        return Truth(self.term == (other.term if isinstance(other, Truth) else bool(other)), (), ())


def raw(x: Any) -> Any:
    return x.term if isinstance(x, Num) else x


def ends(x: Any) -> tuple[int, int]:
    return (x.low, x.high) if isinstance(x, Num) else (x, x)


def twos(x: Any) -> int:
    return x.zeros if isinstance(x, Num) else (x & -x).bit_length() - 1 if x else 99


def number(term: Any, low: int, high: int, zeros: int = 0) -> Any:
    low, high = Path.now.known.get(term.get_id(), (low, high))
    return low if low == high else Num(term, low, high, zeros)


def fresh(low: int, high: int, name: str = "x") -> Any:
    """Returns any integer from low to high."""
    if low == high:
        return low
    integer = Num(z3.FreshInt(name), low, high)
    integer.tight = name not in ("extreme", "shifted")
    Path.now.assume(z3.And(integer.term >= low, integer.term <= high))
    return integer


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
        (c, d), (e, f) = [
            [z3.simplify(z3.substitute(x.term, (k, z3.IntVal(v)))).as_long() for v in (0, 1)] for x in (a, b)
        ]
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
    low, high = (
        (min(corners), max(corners)) if a is not b else (0 if a.low <= 0 <= a.high else min(corners), max(corners))
    )
    p = PRODUCT(a.term, b.term)
    path.assume(p == PRODUCT(b.term, a.term))
    path.assume(z3.And(p >= low, p <= high))
    for x, y in ((a, b), (b, a)):
        if x.low >= 0 and y.low >= 0:
            continue
        path.assume(z3.Or(x.term < 0, z3.And(p >= y.low * x.term, p <= y.high * x.term)))
        path.assume(z3.Or(x.term > 0, z3.And(p <= y.low * x.term, p >= y.high * x.term)))
        if x.magnitude is not None:
            most = max(-y.low, y.high)
            path.assume(z3.And(p <= most * raw(x.magnitude), p >= -most * raw(x.magnitude)))
    for i, j in product(ends(a), ends(b)):
        rest = p - i * b.term - j * a.term + i * j
        path.assume(rest >= 0 if (i == a.low) == (j == b.low) else rest <= 0)
    result = Num(p, low, high)
    result.factors = 2
    if a is b:
        path.squares.append((a, result))
    return result


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
    key = path.key(a), path.key(b)
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
    result = fresh(*((low, high) if sign > 0 else (-high, -low)), "extreme")
    for x in left:
        Path.now.assume(raw(result) >= raw(x) if sign > 0 else raw(result) <= raw(x))
    Path.now.assume(z3.Or([raw(result) == raw(x) for x in left]))
    return result


def magnitude(x: Any) -> Any:
    """abs of an integer."""
    low, high = ends(x)
    if low >= 0 or high <= 0:
        return x if low >= 0 else -x
    if x.magnitude is None:
        x.magnitude = extreme(1, x, -x)
        x.magnitude.low = 0
    return x.magnitude


@dataclass
class Memory:
    """What the paths of a proof share: the number of queries, and whether conditions hold, by where they are asked."""

    queries: int = 0
    answers: dict[Any, bool] = field(default_factory=dict)


class Path:
    """A path through a block. taken: the outcomes where it divides."""

    now: Path

    def __init__(self, memory: Memory, taken: list[Any]) -> None:
        self.memory, self.taken, self.at = memory, taken, 0
        self.others: list[list[Any]] = []
        self.squares: list[tuple[Num, Num]] = []
        self.tight, self.split, self.typed = False, WIDTH, True
        self.powers: Any = None
        self.solver = z3.Solver()
        self.solver.set("rlimit", EFFORT)
        # The terms whose values the path has chosen.
        self.known: dict[int, tuple[int, int]] = {}
        self.shifted: dict[Any, Any] = {}
        self.keyed: list[Any] = []
        self.quotients: dict[Any, Any] = {}
        self.asked: Any = ()
        self.model: Any = None

    def key(self, x: Any) -> Any:
        """Returns what tells integers of the path apart. A term is kept, because z3 numbers others like lost ones."""
        if isinstance(x, int):
            return str(x)
        self.keyed.append(x.term)
        return x.term.get_id()

    def assume(self, term: Any) -> None:
        self.solver.add(term)

    def check(self, *terms: Any) -> Any:
        self.memory.queries += 1
        self.solver.push()
        self.solver.add(*terms)
        verdict = self.solver.check()
        self.model = self.solver.model() if verdict == z3.sat else None
        self.solver.pop()
        return verdict

    def holds(self, truth: Any) -> bool:
        """Whether a condition holds for all inputs of the path."""
        if isinstance(truth, bool):
            return truth
        # Paths that divide later ask the same first.
        self.asked = self.at, self.asked[1] + 1 if self.asked and self.asked[0] == self.at else 0
        key = *map(str, self.taken[: self.at]), self.asked[1]
        if key not in self.memory.answers:
            self.memory.answers[key] = self.check(z3.Not(truth.term)) == z3.unsat
        return self.memory.answers[key]

    def oblige(self, truth: Any, text: str) -> None:
        if not self.holds(truth):
            inputs = self.model or {}
            example = ", ".join(sorted(f"{d}={inputs[d]}" for d in inputs if "!" in str(d)))[:300] if inputs else ""
            raise UnprovedError(f"{text}{example and ' with '}{example}")

    def within(self, x: Any, low: Any, below: Any, text: str) -> None:
        """Obliges low <= x < below."""
        self.oblige(x >= low, f"{text}: below {low}")
        self.oblige(x < below, f"{text}: {below} or above")

    def must(self, truth: Any) -> None:
        """Assumes a condition: other inputs are refused."""
        if isinstance(truth, Truth):
            self.assume(truth.term)
            for x, low, high in truth.true:
                narrow(x, low, high)
        elif not truth:
            raise DeadError

    def take(self, choices: Callable[[], list[Any]]) -> Any:
        """Returns the outcome at a division: one of choices(), which other paths take, too."""
        if self.at == len(self.taken):
            first, *rest = choices() or [None]
            self.others += [[*self.taken, x] for x in rest]
            self.taken.append(first)
            if first is None:
                raise DeadError
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
            seen: list[int] = []
            while self.check(*[x.term != v for v in seen]) == z3.sat:
                seen.append(self.model.eval(x.term, model_completion=True).as_long())
            return seen

        outcome = self.take(values)
        self.assume(x.term == outcome)
        self.known[self.key(x)] = outcome, outcome
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
            raise DeadError
