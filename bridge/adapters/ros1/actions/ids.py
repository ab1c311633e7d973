"""Goal ids: ROS 1 has any text, ROS 2 sixteen bytes.

A goal that came from the hub is ``midspan-<uuid>`` on ROS 1, so that the UUID is known again from the text alone, by a
restarted worker too. A goal of a ROS 1 client has the UUID that version 5 of RFC 9562 makes of action name and text.
"""

from __future__ import annotations

import re
import uuid

PREFIX = "midspan-"

_OURS = re.compile(PREFIX + "([0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12})")
_SPACE = uuid.uuid5(uuid.NAMESPACE_URL, "midspan:actionlib")


def text_of(goal: bytes) -> str:
    """The ROS 1 id of a goal of the hub."""
    return f"{PREFIX}{uuid.UUID(bytes=goal)}"


def uuid_in(text: str) -> bytes | None:
    """The UUID of a ROS 1 id that `text_of` made, None of any other."""
    ours = _OURS.fullmatch(text)
    return uuid.UUID(ours.group(1)).bytes if ours else None


def uuid_of(action: str, text: str) -> bytes:
    """The UUID of any ROS 1 id; the same one each time."""
    return uuid_in(text) or uuid.uuid5(_SPACE, f"{action} {text}".encode(errors="surrogateescape").hex()).bytes
