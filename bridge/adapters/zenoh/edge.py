"""What the edges of all key dialects share: a session of their own, Midspan's neighbours there, their endpoints."""

from __future__ import annotations

import contextlib
import json
import logging
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol
from urllib.parse import quote

import zenoh

from bridge.adapters.base import Deliver, Edge, EdgeListener, Endpoint, Sighting
from bridge.adapters.zenoh.inbox import Inbox, Lanes
from bridge.adapters.zenoh.mark import new_zid
from bridge.adapters.zenoh.neighbours import Neighbours, remember
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect
from bridge.hub.errands import Errands
from bridge.hub.errors import HubError, zenoh_reason
from bridge.hub.origin import Origin
from bridge.hub.qos import Qos
from bridge.hub.settings import MAX_PAYLOAD, make_config, session_tree
from bridge.messages.conversion import SideType
from bridge.messages.registry import Registry
from bridge.routing.dispatcher import Dispatcher

_log = logging.getLogger(__name__)

TICK = 0.25
"""Seconds between an edge's looks at the time."""

LINK_SECONDS = 0.5
"""Seconds after which a new link has told all tokens: asked at once, it answers with none."""


class Part(Protocol):
    """A publisher or subscription of ours."""

    def close(self) -> None:
        """Give it back."""


class KeyEdge(Edge):
    """Joins one dialect on one zenoh network; ``scope`` tells it from others of the dialect there.

    Subclasses say what is on the graph and how endpoints are made.
    """

    def __init__(self, config: Config, dialect: Dialect, registry: Registry, state: Path, scope: str) -> None:
        self.config, self.dialect, self.registry = config, dialect, registry
        self.limit = config.limits.message_bytes
        self._scope = scope
        self._file = state / "zenoh" / f"{self.side}-{quote(scope, safe='')}"
        self._lock = threading.Lock()
        self._parts: set[Part] = set()
        self.errands = Errands(f"midspan-{self.side}-errands")
        self._lanes: Lanes | None = None
        self._listener: EdgeListener | None = None
        self._session: zenoh.Session | None = None
        self._neighbours: Neighbours | None = None
        self._linked_since: float | None = None
        self._stopping = threading.Event()
        self._ticker = threading.Thread(target=self._tick_on, name=f"midspan-{self.side}-tick", daemon=True)

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self, listener: EdgeListener) -> None:
        """Open the session; it joins the network when it can, and again after a cut."""
        self._listener = listener
        session = self._session = _open(self.config)
        zid = str(session.zid())
        self._lanes = Lanes(*(Dispatcher(f"midspan-{self.side}-in-{size}") for size in ("small", "bulk")))
        self._lanes.start()
        past = remember(zid, self._file)
        self._neighbours = Neighbours(
            session, self.side, self._scope, past, listener.graph_changed, listener.presence_changed
        )
        self.opened(session)
        self._ticker.start()

    def stop(self) -> None:
        """Give back everything; see `Edge.stop`."""
        self._stopping.set()
        if self._ticker.is_alive():
            self._ticker.join(2.0)
        session, self._session = self._session, None
        if session is None:
            return
        with self._lock:
            parts = list(self._parts)
        for part in parts:
            part.close()
        self.closing()
        if self._neighbours is not None:
            self._neighbours.close()
        self.errands.close()
        session.close()  # type: ignore[no-untyped-call]
        if self._lanes is not None:
            self._lanes.stop()

    @abstractmethod
    def opened(self, session: zenoh.Session) -> None:
        """The session is open: begin to follow the graph."""

    def closing(self) -> None:
        """The session is about to be closed."""

    def tick(self, now: float) -> None:
        """Called a few times a second with the monotonic time."""

    def _tick_on(self) -> None:
        while not self._stopping.wait(TICK):
            session, neighbours = self._session, self._neighbours
            if session is None or neighbours is None:
                return
            try:
                self._look_at_links(session)
                now = time.monotonic()
                neighbours.tick(now)
                self.tick(now)
            except Exception:
                _log.exception("%s: a look at the time failed", self.side)

    def _look_at_links(self, session: zenoh.Session) -> None:
        linked = bool(session.info.routers_zid() or session.info.peers_zid())
        if linked != (self._linked_since is not None):
            self._linked_since = time.monotonic() if linked else None
            self.changed()

    # -- the network ---------------------------------------------------------------------------------------------------

    @property
    def session(self) -> zenoh.Session:
        """The open session."""
        if self._session is None:
            msg = f"the {self.side} edge is not open"
            raise RuntimeError(msg)
        return self._session

    def network(self) -> str | None:
        """Our session's id, by which the others on this network know it; None while the session has no link."""
        session = self._session
        return str(session.zid()) if session is not None and self._linked_since is not None else None

    def is_own_network(self, origin: Origin) -> bool:
        """Whether the origin's session is ours or one that is seen here."""
        neighbours = self._neighbours
        return origin.side == self.side and (neighbours is None or neighbours.is_own(origin.network))

    def announce(self, record: bytes) -> None:
        """See `Edge.announce`."""
        neighbours = self._neighbours
        if neighbours is not None:
            with contextlib.suppress(zenoh.ZError):  # the session is being closed
                neighbours.announce(record)

    def sightings(self) -> Sequence[Sighting]:
        """See `Edge.sightings`; one that dies is gone when zenoh gives up its session, after its lease."""
        return () if self._neighbours is None else self._neighbours.sightings()

    def settled(self, since: float) -> bool:
        """See `Edge.settled`: the network's routers and peers are asked for all tokens."""
        linked, neighbours = self._linked_since, self._neighbours
        if linked is None or neighbours is None or time.monotonic() - linked < LINK_SECONDS:
            return False
        return neighbours.settled(since)

    def changed(self) -> None:
        """The graph changed; may be called from any thread."""
        if self._listener is not None:
            self._listener.graph_changed()

    def learn(self, type_name: str, definition: str) -> None:
        """See `Edge.learn`."""
        self.registry.learn_ros2(type_name, definition)

    # -- endpoints of ours ---------------------------------------------------------------------------------------------

    def inbox(self, deliver: Deliver, qos: Qos) -> Inbox:
        """A queue for a new subscription."""
        assert self._lanes is not None
        return Inbox(deliver, qos, self._lanes)

    def keep(self, part: Part) -> None:
        """Close a part with the edge."""
        with self._lock:
            self._parts.add(part)

    def drop(self, part: Part) -> None:
        """A part was closed."""
        with self._lock:
            self._parts.discard(part)


def configured(
    dialect: Dialect, ros2: Callable[[str], SideType], endpoint: Callable[[str, SideType], Endpoint]
) -> list[Endpoint]:
    """The publishers that the configuration names because they announce nothing; types that are unknown are kept."""
    found = []
    for key in dialect.keys:
        assert key.topic is not None
        try:
            known = ros2(key.type)
        except Exception:  # the engine meets it again and tells the reason
            known = SideType(key.type, "", "")
        found.append(endpoint(key.topic, known))
    return found


def _open(config: Config) -> zenoh.Session:
    section = config.zenoh
    own = section.router is not None or section.zenoh is not None
    router, over = (section.router, section.zenoh) if own else (config.hub.listen, config.hub.zenoh)
    tree = session_tree(router, shared_memory=config.hub.shared_memory and not own, max_payload=MAX_PAYLOAD)
    settings = make_config(tree, over)
    settings.insert_json5("id", json.dumps(new_zid()))
    try:
        return zenoh.open(settings)
    except zenoh.ZError as err:
        msg = f"cannot join the network of the zenoh dialects: {zenoh_reason(err)}"
        raise HubError(msg) from None
