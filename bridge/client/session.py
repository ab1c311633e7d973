"""A program's session on the hub: a zenoh client of the router."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import zenoh

from bridge.client.errors import ClientError, UnreachableHubError
from bridge.config.model import Config
from bridge.config.sections.section import is_loopback
from bridge.hub.control import WorkerAnswer
from bridge.hub.errors import HubError
from bridge.hub.graph import HubEndpoint
from bridge.hub.identity import ask_identity
from bridge.hub.node import Hub
from bridge.hub.session import HubSession, HubSettings
from bridge.hub.zenoh_config import client_session_config, connect_endpoint

if TYPE_CHECKING:
    from bridge.messages.registry import Registry


CONNECT_SECONDS = 2.0
SLOW_SECONDS = 8.0
"""Additional seconds for a router that listens but has not answered yet, for example on a busy machine."""
ASK_SECONDS = 2.0
_QUIET = 0.1
_SETTLE_SECONDS = 1.5

DOWN = "Is the daemon running? Start it with 'midspan run', or name another router with --router."
HELD = "Another program holds"


@dataclass(frozen=True, slots=True)
class Client:
    """A program's session on the hub.

    Attributes:
        hub: the session's node.
        config: the configuration.
        where: the hub's address and domain, for messages.
        here: whether the hub is the one of this machine's daemon.
    """

    hub: Hub
    config: Config
    where: str
    here: bool = True

    def ask(
        self, verb: str, params: dict[str, Any] | None = None, *, worker: str = "*", timeout: float = ASK_SECONDS
    ) -> list[WorkerAnswer]:
        """Query all workers on the hub, or all workers of one name; the replies are sorted by daemon and worker."""
        answers = self.hub.ask(verb, params or {}, worker=worker, timeout=timeout)
        return sorted(answers, key=lambda a: (a.daemon, a.worker))

    def registry(self) -> Registry:
        """Return the message types of the configuration's folders and rules."""
        from bridge.messages.registry import Registry  # many programs need no types

        return Registry.of(self.config.types)

    def endpoints(self) -> list[HubEndpoint]:
        """Return the endpoints of other programs on the hub."""
        return [endpoint for endpoint in self.hub.graph.endpoints() if not endpoint.own]

    def publishers(self, topic: str) -> list[HubEndpoint]:
        """Return the publishers of a topic on the hub."""
        return self.hub.graph.publishers(topic)

    def servers(self, name: str) -> list[HubEndpoint]:
        """Return the servers of a service on the hub."""
        return self.hub.graph.servers(name)

    def catch_up(self) -> None:
        """Wait until this session has received the hub's graph from the router."""
        self.hub.graph.catch_up(_SETTLE_SECONDS)

    def settle(self) -> None:
        """Wait until this session has received the hub's graph, and the graph has not changed for a moment."""
        self.catch_up()
        changed = threading.Event()
        close = self.hub.graph.watch(changed.set)
        end = time.monotonic() + _SETTLE_SECONDS
        try:
            while changed.wait(_QUIET) and time.monotonic() < end:
                changed.clear()
        finally:
            close()


def unreachable_hint(config: Config) -> str:
    """Return a probable reason why no router answers at the hub's endpoint, and what to do."""
    from bridge.hub.router import port_held  # needed only here

    endpoint = config.hub.listen
    if not port_held(endpoint):
        return DOWN
    place = connect_endpoint(endpoint)
    tls = ", or it refuses this machine's certificate" if place.startswith(("tls/", "quic/")) else ""
    cure = "Stop it, set hub.listen to a free port, or name another router with --router."
    return f"{HELD} {place}: it is not a zenoh router{tls}. {cure}"


def _log_wait(text: str) -> None:
    logging.getLogger("midspan").warning(text)


@contextmanager
def connect(
    config: Config, seconds: float = CONNECT_SECONDS, *, here: bool = False,
    hint: Callable[[Config], str] = unreachable_hint, on_wait: Callable[[str], None] = _log_wait,
) -> Iterator[Client]:  # fmt: skip
    """Join the hub of a configuration; raises `ClientError` if no router answers within ``seconds``.

    If a router listens but does not answer, ``on_wait`` is called with a message, and the router gets `SLOW_SECONDS`
    more, unless one end refuses the other's certificate. ``here``: the hub is the one of this machine's daemon, and the
    client uses the daemon's name if the configuration has none.
    """
    where = f"the hub at {connect_endpoint(config.hub.listen)} (domain {config.hub.domain})"
    try:
        session = _open(config, seconds, on_wait)
    except zenoh.ZError as err:
        text = f"no zenoh router answers for {where}: {_short(err)}"
        raise UnreachableHubError(text, hint(config)) from None
    except HubError as err:
        raise ClientError(f"hub.zenoh: {err}") from None
    try:
        config = _with_name(config, session) if here else config
        settings = HubSettings(
            domain=config.hub.domain, node=f"midspan_cli_{os.getpid()}", daemon=config.name, worker=f"cli-{os.getpid()}"
        )
        hub = Hub(HubSession(session, settings), settings)
    except BaseException:
        session.close()  # type: ignore[no-untyped-call]
        raise
    try:
        yield Client(hub, config, where, here)
    finally:
        hub.close()


def _open(config: Config, seconds: float, on_wait: Callable[[str], None]) -> zenoh.Session:
    """Open a session; raises `zenoh.ZError`, and `UnreachableHubError` for a refused certificate."""
    from bridge.hub.router import may_be_slow  # needed only here
    from bridge.hub.security.handshake import refusal

    hub = config.hub
    place = connect_endpoint(hub.listen)
    try:
        return zenoh.open(client_session_config(hub.listen, hub.zenoh, seconds))
    except zenoh.ZError:
        refused = refusal(place, client_session_config(hub.listen, hub.zenoh, seconds))
        if refused is not None:
            text = f"the hub at {place} cannot be joined: {refused.text}"
            raise UnreachableHubError(text, refused.cure) from None
        if not may_be_slow(hub.listen):
            raise
    on_wait(
        f"the router at {place} has not answered for {seconds:g} s, although it listens; "
        f"waiting up to {SLOW_SECONDS:g} s more"
    )
    return zenoh.open(client_session_config(hub.listen, hub.zenoh, SLOW_SECONDS))


def _with_name(config: Config, session: zenoh.Session) -> Config:
    """Return the configuration with the name of the local router's daemon, if neither the file nor the state has one.

    Other users cannot read the state folder of a service, and the machine may have been renamed.
    """
    if "name" not in config.model_fields_set and is_loopback(config.hub.listen):
        for zid in session.info.routers_zid():
            daemon, _ = ask_identity(session, str(zid), ASK_SECONDS)
            if daemon:
                return config.model_copy(update={"name": daemon})
    return config


def _short(err: zenoh.ZError) -> str:
    """Return zenoh's message without the location in its source code."""
    return str(err).partition(" at /")[0].rstrip(".!")
