"""Wrong decoders of a reader of SPEC.md who leaves a check out, weakens it or moves it, or computes otherwise.

A misreading is applied wherever the blocks have a place for it. A check is a call of REQUIRE, or an `if` that returns
an error. A mutant breaks the requirements of the errors of its checks, or else those that name its function.
"""

import ast
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from conformance.quantities import bounds

from .mutant import Mutant, Names, definitions, demanded, planted, span, text

SEED = "c3gs misreadings 0"


@dataclass(frozen=True)
class Edit:
    """A new text at a span of characters. errors: of the checks that change."""

    at: tuple[int, int]
    new: str
    what: str
    errors: tuple[str, ...] = ()


@dataclass(frozen=True)
class Check:
    """A check. conditions: expressions that decide it. passing: their value for a right file. offset: of the error."""

    conditions: list[ast.expr]
    passing: bool
    error: str
    offset: ast.expr | None


Misreading = Callable[[ast.stmt], Iterator[Edit]]


def _text(node: ast.AST) -> str:
    first, end = span(node)
    return text()[first:end]


def _names(nodes: Iterable[ast.AST], context: type[ast.expr_context]) -> set[str]:
    every = (n for node in nodes for n in ast.walk(node))
    return {n.id for n in every if isinstance(n, ast.Name) and isinstance(n.ctx, context)}


def _bodies(node: ast.AST) -> Iterator[list[ast.stmt]]:
    """Yields all runs of statements inside a node."""
    for each in ast.walk(node):
        for body in (getattr(each, "body", None), getattr(each, "orelse", None)):
            if isinstance(body, list):
                yield body


def _conditions(condition: ast.expr, above: Sequence[ast.stmt]) -> list[ast.expr]:
    """Returns a condition, or what is assigned to its name above it."""
    if not isinstance(condition, ast.Name):
        return [condition]
    values: list[ast.expr] = []
    for statement in reversed(above):
        every = (node for node in ast.walk(statement) if isinstance(node, ast.Assign))
        own = [node for node in every if _names(node.targets, ast.Store) == {condition.id}]
        values += [node.value for node in own]
        if isinstance(statement, ast.Assign) and own:
            break
    return values or [condition]


def _check(statement: ast.stmt, above: Sequence[ast.stmt] = ()) -> Check | None:
    match statement:
        case ast.Expr(ast.Call(ast.Name("REQUIRE"), [condition, ast.Constant(str(error)), offset])):
            return Check(_conditions(condition, above), True, error, offset)
        case ast.If(condition, [ast.Return(ast.Constant(str(error)))], []) if error in demanded()[0]:
            return Check([condition], False, error, None)
    return None


def checks(statement: ast.stmt) -> list[Check]:
    """Returns the checks of a function."""
    checked = (_check(each, body[:i]) for body in _bodies(statement) for i, each in enumerate(body))
    return [check for check in checked if check]


def _inside(statement: ast.stmt, kind: type[ast.expr]) -> Iterator[tuple[Any, tuple[str, ...]]]:
    """Yields the expressions of a kind, each with the error of the check that it decides, if it does."""
    own = {node: (c.error,) for c in checks(statement) for condition in c.conditions for node in ast.walk(condition)}
    yield from ((node, own.get(node, ())) for node in ast.walk(statement) if isinstance(node, kind))


# --- checks -----------------------------------------------------------------------------------------------------------


def unchecked(statement: ast.stmt) -> Iterator[Edit]:
    """A check is left out."""
    for check in checks(statement):
        for condition in check.conditions:
            yield Edit(span(condition), str(check.passing), "missing check", (check.error,))


def split(statement: ast.stmt) -> Iterator[Edit]:
    """Of a range only one end is checked."""
    for node, errors in _inside(statement, ast.Compare):
        if len(node.ops) > 1:
            (first, end), low, high = span(node), span(node.comparators[-2])[1], span(node.comparators[0])[0]
            yield Edit((first, end), text()[high:end], "missing check of the first bound", errors)
            yield Edit((first, end), text()[first:low], "missing check of the last bound", errors)


