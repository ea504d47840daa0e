"""Who stores into which part of the cycle's memory: what the records say of themselves, compared with the code.

Looked at are the compiled functions, which read and write by attribute: their types are followed from the annotations
of their parameters through local names. Records of `shm.layout` say nothing of who writes them and have no owner here:
the state file, and what the cycle's memory has of such records (`snapshot`, `record`, waypoints, tolerances, scratch).
"""

import ast
import importlib
from collections.abc import Iterator
from inspect import isfunction
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import numpy as np
import pytest

from rtloop.memory.owned_record import OwnedRecord
from rtloop.memory.state import Loop
from shm.record import Record, Rows

ROOT = Path(__file__).parents[3]


def records(of: type[OwnedRecord] = Loop) -> Iterator[type[OwnedRecord]]:
    """A record and those in it."""
    yield of
    for hint in of.hints.values():
        element = element_of(hint) if get_origin(hint) is Annotated else hint
        if isinstance(element, type) and issubclass(element, OwnedRecord):
            yield from records(element)


def element_of(hint: Any) -> Any:
    """What one element of an annotated array is; Any where that is no record."""
    of = get_args(hint)[0]
    return get_args(of)[0] if get_origin(of) is Rows else Any


class Stores(ast.NodeVisitor):
    """The stores of one function: (record, field), and what they are stored through where that is not known."""

    def __init__(self, parameters: dict[str, Any], module: dict[str, Any]) -> None:
        self.local, self.module = dict(parameters), module
        self.arrays: dict[str, tuple[type[OwnedRecord], str]] = {}
        self.found: set[tuple[type[OwnedRecord], str]] = set()
        self.unknown: list[str] = []

    def type_of(self, node: ast.expr) -> Any:
        """The type of an expression, None where it is not known."""
        if isinstance(node, ast.Name):
            return self.local.get(node.id)
        if isinstance(node, ast.Attribute):
            of = self.type_of(node.value)
            return of.hints.get(node.attr) if isinstance(of, type) and issubclass(of, Record) else None
        if isinstance(node, ast.Subscript):
            of = self.type_of(node.value)
            return element_of(of) if get_origin(of) is Annotated else of
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            called = self.module.get(node.func.id)
            called = getattr(called, "py_func", called)
            return called.__annotations__.get("return") if isfunction(called) else None
        return None

    def origin_of(self, node: ast.expr) -> tuple[type[OwnedRecord], str] | None:
        """The record and field that an array is, None for what is no array of a record."""
        if isinstance(node, ast.Name):
            return self.arrays.get(node.id)
        if isinstance(node, ast.Attribute):
            of = self.type_of(node.value)
            if isinstance(of, type) and issubclass(of, OwnedRecord):
                return of, node.attr
        return None

    def stored(self, target: ast.expr, value: ast.expr | None) -> None:
        if isinstance(target, ast.Tuple):
            values = value.elts if isinstance(value, ast.Tuple) else [None] * len(target.elts)
            for one, its in zip(target.elts, values, strict=True):
                self.stored(one, its)
        elif isinstance(target, ast.Name):
            self.local[target.id] = None if value is None else self.type_of(value)
            self.arrays.pop(target.id, None)
            if value is not None and (origin := self.origin_of(value)) is not None:
                self.arrays[target.id] = origin
        else:
            while isinstance(target, ast.Subscript):
                target = target.value
            if not isinstance(target, ast.Attribute):
                self.found |= {origin for origin in [self.origin_of(target)] if origin is not None}
                return
            of = self.type_of(target.value)
            if not (isinstance(of, type) and issubclass(of, Record)):
                self.unknown.append(ast.unparse(target))
                return
            assert target.attr in of.hints, ast.unparse(target)
            if issubclass(of, OwnedRecord):
                self.found.add((of, target.attr))

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            self.stored(target, node.value)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self.stored(node.target, node.value)

    def visit_For(self, node: ast.For) -> None:
        self.stored(node.target, None)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        if not isinstance(node.target, ast.Name):
            self.stored(node.target, None)


def stores(path: Path) -> Iterator[Stores]:
    """The stores of each compiled function of a file."""
    module = vars(importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts)))
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef) or not any(ast.unparse(one) == "jit" for one in node.decorator_list):
            continue
        parameters = {
            one.arg: eval(ast.unparse(one.annotation), module) for one in node.args.args if one.annotation is not None
        }
        found = Stores(parameters, module)
        for statement in node.body:
            found.visit(statement)
        yield found


FILES = sorted(path for path in (ROOT / "rtloop").rglob("*.py") if "@jit" in path.read_text(encoding="utf-8"))


def writers() -> dict[type[OwnedRecord], set[str]]:
    """The modules that store into each record, the parts' own functions aside."""
    found: dict[type[OwnedRecord], set[str]] = {record: set() for record in records()}
    for path in FILES:
        if path == ROOT / "rtloop/memory/updates.py":
            continue
        for function in stores(path):
            for record, _ in function.found:
                found[record].add(".".join(path.relative_to(ROOT / "rtloop").with_suffix("").parts))
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_it_is_known_into_what_a_function_stores(path: Path) -> None:
    assert [target for function in stores(path) for target in function.unknown] == []


def covers(writer: str, module: str) -> bool:
    """Whether a module is the one that is named, or in the room that is."""
    return module == writer or module.startswith(f"{writer}.")


WRITERS = writers()


@pytest.mark.parametrize("record", WRITERS, ids=lambda record: record.__name__)
def test_a_record_names_those_who_store_into_it(record: type[OwnedRecord]) -> None:
    found = WRITERS[record]
    assert {module for module in found if not any(covers(writer, module) for writer in record.writers)} == set()
    assert {writer for writer in record.writers if not any(covers(writer, module) for module in found)} == set()


@pytest.mark.parametrize("record", WRITERS, ids=lambda record: record.__name__)
def test_a_field_is_read_by_its_name_without_the_compiler_too(record: type[OwnedRecord]) -> None:
    """One that is called as something that every record of numpy has would not be; the system's own are never read."""
    assert [name for name in record.hints if hasattr(np.record, name)] in ([], ["flags"])
