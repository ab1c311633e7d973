"""What the demo needs on this machine, and what to install where it is missing."""

from __future__ import annotations

import os
import shutil
from importlib.util import find_spec
from pathlib import Path

from bridge.adapters.ros1 import environment as ros1
from bridge.adapters.ros2 import environment as ros2
from bridge.config.model import Config

SYSTEM_PYTHON = Path("/usr/bin/python3")
"""The Python that ROS 1's packages are installed for."""

_APT = (
    "apt install python3-rospy python3-roslaunch python3-std-msgs python3-sensor-msgs python3-nav-msgs"
    " python3-geometry-msgs python3-tf2-msgs"
)


def missing(config: Config) -> list[str]:
    """What is missing, each with its cure; empty where the demo can run."""
    return [reason for reason in (_ros1(config), _ros2(config), _zenoh()) if reason]


def ros1_packages(config: Config) -> Path:
    """Folder of ROS 1's Python packages; to be asked only where nothing is `missing`."""
    folder = ros1.packages_folder(config, os.environ)
    assert folder is not None
    return folder


def roscore(config: Config) -> Path:
    """The program ``roscore``."""
    found = shutil.which("roscore", path=f"{ros1_packages(config).parents[2] / 'bin'}:{os.environ.get('PATH', '')}")
    assert found is not None
    return Path(found)


def _ros1(config: Config) -> str:
    reason = ros1.available(config)
    if reason:
        return f"ROS 1: {reason}"
    folder = ros1_packages(config)
    lacking = [
        name for name in ("nav_msgs", "sensor_msgs", "geometry_msgs", "tf2_msgs") if not (folder / name).is_dir()
    ]
    if lacking:
        return f"ROS 1: {folder} lacks {', '.join(lacking)}: {_APT}"
    if shutil.which("roscore", path=f"{folder.parents[2] / 'bin'}:{os.environ.get('PATH', '')}") is None:
        return f"ROS 1: no roscore on this machine: {_APT}"
    return ""


def _ros2(config: Config) -> str:
    reason = ros2.available(config)
    if reason:
        return f"ROS 2: {reason}"
    if find_spec("tf2_msgs") is None:
        return "ROS 2: no message package tf2_msgs for this Python: midspan interfaces build"
    return ""


def _zenoh() -> str:
    if find_spec("zenoh_ros2_sdk") is None:
        return "zenoh: no zenoh-ros2-sdk for this Python: pip install zenoh-ros2-sdk==0.1.8"
    return ""
