"""What the routes of both directions share: who they are, how they report, what they decided."""

from __future__ import annotations

import logging
import re
from typing import Any, NamedTuple

from bridge.hub.qos import Durability, Qos, Reliability
from bridge.messages.conversion import Conversion
from bridge.routing.counters import Counters
from bridge.routing.priority import Priority, default_priority
from bridge.routing.rules import Decision
from bridge.routing.subject import split

_log = logging.getLogger(__name__)

QUEUE_DEPTH = {Priority.COMMAND: 1, Priority.STATE: 1000, Priority.STREAM: 1000}
"""Messages that wait for a side at most, where no rule says otherwise."""

STREAM_DEPTH = 1000
"""History of the bridge's own endpoints on a stream at least, so that a burst finds room."""

BULK_DEPTH = 50
"""The same for types that carry bytes without end, as images, clouds and maps do."""

BULK = 64 * 1024
"""Bytes from which a message is carried by other threads than small ones, so that it delays none of them."""

QUEUE_BYTES = 64 * 1024 * 1024
"""Bytes that wait in one route's queue at most, but for the newest message."""

MAX_PENDING = 64
"""Messages that wait at most for their publisher to be known; the same room of bytes."""

_BYTES = re.compile(r"^[ \t]*(?:u?int8|byte|char|octet)\[\][ \t]", re.MULTILINE)


def stream_depth(definition: str) -> int:
    """History of the bridge's own endpoints on a stream of a type, given by its full definition."""
    return BULK_DEPTH if _BYTES.search(definition) else STREAM_DEPTH


class RouteKey(NamedTuple):
    """What makes two routes of one direction the same."""

    topic: str
    type_name: str
    type_id: str


class Route:
    """What crosses in one direction under one name: a topic or a service.

    ``hub_type`` is the type's ROS 2 name, ``side_type`` its name on the side; ``refused`` says what stands in the way
    of an endpoint that the route needs, "" where it has them all.
    """

    direction = ""
    kind = "topic"

    def __init__(
        self, key: RouteKey, hub_topic: str, side_topic: str, types: tuple[str, str], decision: Decision
    ) -> None:
        self.key = key
        self.hub_topic = hub_topic
        self.side_topic = side_topic
        self.hub_type, self.side_type = types
        self.decision = decision
        self.counters = Counters()
        self.refused = ""

    def status(self) -> dict[str, Any]:
        """The route as it stands in the status document."""
        raise NotImplementedError

    def close(self) -> None:
        """Give back everything on both networks."""
        raise NotImplementedError

    def too_large(self, size: int, limit: int) -> bool:
        """Whether a message of ``size`` bytes is refused for it."""
        if size > limit:
            self.bad(f"message of {size} bytes, limits.message allows {limit}", "large")
        return size > limit

    def bad(self, error: str, reason: str = "bad") -> None:
        """Count a refused message and log at a limited rate. May be called from any thread."""
        self.counters.dropped(reason)
        if self.counters.failed(error):
            _log.warning("%s %s: message refused: %s", self.direction, self.side_topic, error)

    def row(self, *, active: bool, sources: int) -> dict[str, Any]:
        """What every route's part of the status document has."""
        return {
            "kind": self.kind,
            "action": split(self.hub_topic)[0],
            "direction": self.direction,
            "topic": self.side_topic,
            "hub_topic": self.hub_topic,
            "type": self.hub_type,
            "side_type": self.side_type,
            "state": "refused" if self.refused else "active" if active else "idle",
            "sources": sources,
            **self.counters.as_dict(),
        }


class TopicRoute(Route):
    """One topic that crosses in one direction."""

    def __init__(
        self, key: RouteKey, hub_topic: str, side_topic: str, conversion: Conversion, decision: Decision
    ) -> None:
        inwards = self.direction == "in"
        hub, side = (conversion.target, conversion.source) if inwards else (conversion.source, conversion.target)
        super().__init__(key, hub_topic, side_topic, (hub.name, side.name), decision)
        self.conversion = conversion

    def priority_of(self, *, latched: bool) -> Priority:
        """The route's class: the rule's, else by type and latching."""
        if self.decision.priority:
            return Priority(self.decision.priority)
        return default_priority(self.hub_topic, self.hub_type, latched=latched)

    def describe(self, priority: Priority, qos: Qos, sources: int, *, active: bool) -> dict[str, Any]:
        """The route as it stands in the status document."""
        return {**self.row(active=active, sources=sources), "priority": priority.value, "qos": qos_text(qos)}


def qos_text(qos: Qos) -> str:
    """QoS for people, as ``reliable transient_local 1``."""
    return f"{qos.reliability.name.lower()} {qos.durability.name.lower()} {qos.depth}"


def joint_qos(qualities: list[Qos]) -> Qos:
    """The QoS that hears every one of several publishers: best effort and latched if any of them is."""
    best_effort = any(q.reliability is Reliability.BEST_EFFORT for q in qualities)
    latched = [q for q in qualities if q.latched]
    return Qos(
        Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
        depth=max(sum(max(q.depth, 1) for q in latched), *(q.depth for q in qualities), 10),
    )
