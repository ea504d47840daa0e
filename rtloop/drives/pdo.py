"""CANopen's process data objects (PDO), as a drive's dialogue checks and configures them (CiA 301).

A PDO has an identifier with a bit that turns it off, a transmission type, and up to eight objects mapped into it. It is
remapped while it is off: the number of objects is set to 0, then each object and their number, then it is turned on.
"""

from __future__ import annotations

from rtloop.drives.sdo import Node, Object
from rtloop.service.conversation import Part

RECEIVED, TOLD = 0x1400, 0x1800
"""First objects of the PDOs that a drive receives (RPDO) and sends (TPDO)."""
MAPPED = 0x200
"""Distance from a PDO's object to the object that holds its mapping."""
PREDEFINED = 4
"""PDOs of each kind that may be on by default."""
SYNCHRONOUS = 1
"""Transmission type: with every SYNC."""
NOT_VALID, NO_REMOTE = 1 << 31, 1 << 30
"""Bits of a PDO's identifier: the PDO is off; it is not sent on a remote request, which some drives insist on."""


def identifier_of(pdo: int) -> Object:
    return Object(pdo, 1, 4, "PDO's identifier")


def type_of(pdo: int) -> Object:
    return Object(pdo, 2, 1, "PDO's transmission type")


def mapping_of(pdo: int, number: int) -> Object:
    """An entry of a PDO's mapping: number 0 is how many objects are mapped, the others are these objects."""
    return Object(pdo + MAPPED, number, 4 if number else 1, "PDO's mapping")


def fits(node: Node, pdo: int, identifier: int, objects: tuple[int, ...]) -> Part[bool]:
    """Whether a PDO is on and has this identifier, the synchronous type and exactly these objects."""
    valid = yield from node.read(identifier_of(pdo))
    if valid & ~NO_REMOTE != identifier or (yield from node.read_if_there(type_of(pdo))) != SYNCHRONOUS:
        return False
    for number, wanted in enumerate((len(objects), *objects)):
        if (yield from node.read_if_there(mapping_of(pdo, number))) != wanted:
            return False
    return True


def map_anew(node: Node, pdo: int, identifier: int, objects: tuple[int, ...]) -> Part[None]:
    """Map a PDO anew (CiA 301): turn it off, clear its mapping, write the new one, turn it on."""
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
    """Turn off a PDO that is not used here: it would load the bus, or take another family's frames for its own."""
    identifier = identifier_of(pdo)
    found = yield from node.read_if_there(identifier)
    if found is not None and not found & NOT_VALID:
        yield from node.write(identifier, found | NOT_VALID)
