"""Makes sessions rejoin a router, so that it announces them again to a session that has lost its link to them.

A session of rmw_zenoh sends its address to routers only. Of two sessions, the one with the greater zenoh id opens the
direct link (``autoconnect_strategy``), and it learns the other's address from the router, once. So if a link ends whose
greater end is a session of Midspan, no introduction (`bridge.hub.links`) restores it: it would last until the node is
restarted. When the node's link to the router is closed, zenoh connects it again after about a second, and the router
announces the node to all sessions. The node's other links are not affected, but its clients without a direct link, such
as those on other machines, lose their calls. Midspan's own sessions keep their links: introductions restore theirs.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any

import zenoh

from bridge.concurrency import Backoff
from bridge.hub.graph.tokens import MIDSPAN_SPACE
from bridge.hub.security.link_restart import close_connection

REJOIN = "rejoin"
"""The verb by which a session requests this; ``sessions`` are zenoh ids."""

_SECONDS, _LONGEST_SECONDS = 5.0, 300.0
"""Pauses between two closings of a session's link; they double, because a session may be unreachable for good."""

_ANSWER_SECONDS = 0.5
_MOST = 1000


@dataclass(slots=True)
class _Closed:
    """The closings of one session's links; ``due``: when the next one is allowed."""

    pauses: Backoff = field(default_factory=lambda: Backoff(_SECONDS, _LONGEST_SECONDS))
    due: float = float("-inf")


class Rejoins:
    """Closes the links of sessions to a router on request."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._closed: dict[str, _Closed] = {}
        """By zenoh id."""

    def answer(self, params: dict[str, Any]) -> dict[str, Any]:
        """Handle a request; return the zenoh ids of the sessions that join again."""
        wanted = params.get("sessions")
        sessions = set(map(str, wanted[:_MOST])) if isinstance(wanted, list) else set()
        links = [(str(link.zid), str(link.src), str(link.dst)) for link in self._session.info.links()]
        due = self._due({zid for zid in sessions & {zid for zid, *_ in links} if self._is_foreign(zid)})
        return {"sessions": sorted({zid for zid, here, there in links if zid in due and close_connection(here, there)})}

    def _is_foreign(self, zid: str) -> bool:
        """Return whether a session is known as a ROS 2 node that does not announce a version of Midspan."""
        return self._has_tokens(f"@ros2_lv/*/{zid}/**") and not self._has_tokens(f"{MIDSPAN_SPACE}/*/wire/{zid}/**")

    def _has_tokens(self, keys: str) -> bool:
        replies: Any = self._session.liveliness().get(keys, timeout=_ANSWER_SECONDS)
        return any(reply.ok is not None for reply in list(replies))

    def _due(self, sessions: set[str]) -> set[str]:
        """Return the sessions whose links may be closed now, and count them as closed."""
        now = time.monotonic()
        with self._lock:
            self._closed = {z: closed for z, closed in self._closed.items() if now < closed.due + _LONGEST_SECONDS}
            due = {zid for zid in sessions if zid not in self._closed or self._closed[zid].due <= now}
            for zid in due:
                closed = self._closed.setdefault(zid, _Closed())
                closed.due = now + closed.pauses.pause(0.0)
        return due
