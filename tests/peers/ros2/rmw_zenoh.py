"""Real rclpy programs on rmw_zenoh_cpp, if ``librmw_zenoh_cpp.so`` is installed; see docs/sides/ros2.md.

No wheel has this library. It belongs in the folder ``lib`` of `sys.prefix` for Jazzy, and in ``.cache/kilted/lib`` for
Kilted.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from bridge.interfaces.builder import build
from bridge.interfaces.cache import environment
from tests.peers.ros2 import kilted
from tests.peers.ros2.kilted import Packages
from tests.peers.ros2.network import ros2_environment
from tests.support.missing import kilted_prefix

RMW = "rmw_zenoh_cpp"
_LIBRARY = f"lib{RMW}.so"


def has_rmw_zenoh(release: str = "jazzy") -> bool:
    """Return whether rmw_zenoh_cpp is installed for this release."""
    return _library(release) is not None


def rmw_zenoh_environment(
    router: str, domain: int, packages: Packages, release: str = "jazzy", overrides: Mapping[str, object] | None = None
) -> dict[str, str]:
    """Return the environment of a program whose session connects to this router.

    Args:
        router: zenoh endpoint of the router.
        domain: ROS domain, which is also the first part of keys on the hub.
        packages: further message packages of the program (their files' texts by path).
        release: the release of its ROS 2, ``jazzy`` or ``kilted``.
        overrides: further keys of the session's zenoh configuration.
    """
    library = _library(release)
    assert library is not None
    if release == "kilted":
        env = kilted.program_environment(packages)
    else:
        env = {**ros2_environment(), **environment([build(packages)])}
        env["AMENT_PREFIX_PATH"] += f"{os.pathsep}{sys.prefix}"
    values = {"connect/endpoints": [router], **(overrides or {})}
    return env | {
        "RMW_IMPLEMENTATION": RMW,
        "LD_PRELOAD": str(library),  # the wheels' rclpy is linked with Fast DDS's rmw, and ignores RMW_IMPLEMENTATION
        "ROS_DOMAIN_ID": str(domain),
        "ZENOH_CONFIG_OVERRIDE": ";".join(f"{key}={json.dumps(value)}" for key, value in values.items()),
    }


def _library(release: str) -> Path | None:
    prefix = kilted_prefix() if release == "kilted" else Path(sys.prefix)
    library = None if prefix is None else prefix / "lib" / _LIBRARY
    return library if library is not None and library.is_file() else None
