"""Other machines on the hub whose daemons have the same name as this one's, so that their keys are the same."""

from __future__ import annotations

import logging
import time

import zenoh

from bridge.hub.control import ask
from bridge.hub.links import MEMBERS

_log = logging.getLogger(__name__)

_EVERY = 10.0
_ANSWER_SECONDS = 1.0


class Namesakes:
    """Searches the hub for routers of other daemons with this daemon's name.

    Attributes:
        warning: the routers found, with the cure; "" without any.
    """

    def __init__(self, session: zenoh.Session, domain: int, daemon: str) -> None:
        self._session, self._domain, self._daemon = session, domain, daemon
        self._due = 0.0
        self.warning = ""

    def check(self) -> None:
        """Search every 10 s; the log gets changes."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + _EVERY
        own = str(self._session.zid())
        answers = ask(self._session, self._domain, MEMBERS, {}, self._daemon, "router", _ANSWER_SECONDS)
        values = [answer.value for answer in answers if isinstance(answer.value, dict)]
        routers = {str(value.get("zid")): str(value.get("machine", "")) for value in values}
        others = [f"{machine or 'a machine'} (router {zid[:8]})" for zid, machine in routers.items() if zid != own]
        warning = self._text(others)
        if warning and warning != self.warning:
            _log.warning("%s", warning)
        elif self.warning and not warning:
            _log.info("no other machine on the hub has a daemon named %r now", self._daemon)
        self.warning = warning

    def _text(self, others: list[str]) -> str:
        if not others:
            return ""
        return (
            f"{', '.join(sorted(others))} on this hub also has a daemon named {self._daemon!r}: commands for one reach"
            " both; set another 'name' in one of the configurations"
        )
