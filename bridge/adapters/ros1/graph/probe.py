"""Probes each publisher and server on the graph with a TCPROS handshake, and informs subscriptions and callers.

The connection to a publisher stays open for a moment, and the next subscription reuses it. To the publisher, this
connection is a subscriber. Programs that wait for a subscriber before they publish (with ``get_num_connections`` of
rospy or ``getOutputCount`` of a YARP port, which counts a closed connection until its next write) send their first
message over it, and some programs send only that message.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.handshake import ORIGIN_FIELD, Header, connect
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1.topics.book import TopicBook
from bridge.adapters.ros1_peers import DeadlineSocket, Ros1Error, UnreachableError
from bridge.concurrency import DelayedCalls

_log = logging.getLogger(__name__)

HANDSHAKE_SECONDS = 2.0

HOLD_SECONDS = 1.0
"""How long the connection to a publisher is held for a subscription. Nothing is read from it meanwhile, so a publisher
that sends some megabytes and waits for its subscribers may be delayed by this time, once."""

LATCH_SECONDS = 1.0
"""Delay after which a publisher that does not latch is probed once more: rospy registers a publisher with the master
before it enables latching (``rospy.topics.Publisher.__init__``), and may announce ``latching=0`` for that moment."""

_FIRST_WAIT = 0.5
_LONGEST_WAIT = 10.0
_MOST_LOGGED = 5
"""Maximum number of different errors of one peer in the log."""


@dataclass(frozen=True, slots=True)
class Ros1Context:
    """The shared state of the edge's endpoints.

    ``pool`` calls other nodes, ``loop`` reads connections, ``timer`` delays calls; ``book`` has this node's topics;
    ``node`` returns this node's name, ``origin`` is the daemon's name; ``facts_changed`` is called when the facts about
    a publisher or server have changed; ``limit`` is the maximum message size in bytes.
    """

    pool: PeerPool
    loop: ConnectionLoop
    timer: DelayedCalls
    book: TopicBook
    node: Callable[[], str]
    origin: str
    facts_changed: Callable[[], None]
    limit: int


@dataclass(frozen=True, slots=True)
class Facts:
    """The properties in a publisher's or server's connection header."""

    type: str
    md5: str
    definition: str
    latching: bool
    native: bool

    @classmethod
    def of(cls, header: Header) -> Facts:
        """Read the facts from a connection header, which must have ``type`` and ``md5sum``."""
        latching = header.get("latching", "0").strip() == "1"
        definition, native = header.get("message_definition", ""), ORIGIN_FIELD not in header
        return cls(header["type"], header["md5sum"], definition, latching, native)

    def fits(self, md5: str) -> bool:
        """Return whether the peer is native and has the type with this MD5 sum ("*" or "" for any)."""
        return self.native and md5 in (self.md5, "*", "")


@dataclass(slots=True)
class _Attempt:
    """The attempts to probe one peer.

    ``due`` is the monotonic time of the next attempt, ``wait`` the pause in seconds after it, ``failure`` the last
    error, ``logged`` all errors so far; ``refused``: nothing listens at the peer's address.
    """

    due: float = 0.0
    wait: float = _FIRST_WAIT
    under_way: bool = False
    failure: str = ""
    logged: set[str] = field(default_factory=set)
    refused: bool = False


ProbedConnection = tuple[DeadlineSocket, Header]
"""The connection to a peer that has sent its header, and the header."""

Handshake = Callable[[str, str, str, float], ProbedConnection]
"""``handshake(caller, uri, topic, seconds)``: connect, and read the peer's header; raises `Ros1Error`."""


