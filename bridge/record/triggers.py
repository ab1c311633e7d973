"""Triggers of the ring: a message on a topic, a halt, a failed goal, a call to the service."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from bridge.client.topics import TopicFollower, TopicKey
from bridge.hub.control import RECORDED
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.modules.services import Answer
from bridge.record.section import TriggerSection

_log = logging.getLogger("midspan.record")

SERVICE = "/record/trigger"
QUIET_SECONDS = 10.0
"""Seconds after a trigger for which topics, halts and goals do not trigger again: their messages are just saved."""

_SERVICE_TYPE = "std_srvs/srv/Trigger"
_STATUS_TOPIC, _STATUS = "/navigation/status", "midspan_msgs/msg/NavigationStatus"
_FAILED = ("aborted", "failing", "error")

Keep = Callable[[str], "Future[Path | None]"]


class Triggers:
    """Watches all triggers; ``keep`` is called with the reason, and returns at once."""

    def __init__(self, host: Host, section: TriggerSection, keep: Keep) -> None:
        self._section, self._keep = section, keep
        self._topics = TopicFollower(host.node.hub, self._on_message)
        self._state = ""
        self._quiet_until = 0.0
        host.node.server(SERVICE, _SERVICE_TYPE, self._serve)
        if section.goals:
            host.node.subscription(_STATUS_TOPIC, _STATUS, self._on_status, Qos(depth=10))
        if section.halt:
            host.answer("halt", self._halt)

    def refresh(self, topics: Iterable[TopicKey]) -> None:
        """Subscribe to those of the hub's topics that are triggers."""
        for key in topics:
            if key.topic in self._section.topics:
                topic = self._topics.topic(key)
                topic.subscribe(Qos())  # volatile, because older latched messages are not triggers
                if topic.trouble:
                    _log.warning("trigger %s: %s", key.topic, topic.trouble)

    def _on_message(self, key: TopicKey, _sample: HubSample) -> None:
        self._trigger(f"a message on {key.topic}")

    def _halt(self, _params: Any) -> dict[str, Any]:
        self._trigger("halt")
        return RECORDED

    def _on_status(self, status: dict[str, Any]) -> None:
        before, self._state = self._state, str(status["state"])
        if self._state in _FAILED and before != self._state:
            self._trigger(f"a goal failed: {status['reason'] or self._state}")

    def _trigger(self, why: str) -> None:
        """Trigger unless a trigger occurred recently; may be called from any thread."""
        now = time.monotonic()
        if now >= self._quiet_until:
            self._quiet_until = now + QUIET_SECONDS
            self._keep(why).add_done_callback(self._on_kept)

    def _on_kept(self, future: Future[Path | None]) -> None:
        """Accept the next trigger at once if this trigger saved nothing."""
        if future.exception() is not None or future.result() is None:
            self._quiet_until = 0.0

    def _serve(self, _request: dict[str, Any], answer: Answer) -> None:
        self._keep(f"a call to {SERVICE}").add_done_callback(lambda future: answer(_reply(future)))

    def close(self) -> None:
        """Close the topic subscriptions; the host closes the rest."""
        self._topics.close()


def _reply(future: Future[Path | None]) -> dict[str, Any]:
    err = future.exception()
    if err is not None:
        return {"success": False, "message": str(err)}
    path = future.result()
    return {"success": path is not None, "message": str(path or "the ring is empty")}
