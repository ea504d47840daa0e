# mypy: allow-untyped-calls
# (rclpy annotates some of its functions and leaves the others untyped)
"""Whether another process serves the arm's action too: every server of an action's name takes every goal.

ROS' discovery shows a server that was killed for another 20 s, and says neither whose a server is nor whether it lives.
So where discovery shows more than one, this module asks all of them for the result of a goal that none has. A live
server of any implementation answers that at once and does nothing else; a front of ours answers with its identity. This
runs in a thread of its own: the executor need not wake for it, and a goal can wait for it.
"""

import json
import os
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass
from typing import Any
from uuid import uuid4

from control_msgs.action import FollowJointTrajectory
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from config.errors import legible
from rosfront.apart import Apart

EVERY_NS = 1_000_000_000
"""Period of looking at discovery, and of asking the servers that it shows."""
PATIENCE_NS = 500_000_000
"""A server that has not answered within this time counts as dead, until it answers."""
AGAIN_NS = 100_000_000
"""Period of asking a newcomer until an answer comes: a server just discovered may not receive requests yet."""
LIVE_NS = 2_500_000_000
"""How long a server counts as live after an answer: two requests in a row may be lost on a busy machine."""
LONGEST_LOOK_S = 2.0
_LONGEST_ANSWER = 1000
_LONGEST_WORD = 60
_PIDS = 1 << 22
"""Pids of Linux are lower."""
_MOST_ANSWERS = 50
"""Answers taken in one look."""
_FAST_DDS = b"\x01\x0f"
_MACHINE = slice(2, 4)
"""Bytes of a Fast DDS identifier that name the machine; they are the same for all of its processes."""


@dataclass(frozen=True)
class Server:
    """The identity with which a front of ours answers."""

    instance: str
    """Unique for each start."""
    arm: str
    pid: int
    host: str
    node: str

    @classmethod
    def this(cls, arm: str, node: str) -> "Server":
        return cls(uuid4().hex, arm, os.getpid(), socket.gethostname(), node)

    def written(self) -> str:
        return json.dumps({"rtarm": asdict(self)})

    @classmethod
    def read(cls, text: str) -> "Server | None":
        """The server that gave an answer; None where that is no front of ours."""
        try:
            said = json.loads(text[:_LONGEST_ANSWER])["rtarm"]
            arm, host, node = (legible(str(said[name]), _LONGEST_WORD) for name in ("arm", "host", "node"))
            pid = int(said["pid"])
            return cls(str(said["instance"]), arm, pid, host, node) if 0 < pid < _PIDS else None
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            return None


class Watch:
    """Which servers live, by what discovery shows and what they answer; times are of CLOCK_MONOTONIC (ns)."""

    def __init__(self) -> None:
        self._asked: frozenset[bytes] = frozenset()
        self._asked_ns = self._since_ns = -EVERY_NS
        self._settled: frozenset[bytes] = frozenset()
        self._settled_ns = 0
        self._heard_ns: dict[str, int] = {}

    def should_ask(self, shown: Collection[bytes], now_ns: int) -> bool:
        """Whether it is time to ask the servers that discovery shows; `shown` is empty where this server is alone."""
        return bool(shown) and (not self._asked.issuperset(shown) or now_ns >= self._next_question_ns)

    def asked(self, shown: Collection[bytes], now_ns: int) -> None:
        """Note that the servers shown have been asked."""
        if not self._asked.issuperset(shown) or now_ns - self._since_ns >= EVERY_NS:
            self._since_ns = now_ns
        self._asked, self._asked_ns = frozenset(shown), now_ns

    def answered(self, text: str, now_ns: int) -> None:
        """Note the answer of a server other than this one."""
        self._heard_ns[text] = now_ns

    def live(self, shown: Collection[bytes], now_ns: int) -> list[str]:
        """The answers of the servers that live."""
        self._heard_ns = {text: at_ns for text, at_ns in self._heard_ns.items() if shown and now_ns - at_ns < LIVE_NS}
        return sorted(self._heard_ns)

    def is_known(self, shown: Collection[bytes], now_ns: int) -> bool:
        """Whether another server lives, or none is shown, or all shown have had time to answer and have not."""
        if self._asked and now_ns >= self._settles_ns:
            self._settled, self._settled_ns = self._asked, self._since_ns
        silent = self._settled.issuperset(shown) and now_ns - self._settled_ns < LIVE_NS
        return not shown or silent or bool(self.live(shown, now_ns))

    def next_ns(self, now_ns: int) -> int:
        """When to look again, if nothing happens before."""
        due = (self._settles_ns, self._next_question_ns)
        return min((at_ns for at_ns in due if at_ns > now_ns), default=now_ns + EVERY_NS)

    @property
    def _settles_ns(self) -> int:
        """When servers without an answer count as silent; the last request, often a late one, needs time as well."""
        return max(self._since_ns + PATIENCE_NS, self._asked_ns + AGAIN_NS)

    @property
    def _next_question_ns(self) -> int:
        """When to ask again, if no newcomer is shown before."""
        again_ns = self._asked_ns + AGAIN_NS
        has_newcomers = not self._settled.issuperset(self._asked)
        unanswered = max(self._heard_ns.values(), default=0) < self._since_ns
        if has_newcomers and unanswered and again_ns < self._since_ns + PATIENCE_NS:
            return again_ns
        return self._since_ns + EVERY_NS