class Prober:
    """Probes every new publisher (or server), with growing pauses until it responds.

    ``changed`` is called with each peer whose facts have changed. ``holds``: whether the connection to a native peer
    stays open for `HOLD_SECONDS`, for `take`; otherwise it is closed at once.
    """

    def __init__(
        self, context: Ros1Context, changed: Callable[[Registration], None], handshake: Handshake = connect,
        kind: str = "publisher", *, holds: bool = False,
    ) -> None:  # fmt: skip
        self._pool, self._caller, self._timer = context.pool, context.node, context.timer
        self._changed, self._handshake, self._kind, self._holds = changed, handshake, kind, holds
        self._lock = threading.Lock()
        self._facts: dict[Registration, Facts] = {}
        self._unprobed: dict[Registration, _Attempt] = {}
        self._held: dict[Registration, ProbedConnection] = {}
        self._closed = False

    def close(self) -> None:
        with self._lock:
            self._closed = True
            for peer in list(self._held):
                self._release(peer)

    def update(self, peers: frozenset[Registration]) -> None:
        """Update the publishers that are on the graph, and probe the publishers that are due."""
        now = time.monotonic()
        with self._lock:
            for removed in self._facts.keys() - peers:
                del self._facts[removed]
                self._release(removed)
            for removed in self._unprobed.keys() - peers:
                del self._unprobed[removed]
            for new in peers - self._facts.keys() - self._unprobed.keys():
                self._unprobed[new] = _Attempt()
            due = [peer for peer, a in self._unprobed.items() if peer.uri and not a.under_way and a.due <= now]
            for peer in due:
                self._unprobed[peer].under_way = True
        for peer in due:
            self._pool.submit(peer.uri, lambda peer=peer: self._probe(peer))  # type: ignore[misc]

    @property
    def has_unprobed(self) -> bool:
        """Whether there are publishers without known facts."""
        return bool(self._unprobed)

    def facts(self, topic: str = "") -> Mapping[Registration, Facts]:
        """Return the known facts, of all topics or of one."""
        with self._lock:
            return {peer: facts for peer, facts in self._facts.items() if topic in ("", peer.topic)}

    def discard(self, peer: Registration) -> None:
        """Close a publisher's held connection with its unread messages: a base must not execute old commands."""
        with self._lock:
            self._release(peer)

    def take(self, peer: Registration) -> ProbedConnection | None:
        """Return a publisher's held connection, which the caller then owns; None if it is no longer held."""
        with self._lock:
            return self._held.pop(peer, None)

    def drop_facts(self, peer: Registration, failure: str) -> None:
        """Drop the facts of a publisher that disconnected or changed, and probe it again later."""
        with self._lock:
            if self._facts.pop(peer, None) is None:
                return
            self._release(peer)
            self._unprobed[peer] = _Attempt(due=time.monotonic() + _FIRST_WAIT, failure=failure)
        self._changed(peer)

    def check(self, peer: Registration) -> None:
        """Probe a known peer again; drop its facts if it does not respond."""
        self._pool.submit(peer.uri, lambda: self._check(peer))

    def _check(self, peer: Registration) -> None:
        try:
            sock, header = self._do_handshake(peer)
        except Ros1Error as err:
            self.drop_facts(peer, str(err))
        else:
            sock.close()
            self.adopt(peer, Facts.of(header))

    def _check_latching(self, peer: Registration) -> None:
        """Read a publisher's header again; ignore a failure."""
        with self._lock:
            if peer not in self._facts:
                return
        with contextlib.suppress(Ros1Error):
            sock, header = self._do_handshake(peer)
            sock.close()
            self.adopt(peer, Facts.of(header))

    def adopt(self, peer: Registration, facts: Facts) -> None:
        """Adopt the header that a subscription received, because the publisher may have advertised again."""
        with self._lock:
            if self._facts.get(peer) in (None, facts):
                return
            self._facts[peer] = facts
        self._changed(peer)

    def failures(self) -> dict[Registration, str]:
        """Return the publishers that did not respond, and why."""
        with self._lock:
            return {peer: a.failure for peer, a in self._unprobed.items() if a.failure}

    def is_unprobed(self, peer: Registration) -> bool:
        """Return whether a listed peer has not been probed successfully yet."""
        with self._lock:
            return peer in self._unprobed

    def is_gone(self, peer: Registration) -> bool:
        """Return whether the last connection was refused because nothing listens at the address."""
        with self._lock:
            attempt = self._unprobed.get(peer)
        return attempt is not None and attempt.refused

    def _do_handshake(self, peer: Registration, *, held: bool = False) -> ProbedConnection:
        # rospy drops an older connection of the same caller name, so a connection that is not held needs another name.
        caller = self._caller() if held else f"{self._caller()}_probe"
        return self._handshake(caller, peer.uri, peer.topic, HANDSHAKE_SECONDS)

    def _probe(self, peer: Registration) -> None:
        try:
            sock, header = self._do_handshake(peer, held=self._holds)
        except Ros1Error as err:
            if isinstance(err, UnreachableError):
                self._pool.failed(peer.uri)
            self._retry_later(peer, str(err), refused=isinstance(err, UnreachableError) and err.refused)
            return
        except Exception as err:
            self._retry_later(peer, f"{type(err).__name__}: {err}")
            raise
        self._pool.answered(peer.uri)
        facts = Facts.of(header)
        with self._lock:
            known = self._unprobed.pop(peer, None) is not None
            if known:
                self._facts[peer] = facts
            if known and facts.native and self._holds and not self._closed:
                self._release(peer)
                self._held[peer] = sock, header
                self._timer.after(HOLD_SECONDS, lambda: self._expire(peer, sock))
            else:
                sock.close()
        # a YARP port does not announce latching, and its program may count the second probe as a subscriber
        if known and facts.native and self._holds and not facts.latching and "latching" in header:
            self._timer.after(LATCH_SECONDS, lambda: self._pool.submit(peer.uri, lambda: self._check_latching(peer)))
        if known:
            self._changed(peer)

    def _expire(self, peer: Registration, sock: DeadlineSocket) -> None:
        with self._lock:
            if peer in self._held and self._held[peer][0] is sock:
                self._release(peer)

    def _release(self, peer: Registration) -> None:
        """Close a connection that no subscription has reused; called with the lock held."""
        if (held := self._held.pop(peer, None)) is not None:
            held[0].close()

    def _retry_later(self, peer: Registration, failure: str, *, refused: bool = False) -> None:
        with self._lock:
            attempt = self._unprobed.get(peer)
            if attempt is None:
                return
            # the errors of an unreachable host alternate, for example between a timeout and a missing route
            if failure not in attempt.logged and len(attempt.logged) < _MOST_LOGGED:
                attempt.logged.add(failure)
                description = f"{self._kind} of {peer.topic} in {peer.node}"
                _log.info("cannot learn the type from the %s: %s", description, failure)
            attempt.failure, attempt.refused, attempt.under_way = failure, refused, False
            attempt.due, attempt.wait = time.monotonic() + attempt.wait, min(2 * attempt.wait, _LONGEST_WAIT)


