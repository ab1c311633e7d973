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
from dataclasses import dataclass
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
    error; ``refused``: nothing listens at the peer's address.
    """

    due: float = 0.0
    wait: float = _FIRST_WAIT
    under_way: bool = False
    failure: str = ""
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
            for registration in list(self._held):
                self._release(registration)

    def update(self, registrations: frozenset[Registration]) -> None:
        """Update the publishers that are on the graph, and probe those that are due."""
        now = time.monotonic()
        with self._lock:
            for removed in self._facts.keys() - registrations:
                del self._facts[removed]
                self._release(removed)
            for removed in self._unprobed.keys() - registrations:
                del self._unprobed[removed]
            for new in registrations - self._facts.keys() - self._unprobed.keys():
                self._unprobed[new] = _Attempt()
            due = [
                registration
                for registration, a in self._unprobed.items()
                if registration.uri and not a.under_way and a.due <= now
            ]
            for registration in due:
                self._unprobed[registration].under_way = True
        for registration in due:
            self._pool.submit(registration.uri, lambda registration=registration: self._probe(registration))  # type: ignore[misc]

    @property
    def has_unprobed(self) -> bool:
        """Whether there are publishers without known facts."""
        return bool(self._unprobed)

    def facts(self, topic: str = "") -> Mapping[Registration, Facts]:
        """Return the known facts, of all topics or of one."""
        with self._lock:
            return {
                registration: facts for registration, facts in self._facts.items() if topic in ("", registration.topic)
            }

    def discard(self, registration: Registration) -> None:
        """Close a publisher's held connection with its unread messages: a base must not execute old commands."""
        with self._lock:
            self._release(registration)

    def take(self, registration: Registration) -> ProbedConnection | None:
        """Return a publisher's held connection, which the caller then owns; None if it is no longer held."""
        with self._lock:
            return self._held.pop(registration, None)

    def drop_facts(self, registration: Registration, failure: str) -> None:
        """Drop the facts of a publisher that disconnected or changed, and probe it again later."""
        with self._lock:
            if self._facts.pop(registration, None) is None:
                return
            self._release(registration)
            self._unprobed[registration] = _Attempt(due=time.monotonic() + _FIRST_WAIT, failure=failure)
        self._changed(registration)

    def check(self, registration: Registration) -> None:
        """Probe a known peer again; drop its facts if it does not respond."""
        self._pool.submit(registration.uri, lambda: self._check(registration))

    def _check(self, registration: Registration) -> None:
        try:
            sock, header = self._do_handshake(registration)
        except Ros1Error as err:
            self.drop_facts(registration, str(err))
        else:
            sock.close()
            self.adopt(registration, Facts.of(header))

    def _check_latching(self, registration: Registration) -> None:
        """Read a publisher's header again; ignore a failure."""
        with self._lock:
            if registration not in self._facts:
                return
        with contextlib.suppress(Ros1Error):
            sock, header = self._do_handshake(registration)
            sock.close()
            self.adopt(registration, Facts.of(header))

    def adopt(self, registration: Registration, facts: Facts) -> None:
        """Adopt the header that a subscription received, because the publisher may have advertised again."""
        with self._lock:
            if self._facts.get(registration) in (None, facts):
                return
            self._facts[registration] = facts
        self._changed(registration)

    def failures(self) -> dict[Registration, str]:
        """Return the publishers that did not respond, and why."""
        with self._lock:
            return {registration: a.failure for registration, a in self._unprobed.items() if a.failure}

    def is_unprobed(self, registration: Registration) -> bool:
        """Return whether a listed peer has not been probed successfully yet."""
        with self._lock:
            return registration in self._unprobed

    def is_gone(self, registration: Registration) -> bool:
        """Return whether the last connection was refused because nothing listens at the address."""
        with self._lock:
            attempt = self._unprobed.get(registration)
        return attempt is not None and attempt.refused

    def _do_handshake(self, registration: Registration, *, held: bool = False) -> ProbedConnection:
        # rospy drops an older connection of the same caller name, so a connection that is not held needs another name.
        caller = self._caller() if held else f"{self._caller()}_probe"
        return self._handshake(caller, registration.uri, registration.topic, HANDSHAKE_SECONDS)

    def _probe(self, registration: Registration) -> None:
        try:
            sock, header = self._do_handshake(registration, held=self._holds)
        except Ros1Error as err:
            if isinstance(err, UnreachableError):
                self._pool.failed(registration.uri)
            self._retry_later(registration, str(err), refused=isinstance(err, UnreachableError) and err.refused)
            return
        except Exception as err:
            self._retry_later(registration, f"{type(err).__name__}: {err}")
            raise
        self._pool.answered(registration.uri)
        facts = Facts.of(header)
        with self._lock:
            known = self._unprobed.pop(registration, None) is not None
            if known:
                self._facts[registration] = facts
            if known and facts.native and self._holds and not self._closed:
                self._release(registration)
                self._held[registration] = sock, header
                self._timer.after(HOLD_SECONDS, lambda: self._expire(registration, sock))
            else:
                sock.close()
        # a YARP port does not announce latching, and its program may count the second probe as a subscriber
        if known and facts.native and self._holds and not facts.latching and "latching" in header:
            self._timer.after(
                LATCH_SECONDS, lambda: self._pool.submit(registration.uri, lambda: self._check_latching(registration))
            )
        if known:
            self._changed(registration)

    def _expire(self, registration: Registration, sock: DeadlineSocket) -> None:
        with self._lock:
            if registration in self._held and self._held[registration][0] is sock:
                self._release(registration)

    def _release(self, registration: Registration) -> None:
        """Close a connection that no subscription has reused; called with the lock held."""
        if (held := self._held.pop(registration, None)) is not None:
            held[0].close()

    def _retry_later(self, registration: Registration, failure: str, *, refused: bool = False) -> None:
        with self._lock:
            attempt = self._unprobed.get(registration)
            if attempt is None:
                return
            if failure != attempt.failure:
                peer = f"{self._kind} of {registration.topic} in {registration.node}"
                _log.info("cannot learn the type from the %s: %s", peer, failure)
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
        self._registrations: frozenset[Registration] = frozenset()
        self._ends: set[AnyEnd] = set()

    @abstractmethod
    def _notify(self, end: AnyEnd, known: Mapping[Registration, Facts]) -> None:
        """Inform one end about the publishers, or servers, of its name."""

    def update(self, registrations: frozenset[Registration]) -> None:
        """Update the publishers, or servers, that the master lists; called on the master's thread."""
        changed, self._registrations = registrations != self._registrations, registrations
        if changed or self.prober.has_unprobed:
            self.prober.update(registrations)
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
            for registration, facts in self.prober.facts(name).items():
                known.setdefault(registration.topic, {})[registration] = facts
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

    def _probed(self, registration: Registration) -> None:
        self.inform(registration.topic)
        self._context.facts_changed()

    def close(self) -> None:
        with self._lock:
            ends, self._ends = list(self._ends), set()
        for end in ends:
            end.close()
