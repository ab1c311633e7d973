"""Packages built for real, and used by real ROS 2 programs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.interfaces import BuildError, activate, build, environment
from bridge.interfaces.cache import SITE, members
from tests.interfaces.packages import PACKAGES
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, ros2_environment, ros2_python
from tests.support.missing import COMPILER, needs

pytestmark = pytest.mark.thorough

TINY = {"midspan_tiny_msgs": {"msg/Tiny.msg": "int8 value"}}

USE = """
from rclpy.serialization import deserialize_message, serialize_message
from geometry_msgs.msg import Point, TransformStamped
from midspan_parts_msgs.action import Thing as Action
from midspan_parts_msgs.msg import Thing
from midspan_parts_msgs.srv import Thing as Service
from midspan_whole_msgs.msg import Whole

thing = Thing(triple=[1, -2, 3], values=[0.5, 1.5], names=["a", "bc"], points=[Point(x=2.0)])
assert thing.on and Thing.RED == "red" and Thing.LEVEL == 3
assert Thing.TRICKY == 'a"b; it' + "'s %d */ {}"
assert Service.Request.NONE == Service.Response.NONE == Action.Result.NONE == Action.Feedback.NONE == 0
whole = Whole(parts=[thing])
whole.where.transforms = [TransformStamped(child_frame_id="base")]
assert deserialize_message(serialize_message(whole), Whole) == whole
for message in (Service.Request(thing=thing), Action.Feedback(at=thing), Action.Goal(goal=7)):
    assert deserialize_message(serialize_message(message), type(message)) == message
print("used")
"""


def test_a_program_uses_the_built_packages(built: Path) -> None:
    env = os.environ | environment([built])
    done = subprocess.run([sys.executable, "-c", USE], env=env, capture_output=True, text=True, check=False, timeout=90)
    assert done.stdout.strip() == "used", done.stderr


def test_a_second_build_does_nothing(built: Path, cache: Path) -> None:
    reported: list[str] = []
    assert build(PACKAGES, cache, reported.append) == built
    assert reported == []


def test_the_prefix_is_a_ros2_prefix(built: Path) -> None:
    assert set(members(built)) == {"midspan_parts_msgs", "midspan_whole_msgs", "tf2_msgs"}
    for file in (
        "share/midspan_parts_msgs/msg/Thing.msg",
        "share/midspan_parts_msgs/msg/Thing.json",
        "share/midspan_parts_msgs/package.xml",
        "share/ament_index/resource_index/rosidl_interfaces/midspan_parts_msgs",
        "include/midspan_parts_msgs/midspan_parts_msgs/msg/thing.h",
        "lib/libmidspan_parts_msgs__rosidl_typesupport_introspection_c.so",
        f"{SITE}/midspan_parts_msgs/msg/_thing.py",
    ):
        assert (built / file).is_file(), file


def test_two_programs_exchange_a_built_type(built: Path) -> None:
    env = ros2_environment(**environment([built]))
    type_ = "midspan_whole_msgs/Whole"
    part = {"triple": [7, 8, 9], "values": [1.25], "names": ["n"], "on": False}
    with Peer(ROS2_PEER, ros2_python(), env) as listener, Peer(ROS2_PEER, ros2_python(), env) as talker:
        received = listener.subscribe("/built", type_, latched=True)
        talker.publish(talker.advertise("/built", type_, latched=True), {"parts": [part]})
        (message,) = listener.wait(received, 1)
    assert message["parts"][0].items() >= part.items()


@pytest.fixture(scope="module")
def tiny_outputs(cache: Path) -> list[list[str]]:
    """Build a package in two processes at the same time, and return the lines that each prints."""
    code = f"from bridge.interfaces import build; print(build({TINY!r}, progress=print))"
    env = os.environ | {"MIDSPAN_CACHE": str(cache)}
    builders = [
        subprocess.Popen([sys.executable, "-c", code], env=env, stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    return [builder.communicate(timeout=100)[0].splitlines() for builder in builders]


@pytest.fixture(scope="module")
def tiny(tiny_outputs: list[list[str]]) -> Path:
    """Return the prefix that the two processes built."""
    return Path(tiny_outputs[0][-1])


@needs(COMPILER)
def test_two_processes_build_a_package_only_once(tiny_outputs: list[list[str]]) -> None:
    assert tiny_outputs[0][-1] == tiny_outputs[1][-1]
    assert sum("building" in line for output in tiny_outputs for line in output) == 1


def test_a_missing_compiler_is_reported_with_its_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("CXX", raising=False)
    with pytest.raises(BuildError, match=r"'gcc' is not on the PATH.*apt install g\+\+"):
        build(TINY, tmp_path)


def test_a_failed_build_leaves_nothing_behind(tmp_path: Path, tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (built_before,) = members(tiny).values()
    package = tmp_path / "packages" / built_before.name
    with monkeypatch.context() as patch:
        patch.setenv("CXX", "false")
        with pytest.raises(BuildError, match="false failed"):
            build(TINY, tmp_path)
    assert not list((tmp_path / "packages").iterdir())
    # as left by a process that is killed while it builds
    left = package.with_name(f".{package.name}-killed")
    left.mkdir()
    assert build(TINY, tmp_path).name == tiny.name
    assert package.is_dir()
    assert not left.exists()


def test_a_cache_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BuildError, match="MIDSPAN_CACHE"):
        build(TINY, tmp_path / "file")


def test_activate_names_packages_that_were_imported_before(built: Path) -> None:
    code = f"""
import sys
from pathlib import Path
from bridge.interfaces import activate
assert activate(Path({str(built)!r})) == ()
import midspan_parts_msgs.msg
assert midspan_parts_msgs.msg.Thing
assert activate(Path({str(built)!r})) == ()
sys.modules["tf2_msgs"] = type(sys)("tf2_msgs")
assert activate(Path({str(built)!r})) == ("tf2_msgs",)
assert sys.path.count(sys.path[0]) == 1
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100)
    assert ended.returncode == 0, ended.stderr


def test_different_builds_of_one_package_do_not_mix(built: Path, cache: Path) -> None:
    other = build({"midspan_parts_msgs": {"msg/Thing.msg": "int8 other"}}, cache)
    for use in (lambda: environment([built, other]), lambda: activate(built, other)):
        with pytest.raises(BuildError, match="midspan_parts_msgs is in"):
            use()


def test_several_prefixes_merge(built: Path, tiny: Path) -> None:
    env = os.environ | environment([built, tiny])
    code = "import midspan_tiny_msgs.msg, midspan_whole_msgs.msg, tf2_msgs.msg, midspan_parts_msgs.srv"
    ended = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=100)
    assert ended.returncode == 0, ended.stderr
