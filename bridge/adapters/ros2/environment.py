"""What a ros2 worker's process needs of its environment, and whether rclpy can be had at all."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from bridge.adapters.ros2 import shm
from bridge.config.model import Config

_SOURCED = Path("/opt/ros/jazzy")
_PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_CURE = "install the wheels (pip install 'midspan[ros2]'), or source /opt/ros/jazzy/setup.bash with its own Python"


def available(config: Config) -> str:  # noqa: ARG001 - every side's function has the same form
    """Nothing where rclpy can be had; else why not, and the cure."""
    spec = find_spec("rclpy")
    if spec is None:
        return f"rclpy is not installed for {sys.executable}; {_CURE}"
    if find_spec("rmw_fastrtps_cpp") is None and not _libraries():
        return f"rclpy is there without Fast DDS (rmw_fastrtps_cpp); {_CURE}"
    return ""


def _libraries() -> list[Path]:
    """The wheels' library folders: the prefix's own, and those that came with single wheels."""
    folder = Path(sys.prefix) / "lib"
    if not (folder / "librmw_fastrtps_cpp.so").exists():
        return []
    site = folder / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    return [folder, *sorted(site.glob("ros_*.libs"))]


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """The environment for a ros2 worker, made from that of its parent."""
    result = dict(environ)
    libraries = _libraries()
    if libraries:
        # Set here, the wheels' start-up hook does not run the interpreter a second time.
        result["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        _prepend(result, "LD_LIBRARY_PATH", [str(p) for p in libraries])
        _prepend(result, "AMENT_PREFIX_PATH", [sys.prefix])
    result["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
    result["ROS_DOMAIN_ID"] = str(domain(config, environ))
    # The profile says how far to look; ROS 2's own switches would add transports of their own.
    result["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
    result["SKIP_DEFAULT_XML"] = "1"
    for name in ("ROS_LOCALHOST_ONLY", "FASTDDS_BUILTIN_TRANSPORTS", "RMW_FASTRTPS_USE_QOS_FROM_XML"):
        result.pop(name, None)
    return result


def _prepend(environ: dict[str, str], name: str, folders: list[str]) -> None:
    known = [p for p in environ.get(name, "").split(os.pathsep) if p and p not in folders]
    environ[name] = os.pathsep.join([*folders, *known])


def domain(config: Config, environ: Mapping[str, str]) -> int:
    """The ROS domain: the configuration's, else the environment's, else 0."""
    if config.ros2.domain is not None:
        return config.ros2.domain
    try:
        return int(environ.get("ROS_DOMAIN_ID") or 0)
    except ValueError:
        return 0


def use_profile(config: Config, state: Path) -> bytes:
    """Write the Fast DDS profile and point this process at it, before Fast DDS is loaded; our GUID prefix.

    Fast DDS reads the profile once in a process, so a later edge of the same process keeps the first one's mark.
    """
    from bridge.adapters.ros2 import rcl
    from bridge.adapters.ros2.mark import new_prefix
    from bridge.adapters.ros2.profile import Profile, stamped

    if _used.prefix:
        return _used.prefix
    prefix = new_prefix(rcl.host_prefix())
    own = config.ros2.profile
    text = (
        stamped(own, prefix) if own is not None else Profile(prefix, _segment(config), config.ros2.localhost_only).xml()
    )
    folder = state / "ros2"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "fastdds.xml"
    path.write_text(text)
    for name in _PROFILE_VARIABLES:
        os.environ[name] = str(path)
    _used.prefix = prefix
    return prefix


def _segment(config: Config) -> int:
    transport = config.ros2.transport
    if transport == "udp" or (transport == "auto" and shm.other_users()):
        return 0
    return shm.segment_size()


class _Used:
    """The mark that this process's Fast DDS was loaded with."""

    prefix = b""


_used = _Used()
