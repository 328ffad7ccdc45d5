"""Wrong decoders that nobody chose: a fixed sample of the small changes that the blocks of SPEC.md allow."""

import ast
import copy
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from itertools import pairwise

from .mutant import Mutant, Names, definitions, planted, span, text

# One in SHARE of the changes of a function or constant is taken, but at least LEAST.
SHARE, LEAST = 10, 1
SEED = "c3gs mutants 0"

Change = tuple[str, ast.AST]

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
_ARITHMETIC: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Add,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.BitXor: (ast.BitOr,),
}
_OTHER_FUNCTION = {"min": "max", "max": "min", "all": "any", "any": "all"}


def compare(node: ast.AST) -> Iterator[Change]:
    """A comparison becomes its neighbour or its opposite."""
    if isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            for other in _COMPARISONS[type(operator)]:
                changed = copy.deepcopy(node)
                changed.ops[i] = other()
                yield "another comparison", changed


def constant(node: ast.AST) -> Iterator[Change]:
    """A number becomes one more or one less, a truth value the other."""
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "the other truth value", ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield "one more", ast.Constant(node.value + 1)
        yield "one less", ast.Constant(node.value - 1)


def arithmetic(node: ast.AST) -> Iterator[Change]:
    """Another arithmetic operator."""
    if isinstance(node, ast.BinOp | ast.AugAssign):
        for other in _ARITHMETIC.get(type(node.op), ()):
            changed = copy.deepcopy(node)
            changed.op = other()
            yield "another operator", changed


def logic(node: ast.AST) -> Iterator[Change]:
    """and becomes or; one operand of either is left out; not and the minus sign are left out."""
    if isinstance(node, ast.BoolOp):
        changed = copy.deepcopy(node)
        changed.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield "and for or", changed
        for i in range(len(node.values)):
            rest = [copy.deepcopy(value) for j, value in enumerate(node.values) if j != i]
            yield "a condition less", rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
    elif isinstance(node, ast.UnaryOp):
        yield "without its sign", copy.deepcopy(node.operand)


def condition(node: ast.AST) -> Iterator[Change]:
    """A condition becomes its opposite."""
    if isinstance(node, ast.IfExp):
        yield "the other case", ast.IfExp(*map(copy.deepcopy, (node.test, node.orelse, node.body)))


def removal(node: ast.AST) -> Iterator[Change]:
    """A statement that is run for its effect is left out."""
    effect = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    if effect or isinstance(node, ast.AugAssign | ast.Raise | ast.Continue):
        yield "left out", ast.Pass()


def _swaps(items: list[ast.expr]) -> Iterator[list[ast.expr]]:
    """The items with two neighbours swapped that differ. A text and something else stay: that would only crash."""
    for i, (a, b) in enumerate(pairwise(items)):
        texts = [isinstance(item, ast.Constant) and isinstance(item.value, str) for item in (a, b)]
        if (
            texts[0] == texts[1]
            and ast.dump(a) != ast.dump(b)
            and not isinstance(a, ast.Starred)
            and not isinstance(b, ast.Starred)
        ):
            yield [*items[:i], b, a, *items[i + 2 :]]


def arguments(node: ast.AST) -> Iterator[Change]:
    """Two arguments, or two items of a tuple, change places."""
    if isinstance(node, ast.Call):
        for swapped in _swaps(node.args):
            yield "arguments swapped", ast.Call(node.func, swapped, node.keywords)
    elif isinstance(node, ast.Tuple) and isinstance(node.ctx, ast.Load):
        for swapped in _swaps(node.elts):
            yield "items swapped", ast.Tuple(swapped, ast.Load())


def bounds(node: ast.AST) -> Iterator[Change]:
    """A slice loses a bound."""
    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Load) and isinstance(node.slice, ast.Slice):
        for bound in ("lower", "upper", "step"):
            if getattr(node.slice, bound) is not None:
                changed = copy.deepcopy(node)
                setattr(changed.slice, bound, None)
                yield "a slice without a bound", changed


def function(node: ast.AST) -> Iterator[Change]:
    """The least for the largest, any for all."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _OTHER_FUNCTION:
        changed = copy.deepcopy(node)
        changed.func = ast.Name(_OTHER_FUNCTION[node.func.id], ast.Load())
        yield "another function", changed


OPERATORS: tuple[Callable[[ast.AST], Iterator[Change]], ...] = (
    compare, constant, arithmetic, logic, condition, removal, arguments, bounds, function,
)  # fmt: skip


def _inside(node: ast.AST, scope: str) -> Iterator[tuple[str, ast.AST]]:
    """Yields the nodes below a node that are executed, each with the qualified name of its function."""
    for child in ast.iter_child_nodes(node):
        inner = f"{scope}.{child.name}" if isinstance(child, ast.FunctionDef) else scope
        yield inner, child
        yield from _inside(child, inner)


@cache
def points(place: str) -> tuple[Mutant, ...]:
    """Returns all changes of a function or constant of the blocks."""
    mutants: list[Mutant] = []
    names = Names(SEED)
    for scope, node in _inside(definitions()[place], place):
        for operator in OPERATORS:
            if operator is arguments and place == "ERRORS":
                # The class, clause and meaning of an error are reported, but not judged.
                continue
            for what, change in operator(node):
                first, end = span(node)
                new = ast.unparse(ast.fix_missing_locations(change))
                name = names.name(scope, operator.__name__, text()[first:end], new)
                new = new if isinstance(node, ast.stmt) else f"({new})"
                mutants.append(planted(name, place, (first, end), new, what))
    return tuple(mutants)


def _rank(mutants: Iterable[Mutant]) -> list[Mutant]:
    """Returns the changes of a place by hash, one of each operator before the second one of any."""
    times: dict[str, int] = defaultdict(int)
    keyed = []
    for mutant in sorted(mutants, key=lambda m: m.id.rpartition("-")[2]):
        _, operator, digest = mutant.id.rsplit("-", 2)
        times[operator] += 1
        keyed.append((times[operator], digest, mutant))
    return [mutant for *_, mutant in sorted(keyed, key=lambda k: k[:2])]


@cache
def sample() -> tuple[Mutant, ...]:
    """Returns some changes of each place, chosen by hash: an edit of one place does not change the choice in others."""
    chosen: list[Mutant] = []
    for place in definitions():
        mutants = points(place)
        chosen += _rank(mutants)[: max(LEAST, len(mutants) // SHARE)]
    return tuple(chosen)
