"""Control of a base for manual driving: on each velocity topic of the hub, only one person drives at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.hub.control import MANUAL_DRIVING_HALTED
from bridge.hub.node import Hub

_MOST_NAME = 200


class ManualControl:
    """The right of one program to publish velocities for a person: the console, the Foxglove server or `teleop`.

    The program announces the person on the hub while the person drives. The announcement ends at the latest when the
    node is closed, when the program exits, or a few seconds after its process or its machine hangs. If two persons
    begin at the same moment, the program with the lower zid has precedence. Use it on one thread.
    """

    def __init__(self, hub: Hub, topic: str) -> None:
        self._hub, self._topic = hub, topic
        self._withdraw: Callable[[], None] | None = None

    @property
    def held(self) -> bool:
        """Whether this program has announced that it drives."""
        return self._withdraw is not None

    def rival(self) -> str:
        """Return who drives instead; "" if this program may drive."""
        drivers = self._hub.graph.drivers(self._topic)
        rivals = [who for zid, who in drivers.items() if not self.held or zid < self._hub.zid]
        return f"{rivals[0]} drives manually" if rivals else ""

    def begin(self, who: str) -> None:
        """Announce that ``who`` drives, until `end`."""
        if not self.held:
            self._withdraw = self._hub.announce_driver(self._topic, who[:_MOST_NAME])

    def end(self) -> None:
        """Let others drive. Safe to call twice."""
        withdraw, self._withdraw = self._withdraw, None
        if withdraw is not None:
            withdraw()


def on_halt(hub: Hub, stop: Callable[[], None]) -> Callable[[], None]:
    """Call ``stop``, on a thread of the hub, for each halt of all bases, until the returned function is called."""

    def answer(_params: dict[str, Any]) -> dict[str, Any]:
        stop()
        return MANUAL_DRIVING_HALTED

    return hub.serve("halt", answer)
