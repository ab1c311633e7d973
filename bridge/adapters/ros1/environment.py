"""The ros1 worker's environment: its master, its address, and the folders of ROS 1's message definitions.

The worker imports no ROS packages, and needs none.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
import sys
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

from bridge.config.model import Config
from bridge.messages.definitions.names import ROS1_PACKAGES

DEFAULT_MASTER = "http://localhost:11311"
"""rosgraph's default of ROS_MASTER_URI."""


def master_enabled(config: Config) -> bool:
    """Return whether Midspan runs the ROS 1 master."""
    return config.ros1.enabled is not False and bool(config.ros1.embedded_uri)


def available(config: Config) -> str:
    """Return why the ROS 1 side cannot run as configured; "" if it can."""
    folder = config.ros1.packages
    return f"ros1.packages: {folder} is not a folder" if folder is not None and not folder.is_dir() else ""


def master_uri(config: Config, environ: Mapping[str, str]) -> str:
    """Return the master's URI: embedded, configured, from the environment, or else rosgraph's default."""
    return config.ros1.embedded_uri or config.ros1.master or environ.get("ROS_MASTER_URI") or DEFAULT_MASTER


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of the ros1 worker; raises `RuntimeError` if the worker cannot run as configured."""
    reason = available(config)
    if reason:
        raise RuntimeError(reason)
    env = dict(environ)
    ros1, others = _python_folders(environ)
    definitions = ros1 if config.ros1.packages is None else [str(config.ros1.packages)]
    _set_or_drop(env, ROS1_PACKAGES, os.pathsep.join(definitions))
    _set_or_drop(env, "PYTHONPATH", os.pathsep.join(others))
    env["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    _set_or_drop(env, "LD_LIBRARY_PATH", _foreign_libraries(environ))
    for name in ("ROS_DISTRO", "ROS_VERSION", "AMENT_PREFIX_PATH"):
        env.pop(name, None)
    env["ROS_MASTER_URI"] = master_uri(config, environ)
    _set_address(env, config)
    return env


def _python_folders(environ: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Return the folders of PYTHONPATH with ROS 1 packages, and all other folders without ROS 2 packages.

    The worker's path omits ROS 1's folders: other packages in them, such as the system's NumPy, would shadow Midspan's.
    """
    paths = [p for p in environ.get("PYTHONPATH", "").split(os.pathsep) if p and not (Path(p) / "rclpy").exists()]
    ros1 = [p for p in paths if (Path(p) / "rospy").is_dir()]
    return ros1, [p for p in paths if p not in ros1]


def _set_or_drop(env: dict[str, str], name: str, value: str) -> None:
    if value:
        env[name] = value
    else:
        env.pop(name, None)


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
        local = is_local(urlsplit(env["ROS_MASTER_URI"]).hostname or "")
        if local and env.get("ROS_IPV6") == "on":  # roscpp cannot parse URIs with IPv6 addresses
            env["ROS_HOSTNAME"] = "localhost"
        _set_or_drop(env, "ROS_IP", "127.0.0.1" if local else "")


def is_local(host: str) -> bool:
    """Return whether no other machine can reach a master on this host.

    True for localhost, a loopback address, and this machine's name if it resolves only to loopback addresses.
    """
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
