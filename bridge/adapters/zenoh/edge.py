"""The base class of the edges of zenoh dialects: session, other Midspan sessions on the network, and endpoints."""

from __future__ import annotations

import json
import logging
import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar
from urllib.parse import quote

import zenoh
from typing_extensions import override

from bridge.adapters.side_edge import SideEdge
from bridge.adapters.zenoh.neighbors import KeyNeighbors, new_zid, remember
from bridge.adapters.zenoh.topics import Announcement, KeyContext
from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect
from bridge.hub.endpoints.calls import nothing
from bridge.hub.errors import HubError, zenoh_reason
from bridge.hub.graph.tokens import Origin
from bridge.hub.listeners import listen_endpoints
from bridge.hub.opening import open_session
from bridge.hub.security.zenoh_log import captured
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import EdgeListener, Endpoint
from yarp_compat.file_names import escaped

if TYPE_CHECKING:
    from bridge.hub.security.endpoints import EndpointMonitor

_log = logging.getLogger(__name__)

TICK = 0.25
"""Seconds between two calls of `KeyEdge.tick`."""

RETRY_SECONDS = 1.0
"""Seconds between two attempts of a client to connect to its router."""

_CLIENT_WAIT_MS = 1500
"""Time limit of one such attempt in milliseconds."""

UNLINKED_SECONDS = 3.0
"""Seconds without a link after which the log reports it; routers and peers are linked within this time."""

LINK_SECONDS = 0.5
"""Seconds after which a new link has delivered all tokens; a query right after the link opens returns no tokens."""


_WITH_CERTIFICATES = ("tls/", "quic/")
"""Protocols over which an end may refuse the other's certificate."""

_CURE = "compare the files in transport/link/tls of zenoh.zenoh with those of the other machine"

_START = "start it, or correct the address (zenoh.router, zenoh.zenoh)"


_own_sessions = set[str]()
"""The ids of this process's sessions on the networks of the dialects."""


class OwnEndpoint(Protocol):
    """A publisher, subscription, client or server of this edge."""

    announcement: Announcement

    def close(self) -> None:
        """Undeclare the endpoint and withdraw its announcement. Safe to call twice."""


AnyEndpoint = TypeVar("AnyEndpoint", bound=OwnEndpoint)


