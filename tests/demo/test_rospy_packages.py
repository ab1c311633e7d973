"""The environment of ROS 1 programs that run on Midspan's Python."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.config.model import Config
from bridge.config.sections.ros import Ros1Section
from bridge.demo.rospy_packages import PLACES, missing_rospy, packages_folder, program_environment
from tests.peers.ros1.network import needs_ros1


@pytest.fixture
def packages(tmp_path: Path) -> Path:
    """A folder like ROS 1's, with entries that must not be linked."""
    folder = tmp_path / "dist-packages"
    for name in ("rospy", "rosgraph", "genpy", "numpy", "yaml", "rosgraph_msgs/msg", "roscpp/srv", "std_msgs/msg"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").touch()
    (folder / "gnupg.py").touch()
    (folder / "netifaces.cpython-27-x86_64-linux-gnu.so").touch()
    (folder / "defusedxml").mkdir()
    return folder


def on(packages: Path) -> Config:
    return Config(ros1=Ros1Section(packages=packages))


def test_only_ros1_packages_and_missing_helpers_are_linked(tmp_path: Path, packages: Path) -> None:
    env = program_environment(on(packages), {"PYTHONPATH": "/work"}, tmp_path / "links")
    assert env["PYTHONPATH"].split(os.pathsep) == [str(tmp_path / "links"), "/work"]
    assert {p.name for p in (tmp_path / "links").iterdir()} == {
        "rospy", "rosgraph", "genpy", "rosgraph_msgs", "roscpp", "std_msgs", "gnupg.py", "defusedxml"
    }  # fmt: skip
    assert env["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] == "1"


def test_the_reason_why_rospy_is_missing(tmp_path: Path, packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert missing_rospy(on(packages), {}) == ""
    assert "ros1.packages" in missing_rospy(on(tmp_path), {})
    (packages / "std_msgs" / "msg" / "__init__.py").unlink()
    (packages / "std_msgs" / "msg").rmdir()
    (packages / "std_msgs").rmdir()
    assert "std_msgs" in missing_rospy(on(packages), {})
    monkeypatch.setattr("bridge.demo.rospy_packages.PLACES", ())
    assert "apt install" in missing_rospy(Config(), {})
    with pytest.raises(RuntimeError, match="apt install"):
        program_environment(Config(), {}, tmp_path / "links")


def test_a_sourced_ros1_has_precedence(packages: Path) -> None:
    assert packages_folder(Config(), {"PYTHONPATH": f"/nowhere{os.pathsep}{packages}"}) == packages
    assert packages_folder(Config(), {"PYTHONPATH": "/nowhere"}) in (None, *PLACES)


@needs_ros1
def test_real_rospy_imports_with_midspans_libraries(tmp_path: Path) -> None:
    code = "import rospy, std_msgs.msg, netifaces, numpy, zenoh; print(std_msgs.msg.String._md5sum, numpy.__file__)"
    env = program_environment(Config(), {"PATH": os.environ["PATH"]}, tmp_path / "links")
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    md5, numpy = done.stdout.split()
    assert md5 == "992ce8a1687cec8c8bd883ec73ca41d1"
    assert numpy.startswith(sys.prefix)
