"""`make test-arm64`: rtarm in a Debian for ARM64 whose programs qemu runs, as root on a Debian of another processor.

`python3 packaging/arm64.py [STAGE …]` does these stages, or the ones that are named: `userland` (Debian's smallest,
made once), `environment` (packages and the compiled cycle), `tests`, `transcripts` and `page` (what
docs/start/install.md says of ARM64). All is kept in the folder that `RTARM_ARM64` names, so that the next run does only
what has changed.

Of time this says nothing. Nor does it of memory order, since threads keep that of this machine's own processor:
docs/explanation/memory-order.md. Only Python's own library.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
USERLAND = Path(os.environ.get("RTARM_ARM64") or Path.home() / ".cache" / "rtarm-arm64").resolve()
TREE, VENV, ON_PAGE = "/opt/rtarm", "/opt/venv", "/opt/page"
"""Inside: the copy of this tree, the environment of its tests, and the home of who follows the page."""
BINFMT = Path("/proc/sys/fs/binfmt_misc/qemu-aarch64")
PACKAGES = ("ca-certificates", "python3", "python3-venv", "python3-dev", "gcc", "g++")
OF_THIS_MACHINE = ("/etc/resolv.conf", "/etc/pip.conf", "/etc/ssl/certs/ca-certificates.crt")
PIPS_OWN = Path(".config", "pip", "pip.conf")
"""How pip reaches its index is the machine's affair."""

APART = ("setpriv", "--pdeathsig", "KILL", "unshare", "--mount-proc", "--pid", "--fork", "--kill-child")
"""What a command's mounts and processes are its own with: the kernel takes them away when it ends, however it does."""
ENTER = """
mount -t proc proc "$0/proc"
mount -t tmpfs -o mode=1777 tmpfs "$0/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$0/dev/pts"
exec chroot "$0" "$@"
"""

TESTED = ("config", "motion", "rtloop", "sentences", "shm", "sim")
"""Folders of tests that need no ROS."""
LEFT_OUT = {
    "tests/rtloop/process/test_control_process.py::test_what_cannot_be_locked_is_fetched_and_what_can_is_locked": (
        "qemu's madvise fetches nothing"
    ),
}
"""Tests that fail because of qemu, each with the reason."""

INSTALL = ROOT / "docs" / "start" / "install.md"
SERVES = re.compile(r"python -m (rtloop|sim) ")
BESIDE = "{} >served 2>&1 & until grep -q ^ready served; do kill -0 $! || {{ cat served; exit 1; }}; sleep 1; done"
"""A command that serves, started in the background; the next one waits until it is ready."""
TYPIST = """
sudo() { "$@"; }
rtarm() { command rtarm "$@" || [ $? -eq 5 ]; }
set -v
"""
"""The smallest Debian has no sudo; with 5 `rtarm status` says that no ROS process serves the arm, which is so."""
CTRL_C = "kill -INT $!; wait $!"


class Failed(Exception):
    """What cannot be done, in one sentence."""


def refusal() -> str | None:
    """What this machine lacks, in one sentence."""
    if os.geteuid() != 0:
        return "A userland is mounted and entered by root alone: run this again as root."
    if shutil.which("debootstrap") is None:
        return "debootstrap is missing: run 'apt-get install debootstrap'."
    if not BINFMT.exists() or not BINFMT.read_text(encoding="ascii").startswith("enabled"):
        return (
            f"The kernel has no qemu for ARM64 programs ({BINFMT} is not enabled): run 'apt-get install "
            "qemu-user-static binfmt-support', mount binfmt_misc if it is not, and 'update-binfmts --enable "
            "qemu-aarch64'."
        )
    if "F" not in BINFMT.read_text(encoding="ascii").partition("flags:")[2].split("\n")[0]:
        return f"{BINFMT} lacks the flag F, without which qemu is not found inside: install Debian's qemu-user-static."
    return None


def mirror() -> tuple[str, str]:
    """Release and address of the Debian that this machine's own apt reads."""
    listed = subprocess.run(
        ["apt-get", "indextargets", "--format", "$(LABEL) $(CODENAME) $(REPO_URI)", "Created-By: Packages"],
        capture_output=True,
        text=True,
        check=True,
    )
    for line in listed.stdout.splitlines():
        label, release, address = line.split(" ")
        if label == "Debian" and release.isalpha():  # neither updates nor backports
            return release, address
    raise Failed("This machine's apt reads no release of Debian: run 'apt-get update', on a Debian.")


