"""`make test-vm`: run tests/vm inside a small virtual machine that has what this machine may lack: SocketCAN.

QEMU emulates the processor (no KVM, no privilege), Debian's kernel package is unpacked and not installed, an initramfs
of busybox loads its CAN modules and shares this machine's root read-only, so the same Python environment runs inside.
The guest's processor is not ours: it says what it can, and the control cycle is compiled for it out here, where that
takes half a minute instead of ten.

Exit code: that of pytest inside; 1 when the machine does not get that far; 0, with a notice, where it cannot be made.
"""

import lzma
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rtarm" / "vm"
PROGRAMS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "dpkg": "dpkg",
    "apt-get": "apt",
}
KERNEL_PACKAGE = "linux-image-amd64"
MODULES = (
    *("virtio_ring", "virtio", "virtio_pci_modern_dev", "virtio_pci_legacy_dev", "virtio_pci"),
    *("netfs", "fscache", "9pnet", "9pnet_virtio", "9p"),
    *("can", "can-raw", "can-dev", "vcan", "slcan", "sch_tbf"),
)
"""In the order in which they need each other; what a kernel has built in is no file."""
MEMORY_MB = 2048
TIMEOUT_S = float(os.environ.get("RTARM_VM_TIMEOUT_S", "900"))
SHARE = "/run/share"

INIT = """#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin
mkdir -p /proc /sys /dev /host
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
for module in {modules}; do [ ! -e /modules/$module.ko ] || insmod /modules/$module.ko; done
shared() {{ mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144,$3 $1 $2; }}
shared root /host ro,cache=loose
mount --bind /proc /host/proc
mount --bind /sys /host/sys
mount --bind /dev /host/dev
mkdir -p /host/dev/shm /host/dev/pts
mount -t tmpfs shm /host/dev/shm
mount -t devpts -o ptmxmode=0666 pts /host/dev/pts
mount -t tmpfs tmp /host/tmp
mount -t tmpfs run /host/run
mkdir -p /host{root} /host{share}
shared repository /host{root} ro,cache=loose
shared share /host{share} cache=none
ip link set lo up
for name in vcan0 vcan2; do ip link add dev $name type vcan; ip link set $name up; done
chroot /host /bin/sh {share}/inside.sh
echo "vm-exit $?"
poweroff -f
"""

INSIDE = """export HOME=/run/home XDG_CACHE_HOME={share}/cache PATH=/usr/sbin:/usr/bin:/sbin:/bin
export PYTHONDONTWRITEBYTECODE=1 LANG=C.UTF-8 CI={ci} _ROS_WHEELS_BOOTSTRAP_COMPLETE=1 LD_LIBRARY_PATH={libraries}
mkdir -p $HOME
cd {root} || exit 1
{python} tests/vm/processor.py {share}/processor.json || exit 1
while [ ! -e {share}/compiled ]; do sleep 0.2; done
set -- -x -o timeout=300 -p no:cacheprovider -p no:hypothesispytest --basetemp=/run/pytest
exec {python} -m pytest "$@" tests/vm {arguments}
"""

COMPILE = """
import json, sys
import llvmlite.binding as llvm

name, features = json.load(open(sys.argv[1]))
found = llvm.get_host_cpu_features()
found.clear()
found.update(features)
llvm.get_host_cpu_name = lambda: name
llvm.get_host_cpu_features = lambda: found
from rtloop import warm
sys.exit(warm.main())
"""
"""Compile for another processor than ours: whoever asks what the host is gets the guest's answer."""


class NotPossible(Exception):
    """No virtual machine can be made here; the text says why."""


def main(arguments: list[str]) -> int:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # the machine ends with us
    try:
        kernel, modules = prepare()
    except NotPossible as reason:
        print(f"\n=== make test-vm: NOT RUN. SocketCAN is not tested on this machine: {reason}\n", file=sys.stderr)
        return 0
    with tempfile.TemporaryDirectory(prefix="rtarm-vm-") as folder:
        return run(Path(folder), kernel, modules, arguments)


def prepare() -> tuple[Path, Path]:
    """The kernel and the folder of its modules; raises NotPossible."""
    if platform.machine() != "x86_64":
        raise NotPossible(f"its processor is {platform.machine()}, and the machine made here is an x86-64 one.")
    missing = [package for program, package in PROGRAMS.items() if shutil.which(program) is None]
    if missing:
        raise NotPossible(f"install {' '.join(missing)} (`sudo apt-get install {' '.join(missing)}`).")
    if subprocess.run(["ldd", shutil.which("busybox") or ""], capture_output=True, check=False).returncode == 0:
        raise NotPossible("its busybox is not the static one: install busybox-static.")
    folder = CACHE / "kernel"
    if not list(folder.glob("boot/vmlinuz-*")):
        download(folder)
    (kernel,) = folder.glob("boot/vmlinuz-*")
    (modules,) = folder.glob("**/lib/modules/*")
    return kernel, modules


