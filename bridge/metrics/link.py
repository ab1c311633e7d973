"""The connection to the hub for processes that publish metrics and diagnostics: a zenoh client of the hub's router."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import zenoh

from bridge.config.model import Config
from bridge.hub.control import WorkerAnswer
from bridge.hub.daemons import identity_of
from bridge.hub.errors import HubError, zenoh_reason
from bridge.hub.namesakes import own_answers
from bridge.hub.node import Hub
from bridge.hub.session import HubSession, HubSettings
from bridge.hub.zenoh_config import client_session_config
from bridge.metrics.source import ASK_SECONDS

_CONNECT_SECONDS = 0.5


class HubLink:
    """A node that joins the hub once the router is reachable; zenoh reconnects it afterwards.

    The node is a zenoh client without a local transport, so its queries to workers go through the router.

    Args:
        worker: the name under which the node responds to queries.
        status: returns the node's status document; None to respond to no queries.
    """

    def __init__(self, config: Config, worker: str, status: Callable[[], dict[str, Any]] | None = None) -> None:
        self._config, self._worker, self._status = config, worker, status
        self._lock = threading.Lock()
        self._hub: Hub | None = None
        self._session: zenoh.Session | None = None
        self._error = ""

    @property
    def trouble(self) -> str:
        """Why the last `join` failed; "" if it succeeded, or was not called yet."""
        return self._error

    def join(self) -> Hub | None:
        """Return the node, created if necessary; None if that fails. Call it repeatedly, on one thread."""
        if self._hub is not None:
            return self._hub
        hub = self._config.hub
        try:
            session = zenoh.open(client_session_config(hub.listen, hub.zenoh, _CONNECT_SECONDS))
        except zenoh.ZError as err:
            self._error = f"no router at {hub.listen}: {zenoh_reason(err)}"
            return None
        except HubError as err:
            self._error = f"hub.zenoh: {err}"
            return None
        settings = HubSettings(
            domain=hub.domain, node=f"midspan_{self._worker}", daemon=self._config.name, worker=self._worker,
            identity=identity_of(self._config),
        )  # fmt: skip
        node = Hub(HubSession(session, settings), settings)
        if (status := self._status) is not None:
            node.serve("status", lambda _params: status())
        with self._lock:
            self._hub, self._session, self._error = node, session, ""
        return node

    def ask(self) -> list[WorkerAnswer]:
        """Return the status of each worker of this daemon; raises `HubError` without a hub. Safe from any thread."""
        with self._lock:
            hub, session = self._hub, self._session
        if hub is None or session is None:
            raise HubError(self._error or "the hub has not been joined yet")
        try:
            if not session.info.routers_zid():  # zenoh keeps reconnecting
                raise HubError(f"the router at {self._config.hub.listen} is unreachable")
            answers = hub.ask("status", {}, daemon=self._config.name, timeout=ASK_SECONDS)
            return own_answers(answers, hub.zid, identity_of(self._config))
        except zenoh.ZError as err:
            raise HubError(zenoh_reason(err)) from None

    def close(self) -> None:
        """Leave the hub. Safe to call twice."""
        with self._lock:
            hub, self._hub, self._session = self._hub, None, None
        if hub is not None:
            hub.close()
