"""Another server of the arm's action: told from a dead one, named, and no goal taken beside it."""

import contextlib
import os
import signal
import socket
import threading
import time
from itertools import pairwise
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytest.importorskip("control_msgs")

from control_msgs.action import FollowJointTrajectory
from front_stage import goal, served
from rclpy.action import ActionServer
from ros_client import ABORTED, SUCCEEDED, UNKNOWN, Client, Spinner
from waiting import ready_process, until

from config.loader import load_arm
from rosfront.other_servers import AGAIN_NS, EVERY_NS, LIVE_NS, PATIENCE_NS, Server, Watch, machine_of, nodes_beside

OURS, THEIRS, OTHERS = b"ours", b"theirs", b"others"
MS = 1_000_000

# --- what is known, in virtual time ---------------------------------------------------------------------


class Discovery:
    """Servers that discovery shows, of which some live; looked at as the thread does it."""

    def __init__(self):
        self.watch = Watch()
        self.shown, self.living, self.deaf = set(), set(), set()
        self.now_ns = 10**12
        self.questions = []

    def look(self):
        if self.watch.should_ask(self.shown, self.now_ns):
            self.watch.asked(self.shown, self.now_ns)
            self.questions.append(self.now_ns)
            for server in self.living & self.shown - self.deaf:
                self.watch.answered(server.decode(), self.now_ns)
        return self.watch.is_known(self.shown, self.now_ns)

    def lives(self):
        return self.watch.live(self.shown, self.now_ns)

    def pass_to(self, at_ns):
        while (next_ns := self.watch.next_ns(self.now_ns)) <= at_ns:
            self.now_ns = next_ns
            self.look()
        self.now_ns = at_ns


def test_who_is_alone_is_asked_nothing():
    world = Discovery()
    assert world.look()
    world.pass_to(world.now_ns + 10 * EVERY_NS)
    assert world.questions == [] and world.lives() == []


def test_a_server_that_answers_is_known_at_once():
    world = Discovery()
    world.shown, world.living = {OURS, THEIRS}, {THEIRS}
    assert world.look() and world.lives() == ["theirs"]


def test_a_server_that_does_not_hear_the_first_question_is_asked_again():
    """What discovery has just shown may not have found its way back yet."""
    world = Discovery()
    world.shown, world.living, world.deaf = {OURS, THEIRS}, {THEIRS}, {THEIRS}
    assert not world.look()
    world.pass_to(world.now_ns + PATIENCE_NS - 150 * MS)
    world.deaf.clear()
    world.pass_to(world.now_ns + 110 * MS)
    assert world.look() and world.lives() == ["theirs"]
    asked = len(world.questions)
    world.pass_to(world.now_ns + 10 * EVERY_NS)
    assert len(world.questions) == asked + 10, "once a second from then on"


def test_a_server_is_not_silent_that_this_process_stood_too_still_to_ask_again():
    world = Discovery()
    world.shown, world.living, world.deaf = {OURS, THEIRS}, {THEIRS}, {THEIRS}
    assert not world.look()
    world.now_ns += PATIENCE_NS + 50 * MS
    assert not world.look(), "it has just been asked for the second time"
    world.deaf.clear()
    world.pass_to(world.now_ns + EVERY_NS)
    assert world.look() and world.lives() == ["theirs"]


def test_a_dead_server_is_waited_for_once_and_not_again():
    world = Discovery()
    world.shown = {OURS, THEIRS}
    assert not world.look()
    begun_ns = world.now_ns
    world.pass_to(begun_ns + PATIENCE_NS)
    for _ in range(200):  # while discovery goes on showing it
        assert world.look() and world.lives() == []
        world.pass_to(world.now_ns + 100 * MS)
    world.shown.add(OTHERS)
    assert not world.look(), "a newcomer is asked before a goal is taken"


