"""Quality of service of an endpoint, and its text in rmw_zenoh's liveliness tokens.

The enumerations carry rmw's own numbers (rmw/types.h). The text is
``<reliability>:<durability>:<history>,<depth>:<deadline s>,<ns>:<lifespan s>,<ns>:<liveliness>,<s>,<ns>``;
a field equal to rmw_zenoh's default profile is left empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Reliability(IntEnum):
    """Whether samples are sent again when lost."""

    RELIABLE = 1
    BEST_EFFORT = 2


class Durability(IntEnum):
    """Whether a late joiner is given past samples."""

    TRANSIENT_LOCAL = 1
    VOLATILE = 2


class History(IntEnum):
    """Which samples are kept."""

    KEEP_LAST = 1
    KEEP_ALL = 2


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of one endpoint; deadlines and lifespans are in nanoseconds, None is infinite."""

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE
    history: History = History.KEEP_LAST
    depth: int = 10
    deadline_ns: int | None = None
    lifespan_ns: int | None = None

    @property
    def latched(self) -> bool:
        """Whether late joiners get past samples (ROS 1 calls it latching)."""
        return self.durability is Durability.TRANSIENT_LOCAL
