"""The shared memory that a user's Fast DDS profile (``ros2.profile``) needs."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree as ET

from bridge.adapters.ros2.profile_file import default_participant, read
from bridge.hub.shared_memory import FOLDER

_SEGMENT = 512 << 10
"""Fast DDS's default size of a participant's segment in bytes (SharedMemTransportDescriptor)."""

_WITH_MEMORY = {"SHM", "DEFAULT", "DEFAULTv6", "LARGE_DATA", "LARGE_DATAv6", ""}
"""Sets of built-in transports that include shared memory; "" is the default."""


def segment(root: ET.Element) -> int:
    """Return the bytes of shared memory that the default participant of a profile needs, 0 if it uses none."""
    rtps = default_participant(root)
    if rtps is None:
        return 0
    sizes = []
    if _text(rtps, "useBuiltinTransports") != "false" and _text(rtps, "builtinTransports") in _WITH_MEMORY:
        sizes.append(_SEGMENT)
    used = {(name.text or "").strip() for name in rtps.findall("userTransports/transport_id")}
    for transport in root.iter("transport_descriptor"):
        if _text(transport, "type") == "SHM" and _text(transport, "transport_id") in used:
            size = _text(transport, "segment_size")
            sizes.append(int(size) if size.isdecimal() else _SEGMENT)
    return max(sizes, default=0)


def trouble(own: Path, folder: Path = FOLDER) -> str:
    """Return why a profile's shared memory does not fit, with the cure; "" if it fits, or the profile is invalid."""
    try:
        size, room = segment(read(own)), os.statvfs(folder)
    except (OSError, ValueError):
        return ""
    if not size or room.f_bavail * room.f_frsize >= size:
        return ""
    return (
        f"ros2.profile {own} makes Fast DDS use shared memory, but {folder} has no room for it ({size / 1e6:.1f} MB):"
        f" remove files from {folder} or enlarge it, or list only UDP transports in the profile; then restart the ros2"
        " worker"
    )


def _text(parent: ET.Element, name: str) -> str:
    return (parent.findtext(name) or "").strip()
