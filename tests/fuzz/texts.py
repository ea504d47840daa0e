"""Hostile arm files, overrides and parameters: a valid configuration comes of them, or a sentence."""

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from config.budget import check_budget
from config.errors import ConfigError
from config.loader import ARMS_FOLDER, load_arm, parse_overrides
from config.schema import ArmConfig
from fuzz.messages import check_sentence

SCALARS = (
    *(
        "1e400",
        "-1e400",
        ".nan",
        ".inf",
        "-.inf",
        "0",
        "-1",
        "1e-320",
        "0x7fffffffffffffff",
        "9" * 4400,
        "1_000",
        "0o17",
    ),
    *(
        "true",
        "no",
        "~",
        "null",
        '""',
        "''",
        "2026-02-30",
        "2026-01-01",
        "!!binary aGk=",
        "!!python/object:os.system x",
    ),
    *(
        "!!set {a}",
        "!!float 1",
        "!!int x",
        "*unknown",
        "&a [*a]",
        "{a: {a: {a: 1}}}",
        "[[[[[]]]]]",
        "é🤖",
        '"\\0"',
        "\u2028",
    ),
    *("1:30:00", "- 1", "? [a]", "{? {b: 1}: c}", "&x {<<: *x}", "|\n  a\n  b", "6", "3.5", "mock", "zdt", "x" * 3000),
)
KEYS = ("name", "<<", "1", "~", "true", "[a]", "{b: c}", "ratio", "joints", "é", "", "a.b", "? x", '"\\n"', "x" * 500)


def bomb(random: np.random.Generator) -> str:
    """Small files that grow when they are read: aliases, merged keys, nesting."""
    depth, kind = int(random.integers(5, 60)), random.integers(4)
    if kind == 0:
        lines = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, depth)]
        return "\n".join([*lines, f"joints: *a{depth - 1}"])
    if kind == 1:
        merged = [f"b{i}: &b{i} {{<<: [{', '.join([f'*b{i - 1}'] * 9)}]}}" for i in range(1, depth)]
        return "\n".join(["b0: &b0 {k: 1, l: 2}", *merged, f"<<: *b{depth - 1}"])
    if kind == 2:
        return "a: " + "[" * depth * 100 + ("]" * depth * 100 if random.random() < 0.5 else "")
    return "a: " + "{a: " * depth * 40 + "1" + "}" * depth * 40


