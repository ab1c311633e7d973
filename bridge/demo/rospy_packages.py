"""The environment of ROS 1 programs that run on Midspan's Python: ROS 1's packages, but no other system packages.

ROS 1 and ROS 2 use the same names for message packages, so one interpreter cannot have both, and the system's whole
package folder would also shadow the venv's NumPy and YAML. Therefore the first folder on such a program's
``PYTHONPATH`` contains only links to the ROS 1 packages.
"""

from __future__ import annotations

import importlib.util
import os
import re
import sysconfig
from collections.abc import Mapping
from pathlib import Path

from bridge.adapters.ros1.environment import worker_environment
from bridge.config.model import Config

PLACES = (Path("/opt/ros/noetic/lib/python3/dist-packages"), Path("/usr/lib/python3/dist-packages"))
"""Where ROS 1 installs its Python packages: from ROS's repository, and from Debian's or Ubuntu's."""

_ROS = (
    "rospy", "rosgraph", "roslib", "rospkg", "genpy", "genmsg", "catkin", "actionlib", "tf", "tf2_py", "tf2_ros",
    "dynamic_reconfigure", "message_filters", "rosbag", "rosmsg", "rosnode", "rosparam", "rosservice", "rostopic",
)  # fmt: skip
_NEEDED = ("rosgraph", "rosgraph_msgs", "roscpp", "genpy", "std_msgs")
_HELPERS = ("defusedxml", "netifaces", "gnupg", "distro")
"""Third-party imports of ROS 1's packages; linked only if Midspan's Python lacks them."""

_EXTENSION = re.compile(r"\.cpython-(\d+)[^/]*\.so$")


def packages_folder(config: Config, environ: Mapping[str, str]) -> Path | None:
    """Return the folder of the ROS 1 Python packages: configured, sourced, or in a default location."""
    if config.ros1.packages is not None:
        places = [config.ros1.packages]
    else:
        places = [Path(p) for p in environ.get("PYTHONPATH", "").split(os.pathsep) if p] + list(PLACES)
    return next((p for p in places if (p / "rospy" / "__init__.py").is_file()), None)


def missing_rospy(config: Config, environ: Mapping[str, str]) -> str:
    """Return why ROS 1 programs cannot run here, with the cure; "" if they can."""
    folder = packages_folder(config, environ)
    if folder is None:
        if config.ros1.packages is not None:
            return f"ros1.packages: no rospy in {config.ros1.packages}; set it to the folder that contains 'rospy'"
        return (
            "no rospy on this machine: install it (Debian 12: apt install python3-rospy) or set ros1.packages"
            " to the folder that contains it"
        )
    lacking = [name for name in _NEEDED if not (folder / name).is_dir()]
    if lacking:
        return f"rospy in {folder} lacks {', '.join(lacking)}: install its dependencies (apt install python3-rospy)"
    return ""


def program_environment(config: Config, environ: Mapping[str, str], links: Path) -> dict[str, str]:
    """Return the environment of a ROS 1 program; create the folder ``links`` with links to ROS 1's packages for it.

    Raises `RuntimeError` if ROS 1 is not installed.
    """
    folder = packages_folder(config, environ)
    if folder is None:
        raise RuntimeError(missing_rospy(config, environ))
    links.mkdir()
    for name, target in _targets(folder).items():
        (links / name).symlink_to(target)
    env = worker_environment(config, environ)
    env["PYTHONPATH"] = os.pathsep.join(filter(None, [str(links), env.get("PYTHONPATH")]))
    return env


def _targets(folder: Path) -> dict[str, Path]:
    """Return the links to create: all ROS 1 packages, and their dependencies that this Python lacks."""
    targets: dict[str, Path] = {}
    for entry in folder.iterdir():
        has_messages = any((entry / kind / "__init__.py").is_file() for kind in ("msg", "srv"))
        if entry.name in _ROS or has_messages or _is_missing_helper(entry):
            targets[entry.name] = entry.resolve()
    return targets


def _is_missing_helper(entry: Path) -> bool:
    """Return whether an entry is a helper that this Python lacks: pure Python, or an extension for this version."""
    name = entry.name.split(".")[0]
    if name not in _HELPERS or entry.suffix == ".egg-info" or importlib.util.find_spec(name) is not None:
        return False
    match = _EXTENSION.search(entry.name)
    return match is None or match.group(1) == sysconfig.get_config_var("py_version_nodot")