def part(statement: ast.stmt) -> Iterator[Edit]:
    """One of several conditions is left out."""
    for node, errors in _inside(statement, ast.BoolOp):
        for value in node.values:
            rest = [f"({_text(other)})" for other in node.values if other is not value]
            joined = (" and " if isinstance(node.op, ast.And) else " or ").join(rest)
            yield Edit(span(node), joined, "missing condition", errors)


_MOVED: dict[type[ast.cmpop], ast.cmpop] = {
    ast.Lt: ast.LtE(), ast.LtE: ast.Lt(), ast.Gt: ast.GtE(), ast.GtE: ast.Gt()
}  # fmt: skip


def moved(statement: ast.stmt) -> Iterator[Edit]:
    """A bound that belongs to a range is excluded, or the other way round."""
    for node, errors in _inside(statement, ast.Compare):
        for i, operator in enumerate(node.ops):
            if type(operator) in _MOVED:
                operators = [*node.ops[:i], _MOVED[type(operator)], *node.ops[i + 1 :]]
                new = ast.unparse(ast.Compare(node.left, operators, node.comparators))
                yield Edit(span(node), new, "off by one", errors)


def listed(statement: ast.stmt) -> Iterator[Edit]:
    """Of the items that a loop goes through, one is left out, or two neighbours are swapped."""
    for node in ast.walk(statement):
        if isinstance(node, ast.For) and isinstance(node.iter, ast.Tuple):
            items, errors = [_text(item) for item in node.iter.elts], tuple(check.error for check in checks(node))
            for i in range(len(items)):
                rest, swap = items[:i] + items[i + 1 :], [*items[: i - 1], *items[i - 1 : i + 1][::-1], *items[i + 1 :]]
                yield Edit(span(node.iter), f"({', '.join(rest)},)", "missing item", errors)
                if i:
                    yield Edit(span(node.iter), f"({', '.join(swap)})", "wrong order of items", errors)


def offset(statement: ast.stmt) -> Iterator[Edit]:
    """The offset is that of the whole, not that of the part."""
    for check in checks(statement):
        if isinstance(check.offset, ast.BinOp) and isinstance(check.offset.op, ast.Add):
            yield Edit(span(check.offset), _text(check.offset.left), "wrong offset: the first term", (check.error,))


def _errors(statement: ast.stmt) -> tuple[str, ...]:
    """Returns the errors of a statement that only checks, such as a loop of checks, and nothing for another one."""
    if check := _check(statement):
        return (check.error,)
    if not isinstance(statement, ast.For | ast.If) or statement.orelse:
        return ()
    inner = [() if isinstance(each, ast.Assign) else _errors(each) or ("",) for each in statement.body]
    return () if ("",) in inner else tuple(dict.fromkeys(error for errors in inner for error in errors))


def _units(body: list[ast.stmt]) -> Iterator[tuple[list[ast.stmt], ast.stmt, tuple[str, ...]]]:
    """Yields the statements of a run, each with the assignments just above it, and its errors if it only checks."""
    above: list[ast.stmt] = []
    for statement in body:
        if isinstance(statement, ast.Assign):
            above = [*above, statement]
        else:
            yield above, statement, _errors(statement)
            above = []


def swapped(statement: ast.stmt) -> Iterator[Edit]:
    """Two neighbouring checks are made in the other order."""
    for body in _bodies(statement):
        for (above, one, errors), (between, two, others) in pairwise(_units(body)):
            if errors and others:
                first, second = [*above, one], [*between, two]
                needed = (_names(above, ast.Store) - _names(between, ast.Store)) & _names(second, ast.Load)
                order = [*above, *second, one] if needed else [*second, *first]
                new = f"\n{' ' * first[0].col_offset}".join(map(_text, order))
                yield Edit((span(first[0])[0], span(two)[1]), new, "wrong order of checks", errors + others)


# --- arithmetic -------------------------------------------------------------------------------------------------------