class Texts:
    """One target of texts."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.accepted = self.executed = 0
        self._folder = tempfile.TemporaryDirectory()
        whole = (ARMS_FOLDER / "episode1.yaml").read_text(encoding="utf-8")
        values = yaml.safe_load(whole)
        values["joints"] = values["joints"][:1]
        del values["kinematics"], values["homing"]  # one row and one angle a joint
        self._values = values

    def case(self, random: np.random.Generator) -> None:
        """Make one text and read it; raises when anything but a sentence or a sound arm comes of it."""
        try:
            arm = self._overridden(random) if self.kind == "overrides" else self._file(random)
            self.accepted += 1
            self._check(arm)
        except ConfigError as problem:
            for error in problem.errors or [problem]:
                check_sentence(str(error))

    def _check(self, arm: ArmConfig) -> None:
        assert 1 <= len(arm.joints) <= 32
        for joint in arm.joints:
            assert joint.lower_rad < joint.upper_rad
            for number in (joint.max_velocity_rad_s, joint.max_acceleration_rad_s2, joint.lower_rad, joint.upper_rad):
                assert math.isfinite(number)
            assert joint.max_velocity_rad_s > 0.0 and joint.max_acceleration_rad_s2 > 0.0
        assert arm.control.period_ns > 0
        check_budget(arm)

    def _file(self, random: np.random.Generator) -> ArmConfig:
        dice = random.random()
        if dice < 0.05:
            data = bomb(random).encode()
        elif dice < 0.5:
            data = yaml.safe_dump(self._mutated(random), allow_unicode=True).encode()
        else:
            data = self._bent(random, yaml.safe_dump(self._values, sort_keys=False))
        path = Path(self._folder.name) / "arm.yaml"
        path.write_bytes(data)
        return load_arm(path)

    def _mutated(self, random: np.random.Generator) -> Any:
        """The values with some of them replaced, removed, doubled or moved, as a tree."""
        values = yaml.safe_load(yaml.safe_dump(self._values))
        for _ in range(int(random.integers(1, 4))):
            node: Any = values
            while True:
                keys = list(node) if isinstance(node, dict) else list(range(len(node)))
                if not keys:
                    break
                key = keys[int(random.integers(len(keys)))]
                if isinstance(node[key], dict | list) and random.random() < 0.7:
                    node = node[key]
                    continue
                kind = random.integers(5)
                if kind == 0:
                    del node[key]
                elif kind == 1 and isinstance(node, dict):
                    node[KEYS[random.integers(len(KEYS))]] = node[key]
                elif kind == 2:
                    node[key] = [node[key]] * int(random.integers(0, 40))
                else:
                    node[key] = self._scalar(random)
                break
        return values

    def _scalar(self, random: np.random.Generator) -> Any:
        choices = (0, -1, 1, 1e308, -1e308, 5e-324, math.nan, math.inf, 2**63, 10**30, True, None, "", "x", [], {}, "é")
        if random.random() < 0.4:
            return float(random.normal() * 10.0 ** random.integers(-12, 12))
        return choices[int(random.integers(len(choices)))]

    def _bent(self, random: np.random.Generator, text: str) -> bytes:
        """The text with lines and bytes of it changed."""
        lines = text.split("\n")
        for _ in range(int(random.integers(1, 4))):
            at, kind = int(random.integers(len(lines))), random.integers(6)
            scalar = SCALARS[random.integers(len(SCALARS))]
            if kind == 0:
                lines[at] = lines[at].split(":")[0] + ": " + scalar
            elif kind == 1:
                lines.insert(at, lines[int(random.integers(len(lines)))])
            elif kind == 2:
                lines[at] = "\t" + lines[at]
            elif kind == 3:
                lines.insert(at, f"{KEYS[random.integers(len(KEYS))]}: {scalar}")
            elif kind == 4:
                lines[at] = lines[at] + " " + scalar
        data = bytearray("\n".join(lines), "utf-8", "surrogatepass")
        if random.random() < 0.4:
            for _ in range(int(random.integers(1, 6))):
                at = int(random.integers(len(data)))
                if random.random() < 0.5:
                    data[at] = int(random.integers(256))
                else:
                    data[at:at] = random.bytes(int(random.integers(1, 4)))
        return bytes(data)

    def _overridden(self, random: np.random.Generator) -> ArmConfig:
        sections = {name: list(value) for name, value in self._values.items() if isinstance(value, dict)}
        assignments = []
        for _ in range(int(random.integers(1, 4))):
            section = list(sections)[random.integers(len(sections))]
            key = sections[section][random.integers(len(sections[section]))]
            if random.random() < 0.2:
                key = KEYS[random.integers(len(KEYS))]
            value = SCALARS[random.integers(len(SCALARS))]
            if random.random() < 0.3:
                value = f"{random.normal() * 10.0 ** random.integers(-3, 6):g}"
            if random.random() < 0.03:
                value = bomb(random)
            text = f"{section}.{key}={value}"
            if random.random() < 0.1:
                at = int(random.integers(len(text)))
                text = text[:at] + random.choice(["", "=", ".", "[", "\0", "\t", "\n", "{"]) + text[at + 1 :]
            assignments.append(text)
        return load_arm("mock" if random.random() < 0.5 else "episode1", overrides=parse_overrides(assignments))

    def close(self) -> None:
        self._folder.cleanup()


class Parameters:
    """The rules of the node's parameters; needs ROS."""

    def __init__(self) -> None:
        from rosfront.parameters import rules

        self.accepted = self.executed = 0
        self._rules = rules(load_arm("mock"))

    def case(self, random: np.random.Generator) -> None:
        """Offer one value to one parameter."""
        from rosfront.settings import Settings
        from rosfront.start_parameters import BadParameter

        rule = self._rules[int(random.integers(len(self._rules)))]
        value = self._value(random, rule.default)
        try:
            checked = rule.checked(value)
        except BadParameter as problem:
            check_sentence(str(problem))
            return
        self.accepted += 1
        assert type(checked) is type(rule.default)
        adopted = rule.adopt(Settings.of(load_arm_once()), checked)
        numbers = (*adopted.path_tolerance_rad, *adopted.goal_tolerance_rad, adopted.goal_time_s, adopted.feedback_hz)
        assert all(math.isfinite(number) and number >= 0.0 for number in numbers)

    def _value(self, random: np.random.Generator, default: Any) -> Any:
        if random.random() < 0.5 and isinstance(default, float):
            return float(random.normal() * 10.0 ** random.integers(-9, 9))
        choices = (
            *(
                0,
                1,
                -1,
                2**63 - 1,
                -(2**63),
                0.0,
                -0.0,
                math.nan,
                math.inf,
                -math.inf,
                5e-324,
                1e308,
                True,
                False,
                None,
                "",
            ),
            *("joint1", "\n", "x" * 5000, b"x", [], ["joint1"], [1.0], [None], {}, default),
        )
        return choices[int(random.integers(len(choices)))]

    def close(self) -> None:
        """Nothing is open."""


_ARMS: list[ArmConfig] = []


def load_arm_once() -> ArmConfig:
    """The mock arm, read once."""
    if not _ARMS:
        _ARMS.append(load_arm("mock"))
    return _ARMS[0]
