"""Whether the localisation believes in the pose that is on /tf."""

from __future__ import annotations

from functools import partial
from typing import Any

from bridge.hub.qos import Durability, Qos
from bridge.modules.host import Host
from navigation.frames import FramesError

STATUS, REASON = "/localization/status", "/localization/reason"
_STRING = "std_msgs/msg/String"
_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_BELIEVED = ("", "localized_ok")


class Localized:
    """Hears what a localisation says of itself, where there is one that does. On the module's thread.

    Args:
        host: the module's.
    """

    def __init__(self, host: Host) -> None:
        self._said = {STATUS: "", REASON: ""}
        for topic in self._said:
            host.node.subscription(topic, _STRING, partial(self._hear, topic), _LATCHED)

    def check(self) -> None:
        """Raise `FramesError` with why the pose is not to be believed."""
        status, reason = self._said.values()
        if status not in _BELIEVED:
            raise FramesError(f"the localisation says '{status}'" + (f": {reason}" if reason else ""))

    def _hear(self, topic: str, message: dict[str, Any]) -> None:
        self._said[topic] = message["data"]