def make_userland() -> None:
    """Debian's smallest userland, unless it is there."""
    if (USERLAND / "debootstrap").exists():  # it was interrupted
        shutil.rmtree(USERLAND)
    if not (USERLAND / "usr" / "bin" / "python3").exists():
        if USERLAND.exists() and any(USERLAND.iterdir()):
            raise Failed(f"{USERLAND} holds something else: name another folder by RTARM_ARM64.")
        first = ["--arch=arm64", "--foreign", "--variant=minbase", f"--include={','.join(PACKAGES)}"]
        run(["debootstrap", *first, mirror()[0], str(USERLAND), mirror()[1]])
        run(["chroot", str(USERLAND), "/debootstrap/debootstrap", "--second-stage"])
    for path in OF_THIS_MACHINE:
        if Path(path).exists():
            shutil.copy(path, USERLAND / path[1:])
    if (Path.home() / PIPS_OWN).exists():
        (USERLAND / "opt" / PIPS_OWN).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(Path.home() / PIPS_OWN, USERLAND / "opt" / PIPS_OWN)


def run(command: list[str], environment: Mapping[str, str] | None = None) -> None:
    """Run a command, of which no process and no mount is left behind; raises Failed."""
    if code := subprocess.run([*APART, *command], env=environment, check=False).returncode:
        raise Failed(f"'{' '.join(command[:3])} …' ended with code {code}; what it said stands above.")


def inside(script: str, *, home: str = "/opt", folder: str = TREE) -> None:
    """Run a shell script in the userland; raises Failed."""
    kept = {key: value for key, value in os.environ.items() if key.startswith(("PIP_", "SSL_")) or "proxy" in key}
    environment = kept | {
        "HOME": home,
        "LANG": "C.UTF-8",
        "PIP_QUIET": "1",
        "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "XDG_CACHE_HOME": "/opt/cache",
    }
    run(["sh", "-ec", ENTER, str(USERLAND), "bash", "-ec", f"cd {folder}\n{script}"], environment)


def copy_tree() -> None:
    """Bring this tree in: what git knows of it, with its times, which numba's cache goes by."""
    target = USERLAND / TREE[1:]
    shutil.rmtree(target, ignore_errors=True)
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\0")):
        if os.path.lexists(ROOT / name):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name, follow_symlinks=False)


def make_environment() -> None:
    copy_tree()
    inside(f"python3 packaging/environment.py control --venv {VENV}")


def run_tests() -> None:
    folders = " ".join(f"tests/{folder}" for folder in TESTED)
    without = " ".join(f"--deselect={test}" for test in LEFT_OUT)
    pytest = f"{VENV}/bin/python -m pytest -q -m 'not process' --numprocesses=2 --dist=loadfile"
    inside(f"RTARM_EXAMPLES=few {pytest} {without} {folders}")


def compare_transcripts() -> None:
    inside(f"PYTHONPATH=tests {VENV}/bin/python -m transcripts --exact --jobs 2")


def commands_of_page() -> list[str]:
    """What the page tells to type where there is no ROS, in its order."""
    section = INSTALL.read_text(encoding="utf-8").partition("\n### Without ROS\n")[2].partition("\n### ")[0]
    blocks = re.findall(r"^```\n(.*?)^```$", section, re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


def follow_page() -> None:
    """Build the wheel, and type what the page shows, as one who has only that wheel."""
    inside(
        f"rm -rf {ON_PAGE} && mkdir {ON_PAGE}\n"
        f"{VENV}/bin/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir {ON_PAGE}/dist .\n"
        f"cp constraints.txt {ON_PAGE}/dist"
    )
    typed = [BESIDE.format(line) if SERVES.match(line) else line for line in commands_of_page()]
    inside("\n".join([TYPIST, *typed, CTRL_C]), home=ON_PAGE, folder=ON_PAGE)


STAGES: dict[str, Callable[[], None]] = {
    "userland": make_userland,
    "environment": make_environment,
    "tests": run_tests,
    "transcripts": compare_transcripts,
    "page": follow_page,
}


def main() -> int:
    parser = argparse.ArgumentParser(description="Run rtarm on ARM64, emulated.")
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=f"only these: {', '.join(STAGES)}")
    wanted = parser.parse_args().stages or list(STAGES)
    if unknown := set(wanted) - set(STAGES):
        parser.error(f"no stage is called {' or '.join(sorted(unknown))}; there are {', '.join(STAGES)}")
    signal.signal(signal.SIGTERM, lambda caught, _: sys.exit(128 + caught))
    try:
        if why := refusal():
            raise Failed(why)
        for stage in wanted:
            started = time.monotonic()
            print(f"--- {stage}", flush=True)
            STAGES[stage]()
            print(f"--- {stage}: {time.monotonic() - started:.0f} s", flush=True)
    except Failed as failed:
        print(failed, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