class KeyEdge(SideEdge):
    """Joins one dialect on one zenoh network; ``scope`` distinguishes several edges of the same dialect.

    Subclasses read the graph and create endpoints.
    """

    _settings: zenoh.Config

    def __init__(self, config: Config, dialect: Dialect, registry: Registry, state: Path, scope: str) -> None:
        super().__init__(config, registry)
        self.dialect = dialect
        self._scope = scope
        self._file = state / "zenoh" / escaped(f"{self.side}-{quote(scope, safe='')}")
        self._lock = threading.Lock()
        self._endpoints: set[OwnEndpoint] = set()
        self._context: KeyContext | None = None
        self._presence: KeyNeighbors | None = None
        self._monitor: EndpointMonitor | None = None
        self._linked_since: float | None = None
        self._unlinked_since = time.monotonic()
        self._unlinked_logged = False
        self._stopping = threading.Event()
        self._ticker = threading.Thread(target=self._tick_on, name=f"midspan-{self.side}-tick", daemon=True)

    @override
    def start(self, listener: EdgeListener) -> None:
        """Open the session, which joins the network as soon as it can, including after a disconnection.

        zenoh opens no session in client mode before the router responds, and none with a listener that fails, for
        example at an address that this machine gets later. The edge's thread opens these sessions.
        """
        self._listener, self._settings = listener, _settings(self._config)
        if self._is_client:
            self.away = f"waiting for the zenoh router at {self._router_addresses}"
        else:
            try:
                self._join(open_session(self._settings))
            except zenoh.ZError as err:
                if not listen_endpoints(self._settings):
                    raise HubError(f"cannot join the network of the zenoh dialects: {zenoh_reason(err)}") from None
                self._wait(err)
        self._ticker.start()

    @property
    def _is_client(self) -> bool:
        return bool(json.loads(self._settings.get_json("mode")) == "client")

    @property
    def _router_addresses(self) -> str:
        return ", ".join(_endpoints(self._settings, "connect")) or "an unknown address"

    def _client_trouble(self, err: zenoh.ZError) -> str:
        """Return why the router of a client does not connect it, with the cure if a certificate is refused."""
        for address in filter(_has_certificates, _endpoints(self._settings, "connect")):
            from bridge.hub.security.handshake import refusal  # imports libraries that only TLS needs

            refused = refusal(address, self._settings)
            if refused is not None:
                return f"{refused.text}; {_CURE}"
        return f"{zenoh_reason(err)}; {_START}"

    def _wait(self, err: zenoh.ZError) -> None:
        """Report why the session does not open yet; log a new reason."""
        if self._is_client:
            away = f"waiting for the zenoh router at {self._router_addresses}: {self._client_trouble(err)}"
        else:
            away = f"waiting until it can listen: {zenoh_reason(err)}"
        if away != self.away and not self._stopping.is_set():
            _log.warning("%s: %s", self.side, away)
            self.away = away

    def _open_again(self) -> bool:
        """Try to open the session; return whether that succeeded."""
        try:
            session = open_session(self._settings)
        except zenoh.ZError as err:
            self._wait(err)
            return False
        if self._stopping.is_set():
            session.close()  # type: ignore[no-untyped-call]
            return False
        try:
            self._join(session)
        except Exception as err:
            _log.exception("%s: joining the network failed", self.side)
            assert self._listener is not None
            self._listener.edge_failed(f"joining the network failed: {err}")
        self._graph_changed()
        return self._context is not None

    def _join(self, session: zenoh.Session) -> None:
        assert self._listener is not None
        executor, ends = (SerialExecutor(f"midspan-{self.side}-{name}") for name in ("executor", "ends"))
        small, bulk = (Dispatcher(f"midspan-{self.side}-in-{size}") for size in ("small", "bulk"))
        small.start()
        bulk.start()
        limit = self._config.limits.message_bytes
        delays = DelayedCalls(f"midspan-{self.side}-delays")
        self._context = KeyContext(session, limit, executor, ends, delays, small, bulk, self._unregister)
        past = remember(str(session.zid()), self._file)
        changed = self._listener.graph_changed, self._listener.presence_changed
        self._presence = KeyNeighbors(session, self.side, self._scope, past, *changed)
        self.on_open(session)
        self.away = ""
        connect, listen = (_endpoints(self._settings, purpose) for purpose in ("connect", "listen"))
        if any(map(_has_certificates, (*connect, *listen))):
            self._monitor_endpoints(session, connect, listen)

    def _monitor_endpoints(self, session: zenoh.Session, connect: list[str], listen: list[str]) -> None:
        from bridge.hub.security.endpoints import EndpointMonitor, Owner  # they import libraries that only TLS needs
        from bridge.hub.security.handshake import Identity

        owner = Owner(f"{self.side}: ", _CURE)
        identity = Identity.of(self._settings)
        self._monitor = EndpointMonitor(session, listen, connect, identity, captured(), owner=owner)

    @override
    def stop(self) -> None:
        self._stopping.set()
        if self._ticker.is_alive():  # do not wait for a client's attempt to connect; its thread closes the session
            self._ticker.join(2.0 if self._context is not None else 0.1)
        context, self._context = self._context, None
        if context is None:
            return
        with self._lock:
            endpoints = list(self._endpoints)
        for endpoint in endpoints:
            endpoint.close()
        self.on_close()
        if self._presence is not None:
            self._presence.close()
        if self._monitor is not None:
            self._monitor.close()
        context.delays.close(1.0)
        context.executor.close()
        context.ends.close()
        context.session.close()  # type: ignore[no-untyped-call]
        context.small.stop()
        context.bulk.stop()

    @abstractmethod
    def on_open(self, session: zenoh.Session) -> None:
        """Start following the graph on the open session."""

    def on_close(self) -> None:
        """Release the resources of the session before it closes."""

    def tick(self, now: float) -> None:
        """Do periodic work; called every `TICK` seconds with the monotonic time."""

    def _tick_on(self) -> None:
        while self._context is None:
            try:
                opened = not self._stopping.is_set() and self._open_again()
            except Exception:
                _log.exception("%s: opening the session failed", self.side)
                opened = False
            if not opened and self._stopping.wait(RETRY_SECONDS):
                return
        while not self._stopping.wait(TICK):
            context, neighbors = self._context, self._presence
            if context is None or neighbors is None:
                return
            try:
                info = context.session.info
                now = time.monotonic()
                # the sessions of this worker's other dialects link to this one, but nothing is bridged between them
                peers = {str(zid) for zid in info.peers_zid()} - _own_sessions
                self._follow_links(now, linked=bool(info.routers_zid() or peers))
                neighbors.tick(now)
                self.tick(now)
            except Exception:
                _log.exception("%s: periodic work failed", self.side)

    def _follow_links(self, now: float, *, linked: bool) -> None:
        """Record whether the session has a link, and why it has none."""
        if linked != (self._linked_since is not None):
            self._linked_since = now if linked else None
            self._unlinked_since, self._unlinked_logged = now, False
            self._graph_changed()
        away = _trouble(self._monitor) if self._monitor is not None else ""
        if not linked and not away:
            away = self._unlinked
            if now - self._unlinked_since > UNLINKED_SECONDS and not self._unlinked_logged:
                self._unlinked_logged = True
                _log.warning("%s: %s", self.side, away)
        self.away = away

    @property
    def _unlinked(self) -> str:
        """What a session without a link waits for, and what to do."""
        if self._is_client:
            return f"waiting for the zenoh router at {self._router_addresses}: not connected; {_START}"
        addresses = ", ".join(_endpoints(self._settings, "connect"))
        if addresses:
            return f"waiting for another zenoh session at {addresses}: not connected; {_START}"
        return "waiting for another zenoh session: none found; start one, or name its address in zenoh.router"

    @property
    def context(self) -> KeyContext:
        """The state that all endpoints share while the session is open."""
        if self._context is None:
            raise RuntimeError(f"the {self.side} edge is not open")
        return self._context

    @override
    def network(self) -> str | None:
        """Return the id of this session on its network; None while the session has no link."""
        context = self._context
        return str(context.session.zid()) if context is not None and self._linked_since is not None else None

    @override
    def is_own_network(self, origin: Origin) -> bool:
        """Return whether the origin's session is this session or another session on this network."""
        neighbors = self._presence
        return origin.side == self.side and (neighbors is None or neighbors.is_own(origin.network))

    @override
    def settled(self, since: float) -> bool:
        """Return whether the network's routers and peers have replied with all tokens that existed at ``since``."""
        linked, neighbors = self._linked_since, self._presence
        if linked is None or neighbors is None or time.monotonic() - linked < LINK_SECONDS:
            return False
        return neighbors.settled(since)

    def register(self, endpoint: AnyEndpoint, prepare: Callable[[], None] = nothing) -> AnyEndpoint:
        """Prepare and announce an endpoint, and return it; it is closed with the edge."""
        with self._lock:
            self._endpoints.add(endpoint)
        prepare()
        endpoint.announcement.publish()
        return endpoint

    def _unregister(self, endpoint: OwnEndpoint) -> None:
        with self._lock:
            self._endpoints.discard(endpoint)


