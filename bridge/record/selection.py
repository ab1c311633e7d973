"""Selection of the topics to record."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.config.sections.record import RecordSection
from bridge.hub.graph.tokens import TAPS, Origin
from bridge.modules.hub_topics import HubTopic
from bridge.routing.rules import NameFilter


class Selection:
    """Chooses by name and side.

    Attributes:
        name: whether a topic of this name is recorded.
        sides: those from which messages are taken; none: all.
    """

    def __init__(self, section: RecordSection) -> None:
        self.name = NameFilter(section.topics, section.exclude).wants
        self._named = {glob for glob in section.topics if not set("*?") & set(glob)}
        self.sides: Sequence[str] = section.sides

    def wants(self, topic: HubTopic) -> bool:
        """Whether a topic on the hub is recorded; of what workers show on request (a tap) what was asked for."""
        side, name = tapped(topic.key.topic)
        if side:
            return self.taps(side, name)
        return self.name(name) and (not self.sides or not set(self.sides).isdisjoint(topic.sides))

    def taps(self, side: str, name: str) -> bool:
        """Whether a topic that does not cross is to be had of its side: it is named in full, or all of the side is."""
        return self.name(name) and (side in self.sides or (not self.sides and name in self._named))

    @property
    def may_tap(self) -> bool:
        """Whether topics that do not cross may be wanted."""
        return bool(self.sides or self._named)

    def origin(self, origin: Origin | None) -> bool:
        """Whether messages from there are recorded."""
        return not self.sides or side_of(origin) in self.sides


def side_of(origin: Origin | None) -> str:
    """The side of an origin, ``zenoh`` for a native participant of the hub."""
    return "zenoh" if origin is None else origin.side


def tapped(topic: str) -> tuple[str, str]:
    """Side and name of a topic that a worker shows on request; of any other one "" and its name."""
    if not topic.startswith(TAPS):
        return "", topic
    side, _, name = topic.removeprefix(TAPS).partition("/")
    return side, f"/{name}"
