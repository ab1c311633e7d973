"""The environment of a ros2 worker, and whether rclpy is available; loads no ROS code, as the daemon imports it."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from bridge.adapters.ros2 import security
from bridge.config.model import Config

_SYSTEM = Path("/opt/ros/jazzy")
SWITCHES = {
    "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
    # the profile sets the range; ROS 2's setting would add transports
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
    "SKIP_DEFAULT_XML": "1",
    # with ROS_DISCOVERY_SERVER: a plain client of a discovery server learns only of endpoints that match its own
    "ROS_SUPER_CLIENT": "TRUE",
}
STATIC_PEERS = "ROS_STATIC_PEERS"
"""Machines to announce to without multicast: rmw_fastrtps ignores it with SYSTEM_DEFAULT, so the profile has them."""
UNSET = ("ROS_LOCALHOST_ONLY", "FASTDDS_BUILTIN_TRANSPORTS", "RMW_FASTRTPS_USE_QOS_FROM_XML")
_CURE = (
    "install the wheels (pip install 'midspan[ros2]', on Linux and x86-64), or source /opt/ros/jazzy/setup.bash with"
    " its own Python"
)


def available(config: Config) -> str:  # noqa: ARG001 - same signature for every side
    """Return why rclpy is not available, and the cure; "" if it is."""
    if find_spec("rclpy") is None and _unsourced() is None:
        return f"rclpy is not installed for {sys.executable}; {_CURE}"
    if find_spec("rclpy") is not None and find_spec("rmw_fastrtps_cpp") is None and not _sourced(os.environ):
        return f"rclpy is installed without Fast DDS (rmw_fastrtps_cpp); {_CURE}"
    return security.trouble(os.environ, wheels=uses_wheels(os.environ))


def uses_wheels(environ: Mapping[str, str]) -> bool:
    """Return whether a worker would use the wheels in Midspan's environment."""
    return not _sourced(environ) and (Path(sys.prefix) / "lib/librcl.so").exists()


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a ros2 worker, derived from its parent's.

    rclpy comes from a sourced ROS 2, else from the wheels in Midspan's environment, else from ``/opt/ros/jazzy``.
    """
    result = dict(environ)
    _without_ros1(result)
    unsourced = _unsourced()
    if _sourced(environ):
        pass
    elif uses_wheels(environ):
        # prevents the wheels' start-up hook from restarting the interpreter
        result["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
        _prepend(result, "LD_LIBRARY_PATH", [Path(sys.prefix) / "lib", *sorted(_site(sys.prefix).glob("ros_*.libs"))])
        _prepend(result, "AMENT_PREFIX_PATH", [Path(sys.prefix)])
    elif unsourced is not None:
        libraries = [*unsourced.glob("opt/*/lib"), *unsourced.glob("lib/*-linux-gnu"), unsourced / "lib"]
        _prepend(result, "LD_LIBRARY_PATH", libraries)
        _prepend(result, "AMENT_PREFIX_PATH", [unsourced])
        _prepend(result, "PYTHONPATH", [_site(unsourced)])
    result["ROS_DOMAIN_ID"] = str(domain(config, environ))
    for name in UNSET:
        result.pop(name, None)
    return result | SWITCHES | security.enclave(environ)


def _site(prefix: str | Path) -> Path:
    return Path(prefix) / f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"


def _sourced(environ: Mapping[str, str]) -> bool:
    """Return whether the parent's shell has sourced a ROS 2 for this Python version."""
    prefixes = [p for p in environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p and Path(p) != Path(sys.prefix)]
    return any((_site(p) / "rclpy").is_dir() for p in prefixes)


def _unsourced() -> Path | None:
    return _SYSTEM if (_site(_SYSTEM) / "rclpy").is_dir() else None


def _without_ros1(environ: dict[str, str]) -> None:
    """Remove ROS 1's packages from the path: they have the names of ROS 2's, and would be imported instead."""
    folders = [p for p in environ.get("PYTHONPATH", "").split(os.pathsep) if p and not (Path(p) / "rospy").is_dir()]
    environ.pop("PYTHONPATH", None)
    if folders:
        environ["PYTHONPATH"] = os.pathsep.join(folders)


def _prepend(environ: dict[str, str], name: str, folders: list[Path]) -> None:
    first = [str(folder) for folder in folders]
    known = [p for p in environ.get(name, "").split(os.pathsep) if p and p not in first]
    environ[name] = os.pathsep.join([*first, *known])


def domain(config: Config, environ: Mapping[str, str]) -> int:
    """Return the ROS domain: the configuration's, else the environment's, else 0."""
    if config.ros2.domain is not None:
        return config.ros2.domain
    try:
        return int(environ.get("ROS_DOMAIN_ID") or 0)
    except ValueError:
        return 0