class UpdatedEnd(Protocol):
    """A subscription or caller of this node."""

    name: str

    @property
    def needs_connection(self) -> bool:
        """Whether the subscription or caller needs to connect."""

    def close(self) -> None:
        """Close it. Safe to call twice."""


AnyEnd = TypeVar("AnyEnd", bound=UpdatedEnd)


class EndUpdater(ABC, Generic[AnyEnd]):
    """Informs subscriptions (or callers) about the publishers (or servers) of their names; see `Prober`."""

    def __init__(
        self, context: Ros1Context, handshake: Handshake = connect, kind: str = "publisher", *, holds: bool = False
    ) -> None:
        self._context = context
        self.prober = Prober(context, self._probed, handshake, kind, holds=holds)
        self._lock = threading.Lock()
        self._updating = threading.Lock()  # so that each end receives the facts in order
        self._peers: frozenset[Registration] = frozenset()
        self._ends: set[AnyEnd] = set()

    @abstractmethod
    def _notify(self, end: AnyEnd, known: Mapping[Registration, Facts]) -> None:
        """Inform one end about the publishers, or servers, of its name."""

    def update(self, peers: frozenset[Registration]) -> None:
        """Update the publishers, or servers, that the master lists; called on the master's thread."""
        changed, self._peers = peers != self._peers, peers
        if changed or self.prober.has_unprobed:
            self.prober.update(peers)
        with self._lock:
            needs_connection = any(end.needs_connection for end in self._ends)
        if changed or needs_connection:
            self.inform()

    def inform(self, name: str = "") -> None:
        """Inform all ends, or the ends of one name."""
        with self._lock:
            ends = [end for end in self._ends if name in ("", end.name)]
        if not ends:
            return
        with self._updating:
            known: dict[str, dict[Registration, Facts]] = {}
            for peer, facts in self.prober.facts(name).items():
                known.setdefault(peer.topic, {})[peer] = facts
            for end in ends:
                self._notify(end, known.get(end.name, {}))

    def _current_ends(self) -> list[AnyEnd]:
        with self._lock:
            return list(self._ends)

    def _add(self, end: AnyEnd) -> AnyEnd:
        with self._lock:
            self._ends.add(end)
        self.inform(end.name)
        return end

    def _remove(self, end: AnyEnd) -> None:
        with self._lock:
            self._ends.discard(end)

    def _probed(self, peer: Registration) -> None:
        self.inform(peer.topic)
        self._context.facts_changed()

    def close(self) -> None:
        with self._lock:
            ends, self._ends = list(self._ends), set()
        for end in ends:
            end.close()