def test_a_server_that_dies_is_forgotten():
    world = Discovery()
    world.shown, world.living = {OURS, THEIRS}, {THEIRS}
    world.look()
    world.living.clear()
    died_ns = world.now_ns
    world.pass_to(died_ns + LIVE_NS)
    assert world.look() and world.lives() == []


def test_a_server_that_leaves_in_order_is_forgotten_at_once():
    world = Discovery()
    world.shown, world.living = {OURS, THEIRS}, {THEIRS}
    world.look()
    world.shown = set()
    assert world.look() and world.lives() == []


@given(st.lists(st.tuples(st.integers(0, 3000), st.sampled_from("+-!?")), max_size=30))
def test_no_goal_is_taken_beside_a_server_that_lives(steps):
    """+ comes, - goes in order, ! is killed but shown, ? a goal comes; and questions are a second apart."""
    world = Discovery()
    for number, (wait_ms, what) in enumerate(steps):
        world.pass_to(world.now_ns + wait_ms * MS)
        oldest = next(iter(sorted(world.living)), b"")
        if what == "+":
            server = b"%02d" % number  # one that comes again has another identifier
            world.shown |= {OURS, server}
            world.living.add(server)
        elif what == "?":
            assert not world.look() or bool(world.lives()) >= bool(world.living)
            continue
        world.living.discard(oldest) if what in "-!" else None
        if what == "-":
            world.shown.discard(oldest)
            world.shown -= {OURS} if world.shown == {OURS} else set()
    gaps = [later - earlier for earlier, later in pairwise(world.questions)]
    assert sum(gap < EVERY_NS for gap in gaps) <= (PATIENCE_NS // AGAIN_NS + 1) * sum(what == "+" for _, what in steps)


# --- who it is ------------------------------------------------------------------------------------------


def test_a_front_says_who_it_is():
    me = Server.this("mock", "/arm_controller")
    assert Server.read(me.written()) == me
    assert (me.arm, me.pid, me.host, me.node) == ("mock", os.getpid(), socket.gethostname(), "/arm_controller")
    assert Server.this("mock", "/arm_controller").instance != me.instance


NO_PIDS = ("1e999", "NaN", "0", "-1", "4194304", "1" + "0" * 400, "null", '"x"', "[]")


@given(st.text() | st.from_regex(r'\{"rtarm": (\{"instance": 1\}|\[\]|null|3)\}', fullmatch=True))
@example("[" * 1000)
@example('{"rtarm": ' * 100)
def test_what_others_answer_is_no_front(text):
    assert Server.read(text) is None


@pytest.mark.parametrize("pid", NO_PIDS)
def test_who_says_a_process_id_that_there_cannot_be_is_no_front(pid):
    said = Server.this("mock", "/arm_controller").written()
    assert Server.read(said) is not None
    assert Server.read(said.replace(f'"pid": {os.getpid()}', f'"pid": {pid}')) is None


def test_what_a_front_says_cannot_speak_to_the_terminal():
    hostile = Server("1", "\x1b[31mred\n" * 20, 1, "host", "/node")
    said = Server.read(hostile.written())
    assert said is not None and said.arm.isprintable() and len(said.arm) <= 200


def endpoint(namespace, name, gid=b""):
    return SimpleNamespace(node_namespace=namespace, node_name=name, endpoint_gid=gid)


def test_nodes_of_one_name_are_counted():
    shown = [endpoint("/", "arm_controller"), endpoint("/", "arm_controller"), endpoint("/lab", "jtc")]
    assert nodes_beside(["/arm_controller"], shown) == ["/arm_controller", "/lab/jtc"]
    assert nodes_beside(["/arm_controller", "/arm_controller"], shown) == ["/lab/jtc"]


def test_the_machine_is_what_fast_dds_tells():
    """Identifiers as discovery showed them of two processes of one machine, and one with another machine's number."""
    here = [bytes.fromhex("010f78fd5d7ab9320000000000001a03"), bytes.fromhex("010f78fd5c7ad12f0000000000001a03")]
    assert machine_of(here) == "on this machine"
    assert machine_of([here[0], bytes.fromhex("010f11225c7ad12f0000000000001a03")]) == "perhaps on another machine"
    assert machine_of([b"\x01\x10" + here[0][2:]]) == "perhaps on another machine"


# --- real nodes -----------------------------------------------------------------------------------------


class Stranger(Spinner):
    """A server of an action that is none of rtarm's, as ros2_control's controller is one; it carries out every goal."""

    def __init__(self, controller):
        super().__init__(controller)
        self.carried_out = 0
        self._server = ActionServer(
            self.node, FollowJointTrajectory, f"/{controller}/follow_joint_trajectory", execute_callback=self._carry_out
        )

    def _carry_out(self, handle):
        self.carried_out += 1
        handle.succeed()
        return FollowJointTrajectory.Result()


STRANGER = """
import sys
from test_other_servers import Stranger
stranger = Stranger(sys.argv[1])
print("ready", flush=True)
sys.stdin.read()
stranger.close()
"""


def stranger_process(controller):
    """A stranger in a process of its own, which can be killed."""
    return ready_process("-c", STRANGER, controller)


def mock_arm(name, controller):
    return load_arm("mock", overrides={"name": name, "front": {"controller_name": controller}})


@contextlib.contextmanager
def serving(arm):
    """A front that serves, and a client of it."""
    with served(arm) as (loop, front, _), contextlib.closing(Client(arm.front.controller_name)) as client:
        until(front.serving.ever_attached.is_set, "a front that serves")
        yield SimpleNamespace(loop=loop, front=front, client=client, arm=arm, controller=arm.front.controller_name)


@pytest.fixture
def front(arm_name):
    with serving(mock_arm(arm_name, f"of_{arm_name}")) as stage:
        yield stage


def refusal(stage):
    """Whether goals are refused for another server; the sentence."""
    return stage.front.serving.other_server


def judged(stage):
    """What this front says of a goal, as its thread for goals does it: a client hears whoever answers first."""
    try:
        stage.front._plan(goal())
    except Exception as reason:
        return str(reason)
    return ""


@pytest.mark.process
def test_no_goal_is_taken_beside_a_stranger_and_none_of_its_is_disturbed(front):
    status, _, words = front.client.run(goal())
    assert status == SUCCEEDED, words
    with contextlib.closing(Stranger(front.controller)) as stranger:
        until(lambda: refusal(front), "another server that was found")
        assert refusal(front).startswith("A program that does not say which arm it has (on this machine, node /of_t")
        assert f"unload_controller {front.controller}`" in refusal(front)
        assert judged(front) == refusal(front)
        taken = front.front._goals.counts
        front.client.run(goal())
        until(lambda: taken.goals_aborted == 1, "the end of a goal")
        assert stranger.carried_out == 1, "it takes its goals as before"
        assert not front.loop.asked and front.loop.active == 0 and front.loop.incoming == 0
    until(lambda: not refusal(front), "nobody else")
    status, _, words = front.client.run(goal())
    assert status == SUCCEEDED, words


@pytest.mark.process
def test_a_goal_that_comes_with_a_new_server_waits_for_its_answer(front):
    """Between two looks of the thread."""
    front.front._other_servers.look()
    with contextlib.closing(Stranger(front.controller)):
        until(lambda: len(front.front._other_servers._endpoints()) == 2, "a server that discovery shows")
        assert "does not say which arm" in judged(front)


@pytest.mark.process
def test_a_killed_server_refuses_no_goal_though_discovery_shows_it(front):
    with stranger_process(front.controller) as stranger:
        until(lambda: refusal(front), "another server that was found")
        os.kill(stranger.pid, signal.SIGKILL)
        until(lambda: not refusal(front), "a server that has died")
        assert len(front.front._other_servers._endpoints()) == 2, "discovery does not know it yet"
        begun_s = time.monotonic()
        status, _, words = front.client.run(goal())
        assert status == SUCCEEDED, words
        print(f"accepted and carried out in {time.monotonic() - begun_s:.3f} s beside a dead server")


@pytest.mark.process
def test_a_front_that_starts_again_knows_nothing_of_the_one_that_was_killed(arm_name):
    """Who was there before shows the dead one for 20 s; a newcomer has never heard of it, so no goal waits."""
    arm = mock_arm(arm_name, f"of_{arm_name}")
    servers = f"/{arm.front.controller_name}/follow_joint_trajectory/_action/get_result"
    with contextlib.closing(Spinner("witness")) as witness:
        with stranger_process(arm.front.controller_name) as killed:
            until(lambda: witness.node.count_services(servers) == 1, "a server that discovery shows")
            killed.kill()
            killed.wait()
        assert witness.node.count_services(servers) == 1, "who was there before still sees the dead one"
        with serving(arm) as stage:
            status, _, words = stage.client.run(goal())
            assert status == SUCCEEDED, words
            assert stage.front._other_servers._endpoints() == []


@pytest.mark.process
def test_a_server_that_was_suspended_is_found_again(front):
    with stranger_process(front.controller) as stranger:
        until(lambda: refusal(front), "another server that was found")
        os.kill(stranger.pid, signal.SIGSTOP)
        until(lambda: not refusal(front), "a server that stands still")
        os.kill(stranger.pid, signal.SIGCONT)
        until(lambda: refusal(front), "the server again")


@pytest.mark.process
def test_two_fronts_of_one_action_refuse_both_and_say_whose_the_other_is(front, new_arm_name):
    other = mock_arm(new_arm_name(), front.controller)
    with served(other) as (loop, second, _):
        until(lambda: refusal(front) and second.serving.other_server, "two that have found each other")
        who = f"(pid {os.getpid()} on host {socket.gethostname()}, node /{front.controller})"
        assert refusal(front).startswith(f"Arm '{other.name}' {who} serves /{front.controller}/follow_joint")
        assert second.serving.other_server.startswith(f"Arm '{front.arm.name}' {who} serves")
        assert f"Ctrl-C in the `rtarm up` of arm '{other.name}'" in refusal(front)
        records = len(front.loop.records)
        # Two answer each question, and a client takes the first answer: of who has not read the goal yet, UNKNOWN.
        status, _, words = front.client.run(goal())
        assert status == UNKNOWN or (status == ABORTED and "carries out every goal" in words)
        assert len(front.loop.records) == records and not loop.records, "nothing reached an arm"
    until(lambda: not refusal(front), "nobody else")


@pytest.mark.process
def test_a_stream_is_dropped_and_a_move_of_the_arms_own_is_not(front):
    with contextlib.closing(Stranger(front.controller)):
        until(lambda: refusal(front), "another server that was found")
        with pytest.raises(Exception, match="carries out every goal"):
            front.front.serving.stream(goal().trajectory, lambda verdict: None)
        assert front.front.serving.present(for_own_move=True).standing


@pytest.mark.process
def test_a_goal_that_runs_goes_on_when_another_server_comes(front):
    result = front.client.send(goal(seconds=4.0)).get_result_async()  # asked at once, of the only server
    until(lambda: front.loop.active, "motion")  # what is accepted and has not begun is still refused
    with contextlib.closing(Stranger(front.controller)):
        until(lambda: refusal(front), "another server that was found")
        assert not result.done()
        until(result.done, "the end of the goal")
        assert result.result().status == SUCCEEDED


@pytest.mark.process
def test_the_thread_ends_with_its_front(front):
    thread = front.front._other_servers
    waiting = [threading.Thread(target=thread.look) for _ in range(3)]
    for each in waiting:
        each.start()
    thread.stop()
    for each in (*waiting, thread):
        each.join(5.0)
        assert not each.is_alive()
