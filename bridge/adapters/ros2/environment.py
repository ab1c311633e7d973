"""The environment of a ros2 worker, and whether rclpy is available; loads no ROS code, as the daemon imports it."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from bridge.adapters.ros2 import security
from bridge.adapters.ros2.releases import RELEASES, Release, names, release_of
from bridge.config.model import Config

_SYSTEM = Path("/opt/ros")
RMW = "RMW_IMPLEMENTATION"
FAST_DDS, CYCLONE = "rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"
LIBRARY = f"lib{CYCLONE}.so"
# the profile, or CYCLONEDDS_URI, sets the range; ROS 2's setting would add transports
_RANGE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
SWITCHES: Mapping[str, dict[str, str]] = {
    FAST_DDS: {
        RMW: FAST_DDS,
        "SKIP_DEFAULT_XML": "1",
        # with ROS_DISCOVERY_SERVER: a plain client of a discovery server learns only of endpoints that match its own
        "ROS_SUPER_CLIENT": "TRUE",
        **_RANGE,
    },
    CYCLONE: {RMW: CYCLONE, **_RANGE},
}
"""Variables of the worker, by ``ros2.rmw``."""
STATIC_PEERS = "ROS_STATIC_PEERS"
"""Variable with the machines to announce to without multicast. With SYSTEM_DEFAULT rmw_fastrtps ignores the variable,
so the profile has the machines."""
UNSET = ("ROS_LOCALHOST_ONLY", "FASTDDS_BUILTIN_TRANSPORTS", "RMW_FASTRTPS_USE_QOS_FROM_XML")
_PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
_REACHED = "Nodes of other releases are reached over the network, without their installation"
_CURE = (
    "install the wheels (pip install 'midspan[ros2]', on Linux and x86-64), or source the setup.bash of"
    f" {names()} with its own Python"
)


def available(config: Config) -> str:
    """Return why rclpy is not available, and the cure; "" if it is."""
    if sys.platform == "win32":
        return "the ROS 2 side runs only on Linux; nodes on rmw_zenoh_cpp join the hub without it"
    prefix = _installation(os.environ)
    if prefix is None:
        foreign = next(iter(_foreign(os.environ)), None)
        if foreign is not None:
            return f"the sourced ROS 2 in {foreign} is not for Midspan's Python {_PYTHON}; {_CURE}. {_REACHED}"
        return f"rclpy is not installed for {sys.executable}; {_CURE}"
    release = release_of(prefix)
    if release is None:
        return f"the ROS 2 in {prefix} is none of {names()}; {_CURE}. {_REACHED}"
    if config.ros2.rmw == CYCLONE:
        return _without_cyclone(prefix, release)
    if not (_site(prefix) / FAST_DDS).is_dir() and not _sourced(os.environ):
        return f"rclpy is installed without Fast DDS ({FAST_DDS}); {_CURE}"
    return security.trouble(os.environ, domain(config, os.environ), wheels=uses_wheels(os.environ))


def _without_cyclone(prefix: Path, release: Release) -> str:
    """Return why a worker with this installation cannot run on Cyclone DDS, and the cure; "" if it can."""
    chosen = f"ros2.rmw is {CYCLONE}"
    if _cyclone_library(prefix, os.environ) is None:
        return (
            f"{chosen}, but {LIBRARY} is not in the ROS 2 in {prefix}; install ros-{release.name}-rmw-cyclonedds-cpp"
            f" for a sourced ROS 2 (the wheels have only Fast DDS), or remove ros2.rmw"
        )
    if security.is_enabled(os.environ):
        return (
            f"{chosen} and {security.ENABLE} is true, but on Cyclone DDS the side's enclave marks what Midspan creates,"
            f" so it cannot be an enclave of a keystore; remove ros2.rmw, or unset {security.ENABLE}"
        )
    return ""


def _cyclone_library(prefix: Path, environ: Mapping[str, str]) -> Path | None:
    """Return rmw_cyclonedds_cpp's library of an installation, or of another sourced prefix."""
    folders = (f for p in (prefix, *_prefixes(environ)) for f in (p / "lib", *p.glob("lib/*-linux-gnu")))
    return next((folder / LIBRARY for folder in folders if (folder / LIBRARY).is_file()), None)


