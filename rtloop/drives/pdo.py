"""CANopen's process data objects, as a drive's dialogue sees to them (CiA 301).

A PDO has an identifier, of which one bit says that it is off, a transmission type, and up to eight objects mapped into
it. It is mapped anew while it is off: number of objects 0, each object, their number, and then on again.
"""

from __future__ import annotations

from rtloop.drives.sdo import Node, Object
from rtloop.service.conversation import Part

RECEIVED, TOLD = 0x1400, 0x1800
"""First objects of the PDOs that a drive hears and says; where they are mapped stands `MAPPED` further on."""
MAPPED = 0x200
PREDEFINED = 4
"""PDOs of each kind that may be on by default."""
SYNCHRONOUS = 1
"""Transmission type: with every SYNC."""
NOT_VALID, NO_REMOTE = 1 << 31, 1 << 30
"""Bits of a PDO's identifier: it is off; it is not told on request, which some drives insist on."""


def identifier_of(pdo: int) -> Object:
    return Object(pdo, 1, 4, "PDO's identifier")


def type_of(pdo: int) -> Object:
    return Object(pdo, 2, 1, "PDO's transmission type")


def mapping_of(pdo: int, number: int) -> Object:
    """What a PDO holds: number 0 is how many objects, the others are those."""
    return Object(pdo + MAPPED, number, 4 if number else 1, "PDO's mapping")


def fits(node: Node, pdo: int, identifier: int, objects: tuple[int, ...]) -> Part[bool]:
    """Whether a PDO is valid and as it should be."""
    valid = yield from node.read(identifier_of(pdo))
    if valid & ~NO_REMOTE != identifier or (yield from node.read_if_there(type_of(pdo))) != SYNCHRONOUS:
        return False
    for number, wanted in enumerate((len(objects), *objects)):
        if (yield from node.read_if_there(mapping_of(pdo, number))) != wanted:
            return False
    return True


def map_anew(node: Node, pdo: int, identifier: int, objects: tuple[int, ...]) -> Part[None]:
    """Map a PDO anew: off, taken apart, put together, on (CiA 301)."""
    if pdo == TOLD:
        identifier |= (yield from node.read(identifier_of(pdo))) & NO_REMOTE
    yield from node.write(identifier_of(pdo), identifier | NOT_VALID)
    yield from node.write(type_of(pdo), SYNCHRONOUS)
    yield from node.write(mapping_of(pdo, 0), 0)
    for number, mapped in enumerate(objects, 1):
        yield from node.write(mapping_of(pdo, number), mapped)
    yield from node.write(mapping_of(pdo, 0), len(objects))
    yield from node.write(identifier_of(pdo), identifier)


def turn_off(node: Node, pdo: int) -> Part[None]:
    """A PDO that nobody here uses would load the bus, or take another family's frames for its own."""
    identifier = identifier_of(pdo)
    found = yield from node.read_if_there(identifier)
    if found is not None and not found & NOT_VALID:
        yield from node.write(identifier, found | NOT_VALID)
