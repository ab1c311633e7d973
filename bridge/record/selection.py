"""Selection of the topics to record."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.client.topics import HubTopic
from bridge.hub.graph.tokens import TAPS, Origin
from bridge.record.section import RecordSection
from bridge.routing.rules import NameFilter


class Selection:
    """Selects topics by name and side.

    Attributes:
        name: returns whether a topic of this name is recorded.
        sides: the sides whose messages are recorded; empty for all.
    """

    def __init__(self, section: RecordSection) -> None:
        self.name = NameFilter(section.topics, section.exclude).matches
        self._named = {glob for glob in section.topics if not set("*?") & set(glob)}
        self.sides: Sequence[str] = section.sides

    def includes(self, topic: HubTopic) -> bool:
        """Return whether a topic on the hub is recorded; for a tap, see `taps`."""
        side, name = tapped(topic.key.topic)
        if side:
            return self.taps(side, name)
        return self.name(name) and (not self.sides or not set(self.sides).isdisjoint(topic.sides))

    def taps(self, side: str, name: str) -> bool:
        """Return whether a topic that is not bridged is selected.

        Its name must match, and its side must be one of `sides` or, without `sides`, its full name must be configured.
        """
        return self.name(name) and (side in self.sides or (not self.sides and name in self._named))

    @property
    def may_tap(self) -> bool:
        """Whether topics that are not bridged may be requested."""
        return bool(self.sides or self._named)

    def origin(self, origin: Origin | None) -> bool:
        """Return whether messages of this origin are recorded."""
        return not self.sides or side_of(origin) in self.sides


def side_of(origin: Origin | None) -> str:
    """Return the side of an origin, ``zenoh`` for a native participant on the hub."""
    return "zenoh" if origin is None else origin.side


def tapped(topic: str) -> tuple[str, str]:
    """Return side and name of a topic that a worker forwards on request; for other topics "" and the name."""
    if not topic.startswith(TAPS):
        return "", topic
    side, _, name = topic.removeprefix(TAPS).partition("/")
    return side, f"/{name}"
