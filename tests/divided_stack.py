"""The running parts of an arm that is divided among two buses, each part a process of its own."""

import math
import signal
from collections.abc import Sequence
from pathlib import Path

from arm_files import edited
from observer import life_violations
from stack import PATIENT, Process, Stack
from two_buses import NAMES, write_divided

from config.loader import load_arm
from sim.truth import JointTruth, load_truth


class DividedStack(Stack):
    """episode1, divided as `two_buses` does, with a simulator at each of its buses."""

    def __init__(self, name: str, folder: Path, start_rad: Sequence[float]) -> None:
        super().__init__(name, folder, start_deg=[math.degrees(angle) for angle in start_rad])
        self.links = {bus: folder / f"tty_{bus}" for bus in NAMES}
        self.truth_files = {bus: folder / f"truth_{bus}.npz" for bus in NAMES}
        front = {"controller_name": f"controller_{name}"}
        write_divided("episode1", self.arm_file, name=name, limits=PATIENT, front=front)
        with edited(self.arm_file) as values:
            for bus in values["bus"]:
                bus["channel"] = str(self.links[bus["name"]])
        self.parts = dict(zip(NAMES, load_arm(self.arm_file).parts, strict=True))
        self.sims: dict[str, Process] = {}

    def start_sims(self) -> None:
        same = ("--arm", str(self.arm_file), "--faults-from-stdin")
        start = "--start-deg=" + ",".join(str(angle) for angle in self._start_deg)
        for bus in NAMES:
            place = ("--bus", bus, "--link", str(self.links[bus]), "--truth", str(self.truth_files[bus]))
            self.sims[bus] = self._keep(Process("sim", *same, *place, start))
        for sim in self.sims.values():
            sim.line_with("ready")

    def truth_of(self, bus: str) -> dict[str, JointTruth]:
        """What the drives on this bus have done up to now."""
        self.sims[bus].process.send_signal(signal.SIGUSR1)
        self.sims[bus].line_with("truth")
        return load_truth(self.truth_files[bus])

    def unplug_bus(self, bus: str) -> None:
        self.links[bus].unlink()
        self.sims[bus].process.kill()

    def _look(self) -> None:
        for bus, file in self.truth_files.items():
            if file.exists():
                self._found += life_violations(self.parts[bus], load_truth(file))
                file.unlink()
