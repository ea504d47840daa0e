"""The protocols of shared memory on a machine weaker than any real one, and the same with each order weakened.

`memory_model` says what that machine may do. The threads here are the protocols' operations in the order in which the
code has them, which is compared with the code itself; every order in them is needed, as each is weakened in turn and
must then be found guilty.
"""

import ast
import inspect
import textwrap
from dataclasses import replace

import pytest
from memory_model import ACQUIRE, RELAXED, RELEASE, Explorer, Fence, Load, Operation, Registers, Store

from rtloop.commands import request_reader, setpoint_reader
from rtloop.service import rings
from rtloop.service.port import ServicePort
from rtloop.wire import received
from shm import seqlock

SLOTS = 2

Thread = tuple[Operation, ...]


# --- that the machine is weak, and not weaker than the language -----------------------------------------------


def is_possible(outcome: dict[str, int], *threads: Thread) -> bool:
    """Whether the threads may end with these registers, over all threads."""
    return (
        Explorer(*threads).violation(lambda registers: {k: v for r in registers for k, v in r.items()} != outcome)
        is not None
    )


def test_message_passing_needs_both_sides() -> None:
    for store, load in ((RELAXED, RELAXED), (RELEASE, RELAXED), (RELAXED, ACQUIRE), (RELEASE, ACQUIRE)):
        writer: Thread = (Store("data", 1), Store("flag", 1, store))
        reader: Thread = (Load("flag", "flag", load), Load("data", "data"))
        assert is_possible({"flag": 1, "data": 0}, writer, reader) == ((store, load) != (RELEASE, ACQUIRE))


def test_stores_may_wait_and_loads_may_come_late() -> None:
    store_buffering = ((Store("x", 1), Load("y", "a")), (Store("y", 1), Load("x", "b")))
    assert is_possible({"a": 0, "b": 0}, *store_buffering)
    load_buffering = ((Load("x", "a"), Store("y", 1)), (Load("y", "b"), Store("x", 1)))
    assert is_possible({"a": 1, "b": 1}, *load_buffering)
    held = ((Load("x", "a"), Store("y", 1, RELEASE)), (Load("y", "b"), Store("x", 1, RELEASE)))
    assert not is_possible({"a": 1, "b": 1}, *held)


def test_one_location_never_goes_backwards() -> None:
    writer: Thread = (Store("x", 1), Store("x", 2))
    reader: Thread = (Load("x", "a"), Load("x", "b"))
    assert is_possible({"a": 1, "b": 2}, writer, reader)
    assert not is_possible({"a": 2, "b": 1}, writer, reader)


def test_a_branch_holds_back_stores_but_no_loads() -> None:
    writer: Thread = (Store("data", 1), Store("flag", 1, RELEASE))
    branch = Load("flag", "flag", guard=lambda flag: flag == 1)
    assert is_possible({"flag": 1, "data": 0}, writer, (branch, Load("data", "data")))
    assert not is_possible({"a": 1, "flag": 1}, (Load("y", "a"), Store("flag", 1, RELEASE)), (branch, Store("y", 1)))


# --- the ring ----------------------------------------------------------------------------------------------------


def producer(records: int, words: int = 1) -> Thread:
    """Look for room, write the record, publish it (`received.push`, `rings.hand_out`, `ServicePort.post`)."""
    thread: list[Operation] = []
    for k in range(records):
        thread.append(Load("taken", f"room{k}", ACQUIRE, guard=lambda taken, k=k: k - taken < SLOTS))
        thread += [Store(f"slot{k % SLOTS}.{word}", k + 1) for word in range(words)]
        thread.append(Store("written", k + 1, RELEASE))
    return tuple(thread)


def consumer(records: int, words: int = 1) -> Thread:
    """Look whether there is one, read the record, give its slot back (`take_setpoints`, `service`, `received`)."""
    thread: list[Operation] = []
    for k in range(records):
        thread.append(Load("written", f"there{k}", ACQUIRE, guard=lambda written, k=k: written > k))
        thread += [Load(f"slot{k % SLOTS}.{word}", f"read{k}.{word}") for word in range(words)]
        thread.append(Store("taken", k + 1, RELEASE))
    return tuple(thread)


