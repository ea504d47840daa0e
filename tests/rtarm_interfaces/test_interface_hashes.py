"""control_msgs is byte-compatible with everybody else's: type hashes, serialisation, and how it is built.

robot_arm_interfaces is built the same way; its hashes say that nobody changes it unnoticed.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient, ActionServer
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectoryPoint

from rtarm_interfaces import build

ROOT = Path(__file__).resolve().parents[2]

# RIHS01 hashes of control_msgs 5.8, found independently of rtarm: the first eight from another build of
# upstream's definitions, the others by applying the published rule to the field tables.
TYPE_HASHES = dict(
    row.split()
    for row in """
action/FollowJointTrajectory 738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cfe508015d9be8485e4b1c66f6
action/FollowJointTrajectory_Goal 8a9060704b269608f5a340934cc26e66869dd14bdac29e2e7fd9ec8b9882d205
action/FollowJointTrajectory_Result 8002e99ed2c14c6faa522f2a93c26d744c5982f254f9e98ff9c6f19789bdb220
action/FollowJointTrajectory_Feedback 3fd0aaecf71725121ae1ff7f01098a5e0da581e672be18a6b2c286cb43d96b49
action/FollowJointTrajectory_SendGoal b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f
action/FollowJointTrajectory_GetResult e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b
msg/JointTolerance c254f9cece0f3b733017b6990fd46d1326e25242d6b8844398c97d9a88e7d648
msg/JointComponentTolerance 739ea7566931944d33830fa10f1bf5e7a7fbdc3172bce7a7eaac642bd6e3ffa4
action/FollowJointTrajectory_FeedbackMessage 80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71
action/GripperCommand e17c0e644eccf14bea84a0a93e0977182872c2eb7873ca6694900059b46dbc84
action/GripperCommand_SendGoal 6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212
action/GripperCommand_GetResult 7e60a7606063d4a2728d21badac099e68b734a196ac3ab42d1d4c668eb0bb3cd
action/GripperCommand_FeedbackMessage 392ff03fcd872f9dc2405cbeb2897fcf011ad9998458b6aa85c603b8a49e431d
action/ParallelGripperCommand adfd3c1ebe8abc38ebcc0e454b6423d291d4010dd5697d14eca5b9be4726ae18
action/ParallelGripperCommand_SendGoal 567c37373fed1260adbe047415688c73e4f3e94b2e3982761ecc71fd63d710a7
action/ParallelGripperCommand_GetResult e4c7f0e8a831ce5625ed20abcd13796406d945f92ebc7ad5972e0b0d29b381bd
action/ParallelGripperCommand_FeedbackMessage c61f4cf99d06c5a3e24bed17c2910bdf66a30d89461e2ac7b5fd538a34b022cc
msg/JointTrajectoryControllerState 51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480
msg/DynamicJointState 18024c98a62697680f581108eeed40b28fb4542fa0ac5a8e36f56c62b6813d26
msg/InterfaceValue 74a12144ef6b7af67533195cb30f7f607d3301b66950208a72d280695f3e190c
msg/JointJog ba249455a20f70168a1acb7bf43b776b72ff1f7eb5fc4cfea443f749e963c6e7
msg/SpeedScalingFactor 0c240f349f2b74e33e8741f83e0f196ddeb6585923663876ed3c1f51f0566037
msg/GripperCommand 57eb8f326c9889ca8bb34ead82cc94cc09bf6bc5c3b6c09546dca3a00b589890
srv/QueryTrajectoryState 4a0935dffef18bc5b9e101c9d03d84e681ecd4cebd724b8f11fde008751a325a
srv/QueryCalibrationState c6b9d1fd88cba488075ee9fd7b69ea4ff6b12bcdd01afeb9c608dd6f8274de57
""".strip().splitlines()
)

# RIHS01 hashes of robot_arm_interfaces, found by applying the published rule to the field tables of the facts.
FULL_NODE_HASHES = dict(
    row.split()
    for row in """
