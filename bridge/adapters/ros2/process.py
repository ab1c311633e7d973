"""What this process's Fast DDS is loaded with: the profile, and the mark in it."""

from __future__ import annotations

import os
from pathlib import Path

from bridge.adapters.ros2 import neighbours, rcl, shm
from bridge.adapters.ros2.environment import SWITCHES, UNSET
from bridge.adapters.ros2.mark import new_prefix
from bridge.adapters.ros2.profile import Profile, stamped
from bridge.config.model import Config

_PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


def use_profile(config: Config, state: Path) -> Profile:
    """Write the Fast DDS profile and point this process at it, before Fast DDS is loaded.

    Fast DDS reads the profile once in a process, so a later edge of the same process keeps the first one's.
    """
    if _used:
        return _used[0]
    profile = Profile(new_prefix(rcl.host_prefix()), _segment(config, state), config.ros2.localhost_only)
    own = config.ros2.profile
    folder = state / "ros2"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "fastdds.xml"
    path.write_text(profile.xml() if own is None else stamped(own, profile.prefix))
    os.environ.update(SWITCHES | dict.fromkeys(_PROFILE_VARIABLES, str(path)))
    for name in UNSET:
        os.environ.pop(name, None)
    _used.append(profile)
    return profile


_used: list[Profile] = []
"""The profile that this process's Fast DDS was loaded with."""


def _segment(config: Config, state: Path) -> int:
    transport = config.ros2.transport
    if transport == "udp" or (transport == "auto" and (shm.other_users() or neighbours.noted(state / "ros2"))):
        return 0
    return shm.segment_size()
