"""Structured records that are declared once: a class that mypy knows, of whose annotations numpy's dtype is made.

Compiled functions read and write records of that dtype; no object of such a class ever exists. What it gains is that a
signature says which record a function gets, and that mypy knows each of its fields.
"""

from collections.abc import Iterator
from inspect import get_annotations
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
SmallInts = NDArray[np.int8]

T = TypeVar("T")
R = TypeVar("R")


class Rows(Protocol[R]):
    """An array of records."""

    def __getitem__(self, index: int, /) -> R: ...

    def __setitem__(self, index: int, row: R, /) -> None: ...

    def __iter__(self) -> Iterator[R]: ...


class Word(NamedTuple):
    """What is said of a field, "" where nothing is."""

    unit: str
    meaning: str


class Record:
    """A structured record: its annotations are its fields, in their order; the fields of its base classes follow.

    `int` is an i8 and `float` an f8, another record stands where it is named, and an array has its length beside its
    type: `Annotated[Ints, 16]`, `Annotated[Rows[Axis], MAX_JOINTS]`. What a field means may stand last in its
    annotation, and its unit before that: `Annotated[int, "ns", "control period"]`. With `line_bytes`, a last field
    `padding` makes the record as long as a whole number of such lines.

    Attributes:
        hints: each field's annotation, in the order of the fields.
        words: what is said of each field.
        dtype: what numpy and compiled functions know it as.
    """

    hints: ClassVar[dict[str, Any]] = {}
    words: ClassVar[dict[str, Word]] = {}
    dtype: ClassVar[np.dtype[np.void]]

    def __init_subclass__(cls, *, line_bytes: int = 0) -> None:
        own = get_annotations(cls).items()
        cls.hints = {name: hint for name, hint in own if getattr(hint, "__origin__", None) is not ClassVar}
        for base in cls.__bases__:
            cls.hints |= getattr(base, "hints", {})
        if line_bytes:
            cls.hints["padding"] = Annotated[Ints, -_dtype(cls.hints).itemsize % line_bytes // 8]
        cls.words = {name: _word(hint) for name, hint in cls.hints.items()}
        cls.dtype = _dtype(cls.hints)


def _dtype(hints: dict[str, Any]) -> np.dtype[np.void]:
    return np.dtype([(name, _type(hint), tuple(_beside(hint, int))) for name, hint in hints.items()])


def _type(hint: Any) -> Any:
    """Type of a field, or of each element of an array."""
    of = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    if get_origin(of) is Rows:
        of = get_args(of)[0]
    elif get_origin(of) is np.ndarray:
        of = get_args(get_args(of)[1])[0]
    return of.dtype if issubclass(of, Record) else {int: "i8", float: "f8"}.get(of, of)


def _word(hint: Any) -> Word:
    *unit, meaning = _beside(hint, str) or [""]
    return Word("".join(unit), meaning)


def _beside(hint: Any, kind: type[T]) -> list[T]:
    """What of a kind stands beside the type in an annotation."""
    return [one for one in get_args(hint)[1:] if isinstance(one, kind)] if get_origin(hint) is Annotated else []


def offset_of(record: type[Record], *path: str) -> int:
    """Byte offset of a nested field."""
    at, dtype = 0, record.dtype
    for name in path:
        assert dtype.fields is not None
        dtype, here = dtype.fields[name][:2]
        at += here
    return at
