"""The ros1 worker's environment: ROS 1's Python packages in addition to Midspan's, but no other system packages.

ROS 1 and ROS 2 use the same names for message packages, so one interpreter cannot have both, and the system's whole
package folder would also shadow the venv's NumPy and YAML. Therefore the worker runs on Midspan's Python with one
folder first on ``PYTHONPATH`` that contains only links to the ROS 1 packages.

This module imports no ROS packages.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import ipaddress
import os
import re
import shutil
import socket
import sys
import sysconfig
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

from bridge.config.model import Config
from bridge.state_file import state_folder

DEFAULT_MASTER = "http://localhost:11311"
"""rosgraph's default of ROS_MASTER_URI."""

PLACES = (Path("/opt/ros/noetic/lib/python3/dist-packages"), Path("/usr/lib/python3/dist-packages"))
"""Where ROS 1 installs its Python packages: from ROS's repository, and from Debian's or Ubuntu's."""

_ROS = (
    "rospy", "rosgraph", "roslib", "rospkg", "genpy", "genmsg", "catkin", "actionlib", "tf", "tf2_py", "tf2_ros",
    "dynamic_reconfigure", "message_filters", "rosbag", "rosmsg", "rosnode", "rosparam", "rosservice", "rostopic",
)  # fmt: skip
_NEEDED = ("rosgraph", "rosgraph_msgs", "roscpp", "genpy", "std_msgs")
_HELPERS = ("defusedxml", "netifaces", "gnupg", "distro")
"""Third-party imports of ROS 1's packages; linked only if Midspan's Python lacks them."""

_STALE_SECONDS = 30 * 24 * 3600.0
_EXTENSION = re.compile(r"\.cpython-(\d+)[^/]*\.so$")


def packages_folder(config: Config, environ: Mapping[str, str]) -> Path | None:
    """Return the folder of the ROS 1 Python packages: configured, sourced, or in a default location."""
    if config.ros1.packages is not None:
        places = [config.ros1.packages]
    else:
        places = [Path(p) for p in environ.get("PYTHONPATH", "").split(os.pathsep) if p] + list(PLACES)
    return next((p for p in places if (p / "rospy" / "__init__.py").is_file()), None)


def available(config: Config, environ: Mapping[str, str] | None = None) -> str:
    """Return why the ROS 1 side cannot run here, with the cure; "" if it can."""
    environ = os.environ if environ is None else environ
    folder = packages_folder(config, environ)
    if folder is None:
        if config.ros1.packages is not None:
            return f"ros1.packages: no rospy in {config.ros1.packages}; give the folder that contains 'rospy'"
        return (
            "no rospy on this machine: install it (Debian 12: apt install python3-rospy) or set ros1.packages"
            " to the folder that contains it"
        )
    lacking = [name for name in _NEEDED if not (folder / name).is_dir()]
    if lacking:
        return f"rospy in {folder} lacks {', '.join(lacking)}: install its dependencies (apt install python3-rospy)"
    return ""


def master_uri(config: Config, environ: Mapping[str, str]) -> str:
    """Return the master's URI: the embedded or configured one, else the environment's, else rosgraph's default."""
    return config.ros1.embedded_uri or config.ros1.master or environ.get("ROS_MASTER_URI") or DEFAULT_MASTER


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of the ros1 worker; raises `RuntimeError` if ROS 1 is not available."""
    reason = available(config, environ)
    if reason:
        raise RuntimeError(reason)
    folder = packages_folder(config, environ)
    assert folder is not None
    env = dict(environ)
    try:
        links = _links(folder, _cache_folder(environ))
    except OSError as err:
        raise RuntimeError(
            f"{_cache_folder(environ)} cannot be written: {err.strerror}; set $XDG_CACHE_HOME to a writable folder"
        ) from None
    env["PYTHONPATH"] = os.pathsep.join([str(links), *_ros1_paths(environ, folder)])
    env["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    _set_or_drop(env, "LD_LIBRARY_PATH", _foreign_libraries(environ))
    for name in ("ROS_DISTRO", "ROS_VERSION", "AMENT_PREFIX_PATH"):
        env.pop(name, None)
    env["ROS_MASTER_URI"] = master_uri(config, environ)
    _set_address(env, config)
    env["ROS_LOG_DIR"] = str(state_folder(config, environ) / "ros1-log")
    return env


def _cache_folder(environ: Mapping[str, str]) -> Path:
    if environ.get("CACHE_DIRECTORY"):
        return Path(environ["CACHE_DIRECTORY"].split(":")[0])
    home = Path(environ.get("HOME") or Path.home())
    return Path(environ.get("XDG_CACHE_HOME") or home / ".cache") / "midspan"


def _set_or_drop(env: dict[str, str], name: str, value: str) -> None:
    if value:
        env[name] = value
    else:
        env.pop(name, None)


def _ros1_paths(environ: Mapping[str, str], folder: Path) -> list[str]:
    """Return a sourced workspace's PYTHONPATH without ROS 2's folders and the linked one."""
    paths = [p for p in environ.get("PYTHONPATH", "").split(os.pathsep) if p]
    return [p for p in paths if not (Path(p) / "rclpy").exists() and Path(p) != folder]


def _foreign_libraries(environ: Mapping[str, str]) -> str:
    """Return LD_LIBRARY_PATH without this Python's own folders, which the ROS 2 wheels add."""
    prefix = Path(sys.prefix)
    paths = [p for p in environ.get("LD_LIBRARY_PATH", "").split(os.pathsep) if p]
    return os.pathsep.join(p for p in paths if prefix not in Path(p).parents)


