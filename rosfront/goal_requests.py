# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""Takes an action server's goal requests as bytes in a thread of its own, with the interpreter unlocked.

rclpy takes a request with the interpreter locked, from the middleware's copy to the last of the objects that it makes
of the request. Meanwhile no thread of this process runs, not even the one with the heartbeat. The C functions below are
those that rclpy itself calls. Called from here they do not lock the interpreter, and the request that they took is
serialised again: bytes are the one form that depends on no memory layout. What a C function is given is made and freed
by other C functions and never read here.
"""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from control_msgs.action import FollowJointTrajectory
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message

from rosfront.goal_bytes import goal_id
from rosfront.serving import Arrival

Request: Any = FollowJointTrajectory.Impl.SendGoalService.Request
Response: Any = FollowJointTrajectory.Impl.SendGoalService.Response
SOON_S = 0.002
"""How long the executor waits for a request to be taken: ten times what a usual one needs."""
LONGEST_STOP_S = 0.2
"""How long `stop` waits; a request that takes longer is left to a thread that ends with the process."""
_TAKE_FAILED = 2201
"""RCL_RET_ACTION_SERVER_TAKE_FAILED: there is no request."""
_HEADER_SIZE = 256
"""Bytes, ten times those of a rmw_request_id_t."""


class Unavailable(Exception):
    """This ROS installation does not offer what is needed."""


class GoalRequest(NamedTuple):
    """A request that was taken from the middleware."""

    goal_id: bytes
    data: np.ndarray
    """(n,) bytes, serialised."""
    arrival: Arrival
    """When it arrived, or earlier: requests taken one after another have the arrival of the first."""
    header: Any
    """The middleware's header of the request, needed to answer it."""


class _Allocator(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")]


class _Bytes(ctypes.Structure):
    """A rcutils_uint8_array_t, which the middleware fills."""

    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _ErrorString(ctypes.Structure):
    _fields_ = [("text", ctypes.c_char * 1024)]


class _Messages:
    """rclpy's functions for a message class: they make, fill and free its C message."""

    def __init__(self, kind: Any) -> None:
        """Raises AttributeError, ValueError when rclpy lacks one of them."""
        pointer, address = ctypes.pythonapi.PyCapsule_GetPointer, ctypes.c_void_p
        pointer.restype, pointer.argtypes = address, (ctypes.py_object, ctypes.c_char_p)
        known = type(kind)
        if known._TYPE_SUPPORT is None:
            known.__import_type_support__()
        self._create = ctypes.CFUNCTYPE(address)(pointer(known._CREATE_ROS_MESSAGE, None))
        self._free = ctypes.CFUNCTYPE(None, address)(pointer(known._DESTROY_ROS_MESSAGE, None))
        fill = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, address)  # it reads rclpy's message, so it locks
        self._fill = fill(pointer(known._CONVERT_FROM_PY, None))
        self.type_support: int = pointer(known._TYPE_SUPPORT, None)

    @contextmanager
    def new(self) -> Iterator[int]:
        """The address of an empty C message; raises MemoryError."""
        made: int | None = self._create()
        if made is None:
            raise MemoryError
        try:
            yield made
        finally:
            self._free(made)

    @contextmanager
    def of(self, message: Any) -> Iterator[int]:
        """The address of a C message with the contents of rclpy's message; raises MemoryError, ValueError."""
        with self.new() as made:
            if not self._fill(message, made):
                raise ValueError(f"rclpy does not fill a {type(message).__name__}")
            yield made