def uses_wheels(environ: Mapping[str, str]) -> bool:
    """Return whether a worker would use the wheels in Midspan's environment."""
    return _installation(environ) == Path(sys.prefix)


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a ros2 worker, derived from its parent's.

    rclpy comes from a sourced ROS 2 for this Python, else from the wheels in Midspan's environment, else from
    ``/opt/ros``, else from wherever this process finds it. A sourced ROS 2 for another Python is removed from the
    paths, because its rclpy would be imported.
    """
    result = dict(environ)
    _without_ros1(result)
    for foreign in _foreign(environ):
        _without(result, foreign)
    prefix = _installation(environ)
    if prefix is not None:
        # prevents the wheels' start-up hook from restarting the interpreter with the wheels' libraries
        result["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    if prefix is not None and not _sourced(environ):
        if prefix == Path(sys.prefix):
            libraries = [prefix / "lib", *sorted(_site(prefix).glob("ros_*.libs"))]
        else:
            libraries = [*prefix.glob("opt/*/lib"), *prefix.glob("lib/*-linux-gnu"), prefix / "lib"]
            _prepend(result, "PYTHONPATH", [_site(prefix)])
        _prepend(result, "LD_LIBRARY_PATH", libraries)
        _prepend(result, "AMENT_PREFIX_PATH", [prefix])
    library = _cyclone_library(prefix, environ) if config.ros2.rmw == CYCLONE and prefix == Path(sys.prefix) else None
    if library is not None:  # the wheels' rclpy is linked with Fast DDS's rmw, and ignores RMW_IMPLEMENTATION
        _prepend(result, "LD_PRELOAD", [library])
    result["ROS_DOMAIN_ID"] = str(domain(config, environ))
    for name in UNSET:
        result.pop(name, None)
    return result | SWITCHES[config.ros2.rmw] | security.enclave(environ)


def _site(prefix: str | Path) -> Path:
    return Path(prefix) / f"lib/python{_PYTHON}/site-packages"


def _installation(environ: Mapping[str, str]) -> Path | None:
    """Return the prefix of the ROS 2 that a worker would use; None if ROS 2 is missing."""
    sourced = next((p for p in _prefixes(environ) if (_site(p) / "rclpy").is_dir()), None)
    if sourced is not None:
        return sourced
    if find_spec("rclpy") is not None and (_site(sys.prefix) / "rclpy").is_dir():
        return Path(sys.prefix)
    unsourced = next((p for release in RELEASES if (_site(p := _SYSTEM / release.name) / "rclpy").is_dir()), None)
    return unsourced or _importable(environ)


def _importable(environ: Mapping[str, str]) -> Path | None:
    """Return the prefix of the rclpy on this process's path, unless it is for another Python."""
    spec = find_spec("rclpy")
    if spec is None or spec.origin is None or any(Path(spec.origin).is_relative_to(p) for p in _foreign(environ)):
        return None
    return Path(spec.origin).parents[4]  # <prefix>/lib/python3.x/site-packages/rclpy/__init__.py


def _prefixes(environ: Mapping[str, str]) -> list[Path]:
    """Return the prefixes that the parent's shell has sourced."""
    named = map(Path, filter(None, environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)))
    return [prefix for prefix in named if prefix != Path(sys.prefix)]


def _sourced(environ: Mapping[str, str]) -> bool:
    """Return whether the parent's shell has sourced a ROS 2 for this Python version."""
    return any((_site(p) / "rclpy").is_dir() for p in _prefixes(environ))


def _foreign(environ: Mapping[str, str]) -> list[Path]:
    """Return the sourced prefixes whose rclpy is for other Python versions only."""
    folders = ("lib/python3.*/*-packages/rclpy", "local/lib/python3.*/*-packages/rclpy")
    candidates = [p for p in _prefixes(environ) if any(next(p.glob(f), None) for f in folders)]
    return [p for p in candidates if not (_site(p) / "rclpy").is_dir()]


def _without_ros1(environ: dict[str, str]) -> None:
    """Remove ROS 1's packages from the path, because they would be imported instead of ROS 2's of the same names."""
    folders = [p for p in environ.get("PYTHONPATH", "").split(os.pathsep) if p and not (Path(p) / "rospy").is_dir()]
    environ.pop("PYTHONPATH", None)
    if folders:
        environ["PYTHONPATH"] = os.pathsep.join(folders)


def _without(environ: dict[str, str], prefix: Path) -> None:
    """Remove the folders of a prefix from the search paths of Python and the dynamic linker."""
    for name in ("PYTHONPATH", "LD_LIBRARY_PATH"):
        folders = [f for f in environ.pop(name, "").split(os.pathsep) if f and not Path(f).is_relative_to(prefix)]
        if folders:
            environ[name] = os.pathsep.join(folders)


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
