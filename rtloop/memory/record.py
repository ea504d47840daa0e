"""Structured records that are declared once: a class that mypy knows, of whose annotations numpy's dtype is made.

The compiled cycle reads and writes records of that dtype; no object of such a class ever exists. What it gains is that
a signature says which part of the cycle's memory a function gets, and that mypy knows each of its fields.
"""

from collections.abc import Iterator
from inspect import get_annotations
from typing import Annotated, Any, ClassVar, Protocol, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
SmallInts = NDArray[np.int8]

R_co = TypeVar("R_co", covariant=True)


class Rows(Protocol[R_co]):
    """An array of records."""

    def __getitem__(self, index: int, /) -> R_co: ...

    def __iter__(self) -> Iterator[R_co]: ...


class Record:
    """A structured record: its annotations are its fields, in their order.

    `int` is an i8 and `float` an f8, another record stands where it is named, and an array has its length beside its
    type: `Annotated[Ints, 16]`, `Annotated[Rows[Axis], MAX_JOINTS]`. Where a dtype stands there instead of a length, as
    for what `shm.layout` defines, the field has that one.

    Attributes:
        dtype: what numpy and the compiled cycle know it as.
        writers: modules and rooms of rtloop whose compiled functions store into its fields, which a test compares with
            the code. Not among them are the parts' own functions (`memory.updates`); what is stored at an
            address, as the positions of rings are; and what ordinary Python stores: everything before the first cycle
            (`process.initial_state`), and later that it has taken up what `Dialogue` asks for, that the process is
            `closing`, and the records of `service_in`.
    """

    dtype: ClassVar[np.dtype[np.void]]
    writers: ClassVar[tuple[str, ...]]

    def __init_subclass__(cls, *, writers: tuple[str, ...]) -> None:
        # of np.record, whose fields are attributes without the compiler too
        cls.dtype = np.dtype((np.record, [(name, *_form(hint)) for name, hint in get_annotations(cls).items()]))
        cls.writers = writers


def _form(hint: Any) -> tuple[Any, ...]:
    """Type, and where it is an array shape, of a field."""
    if get_origin(hint) is not Annotated:
        return (_type(hint),)
    of, given = get_args(hint)
    if isinstance(given, int):
        element = get_args(of)[0] if get_origin(of) is Rows else get_args(get_args(of)[1])[0]
        return _type(element), (given,)
    return given if isinstance(given, tuple) else (given,)


def _type(hint: Any) -> Any:
    if isinstance(hint, type) and issubclass(hint, Record):
        return hint.dtype
    return {int: "i8", float: "f8"}.get(hint, hint)


def offset_of(dtype: np.dtype[np.void], *path: str) -> int:
    """Byte offset of a nested field."""
    at = 0
    for name in path:
        assert dtype.fields is not None
        dtype, here = dtype.fields[name][:2]
        at += here
    return at