class GoalFunctions:
    """The functions of rclpy's libraries that take and answer the goal requests of an action server."""

    def __init__(self) -> None:
        """Raises Unavailable."""
        try:
            self._find_functions()
            self._requests, self._responses = _Messages(Request), _Messages(Response)
            self._try_a_request()
        except (OSError, AttributeError, ValueError, RuntimeError) as problem:
            raise Unavailable(str(problem)) from problem

    def _find_functions(self) -> None:
        library = ctypes.CDLL(rclpy_implementation.__file__)  # finds its own functions and those of all it depends on
        pointer, code, serialised = ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(_Bytes)

        def function(name: str, result: Any, *arguments: Any) -> Any:
            found = library[name]
            found.restype, found.argtypes = result, arguments
            return found

        self._take = function("rcl_action_take_goal_request", code, pointer, pointer, pointer)
        self._answer = function("rcl_action_send_goal_response", code, pointer, pointer, pointer)
        self._serialise = function("rmw_serialize", code, pointer, pointer, serialised)
        self._begin = function(
            "rcutils_uint8_array_init", code, serialised, ctypes.c_size_t, ctypes.POINTER(_Allocator)
        )
        self._end = function("rcutils_uint8_array_fini", code, serialised)
        self._error = function("rcutils_get_error_string", _ErrorString)
        self._reset_error = function("rcutils_reset_error", None)
        self._allocator = function("rcutils_get_default_allocator", _Allocator)()

    def _try_a_request(self) -> None:
        """Raise ValueError unless rclpy reads the bytes made here of a request as that request."""
        request = Request()
        request.goal_id.uuid = np.arange(1, 17, dtype=np.uint8)
        request.goal.trajectory.joint_names = ["joint"]
        with self._requests.of(request) as made:
            data = self._serialised(made)
        if deserialize_message(data.tobytes(), Request) != request or goal_id(data) != bytes(range(1, 17)):
            raise ValueError("a serialised goal request has another form")

    def take(self, server: int) -> tuple[np.ndarray, Any] | None:
        """The next request of an action server: (n,) bytes, and the header for its answer; None when there is none.

        Raises RuntimeError, MemoryError.
        """
        header = ctypes.create_string_buffer(_HEADER_SIZE)
        with self._requests.new() as made:
            code = self._take(server, header, made)
            if code == _TAKE_FAILED:
                return None
            self._check(code)
            return self._serialised(made), header

    def answer(self, server: int, header: Any, response: Any) -> None:
        """Answer with rclpy's message; raises RuntimeError when the client cannot be reached any more."""
        with self._responses.of(response) as made:
            self._check(self._answer(server, header, made))

    def _serialised(self, message: int) -> np.ndarray:
        """A C request as bytes, (n,)."""
        found = _Bytes()
        self._check(self._begin(found, 0, self._allocator))
        try:
            self._check(self._serialise(message, self._requests.type_support, found))
            data = np.empty(found.length, np.uint8)
            ctypes.memmove(data.ctypes.data, found.buffer, found.length)
        finally:
            self._end(found)
        return data

    def _check(self, code: int) -> None:
        """Raise RuntimeError when a function returned anything but success."""
        if code:
            text = self._error().text.decode(errors="replace")
            self._reset_error()
            raise RuntimeError(f"{text} (code {code})")


class GoalRequests(threading.Thread):
    """Takes the requests that the executor finds, whose wait set has the server.

    The functions called here use only the server's goal service, from which nothing else takes.
    """

    def __init__(
        self,
        functions: GoalFunctions,
        handle: Any,
        executor: Executor,
        arrival: Callable[[], Arrival],
        say: Callable[[str], Any],
    ) -> None:
        """`handle` is rclpy's handle of the action server; `arrival` is called when requests are found.

        `say` is called with a sentence about a request that could not be taken.
        """
        super().__init__(name="goal-requests", daemon=True)
        self._functions = functions
        self._handle = handle
        self._server: int = handle.pointer
        self._executor = executor
        self._arrival = arrival
        self._say = say
        self._lock = threading.Lock()
        self._found: Arrival | None = None
        self._taking = False
        self._taken: deque[GoalRequest] = deque()
        self._changed = threading.Event()
        self._wanted = threading.Event()
        self._leaving = False

    # --- in the executor's thread ---

    def find(self) -> None:
        """Have the thread take the requests; waits until it has taken the first, `SOON_S` at most."""
        with self._lock:
            if self._found is None:
                self._found = self._arrival()
            self._changed.clear()
            self._wanted.set()
        self._changed.wait(SOON_S)

    @property
    def taken(self) -> bool:
        """Whether `pop` has a request."""
        return bool(self._taken)

    def pop(self) -> GoalRequest:
        """Remove and return the next request that was taken."""
        request = self._taken.popleft()
        if self._taken:
            self._executor.wake()
        return request

    @property
    def idle(self) -> bool:
        """Whether no request is being taken or waits for `pop`."""
        with self._lock:
            return not (self._found or self._taking or self._taken)

    def answer(self, request: GoalRequest, response: Any) -> None:
        """Answer a request with rclpy's message; raises RuntimeError when its client cannot be reached."""
        self._functions.answer(self._server, request.header, response)

    def stop(self) -> None:
        """Take no further request; returns within `LONGEST_STOP_S`."""
        self._leaving = True
        self._wanted.set()
        if self.is_alive():
            self.join(LONGEST_STOP_S)

    # --- in the thread of this class ---

    def run(self) -> None:
        try:
            with self._handle:
                while self._take_all():
                    pass
        except BaseException as problem:
            failure = problem

            def fail() -> None:
                raise failure

            self._executor.create_task(fail)

    def _take_all(self) -> bool:
        """Wait until there are requests, and take them until there is none; returns False when the thread is to end."""
        self._wanted.wait()
        with self._lock:
            self._wanted.clear()
            arrival, self._found = self._found, None
            self._taking = arrival is not None
        try:
            while arrival and not self._leaving and (taken := self._functions.take(self._server)):
                data, header = taken
                self._taken.append(GoalRequest(goal_id(data), data, arrival, header))
                self._changed.set()
                self._executor.wake()
        except (RuntimeError, MemoryError) as problem:
            reason = str(problem) or "there is no memory for it"
            self._say(f"A goal could not be received, and its client gets no answer: {reason}; send it again.")
        self._taking = False
        self._changed.set()
        return not self._leaving