def records_are_right(outcome: tuple[Registers, ...]) -> bool:
    """Whether every record that was read is the one that was written there."""
    read = {name: value for registers in outcome for name, value in registers.items() if name.startswith("read")}
    return all(value == int(name[4:].split(".")[0]) + 1 for name, value in read.items())


@pytest.mark.parametrize(("records", "words"), [(4, 1), (3, 2)])
def test_a_ring_loses_and_repeats_nothing(records: int, words: int) -> None:
    explorer = Explorer(producer(records, words), consumer(records, words))
    assert explorer.violation(records_are_right) is None
    assert explorer.states > 300


def weakened(thread: Thread, order: str) -> Thread:
    """The same thread with everything of an order made relaxed."""
    return tuple(replace(op, order=RELAXED) if not isinstance(op, Fence) and op.order == order else op for op in thread)


@pytest.mark.parametrize(
    ("producing", "consuming"),
    [
        (weakened(producer(3), RELEASE), consumer(3)),
        (producer(3), weakened(consumer(3), ACQUIRE)),
        (producer(3), weakened(consumer(3), RELEASE)),
    ],
    ids=["written is not released", "written is not acquired", "taken is not released"],
)
def test_every_order_of_the_ring_is_needed(producing: Thread, consuming: Thread) -> None:
    assert Explorer(producing, consuming).violation(records_are_right) is not None


def test_looking_for_room_needs_no_acquire_on_a_machine_that_does_not_speculate_stores() -> None:
    """The branch alone holds the writing back; the acquire is there because the language asks for it."""
    assert Explorer(weakened(producer(3), ACQUIRE), consumer(3)).violation(records_are_right) is None


# --- the seqlock -------------------------------------------------------------------------------------------------


def publisher(snapshots: int, words: int = 2) -> Thread:
    """`shm.seqlock.publish`, again and again; the sequence is only read by who writes it."""
    thread: list[Operation] = []
    for k in range(snapshots):
        thread += [Store("sequence", 2 * k + 1), Fence(RELEASE)]
        thread += [Store(f"word{word}", k + 1) for word in range(words)]
        thread += [Fence(RELEASE), Store("sequence", 2 * k + 2)]
    return tuple(thread)


def reader(words: int = 2) -> Thread:
    """One try of `shm.seqlock.read`."""
    return (
        Load("sequence", "before", guard=lambda sequence: sequence % 2 == 0),
        Fence(ACQUIRE),
        *(Load(f"word{word}", f"read{word}") for word in range(words)),
        Fence(ACQUIRE),
        Load("sequence", "after"),
    )