def _has_certificates(address: str) -> bool:
    return address.startswith(_WITH_CERTIFICATES)


def _endpoints(settings: zenoh.Config, purpose: str) -> list[str]:
    """Return a session's zenoh endpoints for ``connect`` or ``listen``; each mode may have its own list."""
    value = json.loads(settings.get_json(f"{purpose}/endpoints"))
    lists = value.values() if isinstance(value, dict) else [value]
    return [str(address) for addresses in lists for address in addresses or ()]


def _trouble(monitor: EndpointMonitor) -> str:
    """Return which endpoints connect no other machine, why, and the cures; "" if all are in a good state."""
    bad = [status for status in monitor.statuses() if not status.good]
    return "; ".join(status.text("") + (f"; {status.cure}" if status.cure else "") for status in bad)


def configured(
    dialect: Dialect, ros2: Callable[[str], SideType], endpoint: Callable[[str, SideType], Endpoint]
) -> list[Endpoint]:
    """Return the publishers that the configuration lists because they do not announce themselves.

    Publishers of unknown types are included.
    """
    endpoints = []
    for key in dialect.keys:
        assert key.topic is not None
        try:
            known = ros2(key.type)
        except Exception:  # the engine will fail in the same way, and report the reason
            known = SideType(key.type, "", "")
        endpoints.append(endpoint(key.topic, known))
    return endpoints


def _settings(config: Config) -> zenoh.Config:
    """Return the session's configuration; raises `HubConfigError`."""
    section = config.zenoh
    separate = section.router is not None or section.zenoh is not None
    router, over = (section.router, section.zenoh) if separate else (config.hub.listen, config.hub.zenoh)
    tree = session_tree(router, shared_memory=config.hub.shared_memory and not separate, max_payload=MAX_PAYLOAD)
    tree["connect"]["timeout_ms"]["client"] = _CLIENT_WAIT_MS
    settings = make_config(tree, over)
    zid = new_zid()
    _own_sessions.add(zid)
    settings.insert_json5("id", json.dumps(zid))
    # A session with a hybrid logical clock stamps received samples with its own id if they have no stamp, or a stamp
    # more than 0.5 s ahead. Such samples would look like Midspan's own, and be ignored.
    settings.insert_json5("timestamping/enabled", "false")
    return settings