def _set_address(env: dict[str, str], config: Config) -> None:
    """Set ROS_IP and ROS_HOSTNAME from the configuration, else the environment, else to loopback for a local master."""
    if config.ros1.hostname or config.ros1.ip:
        _set_or_drop(env, "ROS_HOSTNAME", config.ros1.hostname or "")
        _set_or_drop(env, "ROS_IP", config.ros1.ip or "")
    elif not env.get("ROS_IP") and not env.get("ROS_HOSTNAME"):
        env.pop("ROS_HOSTNAME", None)
        if is_local(urlsplit(env["ROS_MASTER_URI"]).hostname or ""):
            env["ROS_IP"] = "127.0.0.1"
        else:
            env.pop("ROS_IP", None)


def is_local(host: str) -> bool:
    """Return whether a master's host resolves only to loopback, so that no other machine can join."""
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    if host != socket.gethostname():
        return False
    with contextlib.suppress(OSError):
        addresses = {str(info[4][0]) for info in socket.getaddrinfo(host, None)}
        return all(ipaddress.ip_address(a.partition("%")[0]).is_loopback for a in addresses)
    return False


def _links(folder: Path, cache: Path) -> Path:
    """Return a folder of links to the packages in ``folder``; its name is a hash of the links, so it is never stale."""
    targets = _targets(folder)
    text = "\n".join(f"{name} {target}" for name, target in sorted(targets.items()))
    links = cache / f"ros1-{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    if links.is_dir():
        with contextlib.suppress(OSError):  # still usable if the disk is read-only by now
            os.utime(links)
        return links
    cache.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix="ros1-making-", dir=cache))
    try:
        for name, target in targets.items():
            (draft / name).symlink_to(target)
        draft.chmod(0o755)
        # another process may have been faster; its folder is the same
        with contextlib.suppress(OSError):
            draft.rename(links)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    _prune(cache, links)
    return links


def _prune(cache: Path, keep: Path) -> None:
    for old in cache.glob("ros1-*"):
        with contextlib.suppress(OSError):
            if old != keep and time.time() - old.stat().st_mtime > _STALE_SECONDS:
                shutil.rmtree(old)


def _targets(folder: Path) -> dict[str, Path]:
    """Return the links to create: all ROS 1 packages, and their dependencies that this Python lacks."""
    targets: dict[str, Path] = {}
    for entry in folder.iterdir():
        has_messages = any((entry / kind / "__init__.py").is_file() for kind in ("msg", "srv"))
        if entry.name in _ROS or has_messages or _is_missing_helper(entry):
            targets[entry.name] = entry.resolve()
    return targets


def _is_missing_helper(entry: Path) -> bool:
    """Return whether it is a helper that this Python lacks: pure Python, or an extension for this version."""
    name = entry.name.split(".")[0]
    if name not in _HELPERS or entry.suffix == ".egg-info" or importlib.util.find_spec(name) is not None:
        return False
    match = _EXTENSION.search(entry.name)
    return match is None or match.group(1) == sysconfig.get_config_var("py_version_nodot")