def snapshot_is_whole(outcome: tuple[Registers, ...]) -> bool:
    """Whether a read that was believed is of one snapshot, and of the one its sequence names."""
    registers = outcome[-1]
    if "after" not in registers or registers["before"] != registers["after"]:
        return True
    return all(value == registers["before"] // 2 for name, value in registers.items() if name.startswith("read"))


def without(thread: Thread, which: int) -> Thread:
    """The thread without the fences that stand at that place among those of one turn."""
    fences = [index for index, op in enumerate(thread) if isinstance(op, Fence)]
    return tuple(op for index, op in enumerate(thread) if index not in fences[which::2])


def test_no_snapshot_is_torn() -> None:
    explorer = Explorer(publisher(2), reader())
    assert explorer.violation(snapshot_is_whole) is None
    assert explorer.states > 300


@pytest.mark.parametrize(
    ("publishing", "reading"),
    [
        (without(publisher(2), 0), reader()),
        (without(publisher(2), 1), reader()),
        (publisher(2), without(reader(), 0)),
        (publisher(2), without(reader(), 1)),
    ],
    ids=["behind the odd count", "before the even count", "behind the first look", "before the second look"],
)
def test_every_fence_of_the_seqlock_is_needed(publishing: Thread, reading: Thread) -> None:
    assert Explorer(publishing, reading).violation(snapshot_is_whole) is not None


# --- ordinary Python, which has no order to offer ------------------------------------------------------------------


def plain(thread: Thread) -> Thread:
    """The same without any order: what CPython's plain reads and writes may become."""
    return tuple(replace(op, order=RELAXED) for op in thread if not isinstance(op, Fence))


def sealed(records: int, slots: int = SLOTS) -> Thread:
    """`CommandWriter._append`: three words a record, the number, what it says and the sum of both, in any order."""
    thread: list[Operation] = []
    for k in range(records):
        at, number, says = k % slots, k + 1, k + 10
        thread += [Store(f"slot{at}.number", number), Store(f"slot{at}.says", says)]
        thread += [Store(f"slot{at}.sum", number * 1000 + says), Store("written", k + 1)]
    return tuple(thread)


def unsealing(records: int, slots: int = SLOTS) -> Thread:
    """`take_setpoints`: acquire the head, copy the record; what of it is believed is the judge's matter."""
    thread: list[Operation] = []
    for k in range(records):
        at = k % slots
        thread.append(Load("written", f"there{k}", ACQUIRE, guard=lambda written, k=k: written > k))
        thread += [Load(f"slot{at}.{word}", f"{word}{k}") for word in ("number", "says", "sum")]
    return tuple(thread)


def believed_records_are_right(outcome: tuple[Registers, ...], *, sums: bool = True) -> bool:
    """A record is believed if its number is the expected one and its sum is right; then it says what was written."""
    read = outcome[-1]
    for k in range(len(read)):
        if f"sum{k}" in read and f"number{k}" in read and f"says{k}" in read:
            whole = read[f"sum{k}"] == read[f"number{k}"] * 1000 + read[f"says{k}"]
            if read[f"number{k}"] == k + 1 and (whole or not sums) and read[f"says{k}"] != k + 10:
                return False
    return True


def test_a_record_of_plain_writes_is_believed_only_when_whole() -> None:
    assert Explorer(sealed(2, 1), unsealing(2, 1)).violation(believed_records_are_right) is None
    guilty = Explorer(sealed(2, 1), unsealing(2, 1)).violation(lambda o: believed_records_are_right(o, sums=False))
    assert guilty is not None  # without the CRC the same plain writes are misread


def test_plain_reads_of_a_snapshot_cannot_do_with_the_sequence_alone() -> None:
    """That is why `StateReader.snapshot` judges its copy by the CRC in it."""
    assert Explorer(publisher(2), plain(reader())).violation(snapshot_is_whole) is not None


# --- that the model is the code ------------------------------------------------------------------------------------

ATOMICS = {
    *("load_acquire", "load_relaxed", "store_release", "store_relaxed", "fence_acquire", "fence_release"),
    *("load_word", "store_word", "copy_words", "crc32_at"),
}


def atomics_of(function: object) -> list[str]:
    """The atomic operations of a function in the order in which it comes to them."""
    source = textwrap.dedent(inspect.getsource(getattr(function, "py_func", function)))

    def calls(node: ast.AST) -> list[str]:
        found = [name for child in ast.iter_child_nodes(node) for name in calls(child)]
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            if name in ATOMICS:
                found.append(name)
        return found

    return calls(ast.parse(source).body[0])


CODE = {
    seqlock.publish: (
        *("load_relaxed", "store_relaxed", "fence_release", "copy_words", "copy_words"),
        *("fence_release", "store_relaxed"),
    ),
    seqlock.read: ("load_relaxed", "fence_acquire", "copy_words", "fence_acquire", "load_relaxed"),
    seqlock.copy_words: ("load_relaxed", "store_relaxed"),
    received.chunks_arrived: ("load_acquire",),
    received.taken: ("store_release", "store_release"),
    rings.pass_on: ("load_relaxed", "store_release"),
    rings.waiting: ("load_acquire", "load_relaxed"),
    rings.room: ("load_relaxed", "load_acquire"),
    ServicePort.post: ("store_word",),
    ServicePort.received: ("store_word",),
}
"""What the threads above are made of; the written word of `received.push` is chunks_arrived, published last."""


@pytest.mark.parametrize("function", CODE, ids=lambda function: function.__qualname__)
def test_the_code_does_what_the_model_does(function: object) -> None:
    assert tuple(atomics_of(function)) == CODE[function]


def test_what_is_published_is_published_last() -> None:
    assert atomics_of(received.push)[-1] == "store_release"
    assert atomics_of(setpoint_reader.take_setpoints) == [
        "load_acquire",
        "load_acquire",
        "copy_words",
        "crc32_at",
        "store_release",
    ]
    assert atomics_of(request_reader.take_requests) == ["load_acquire", "copy_words", "crc32_at", "store_release"]
