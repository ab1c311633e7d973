"""The way to the workers of a process that is no node of the hub: a client of its router, which asks and answers."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from bridge.config.model import Config
from bridge.hub.control import Control, WorkerAnswer, ask
from bridge.hub.errors import HubError, zenoh_reason
from bridge.hub.zenoh_config import client_session_config
from bridge.metrics.source import ASK_SECONDS

_log = logging.getLogger("midspan.metrics")

_CONNECT_SECONDS = 0.5


class HubLink:
    """A session that is opened when the router is there; zenoh joins it again where the router comes back.

    It has no graph and no links to the workers: to ask them, the router is way enough, and that spares memory.

    Args:
        worker: the name under which it answers.
        status: gives its status document.
    """

    def __init__(self, config: Config, worker: str, status: Callable[[], dict[str, Any]]) -> None:
        self._config, self._worker, self._status = config, worker, status
        self._lock = threading.Lock()
        self._open: tuple[zenoh.Session, Control] | None = None
        self._why = ""

    @property
    def trouble(self) -> str:
        """Why there is no session, "" where there is one."""
        return self._why

    def look(self) -> None:
        """Open the session where there is none. To be called by one thread, again and again."""
        if self._open is not None:
            return
        hub = self._config.hub
        try:
            session = zenoh.open(client_session_config(hub.listen, hub.zenoh, _CONNECT_SECONDS))
        except zenoh.ZError as err:
            self._why = f"no router at {hub.listen}: {zenoh_reason(err)}"
            return
        except HubError as err:
            self._why = f"hub.zenoh: {err}"
            return
        control = Control(session, hub.domain, self._config.name, self._worker)
        control.serve("status", lambda _params: self._status())
        with self._lock:
            self._open, self._why = (session, control), ""

    def ask(self) -> list[WorkerAnswer]:
        """The status of each worker of this daemon; raises `HubError` where there is no hub. On any thread."""
        with self._lock:
            found = self._open
        if found is None:
            raise HubError(self._why or "the hub is not joined yet")
        session = found[0]
        try:
            if not session.info.routers_zid():  # zenoh goes on trying
                raise HubError(f"the router at {self._config.hub.listen} is gone")
            return ask(session, self._config.hub.domain, "status", {}, self._config.name, "*", ASK_SECONDS)
        except zenoh.ZError as err:
            raise HubError(zenoh_reason(err)) from None

    def close(self) -> None:
        """Close the session. Safe to call twice."""
        with self._lock:
            found, self._open = self._open, None
        if found is not None:
            session, control = found
            control.close()
            session.close()  # type: ignore[no-untyped-call]