def _calls(statement: ast.stmt, *names: str) -> Iterator[tuple[ast.Call, list[str]]]:
    """Yields the calls of functions, each with the texts of its arguments."""
    for node in ast.walk(statement):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names:
            yield node, [f"({_text(argument)})" for argument in node.args]


def unclamped(statement: ast.stmt) -> Iterator[Edit]:
    """A number is not clamped, or at one end only."""
    for node, (x, low, high) in _calls(statement, "CLAMP"):
        yield Edit(span(node), x, "missing clamp")
        yield Edit(span(node), f"max({x}, {low})", "missing clamp at the upper end")
        yield Edit(span(node), f"min({x}, {high})", "missing clamp at the lower end")
    for node, (x,) in _calls(statement, "ACTIVATION"):
        yield Edit(span(node), x, "missing ACTIVATION")


def rounded(statement: ast.stmt) -> Iterator[Edit]:
    """A number is rounded down instead of to the nearest, or not rounded up to a multiple of four."""
    for node, (a, s) in _calls(statement, "RSHIFT_ROUND"):
        yield Edit(span(node), f"({a} >> {s})", "rounded down")
    for node, (n,) in _calls(statement, "PAD4"):
        yield Edit(span(node), n, "without padding")


def narrowed(statement: ast.stmt) -> Iterator[Edit]:
    """An integer is read with half of its bytes."""
    for node, (*_, size) in _calls(statement, "U", "I"):
        if size in ("(2)", "(4)", "(8)"):
            yield Edit(span(node.args[-1]), str(int(size[1]) // 2), "wrong width: half of the bytes")


_OTHER = {"GAUSS": ("LAPLACE",), "LAPLACE": ("GAUSS",)} | {
    f'"{own}_lanes_log2"': tuple(f'"{other}_lanes_log2"' for other in ("plane", "mask", "attribute") if other != own)
    for own in ("plane", "mask", "attribute")
}


def mistaken(statement: ast.stmt) -> Iterator[Edit]:
    """The family of models or the number of lanes is that of other symbols."""
    for node in ast.walk(statement):
        if isinstance(node, ast.Constant) or (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)):
            for other in _OTHER.get(_text(node), ()):
                yield Edit(span(node), other, "that of other symbols")


# --- what a reader does in one case only ------------------------------------------------------------------------------

# Conditions on the file, of which FILE has the bytes (trial.py). Its header may be too short.
_CASES = {"of a later minor version": "any(FILE[10:12])", "without anchors": "not any(FILE[24:28])"}
# Functions that only chunks use, and thus no file without anchors.
_OF_CHUNKS = {"DECODE_CHUNK", "DECODE_POSITIONS"}


def skipped(statement: ast.stmt) -> Iterator[Edit]:
    """A check is not made in files of a later minor version, or without anchors."""
    for check in checks(statement):
        for condition in check.conditions:
            for what, case in _CASES.items():
                if case.startswith("any") or getattr(statement, "name", "") not in _OF_CHUNKS:
                    own = f"({_text(condition)}) " + (f"or {case}" if check.passing else f"and not {case}")
                    yield Edit(span(condition), f"({own})", f"no check in files {what}", (check.error,))


def halved(statement: ast.stmt) -> Iterator[Edit]:
    """Of two numbers that must be equal, one may be larger. Of a loop of checks, the first or last item is left out."""
    for node, errors in _inside(statement, ast.Compare):
        if errors and len(node.ops) == 1 and isinstance(node.ops[0], ast.Eq | ast.NotEq):
            # No unsigned number is below 0.
            zero = _text(node.comparators[0]) in ("0", "MAJOR")
            for each in (("<=", ">=") if isinstance(node.ops[0], ast.Eq) else (">", "<"))[zero:]:
                own = f"{_text(node.left)} {each} {_text(node.comparators[0])}"
                yield Edit(span(node), own, "missing check of one side", errors)
    for node in ast.walk(statement):
        if isinstance(node, ast.For) and (errors := tuple(check.error for check in checks(node))):
            for part, what in (("[:1]", "all but the first"), ("[1:]", "the first"), ("[:-1]", "the last")):
                yield Edit(span(node.iter), f"list({_text(node.iter)}){part}", f"missing check of {what}", errors)


def _head(loop: ast.For) -> tuple[str, str]:
    return ast.dump(loop.target), ast.dump(loop.iter)


def fused(statement: ast.stmt) -> Iterator[Edit]:
    """Two loops of checks become one, or one becomes two. A check is made before the two checks above it."""
    for body in _bodies(statement):
        for above, one in pairwise(body):
            errors = _errors(above), _errors(one)
            match above, one:
                case ast.For(), ast.For() if all(errors) and _head(above) == _head(one):
                    new = f"\n{' ' * above.body[0].col_offset}".join(map(_text, [above, *one.body]))
                    yield Edit((span(above)[0], span(one)[1]), new, "wrong order: item by item", sum(errors, ()))
        for (a, one, errors), (b, two, others), (c, three, last) in zip(
            *(list(_units(body))[i:] for i in range(3)), strict=False
        ):
            if errors and others and last and not _names([*a, *b], ast.Store) & _names([*c, three], ast.Load):
                order = [*c, three, *a, one, *b, two]
                first = [*a, one][0]
                new = f"\n{' ' * first.col_offset}".join(map(_text, order))
                yield Edit(
                    (span(first)[0], span(three)[1]),
                    new,
                    "wrong order: the third check first",
                    (*errors, *others, *last),
                )
    for node in ast.walk(statement):
        if isinstance(node, ast.For) and len(list(_units(node.body))) > 1 and _errors(node):
            head, indent = text()[span(node)[0] : span(node.body[0])[0]], " " * node.col_offset
            loops = [
                head + f"\n{' ' * node.body[0].col_offset}".join(map(_text, [*above, one]))
                for above, one, _ in _units(node.body)
            ]
            yield Edit(span(node), f"\n{indent}".join(loops), "wrong order: check by check", _errors(node))


# --- how a reader computes otherwise ----------------------------------------------------------------------------------

# The ways to round a / 2^s, a * 2^s and a // s, by the function of the blocks.
_ROUNDINGS = json.loads(Path(__file__).with_name("roundings.json").read_text(encoding="utf-8"))
# By the bytes of a stored integer: how many of its bits are read.
_FEWER = {"1": (7,), "2": (15, 8), "4": (31, 24, 16), "8": (63, 53, 48, 32)}
# Functions whose other divisions and shifts to the right divide numbers that may be negative.
_DIVIDING = {"CONTRACT", "RESCALE", "SELECT", "EXPONENTIAL"}


def tied(statement: ast.stmt) -> Iterator[Edit]:
    """A number is rounded in another way. A zero that is a sum gets the sign of an operand."""
    place = getattr(statement, "name", "")
    for name, ways in _ROUNDINGS.items():
        for node, (a, s) in _calls(statement, name):
            below, _ = bounds().get((place, ast.unparse(node.args[0])), (0, True))
            for what, way in ways.items():
                # Where there is something to round.
                possible = name != "ROUND_F32" or isinstance(node.args[0], ast.BinOp)
                possible = {"first to binary64": below > 53, "subnormal numbers as 0": place == "PACKED_LAYER"}.get(
                    what, possible
                )
                if possible:
                    yield Edit(span(node), f"(lambda a, s: {way})({a}, {s})", f"wrong rounding: {what}")
            match node.args[0]:
                case ast.BinOp(left, ast.Add(), right) if name == "ROUND_F32":
                    for operand in (left, right):
                        new = f"({_text(node)} or (({_text(operand)}) < 0) << 31)"
                        yield Edit(span(node), new, "wrong sign: a zero of the sign of an operand")
    for each in ast.walk(statement) if place in _DIVIDING else ():
        if isinstance(each, ast.BinOp) and isinstance(each.op, ast.FloorDiv | ast.RShift):
            a, s = _text(each.left), _text(each.right)
            s = f"1 << ({s})" if isinstance(each.op, ast.RShift) else s
            for what, way in _ROUNDINGS["//"].items():
                yield Edit(span(each), f"(lambda a, s: {way})({a}, {s})", f"wrong rounding: {what}")


_TYPES = {
    "signed": "(a + {half} & 2 * {half} - 1) - {half}",
    "unsigned": "a & 2 * {half} - 1",
    "saturated": "CLAMP(a, -{half}, {half} - 1)",
}


def typed(statement: ast.stmt) -> Iterator[Edit]:
    """A quantity of 7.11 has a type of 16, 24 or 32 bits that does not hold it: it wraps or saturates."""
    for scope in (node for node in ast.walk(statement) if isinstance(node, ast.FunctionDef)):
        # The first one of each, from which the value of a name is used later.
        sites: dict[str, ast.expr] = {}
        loads = (n for n in ast.walk(scope) if isinstance(getattr(n, "ctx", ast.Load()), ast.Load))
        for node in sorted((n for n in loads if isinstance(n, ast.expr)), key=span, reverse=True):
            sites[ast.unparse(node)] = node
        for key, node in sites.items():
            below, signed = bounds().get((scope.name, key), (0, True))
            for bits in (16, 24, 32):
                for what in [] if below < bits else ["signed", "saturated"] if signed else ["unsigned"][: below - bits]:
                    new = f"(lambda a: {_TYPES[what].format(half=1 << bits - 1)})({_text(node)})"
                    yield Edit(span(node), new, f"wrong width: {bits} bits, {what}")


def _table(name: str) -> list[tuple[Any, ...]]:
    """Returns the rows of a table of the blocks."""
    made: list[tuple[Any, ...]] = ast.literal_eval(_text(definitions()[name]).partition(" = ")[2])
    return made


def stored(statement: ast.stmt) -> Iterator[Edit]:
    """A stored integer is read without its highest bits, or a signed one without its sign."""
    for node, (*_, size) in _calls(statement, "U", "I"):
        for less in _FEWER.get(size[1:-1], ()) if getattr(statement, "name", "") != "READ_TABLES" else ():
            yield Edit(span(node), f"({_text(node)} & {(1 << less) - 1})", f"wrong width: {less} bits are read")
    for each in ast.walk(statement):
        # Counters are used before the lists are read, other fields after that.
        for begin, name in (("for name, size, counter in", "FIRST_FIELDS"), ("extra =", "LISTS")):
            if isinstance(each, ast.stmt) and _text(each).startswith(begin):
                for field, size, *_ in _table(name):
                    for less in _FEWER[str(size)]:
                        new = f'value["{field}"] = [x & {(1 << less) - 1} for x in value["{field}"]]'
                        new += f"\n{' ' * each.col_offset}{_text(each)}"
                        yield Edit(span(each), new, f"wrong width: {less} bits of {field}")


MISREADINGS: tuple[Misreading, ...] = (
    unchecked, split, part, moved, listed, offset, swapped, unclamped, rounded, narrowed, mistaken, skipped, halved,
    fused, tied, typed, stored,
)  # fmt: skip


def edited(misreading: Misreading) -> Iterator[Mutant]:
    """Yields the mutants of a misreading."""
    of_errors, of_functions = demanded()
    for place, statement in definitions().items():
        names = Names(SEED)
        for edit in misreading(statement):
            first, end = edit.at
            name = names.name(place, misreading.__name__, text()[first:end], edit.new)
            broken = dict.fromkeys([of_errors[error] for error in edit.errors] or of_functions.get(place, ()))
            yield planted(name, place, edit.at, edit.new, edit.what, tuple(broken))


@cache
def mutants() -> tuple[Mutant, ...]:
    """Returns the mutants of all misreadings that are planted. One that two of them make is there once."""
    return tuple({mutant.tree: mutant for each in reversed(MISREADINGS) for mutant in edited(each)}.values())