msg/MotorAngles e850e727db99f585e741b8a545ead627f69fcdcc8f933d8267c46b9ed0d32df1
srv/ReadMotorAngles fc2e44961d97faf0796a88160b460223ac53d149a4b977ddd1776beecca3ef81
srv/SetFreeMode 0a98824bef3e043ea685d1c58e5ba1a43a0bbcf1f3c6db74f5f6c5febb3781ad
srv/GripperControl c867fdb0685ab767e60b4cb94ac0918185638b870821c96db2c836caecc69efd
srv/ServoGripper dfe88c25474a7d65846d48c0d3a8ac2cfc4006cc4c8b6dceeb3d8cdbd9cd16bf
action/AngleMode_SendGoal 070e77f39e05b3e2244820f3d805c92bdb550ac63ecd9c16a85fa3c4934b6ee1
action/AngleMode_GetResult b12819ece12a38526de23c53c79c21f24b688b4e11aaa2cf7b276b41ae0d2f78
action/AngleMode_FeedbackMessage b150b0f81bbb5c4c58bfc64af205f56aef8e27d81e50085ed5dbd60536a38672
action/AngleMode e98a6fc4cc629c70fd4c3b1a181ebdea072b0ff11f2fc359ecd07603987566b1
action/MoveXyzRotation_SendGoal 59593a5b781a58f465b462ef5dc1f863f2e693ac43d41882754995ddb6e863f4
action/MoveXyzRotation_GetResult 4c0ddd49d85d91a9e77d3937d350d976d704acb7d48a80bbfcb107a8cb48c995
action/MoveXyzRotation_FeedbackMessage bea41f0436a704dbc1f593138d4fa484dca001b08bad80e0072321652c38862f
action/MoveXyzRotation 075b466e22326e32cd42c71420dce877ced13e9eb51dc696e22c7baede894aba
action/LinearMove_SendGoal a81f0a813292b6ea19bb1d9b66d24d5eff90f2f1e65f68a8405777a4f9b7f975
action/LinearMove_GetResult d6c48483f0612b79a73154de0827d3116331540da2e9a1a51897a135addce655
action/LinearMove_FeedbackMessage 191e6612f00b2710b831023ec87ec8b624b95dd1cd4eacd6188ed70523aebbd3
action/LinearMove 06118e7f7ae430dd37e5c854a981643ece965cc1cbf15a5bd7b0e1cfb2d33453
""".strip().splitlines()
)
TYPES = [
    (package, name, type_hash)
    for package, hashes in ((build.CONTROL_MSGS, TYPE_HASHES), (build.ROBOT_ARM_INTERFACES, FULL_NODE_HASHES))
    for name, type_hash in hashes.items()
]


class _TypeHash(ctypes.Structure):
    """rosidl_type_hash_t of rosidl_runtime_c."""

    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


def compiled_type_hash(package: build.Package, kind_and_name: str) -> tuple[int, str]:
    """Version and hash that the compiled type support announces on the wire."""
    library = ctypes.CDLL(f"lib{package.name}__rosidl_generator_c.so")
    function = library[f"{package.name}__{kind_and_name.replace('/', '__')}__get_type_hash"]
    function.restype = ctypes.POINTER(_TypeHash)
    function.argtypes = (ctypes.c_void_p,)
    type_hash = function(None).contents
    return type_hash.version, bytes(type_hash.value).hex()


@pytest.mark.parametrize(("package", "name", "type_hash"), TYPES, ids=[name for _, name, _ in TYPES])
def test_compiled_types_have_the_published_hash(package: build.Package, name: str, type_hash: str) -> None:
    assert compiled_type_hash(package, name) == (1, type_hash)


@pytest.mark.parametrize("package", build.PACKAGES, ids=lambda package: package.name)
def test_every_definition_has_a_hash_here(package: build.Package) -> None:
    known = {name for of, name, _ in TYPES if of == package}
    defined = {f"{path.suffix[1:]}/{path.stem}" for path in build.definition_files(package)} & {
        f"{path.parent.name}/{path.stem}" for path in build.definition_files(package)
    }
    assert defined <= known


def test_constants_of_the_result() -> None:
    result = FollowJointTrajectory.Result
    assert result.SUCCESSFUL == 0
    assert result.INVALID_GOAL == -1
    assert result.INVALID_JOINTS == -2
    assert result.OLD_HEADER_TIMESTAMP == -3
    assert result.PATH_TOLERANCE_VIOLATED == -4
    assert result.GOAL_TOLERANCE_VIOLATED == -5


def test_goal_survives_serialisation() -> None:
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = ["joint_1", "joint_2"]
    point = JointTrajectoryPoint(positions=[0.5, -0.25], velocities=[0.0, 1e-9])
    point.time_from_start.nanosec = 400_000
    goal.trajectory.points = [JointTrajectoryPoint(positions=[0.0, 0.0]), point]
    goal.goal_tolerance = [JointTolerance(name="joint_2", position=-1.0)]
    goal.goal_time_tolerance.sec = 2

    returned = deserialize_message(serialize_message(goal), FollowJointTrajectory.Goal)

    assert returned == goal
    assert np.array_equal(returned.trajectory.points[1].positions, [0.5, -0.25])


def test_action_server_and_client_talk() -> None:
    """A goal, its feedback and its result through the middleware, which needs every type support."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Node("interface_test", context=context, start_parameter_services=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def execute(goal: ServerGoalHandle) -> FollowJointTrajectory.Result:
        goal.publish_feedback(FollowJointTrajectory.Feedback(joint_names=goal.request.trajectory.joint_names))
        goal.succeed()
        return FollowJointTrajectory.Result(error_string="reached")

    server = ActionServer(node, FollowJointTrajectory, "~/follow_joint_trajectory", execute)
    client = ActionClient(node, FollowJointTrajectory, "~/follow_joint_trajectory")
    heard: list[list[str]] = []
    try:
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = ["joint_1"]
        while not client.server_is_ready():
            executor.spin_once(timeout_sec=0.05)
        sent = client.send_goal_async(
            goal, feedback_callback=lambda message: heard.append(list(message.feedback.joint_names))
        )
        executor.spin_until_future_complete(sent, timeout_sec=10.0)
        result = sent.result().get_result_async()
        executor.spin_until_future_complete(result, timeout_sec=10.0)
        assert result.result().result.error_string == "reached"
        while not heard:
            executor.spin_once(timeout_sec=0.05)
        assert heard == [["joint_1"]]
    finally:
        client.destroy()
        server.destroy()
        node.destroy_node()
        executor.shutdown()
        rclpy.shutdown(context=context)