class OtherServers(threading.Thread):
    """Looks for other servers once a second, and for each goal that comes."""

    def __init__(self, node: Node, action: str, me: Server, changed: Callable[[str], None]) -> None:
        """`changed` is called in this thread with a sentence: who else serves and what to do; empty for no other."""
        super().__init__(name="other-servers", daemon=True)
        self._node, self._me, self._changed = node, me, changed
        self._controller = node.get_name()
        self._action = node.resolve_service_name(action)
        self._service, self._status = f"{self._action}/_action/get_result", f"{self._action}/_action/status"
        group = Apart()
        self._type = FollowJointTrajectory.Impl.GetResultService
        self._client = node.create_client(self._type, self._service, callback_group=group)
        self._wake = node.create_guard_condition(lambda: None, callback_group=group)
        assert node.context.handle is not None
        self._context = node.context.handle
        self._watch = Watch()
        self._concluded = threading.Condition()
        self._looks_asked = self._looks_done = 0
        self._said = ""
        self._leaving = False

    def stop(self) -> None:
        """End the thread, and every `look` that waits for it."""
        with self._concluded:
            self._leaving = True
            self._concluded.notify_all()
        self._wake.trigger()
        if self.is_alive():
            self.join()

    def look(self) -> None:
        """Wait until it is known which servers live now, `LONGEST_LOOK_S` at most; call from any other thread."""
        with self._concluded:
            self._looks_asked += 1
            mine = self._looks_asked
            self._wake.trigger()
            self._concluded.wait_for(lambda: self._looks_done >= mine or self._leaving, LONGEST_LOOK_S)

    def run(self) -> None:
        client, wake = self._client.handle, self._wake.handle
        with client, wake, self._context:
            wait_set = rclpy_implementation.WaitSet(0, 1, 0, 1, 0, 0, self._context)
            while not self._leaving:
                next_ns = self._look_once()
                wait_set.clear_entities()
                wait_set.add_client(client)
                wait_set.add_guard_condition(wake)
                wait_set.wait(max(next_ns - time.monotonic_ns(), 0))

    def _look_once(self) -> int:
        """Look at discovery, take the answers, ask if it is time; returns when to look again (CLOCK_MONOTONIC, ns)."""
        with self._concluded:
            looks = self._looks_asked
        watch, now_ns = self._watch, time.monotonic_ns()
        endpoints = self._endpoints()
        shown = [bytes(endpoint.endpoint_gid) for endpoint in endpoints]
        for text in self._answers():
            server = Server.read(text)
            if server is None or server.instance != self._me.instance:
                watch.answered(text[:_LONGEST_ANSWER], now_ns)
        if watch.should_ask(shown, now_ns):
            self._client.handle.send_request(self._type.Request())
            watch.asked(shown, now_ns)
        is_known = watch.is_known(shown, now_ns)
        self._say([Server.read(text) for text in watch.live(shown, now_ns)], endpoints)
        if is_known:
            with self._concluded:
                self._looks_done = looks
                self._concluded.notify_all()
        return watch.next_ns(now_ns)

    def _endpoints(self) -> list[Any]:
        """What discovery shows of all servers; empty where this one is the only one, which is found out cheaply."""
        if self._node.count_services(self._service) <= 1:
            return []
        return self._node.get_publishers_info_by_topic(self._status)

    def _answers(self) -> list[str]:
        """The answers since the last look. Each server answers, so rclpy's one future per request is not enough."""
        answers: list[str] = []
        for _ in range(_MOST_ANSWERS):
            header, response = self._client.handle.take_response(self._type.Response)
            if header is None:
                break
            answers.append(response.result.error_string)
        return answers

    def _say(self, live: list[Server | None], endpoints: list[Any]) -> None:
        sentence = self._sentence(live, endpoints) if live else ""
        if sentence != self._said:
            self._said = sentence
            self._changed(sentence)

    def _sentence(self, live: list[Server | None], endpoints: list[Any]) -> str:
        ours = [server for server in live if server is not None]
        words = [f"arm '{server.arm}' (pid {server.pid} on host {server.host}, node {server.node})" for server in ours]
        ends = [f"Ctrl-C in the `rtarm up` of arm '{server.arm}'" for server in ours]
        if None in live:
            nodes = nodes_beside([self._me.node, *(server.node for server in ours)], endpoints)
            where = machine_of([bytes(endpoint.endpoint_gid) for endpoint in endpoints])
            node = " or ".join(nodes) or "without a name"
            words.append(f"a program that does not say which arm it has ({where}, node {node})")
            ends.append(
                "end that program, or where ros2_control runs it, `ros2 control unload_controller "
                f"{self._controller}` once that is inactive"
            )
        others = " and ".join(words)
        return (
            f"{others[0].upper()}{others[1:]} serve{'s' if len(words) == 1 else ''} {self._action} too, and each of "
            f"its servers carries out every goal, so none is taken here: to take over, end the other "
            f"({'; '.join(ends)}), or start one of them with another controller_name or ROS_DOMAIN_ID."
        )


def nodes_beside(known: Collection[str], endpoints: Collection[Any]) -> list[str]:
    """Names of the nodes that discovery shows, without those that are known; two nodes may have the same name."""
    shown = Counter(f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}" for endpoint in endpoints)
    return sorted(legible(name, _LONGEST_WORD) for name in shown - Counter(known))


def machine_of(gids: Collection[bytes]) -> str:
    """Words for where the servers with these identifiers run; one of them is in this process."""
    told = {gid[_MACHINE] for gid in gids if gid.startswith(_FAST_DDS)}
    return "on this machine" if len(told) == 1 else "perhaps on another machine"
