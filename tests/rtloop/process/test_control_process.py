"""The control process around the cycle: what it is made of, what it holds, and how it begins and ends."""

import ctypes
import os
import platform
import pty
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import llvmlite.binding as llvm
import numpy as np
import pytest
from arm_files import write_arm
from compiling import make_object
from memory_front import MemoryFront
from stack import PATIENCE_S, Process
from waiting import until

from compilation import cache
from config.loader import load_arm
from rtloop.kept import reference_store
from rtloop.process import attended_wire, compiled, control_process
from rtloop.process.control_process import ControlProcess, StopAsked
from rtloop.service.port import BRING_UP_DONE, BRING_UP_FAILED, ServicePort
from rtloop.system import realtime
from rtloop.wire.refusal import WireRefused
from shm.client import StateReader
from shm.errors import NotRunning
from shm.files import DIRECTORY, open_state
from shm.words import Fault, Mode, Outcome

ROOT = Path(__file__).resolve().parents[3]
MIB = 1 << 20
PR_CAPBSET_DROP, CAP_IPC_LOCK = 24, 14


# --- the compiled cycle ---------------------------------------------------------------------------------


def python_in(folder: Path, program: str, *arguments: str) -> str:
    """What a program prints that finds our packages in a folder."""
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout


def copy_of_the_sources(folder: Path) -> Path:
    for package in ("compilation", "config", "motion", "shm", "sentences", "rtloop"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def test_copies_of_the_same_sources_share_what_was_compiled(tmp_path):
    make_object()
    program = "from rtloop.process import compiled; compiled.load(); print(compiled.path(), compiled.__file__)"
    first, second = (copy_of_the_sources(tmp_path / name) for name in ("first", "second"))
    for copy in (first, second):
        assert python_in(copy, program).split() == [str(compiled.path()), str(copy / "rtloop/process/compiled.py")]


@pytest.mark.parametrize("source", ["config/budget.py", "motion/segment.py", "shm/layout.py", "rtloop/drives/zdt.py"])
def test_other_sources_are_compiled_anew(tmp_path, source):
    copy = copy_of_the_sources(tmp_path / "copy")
    with (copy / source).open("a", encoding="utf-8") as file:
        file.write("\n")
    assert python_in(copy, "from compilation import cache; print(cache.key())").strip() != cache.key()


def object_that_calls(name: str) -> bytes:
    """An object with all the functions it should have, the last of which calls another one."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    functions = [f"define void @{entry}() {{\n call void @{name}()\n ret void\n}}" for entry in compiled.PROTOTYPES]
    module = llvm.parse_assembly("\n".join([f"declare void @{name}()", *functions]))
    return llvm.Target.from_default_triple().create_target_machine(jit=True, codemodel="jitdefault").emit_object(module)


@pytest.mark.parametrize("name", ["PyErr_Clear", "NRT_Allocate", "malloc", "numba_gil_ensure"])
def test_code_that_calls_more_than_it_may_is_not_loaded(name):
    compiled.CompiledCycle(object_that_calls("poll"))
    with pytest.raises(compiled.NotLoadable, match=name):
        compiled.CompiledCycle(object_that_calls(name))


@pytest.mark.parametrize(("name", "expected"), [("ceil", 3), ("floor", 2), ("rint", 2)])
def test_a_processor_without_rounding_instructions_may_call_libm(name, expected):
    """Code for the least processor there is: of 2.5 as a double's bits it makes a whole number."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    rounding = f"""declare double @llvm.{name}.f64(double)
define i64 @load_word(i64 %bits) {{
 %x = bitcast i64 %bits to double
 %y = call double @llvm.{name}.f64(double %x)
 %i = fptosi double %y to i64
 ret i64 %i
}}"""
    others = [f"define void @{entry}() {{\n ret void\n}}" for entry in compiled.PROTOTYPES if entry != "load_word"]
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True, codemodel="jitdefault")
    code = machine.emit_object(llvm.parse_assembly("\n".join([rounding, *others])))
    if platform.machine() == "x86_64":
        assert compiled.undefined_symbols(code) == {name}
    assert compiled.CompiledCycle(code).load_word(int(np.array(2.5).view(np.int64))) == expected


def test_what_is_compiled_ahead_does_not_depend_on_settings_of_numba(tmp_path):
    program = """
import os, runpy, sys

class Settings:
    def find_spec(self, name, path=None, target=None):
        if name == "numba":
            print(sorted(name for name in os.environ if name.startswith("NUMBA_")))
            sys.stdout.flush()
            os._exit(0)

sys.meta_path.insert(0, Settings())
runpy.run_module("rtloop.warm", run_name="__main__")
"""
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "NUMBA_BOUNDSCHECK": "1", "NUMBA_CPU_NAME": "generic"}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert (result.stdout.splitlines()[-1:], result.stderr) == (["[]"], "")


@pytest.mark.parametrize(
    "damage",
    [lambda kept: kept[:-1], lambda kept: b"", lambda kept: kept[:100] + bytes([kept[100] ^ 1]) + kept[101:]],
    ids=["shortened", "empty", "changed"],
)
def test_damaged_code_is_not_loaded(tmp_path, monkeypatch, damage):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(FileNotFoundError):
        compiled.load()
    compiled.store(object_that_calls("poll"))
    compiled.load()
    assert list(compiled.path().parent.iterdir()) == [compiled.path()]
    compiled.path().write_bytes(damage(compiled.path().read_bytes()))
    with pytest.raises(compiled.NotLoadable):
        compiled.load()


def test_words_are_read_and_written_whole():
    cycle = compiled.load()
    words = np.array([7, -(2**63)], np.int64)
    assert [cycle.load_word(words.ctypes.data + at) for at in (0, 8)] == [7, -(2**63)]
    cycle.store_word(words.ctypes.data, 2**63 - 1)
    assert words.tolist() == [2**63 - 1, -(2**63)]


def test_what_is_locked_of_the_code_is_where_it_runs():
    cycle = compiled.load()
    for function in (cycle.run, cycle.read_wire, cycle.load_word, cycle.store_word):
        address = ctypes.cast(function, ctypes.c_void_p).value
        assert any(start <= address < start + size for start, size in cycle.memory)
    assert sum(size for _, size in cycle.memory) < MIB


# --- the process ----------------------------------------------------------------------------------------


@pytest.fixture
def mock_arm(arm_name, tmp_path) -> Iterator[SimpleNamespace]:
    """A mock arm of this test's own: `name`, `file`."""
    yield SimpleNamespace(name=arm_name, file=write_arm("mock", arm_name, tmp_path))
    assert not list(DIRECTORY.glob(f"rtarm.{arm_name}.*"))


def faults(pid: int) -> dict[int, tuple[int, int]]:
    """Minor and major page faults of each thread of a process but the main one."""
    found = {}
    for task in sorted(int(entry) for entry in os.listdir(f"/proc/{pid}/task")):
        words = Path(f"/proc/{pid}/task/{task}/stat").read_text().rpartition(")")[2].split()
        if task != pid:
            found[task] = int(words[7]), int(words[9])
    return found


@pytest.mark.process
def test_whatever_happens_no_cycle_waits_for_a_page(mock_arm):
    """From the first moment that the arm holds: motion, pause, cancel, a latched fault, its end, and the last stop."""
    with closing(Process("rtloop", str(mock_arm.file))) as process:
        process.line_with("ready")
        at_first = faults(process.process.pid)
        front = MemoryFront(mock_arm.file)
        assert front.swing() == 1
        front.until(lambda now: now["trajectory_clock_ns"] > 1e9)
        front.writer.hold()
        front.until(lambda now: now["speed_scale"] == 0 or now["mode"] != Mode.EXECUTING)
        front.writer.resume()
        front.until(lambda now: now["mode"] == Mode.EXECUTING)
        front.writer.cancel(1)
        assert front.outcome(1) == Outcome.CANCELED
        assert front.swing() == 2
        front.until(lambda now: now["mode"] == Mode.EXECUTING)
        front.writer.memory.record["setpoints_written"] += 1  # a record that was never written
        front.until(lambda now: now["mode"] == Mode.FAULT)
        assert front.now()["fault"] == Fault.COMMAND_RING
        assert len(at_first) == 1
        assert faults(process.process.pid) == at_first
        front.close()
    assert process.code() == 0


def limited(program: str, limit_bytes: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a Python program that may lock only so much memory."""

    def limit() -> None:
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_IPC_LOCK, 0, 0, 0)
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit_bytes, limit_bytes))

    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        cwd=ROOT,
        preexec_fn=limit,
        capture_output=True,
        text=True,
        check=False,
    )


def test_memory_is_locked_under_a_limit_and_later_allocations_still_succeed():
    """What the cycle uses counts, not what else the process holds or will hold."""
    program = """
import numpy as np
from rtloop.system import realtime

used = np.ones(1 << 20, np.uint8)
obtained = realtime.prepare_process([(used.ctypes.data, used.nbytes)])
print(obtained.memory_locked, *[line for line in obtained.complaints if "locked" in line])
print(len(bytearray(64 << 20)) >> 20)
"""
    result = limited(program, 8 * MIB)
    assert (result.stdout.split(), result.stderr) == (["True", "64"], "")


MAPPING = """
import ctypes, mmap, re
from rtloop.system import realtime

def mapping(address):
    found = None
    for line in open("/proc/self/smaps"):
        head = re.match("(\\w+)-(\\w+) ", line)
        if head:
            inside = int(head[1], 16) <= address < int(head[2], 16)
            found = {} if inside else found
        elif inside:
            key, _, value = line.partition(":")
            found[key] = value.split()
    return found

def whole(address):
    found = mapping(address)
    return found["Rss"] == found["Size"]

def locked(address):
    return "lo" in mapping(address)["VmFlags"]
"""
"""Whether the mapping with an address is in memory as a whole, and locked."""


def test_all_that_the_c_library_reads_is_locked_with_it():
    """Its code, its variables without and with a beginning, the loader's that it looks at, and libm's code.

    They are looked for in the library: a Python at a fixed address, such as Debian's, has copies of these variables.
    """
    program = f"""{MAPPING}
realtime.prepare_process([])
libc, libm = ctypes.CDLL("libc.so.6"), ctypes.CDLL("libm.so.6")
variables = [ctypes.addressof(ctypes.c_char.in_dll(libc, name)) for name in ("environ", "stdout", "_rtld_global_ro")]
code = [ctypes.cast(function, ctypes.c_void_p).value for function in (libc.clock_gettime, libm.floor)]
print(*[locked(address) for address in variables + code])
"""
    result = limited(program, 8 * MIB)
    assert (result.stdout.split(), result.stderr) == (["True"] * 5, "")


def test_what_cannot_be_locked_is_fetched_and_what_can_is_locked():
    """A mapping beyond the limit, one that nobody may write, and one within the limit after both."""
    program = f"""{MAPPING}
import tempfile
large = mmap.mmap(-1, 12 << 20)
file = tempfile.TemporaryFile()
file.write(bytes(12 << 20))
file.flush()
fixed = mmap.mmap(file.fileno(), 12 << 20, flags=mmap.MAP_PRIVATE, prot=mmap.PROT_READ)
small = mmap.mmap(-1, 1 << 20)
import numpy as np
places = [(np.frombuffer(area, np.uint8).ctypes.data, len(area)) for area in (large, fixed, small)]
obtained = realtime.prepare_process(places)
print([locked(address) for address, _ in places], [whole(address) for address, _ in places])
print(obtained.memory_locked, len([line for line in obtained.complaints if "not locked" in line]))
"""
    result = limited(program, 8 * MIB)
    assert (result.stdout.splitlines(), result.stderr) == (
        ["[False, False, True] [True, True, True]", "False 1"],
        "",
    )


def test_the_recorder_is_locked_last_and_its_size_is_said_where_there_is_no_room():
    program = f"""{MAPPING}
ring = mmap.mmap(-1, 4 << 20)
import numpy as np
place = np.frombuffer(ring, np.uint8).ctypes.data, len(ring)
for limited in (False, True):
    obtained = realtime.Obtained(memory_locked=True)
    if limited:
        import resource
        libc = ctypes.CDLL(None)
        libc.munlock(ctypes.c_void_p(place[0]), ctypes.c_size_t(place[1]))
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (1 << 20, 1 << 20))
    realtime.lock_recorder(place, obtained)
    print(locked(place[0]), whole(place[0]), obtained.memory_locked, *obtained.complaints)
"""
    result = limited(program, 8 * MIB)
    first, second = result.stdout.splitlines()
    assert (first, result.stderr) == ("True True True", "")
    assert second.startswith("False True False The flight recorder's 4 MiB are not locked, everything else is: ")
    assert "raise RLIMIT_MEMLOCK from 1 to 5 MiB" in second


@pytest.fixture
def deaf_arm(arm_name, tmp_path, unlocked):
    """An arm of a name of its own at a terminal where nobody answers."""
    make_object()
    master, slave = pty.openpty()
    yield load_arm(write_arm("episode1", arm_name, tmp_path), overrides={"bus": {"channel": os.ttyname(slave)}})
    os.close(master)
    os.close(slave)


def test_memory_counts_as_locked_only_when_the_readers_stack_is(deaf_arm, monkeypatch):
    """The reader is given its answer late, and it is a refusal."""

    def prepare_thread(wanted, obtained, *, below=0):
        if below:
            time.sleep(0.2)
            obtained.memory_locked = False

    monkeypatch.setattr(realtime, "prepare_thread", prepare_thread)
    stop_asked = StopAsked([])
    stop_asked.yes = True
    process = ControlProcess(deaf_arm, compiled.load(), lambda sentence: None, stop_asked)
    with closing(StateReader(open_state(deaf_arm.name))) as reader:
        assert process.serve(lambda: None) == 0
        assert reader.memory.record["scheduling"]["memory_locked"] == 0


def test_a_cycle_that_takes_no_orders_ends_the_process_with_a_sentence(deaf_arm, monkeypatch):
    monkeypatch.setattr(ServicePort, "post", lambda *arguments, **options: False)  # its ring is full
    told = []
    process = ControlProcess(deaf_arm, compiled.load(), told.append, StopAsked([]))
    assert process.serve(lambda: None) == 3
    assert "The control cycle takes no orders: it has stopped; start rtarm again." in told
    with pytest.raises(NotRunning):
        open_state(deaf_arm.name)


def test_a_fault_amid_the_first_bring_up_is_its_failure(mock_arm, unlocked, monkeypatch):
    """A drive that is up already may trip while others are brought up, and these all answer."""
    post, told, ready = ServicePort.post, [], []

    def fault_before_the_end(port: ServicePort, kind: int, **options: object) -> bool:
        if kind == BRING_UP_DONE:
            post(port, BRING_UP_FAILED, joint=1, code=Fault.DRIVE_FAULT)
        return post(port, kind, **options)

    monkeypatch.setattr(ServicePort, "post", fault_before_the_end)
    stop_asked = StopAsked([])

    def is_ready() -> None:
        ready.append(1)
        stop_asked.yes = True

    assert ControlProcess(load_arm(mock_arm.file), compiled.load(), told.append, stop_asked).serve(is_ready) == 2
    assert "The drive of joint2 reports a fault of its own" in told[-1] and "--clear-fault" in told[-1]
    assert not ready


def test_an_end_amid_the_bring_up_keeps_where_the_joints_stood_before(deaf_arm, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    channel = tmp_path / "tty"
    channel.symlink_to(deaf_arm.bus.channel)  # of a pseudo-terminal's own name nothing is kept
    arm = deaf_arm.on_every_bus(channel=str(channel))
    reference_store.save(arm, {0: 7})
    stop_asked = StopAsked([])
    stop_asked.yes = True
    assert ControlProcess(arm, compiled.load(), lambda sentence: None, stop_asked).serve(lambda: None) == 0
    assert reference_store.counts_before(arm) == {0: 7}


@pytest.fixture
def bring_up_waits(monkeypatch):
    """An event that has to be set before drives are brought up."""
    may_begin, bring_up = threading.Event(), ControlProcess._bring_up

    def bring_up_then(*arguments, **options):
        assert may_begin.wait(PATIENCE_S)
        return bring_up(*arguments, **options)

    monkeypatch.setattr(ControlProcess, "_bring_up", bring_up_then)
    return may_begin


def test_an_adapter_whose_opening_does_not_end_holds_up_neither_conversations_nor_the_end(
    arm_name, tmp_path, unlocked, monkeypatch, bring_up_waits
):
    """The library of an adapter that is plugged in again may wait for it for ever."""
    make_object()
    master, slave = pty.openpty()
    channel = os.ttyname(slave)
    os.close(slave)
    arm = load_arm(write_arm("episode1", arm_name, tmp_path), overrides={"bus": {"channel": channel}})
    told, codes, opened = [], [], threading.Event()
    process = ControlProcess(arm, compiled.load(), told.append, StopAsked([]))

    def open_wire(_):
        bring_up_waits.set()
        opened.wait()
        raise WireRefused("It has been opened too late.")

    monkeypatch.setattr(attended_wire, "open_wire", open_wire)
    monkeypatch.setattr(control_process, "THREAD_PATIENCE_S", 0.1)
    serving = threading.Thread(target=lambda: codes.append(process.serve(lambda: None)))
    serving.start()
    os.close(master)
    try:
        serving.join(PATIENCE_S)  # until the bring-up of drives that are silent has failed
        assert codes == [2], told
    finally:
        opened.set()
    until(lambda: "It has been opened too late." in told, "the end of the opening")
    with pytest.raises(NotRunning):
        open_state(arm.name)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_whoever_attends_to_an_adapter_does_not_end_silently(deaf_arm, monkeypatch, bring_up_waits):
    told = []

    def tell(sentence):
        told.append(sentence)
        bring_up_waits.set()

    def lost_bytes(*_):
        raise OSError("spoilt")

    monkeypatch.setattr(attended_wire, "lost_bytes", lost_bytes)
    assert ControlProcess(deaf_arm, compiled.load(), tell, StopAsked([])).serve(lambda: None) == 2
    channel = deaf_arm.bus.resolved_channel
    assert any(f"The adapter at {channel} is not opened again if it goes" in sentence for sentence in told)


@pytest.mark.process
def test_without_the_permission_to_lock_memory_the_arm_runs_and_says_so(mock_arm):
    program = """
import os, signal, subprocess, sys
process = subprocess.Popen([sys.executable, "-m", "rtloop", sys.argv[1]], stdout=subprocess.PIPE, text=True)
print(process.stdout.readline())
process.terminate()
sys.exit(process.wait())
"""
    result = limited(program, MIB, str(mock_arm.file))
    assert (result.returncode, result.stdout.split()) == (0, ["ready"])
    assert result.stderr.count("Memory is not locked") == 1


@pytest.mark.process
def test_a_closed_terminal_ends_it_in_order_and_nohup_lets_it_outlive_that(mock_arm):
    def begun_with(hangup: signal.Handlers) -> Process:
        before = signal.signal(signal.SIGHUP, hangup)  # what is ignored stays so in a child
        try:
            return Process("rtloop", str(mock_arm.file))
        finally:
            signal.signal(signal.SIGHUP, before)

    with closing(begun_with(signal.SIG_DFL)) as process:
        process.line_with("ready")
        process.process.send_signal(signal.SIGHUP)
        assert process.code() == 0
    with closing(begun_with(signal.SIG_IGN)) as outlives:
        outlives.line_with("ready")
        with closing(StateReader(open_state(mock_arm.name))) as reader:
            outlives.process.send_signal(signal.SIGHUP)
            heard = int(reader.snapshot()["cycle"])
            until(lambda: int(reader.snapshot()["cycle"]) > heard + 10, patience_s=PATIENCE_S)
        assert outlives.process.poll() is None


@pytest.mark.process
def test_an_arm_in_motion_stops_on_its_path_though_nobody_reads_any_more_what_it_says(mock_arm):
    """Its own terminal is closed, and it has something to say in each look at whether it stands."""
    program = """
import fcntl, runpy, termios
from rtloop.process.control_process import ControlProcess

fcntl.ioctl(0, termios.TIOCSCTTY)
stands = ControlProcess._stands

def says(process):
    process._tell("still there")
    return stands(process)

ControlProcess._stands = says
runpy.run_module("rtloop", run_name="__main__")
"""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(mock_arm.file)],
        cwd=ROOT,
        stdin=slave,
        stdout=subprocess.PIPE,
        stderr=slave,
        start_new_session=True,
    )
    os.close(slave)
    with process, closing(process.stdout):
        assert process.stdout.readline() == b"ready\n"
        with closing(MemoryFront(mock_arm.file)) as front:
            assert front.swing() == 1
            front.until(lambda now: now["trajectory_clock_ns"] > 1e9)
            os.close(master)  # which sends it SIGHUP
            assert front.outcome(1) == Outcome.SHUTDOWN
            deadline = time.monotonic() + PATIENCE_S
            while process.poll() is None and time.monotonic() < deadline:
                front.now()
                time.sleep(0.002)
            assert process.poll() == 0
            assert not np.any(front.now()["joints"]["commanded_velocity_rad_s"])


@pytest.mark.process
def test_who_reads_late_misses_a_sentence_and_none_after_it():
    """A terminal that is stopped by Ctrl-S, or a full pipe, of whom does not want to wait."""
    program = "from rtloop.process.program import tell\n"
    program += "tell('x' * 100_000)\nprint('told', flush=True)\ninput()\ntell('heard')"
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=writer) as process:
        os.close(writer)
        assert process.stdout.readline() == b"told\n"
        with open(reader, "rb", buffering=0) as told:
            assert 0 < len(told.read(1 << 20)) < 100_000
            process.communicate(b"\n")
            assert told.read().endswith(b"rtloop: heard\n")


@pytest.mark.process
def test_a_signal_while_the_cycle_is_compiled_ends_the_compiler_too(mock_arm, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with closing(Process("rtloop", str(mock_arm.file))) as process:
        process.line_with("compiling")
        pid = process.process.pid
        (compiler,) = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        process.process.terminate()
        assert process.code() == 0
        assert len(process.lines) == 1
        assert not Path(f"/proc/{compiler}").exists()


def test_a_cache_that_cannot_grow_is_one_sentence(tmp_path):
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    result = subprocess.run(
        [sys.executable, "-m", "rtloop.warm"],
        cwd=ROOT,
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
        preexec_fn=limit,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stderr) == (1, "")
    assert "cannot be written (File too large): free some space" in result.stdout.splitlines()[1]


@pytest.mark.process
def test_a_signal_just_when_the_compiler_begins_ends_it_too(mock_arm, tmp_path):
    program = """
import os, runpy, signal, subprocess, sys

class Signalled(subprocess.Popen):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        print(self.pid, flush=True)
        os.kill(os.getpid(), signal.SIGTERM)

subprocess.Popen = Signalled
runpy.run_module("rtloop", run_name="__main__")
"""
    command = [sys.executable, "-c", program, str(mock_arm.file)]
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0
    assert not Path(f"/proc/{int(result.stdout)}").exists()


@pytest.mark.parametrize("module", ["rtloop", "rosfront"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("loading", ["yaml", "config.loader", "shm.errors"])
def test_a_signal_while_everything_is_loaded_ends_it_quietly(tmp_path, module, number, loading):
    """A program that gets the signal just when it imports something."""
    program = f"""
import os, runpy, sys

class Signals:
    def find_spec(self, name, path=None, target=None):
        if name == {loading!r}:
            os.kill(os.getpid(), {int(number)})

sys.meta_path.insert(0, Signals())
sys.argv = [{module!r}, "no such arm"]
runpy.run_module({module!r}, run_name="__main__")
"""
    result = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