def test_second_build_has_nothing_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert build.main() == 0
    said = capsys.readouterr().out
    for package in build.PACKAGES:
        assert f"{package.name}: up to date" in said or build.installed_elsewhere(package) is not None


@pytest.mark.parametrize("package", build.PACKAGES, ids=lambda package: package.name)
def test_a_changed_definition_changes_the_fingerprint(
    package: build.Package, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before = build.fingerprint(package)
    for path in build.definition_files(package):
        copy = tmp_path / path.relative_to(build.DEFINITIONS)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    monkeypatch.setattr(build, "DEFINITIONS", tmp_path)
    assert build.fingerprint(package) == before
    with (package.definitions / "msg" / f"{package.message}.msg").open("a") as definition:
        definition.write("float64 jerk\n")
    assert build.fingerprint(package) != before


def test_an_environment_reached_through_a_link_is_the_same_one(tmp_path: Path) -> None:
    """Else a build through the link would make everything anew, and each of both undo the other's."""
    link = tmp_path / "environment"
    link.symlink_to(sys.prefix)
    said = [
        subprocess.run(
            [prefix / "bin" / "python", "-c", "from rtarm_interfaces.build import *; print(PREFIX, SITE_PACKAGES)"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for prefix in (Path(sys.prefix), link)
    ]
    assert said[0] == said[1] != ""


def one_sentence(error: BaseException) -> str:
    """The text of an error, after checking that it is a single line with a remedy in it."""
    text = str(error)
    assert "\n" not in text
    assert "install" in text
    return text


def test_missing_compiler_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(build.BuildError) as error:
        build.check_tools(build.CONTROL_MSGS, str(tmp_path))
    assert "no C and C++ compiler" in one_sentence(error.value)
    assert "apt-get install gcc g++" in str(error.value)


def test_missing_make_is_one_sentence(tmp_path: Path) -> None:
    for name in ("cc", "c++"):
        (tmp_path / name).symlink_to("/bin/true")
    with pytest.raises(build.BuildError) as error:
        build.check_tools(build.CONTROL_MSGS, str(tmp_path))
    assert "neither ninja nor make" in one_sentence(error.value)


def test_missing_headers_are_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("cc", "c++", "make"):
        (tmp_path / name).symlink_to("/bin/true")
    assert build.check_tools(build.CONTROL_MSGS, str(tmp_path)) == "Unix Makefiles"
    monkeypatch.setattr(build.sysconfig, "get_path", lambda _: str(tmp_path))
    with pytest.raises(build.BuildError) as error:
        build.check_tools(build.CONTROL_MSGS, str(tmp_path))
    assert "python3-dev" in one_sentence(error.value)


def test_missing_wheels_are_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "REQUIRED_WHEELS", ("ros-jazzy-rclpy", "ros-jazzy-not-there"))
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(build.BuildError) as error:
        build.check_wheels(build.CONTROL_MSGS)
    assert "(missing: ros-jazzy-" in one_sentence(error.value)
    assert "make env" in str(error.value)


def test_ros_installation_without_control_msgs_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(build, "SITE_PACKAGES", tmp_path)  # rclpy now comes from somewhere else
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    with pytest.raises(build.BuildError) as error:
        build.check_wheels(build.CONTROL_MSGS)
    assert "apt-get install ros-jazzy-control-msgs" in one_sentence(error.value)


def test_ros_installation_without_robot_arm_interfaces_is_no_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Its workspace builds the package; without it the arm has everything but the full node's interfaces."""
    monkeypatch.setattr(build, "SITE_PACKAGES", tmp_path)
    monkeypatch.setattr(build, "installed_elsewhere", lambda package: tmp_path if package.needed else None)
    assert build.main() == 0
    said = capsys.readouterr()
    assert said.out == f"control_msgs: taken from {tmp_path}, nothing to generate\n"
    assert said.err.count("\n") == 1
    assert "link rtarm_interfaces/robot_arm_interfaces into the src folder of your workspace" in said.err


def test_a_failing_build_command_shows_its_last_lines() -> None:
    with pytest.raises(build.CommandFailed) as error:
        build.run(build.CONTROL_MSGS, "the compilation", [sys.executable, "-c", "print('reason'); exit(3)"], os.environ)
    assert error.value.log == "reason"
    assert "the compilation failed" in str(error.value)


def test_command_without_wheels_exits_with_the_sentence(tmp_path: Path) -> None:
    """The command itself, in a Python that sees no site-packages: exit code 1 and one line."""
    result = subprocess.run(
        [sys.executable, "-S", "-E", "-m", "rtarm_interfaces.build"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": str(tmp_path), "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
    )
    assert result.returncode == 1
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert "make env" in result.stderr


def test_the_extra_ros_installs_what_the_build_needs() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = {
        requirement.split("[")[0].split(">")[0].split("<")[0].strip()
        for requirement in [*project["dependencies"], *project["optional-dependencies"]["ros"]]
    }
    assert set(build.REQUIRED_WHEELS) <= names
