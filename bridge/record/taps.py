"""Taps: topics that are not bridged, which the worker of their side forwards to the recorder on request."""

from __future__ import annotations

import logging
import time

from bridge.client.graph import decisions_in
from bridge.concurrency import SerialExecutor
from bridge.hub.errors import HubError
from bridge.hub.node import Hub
from bridge.record.selection import Selection

_log = logging.getLogger("midspan.record")

TAP_SECONDS = 10
"""Seconds for which one request to a worker is valid; it is repeated after a third of this time."""

_ASK_SECONDS = 3.0
_MAX_TAPS = 100
"""Maximum number of topics that a worker forwards at the same time (`bridge.routing.side_to_hub`)."""

_STAYS = ("denied", "private")


class Taps:
    """Requests the selected topics from the workers, repeatedly and on a separate thread."""

    def __init__(self, hub: Hub, selection: Selection) -> None:
        self._hub, self._selection = hub, selection
        self._executor = SerialExecutor("midspan-record-taps")
        self._due = 0.0
        self._busy = False

    def refresh(self) -> None:
        """Send the requests if they are due; returns at once."""
        if self._selection.may_tap and not self._busy and time.monotonic() >= self._due:
            self._busy = True
            self._due = time.monotonic() + TAP_SECONDS / 3
            self._executor.submit(self._send_requests)

    def _send_requests(self) -> None:
        try:
            for worker, daemon, topics in self._wanted():
                if len(topics) > _MAX_TAPS:
                    _log.warning(
                        "%s: %d topics are not bridged; %d of them are recorded", worker, len(topics), _MAX_TAPS
                    )
                for topic in topics[:_MAX_TAPS]:
                    request = {"topic": topic, "seconds": TAP_SECONDS}
                    self._hub.ask("tap", request, daemon, worker, timeout=_ASK_SECONDS)
        except HubError as err:
            _log.debug("cannot record what is not bridged: %s", err)
        finally:
            self._busy = False

    def _wanted(self) -> list[tuple[str, str, list[str]]]:
        """Return each worker with its daemon and the selected topics of its side that are not bridged."""
        wanted: list[tuple[str, str, list[str]]] = []
        for answer in self._hub.ask("explain", {"topic": ""}, timeout=_ASK_SECONDS):
            topics = {
                decision.topic
                for decision in decisions_in([answer], "topic")
                if decision.direction == "in" and decision.decision in _STAYS
                if self._selection.taps(answer.worker, decision.topic)
            }
            if topics:
                wanted.append((answer.worker, answer.daemon, sorted(topics)))
        return wanted

    def close(self) -> None:
        self._executor.close()
