"""Priority classes of routes: what is kept, what is dropped and what goes first."""

from __future__ import annotations

import re
from enum import Enum

COMMAND_TYPES = frozenset({"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"})
"""Types that command a velocity."""

_COMMAND_NAME = re.compile(r"(^|[/_])(cmd|command)", re.IGNORECASE)


class Priority(Enum):
    """The class of a route.

    STATE is kept until delivered; COMMAND is newest only, never latched or delivered late; STREAM drops its oldest.
    """

    STATE = "state"
    COMMAND = "command"
    STREAM = "stream"


def default_priority(topic: str, type_name: str, *, latched: bool) -> Priority:
    """The class of a topic that no rule names: velocity commands by type and name, latched topics as state."""
    if type_name in COMMAND_TYPES and _COMMAND_NAME.search(topic):
        return Priority.COMMAND
    return Priority.STATE if latched else Priority.STREAM
