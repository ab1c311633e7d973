"""What this process's Fast DDS is loaded with: the profile, and the mark in it."""

from __future__ import annotations

import os
from pathlib import Path

from bridge.adapters.keep import keep
from bridge.adapters.ros2 import neighbours, rcl, shm
from bridge.adapters.ros2.environment import SWITCHES, UNSET
from bridge.adapters.ros2.mark import new_prefix
from bridge.adapters.ros2.origins import kept_prefixes
from bridge.adapters.ros2.profile import Profile, stamped
from bridge.config.model import Config

_PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


def use_profile(config: Config, state: Path) -> Profile:
    """Write the Fast DDS profile and point this process at it, before Fast DDS is loaded.

    Fast DDS reads the profile once in a process, so a later edge of the same process keeps the first one's.
    """
    if _used:
        return _used[0]
    prefix = new_prefix(rcl.host_prefix(), kept_prefixes(state / "ros2"))
    profile = Profile(prefix, _segment(config, state), config.ros2.localhost_only)
    own = config.ros2.profile
    text = profile.xml() if own is None else stamped(own, profile.prefix)
    path = state / "ros2" / "fastdds.xml"
    if not keep(path, text, "the Fast DDS profile is taken from memory"):
        path = _in_memory(text)
    os.environ.update(SWITCHES | dict.fromkeys(_PROFILE_VARIABLES, str(path)))
    for name in UNSET:
        os.environ.pop(name, None)
    _used.append(profile)
    return profile


def _in_memory(text: str) -> Path:
    """A file without a disk, for as long as this process lives."""
    file = os.memfd_create("midspan-fastdds")
    os.write(file, text.encode())
    return Path(f"/proc/self/fd/{file}")


_used: list[Profile] = []
"""The profile that this process's Fast DDS was loaded with."""


def _segment(config: Config, state: Path) -> int:
    transport = config.ros2.transport
    if transport == "udp" or (transport == "auto" and (shm.other_users() or neighbours.noted(state / "ros2"))):
        return 0
    return shm.segment_size()