def download(folder: Path) -> None:
    """Fetch and unpack Debian's newest kernel package, whole or not at all."""
    told = subprocess.run(["apt-cache", "depends", KERNEL_PACKAGE], capture_output=True, text=True, check=False).stdout
    package = re.search(r"Depends: (linux-image-[\w.+-]+)", told)
    if package is None:
        raise NotPossible(f"its package lists do not know {KERNEL_PACKAGE}.")
    print(f"fetching {package[1]} …", flush=True)
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE) as aside:
        result = subprocess.run(["apt-get", "download", "-q", package[1]], cwd=aside, check=False)
        packages = list(Path(aside).glob("*.deb"))
        if result.returncode != 0 or not packages:
            raise NotPossible(f"the kernel package {package[1]} cannot be downloaded.")
        subprocess.run(["dpkg", "-x", packages[0], f"{aside}/unpacked"], check=True)
        shutil.rmtree(folder, ignore_errors=True)
        os.replace(f"{aside}/unpacked", folder)


def make_initramfs(folder: Path, modules: Path) -> Path:
    """Busybox, the modules and the script that starts everything, as an archive the kernel unpacks."""
    tree = folder / "tree"
    for name in ("bin", "modules"):
        (tree / name).mkdir(parents=True)
    shutil.copy(shutil.which("busybox") or "", tree / "bin" / "busybox")
    for name in MODULES:
        for found in modules.rglob(f"{name}.ko*"):
            data = found.read_bytes()
            packed = found.suffix == ".xz"
            (tree / "modules" / f"{name}.ko").write_bytes(lzma.decompress(data) if packed else data)
    init = tree / "init"
    init.write_text(INIT.format(modules=" ".join(MODULES), root=ROOT, share=SHARE), encoding="utf-8")
    init.chmod(0o755)
    names = "\n".join(str(path.relative_to(tree)) for path in [tree, *sorted(tree.rglob("*"))])
    archive = folder / "initramfs"
    with archive.open("wb") as file:
        subprocess.run(["cpio", "-o", "-H", "newc", "--quiet"], cwd=tree, input=names.encode(), stdout=file, check=True)
    return archive


def run(folder: Path, kernel: Path, modules: Path, arguments: list[str]) -> int:
    """Boot, run the tests, and return how they ended; a machine that hangs is ended and its console shown."""
    share = folder / "share"
    share.mkdir()
    packages = Path(sysconfig.get_path("purelib"))
    libraries = [Path(sys.prefix) / "lib", *sorted(packages.glob("ros_*.libs"))]  # which Python would start anew for
    inside = INSIDE.format(
        share=SHARE, root=ROOT, python=ROOT / ".venv/bin/python", ci=os.environ.get("CI", ""),
        libraries=os.pathsep.join(map(str, libraries)), arguments=shlex.join(arguments),
    )  # fmt: skip
    (share / "inside.sh").write_text(inside, encoding="utf-8")
    command = [
        *("qemu-system-x86_64", "-machine", "q35", "-accel", "tcg", "-cpu", "max", "-m", str(MEMORY_MB)),
        # Time passes by the instructions executed: however busy this machine is, nothing inside comes late.
        *("-icount", "shift=0,sleep=on"),
        *("-nodefaults", "-no-user-config", "-display", "none", "-serial", "stdio", "-no-reboot"),
        *("-kernel", str(kernel), "-initrd", str(make_initramfs(folder, modules))),
        *("-append", "console=ttyS0 quiet panic=-1 mitigations=off"),
        *shared_folder("root", Path("/"), read_only=True),
        *shared_folder("repository", ROOT, read_only=True),
        *shared_folder("share", share, read_only=False),
    ]
    began = time.monotonic()
    machine = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    console: list[bytes] = []
    listener = threading.Thread(target=listen, args=(machine, console), daemon=True)
    listener.start()
    try:
        compiled = compile_for(machine, share, began)
        machine.wait(max(TIMEOUT_S - (time.monotonic() - began), 1.0) if compiled else 1.0)
    except subprocess.TimeoutExpired:
        print(f"\n=== the virtual machine has not ended within {TIMEOUT_S:g} s and is ended", file=sys.stderr)
    finally:
        machine.kill()
        machine.wait()
        listener.join(5.0)
    code = re.search(rb"^vm-exit (\d+)\r?$", b"".join(console), re.MULTILINE)
    print(f"=== {time.monotonic() - began:.0f} s in all, in a virtual machine", flush=True)
    return int(code[1]) if code else 1


def shared_folder(tag: str, path: Path, *, read_only: bool) -> tuple[str, ...]:
    device = f"local,id={tag},path={path},security_model=none,multidevs=remap" + (",readonly=on" if read_only else "")
    return "-fsdev", device, "-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"


def listen(machine: "subprocess.Popen[bytes]", console: list[bytes]) -> None:
    """Show the console as it comes, and keep it."""
    assert machine.stdout is not None
    for line in machine.stdout:
        console.append(line)
        sys.stdout.write(line.decode(errors="replace").replace("\r", ""))
        sys.stdout.flush()


def compile_for(machine: "subprocess.Popen[bytes]", share: Path, began: float) -> bool:
    """Compile the control cycle for the processor that the machine says it has."""
    told = share / "processor.json"
    while not told.exists():
        if machine.poll() is not None or time.monotonic() - began > TIMEOUT_S:
            return False
        time.sleep(0.1)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    environment["XDG_CACHE_HOME"] = str(CACHE / "cache")
    command = [ROOT / ".venv/bin/python", "-c", COMPILE, str(told)]
    result = subprocess.run(command, cwd=ROOT, env=environment, check=False)
    # a link to it would be followed inside, where much of our file system is hidden
    shutil.copytree(CACHE / "cache", share / "cache")
    (share / "compiled").touch()
    return result.returncode == 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
