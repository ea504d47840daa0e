"""Mutants of the functions of a file: each is one small edit of its text, so that lines keep their numbers."""

import ast
import hashlib
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace

COMPARED: dict[type, str] = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.In: "in",
}  # fmt: skip
CALCULATED: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.FloorDiv: "//", ast.Mod: "%",
    ast.LShift: "<<", ast.RShift: ">>", ast.BitAnd: "&", ast.BitOr: "|", ast.BitXor: "^",
}  # fmt: skip
JOINED: dict[type, str] = {ast.And: "and", ast.Or: "or"}
OTHER = {
    **{"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "in": "not in"},
    **{"+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "%": "//"},
    **{"<<": ">>", ">>": "<<", "&": "|", "|": "&", "^": "|", "and": "or", "or": "and"},
}
"""What is written instead of an operator."""
OTHER_FUNCTION = {"min": "max", "max": "min", "floor": "ceil", "ceil": "floor", "round": "int"}
LEFT_OUT = ("abs", "copysign", "swapped")
"""Functions that are left out: their first argument stands alone."""
NOTHING = {"int": "0", "float": "0.0"}
"""What a function of such a result returns instead."""

Edit = tuple[str, int, int, str]
"""Operator, first and last byte in the source, what stands there instead."""


@dataclass(frozen=True)
class Mutant:
    file: str
    function: str
    operator: str
    line: int
    was: str
    """The line, or the first of several, before and after."""
    now: str
    start: int
    end: int
    text: str
    number: int = 1
    """Which one of those that look alike in this function."""

    @property
    def key(self) -> str:
        """Stays the same wherever in its file the function stands."""
        again = f" #{self.number}" if self.number > 1 else ""
        return f"{self.file} {self.function}: {self.was} → {self.now}{again}"

    def applied(self, source: bytes) -> bytes:
        return source[: self.start] + self.text.encode() + source[self.end :]


class Source:
    """A file's bytes, and where in them a node of its syntax tree stands."""

    def __init__(self, text: bytes) -> None:
        self.text = text
        self.line_starts = [0]
        for line in text.splitlines(keepends=True):
            self.line_starts.append(self.line_starts[-1] + len(line))

    def start(self, node: ast.expr | ast.stmt) -> int:
        return self.line_starts[node.lineno - 1] + node.col_offset

    def end(self, node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return self.line_starts[node.end_lineno - 1] + node.end_col_offset

    def of(self, node: ast.expr) -> str:
        return self.text[self.start(node) : self.end(node)].decode()

    def line(self, number: int) -> str:
        return self.text[self.line_starts[number - 1] : self.line_starts[number]].decode().strip()

    def instead(self, operator: str, node: ast.expr | ast.stmt, text: str) -> Edit:
        return operator, self.start(node), self.end(node), text

    def between(self, operator: str, left: ast.expr, right: ast.expr, symbol: str) -> Edit:
        """Another operator between two operands."""
        at = self.text.index(symbol.encode(), self.end(left), self.start(right))
        return operator, at, at + len(symbol), OTHER[symbol]


def edits(source: Source, function: ast.FunctionDef) -> Iterator[Edit]:
    """All edits of a function's body; `compare`, `arithmetic`, `constant`, `condition`, `call`, `drop`, `return`."""
    fillers = {
        id(element)
        for node in ast.walk(function)
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple)
        for element in node.value.elts
        if isinstance(element, ast.Constant) and element.value == 0 and isinstance(element.value, int)
    }  # words of a result that says that there is none
    for statement in function.body:
        for node in ast.walk(statement):
            match node:
                case ast.Compare():
                    operands = [node.left, *node.comparators]
                    for left, kind, right in zip(operands, node.ops, operands[1:], strict=False):
                        if type(kind) in COMPARED:
                            yield source.between("compare", left, right, COMPARED[type(kind)])
                case ast.BinOp() if type(node.op) in CALCULATED:
                    yield source.between("arithmetic", node.left, node.right, CALCULATED[type(node.op)])
                case ast.UnaryOp(op=ast.USub()):
                    yield source.instead("arithmetic", node, f"({source.of(node.operand)})")
                case ast.BoolOp():
                    for left, right in zip(node.values, node.values[1:], strict=False):
                        yield source.between("condition", left, right, JOINED[type(node.op)])
                case ast.If() | ast.IfExp():
                    yield source.instead("condition", node.test, f"(not ({source.of(node.test)}))")
                case ast.Constant(value=bool() as value):
                    yield source.instead("constant", node, str(not value))
                case ast.Constant(value=int() as value) if id(node) not in fillers:
                    yield source.instead("constant", node, str(value + 1))
                    yield source.instead("constant", node, f"({value - 1})")
                case ast.Constant(value=float() as value):
                    yield source.instead("constant", node, str(2.0 * value or 1.0))
                case ast.Call(args=[first, *_], func=ast.Name(id=name) | ast.Attribute(attr=name)):
                    if name in LEFT_OUT:
                        yield source.instead("call", node, f"({source.of(first)})")
                    elif name in OTHER_FUNCTION:
                        called = node.func
                        end = source.end(called)
                        other = OTHER_FUNCTION[name]
                        yield "call", end - len(name), end, other
                case ast.AugAssign() | ast.Expr(value=ast.Call()):
                    yield source.instead("drop", node, "pass")
                case ast.Assign(targets=[ast.Attribute() | ast.Subscript(), *_]):
                    yield source.instead("drop", node, "pass")
                case ast.Return(value=ast.expr() as value) if isinstance(function.returns, ast.Name):
                    if source.of(value).rpartition(".")[2].isupper() or isinstance(value, ast.Constant):
                        continue  # a constant, which may itself be 0
                    if function.returns.id == "bool":
                        yield source.instead("return", value, f"not ({source.of(value)})")
                    elif function.returns.id in NOTHING:
                        yield source.instead("return", value, NOTHING[function.returns.id])


def mutants(file: str, text: bytes, functions: Sequence[str] = ()) -> list[Mutant]:
    """All mutants of a file's functions, or of those that are named."""
    source = Source(text)
    found: list[Mutant] = []
    seen: Counter[str] = Counter()
    tree = ast.parse(text)
    definitions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    inner = {id(node) for outer in definitions for node in ast.walk(outer) if node is not outer}
    definitions = [node for node in definitions if id(node) not in inner]  # one within another is part of it
    unknown = set(functions) - {definition.name for definition in definitions}
    assert not unknown, f"{file} has no function {', '.join(sorted(unknown))}"
    for definition in definitions:
        if functions and definition.name not in functions:
            continue
        for operator, start, end, instead in edits(source, definition):
            line = text.count(b"\n", 0, start) + 1
            mutant = Mutant(file, definition.name, operator, line, source.line(line), "", start, end, instead)
            mutant = replace(mutant, now=Source(mutant.applied(text)).line(line))
            seen[mutant.key] += 1
            found.append(replace(mutant, number=seen[mutant.key]))
    return found


def spread(items: Sequence[Mutant], group: Callable[[Mutant], Hashable]) -> list[Mutant]:
    """The first of each group, then the second of each, and so on."""
    seen: Counter[Hashable] = Counter()
    turns = []
    for item in items:
        turns.append(seen[group(item)])
        seen[group(item)] += 1
    return [items[i] for i in sorted(range(len(items)), key=turns.__getitem__)]


def in_turn(items: Sequence[Mutant], seed: int) -> list[Mutant]:
    """In an order that the seed chooses, in which files take turns, and within a file its functions and operators.

    What is added or taken out leaves the order of the others as it is.
    """
    shuffled = sorted(items, key=lambda mutant: hashlib.sha256(f"{seed} {mutant.key}".encode()).digest())
    of_operators = spread(shuffled, lambda mutant: (mutant.file, mutant.operator))
    of_functions = spread(of_operators, lambda mutant: (mutant.file, mutant.function))
    return spread(of_functions, lambda mutant: mutant.file)
