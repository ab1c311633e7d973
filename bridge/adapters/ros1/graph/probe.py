"""Probes each publisher and server on the graph with a TCPROS handshake, and informs subscriptions and callers.

The connection to a publisher stays open for a moment, and the next subscription reuses it. To the publisher, this
connection is a subscriber. Programs that wait for a subscriber before they publish (with ``get_num_connections`` of
rospy or ``getOutputCount`` of a YARP port, which counts a closed connection until its next write) send their first
message over it, and for some that is the only message.
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
    ``node`` returns this node's name, ``origin`` is the daemon's name; ``found`` is called when the facts about a
    publisher or server have changed; ``limit`` is the maximum message size in bytes.
    """

    pool: PeerPool
    loop: ConnectionLoop
    timer: DelayedCalls
    book: TopicBook
    node: Callable[[], str]
    origin: str
    found: Callable[[], None]
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
    """The probing of one peer: the next attempt and the last error; ``refused``: nothing listens at its address."""

    due: float = 0.0
    wait: float = _FIRST_WAIT
    under_way: bool = False
    trouble: str = ""
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
        self._open: dict[Registration, _Attempt] = {}
        self._held: dict[Registration, ProbedConnection] = {}
        self._closed = False

    def close(self) -> None:
        with self._lock:
            self._closed = True
            for link in list(self._held):
                self._release(link)

    def follow(self, links: frozenset[Registration]) -> None:
        """Update the publishers that are on the graph, and probe those that are due."""
        now = time.monotonic()
        with self._lock:
            for removed in self._facts.keys() - links:
                del self._facts[removed]
                self._release(removed)
            for removed in self._open.keys() - links:
                del self._open[removed]
            for new in links - self._facts.keys() - self._open.keys():
                self._open[new] = _Attempt()
            due = [link for link, a in self._open.items() if link.uri and not a.under_way and a.due <= now]
            for link in due:
                self._open[link].under_way = True
        for link in due:
            self._pool.submit(link.uri, lambda link=link: self._probe(link))  # type: ignore[misc]

    @property
    def waiting(self) -> bool:
        """Whether there are publishers without known facts."""
        return bool(self._open)

    def facts(self, topic: str = "") -> Mapping[Registration, Facts]:
        """Return the known facts, of one topic if one is given."""
        with self._lock:
            return {link: facts for link, facts in self._facts.items() if topic in ("", link.topic)}

    def discard(self, link: Registration) -> None:
        """Close a publisher's held connection with its unread messages: a base must not execute old commands."""
        with self._lock:
            self._release(link)

    def take(self, link: Registration) -> ProbedConnection | None:
        """Return a publisher's held connection, which the caller then owns; None if it is no longer held."""
        with self._lock:
            return self._held.pop(link, None)

    def doubt(self, link: Registration, trouble: str) -> None:
        """Drop the facts of a publisher that disconnected or changed, and probe it again later."""
        with self._lock:
            if self._facts.pop(link, None) is None:
                return
            self._release(link)
            self._open[link] = _Attempt(due=time.monotonic() + _FIRST_WAIT, trouble=trouble)
        self._changed(link)

    def check(self, link: Registration) -> None:
        """Probe a known peer again; drop its facts if it does not respond."""
        self._pool.submit(link.uri, lambda: self._check(link))

    def _check(self, link: Registration) -> None:
        try:
            sock, header = self._shake(link)
        except Ros1Error as err:
            self.doubt(link, str(err))
        else:
            sock.close()
            self.learned(link, Facts.of(header))

    def _check_latching(self, link: Registration) -> None:
        """Read a publisher's header again; ignore a failure."""
        with self._lock:
            if link not in self._facts:
                return
        with contextlib.suppress(Ros1Error):
            sock, header = self._shake(link)
            sock.close()
            self.learned(link, Facts.of(header))

    def learned(self, link: Registration, facts: Facts) -> None:
        """Adopt the header that a subscription received, because the publisher may have advertised again."""
        with self._lock:
            if self._facts.get(link) in (None, facts):
                return
            self._facts[link] = facts
        self._changed(link)

    def troubles(self) -> dict[Registration, str]:
        """Return the publishers that did not respond, and why."""
        with self._lock:
            return {link: a.trouble for link, a in self._open.items() if a.trouble}

    def is_waiting(self, link: Registration) -> bool:
        """Return whether a listed peer has not been probed successfully yet."""
        with self._lock:
            return link in self._open

    def is_gone(self, link: Registration) -> bool:
        """Return whether the last connection was refused because nothing listens at the address."""
        with self._lock:
            attempt = self._open.get(link)
        return attempt is not None and attempt.refused

    def _shake(self, link: Registration, *, held: bool = False) -> ProbedConnection:
        # rospy drops an older connection of the same caller, so a connection that is not held needs another name.
        caller = self._caller() if held else f"{self._caller()}_probe"
        return self._handshake(caller, link.uri, link.topic, HANDSHAKE_SECONDS)

    def _probe(self, link: Registration) -> None:
        try:
            sock, header = self._shake(link, held=self._holds)
        except Ros1Error as err:
            if isinstance(err, UnreachableError):
                self._pool.failed(link.uri)
            self._again(link, str(err), refused=isinstance(err, UnreachableError) and err.refused)
            return
        except Exception as err:
            self._again(link, f"{type(err).__name__}: {err}")
            raise
        self._pool.answered(link.uri)
        facts = Facts.of(header)
        with self._lock:
            known = self._open.pop(link, None) is not None
            if known:
                self._facts[link] = facts
            if known and facts.native and self._holds and not self._closed:
                self._release(link)
                self._held[link] = sock, header
                self._timer.after(HOLD_SECONDS, lambda: self._expire(link, sock))
            else:
                sock.close()
        # a YARP port does not announce latching, and its program may count the second probe as a subscriber
        if known and facts.native and self._holds and not facts.latching and "latching" in header:
            self._timer.after(LATCH_SECONDS, lambda: self._pool.submit(link.uri, lambda: self._check_latching(link)))
        if known:
            self._changed(link)

    def _expire(self, link: Registration, sock: DeadlineSocket) -> None:
        with self._lock:
            if link in self._held and self._held[link][0] is sock:
                self._release(link)

    def _release(self, link: Registration) -> None:
        """Close a connection that no subscription has reused; called with the lock held."""
        if (held := self._held.pop(link, None)) is not None:
            held[0].close()

    def _again(self, link: Registration, trouble: str, *, refused: bool = False) -> None:
        with self._lock:
            attempt = self._open.get(link)
            if attempt is None:
                return
            if trouble != attempt.trouble:
                peer = f"{self._kind} of {link.topic} in {link.node}"
                _log.info("the %s does not announce its type: %s", peer, trouble)
            attempt.trouble, attempt.refused, attempt.under_way = trouble, refused, False
            attempt.due, attempt.wait = time.monotonic() + attempt.wait, min(2 * attempt.wait, _LONGEST_WAIT)


class FollowingEnd(Protocol):
    """A subscription or caller of this node."""

    name: str

    @property
    def restless(self) -> bool:
        """Whether the subscription or caller needs to connect."""

    def close(self) -> None:
        """Close it. Safe to call twice."""


AnyEnd = TypeVar("AnyEnd", bound=FollowingEnd)


class Follower(ABC, Generic[AnyEnd]):
    """Informs subscriptions (or callers) about the publishers (or servers) of their names; see `Prober`."""

    def __init__(
        self, context: Ros1Context, handshake: Handshake = connect, kind: str = "publisher", *, holds: bool = False
    ) -> None:
        self._context = context
        self.prober = Prober(context, self._probed, handshake, kind, holds=holds)
        self._lock = threading.Lock()
        self._following = threading.Lock()  # facts must be passed on in order
        self._links: frozenset[Registration] = frozenset()
        self._ends: set[AnyEnd] = set()

    @abstractmethod
    def _notify(self, end: AnyEnd, known: Mapping[Registration, Facts]) -> None:
        """Inform one end."""

    def take_up(self, links: frozenset[Registration]) -> None:
        """Update the publishers, or servers, that the master lists; called on the master's thread."""
        changed, self._links = links != self._links, links
        if changed or self.prober.waiting:
            self.prober.follow(links)
        with self._lock:
            restless = any(end.restless for end in self._ends)
        if changed or restless:
            self.follow()

    def follow(self, name: str = "") -> None:
        """Inform all ends, or the ends of one name."""
        with self._lock:
            ends = [end for end in self._ends if name in ("", end.name)]
        if not ends:
            return
        with self._following:
            known: dict[str, dict[Registration, Facts]] = {}
            for link, facts in self.prober.facts(name).items():
                known.setdefault(link.topic, {})[link] = facts
            for end in ends:
                self._notify(end, known.get(end.name, {}))

    def _followers(self) -> list[AnyEnd]:
        with self._lock:
            return list(self._ends)

    def _add(self, end: AnyEnd) -> AnyEnd:
        with self._lock:
            self._ends.add(end)
        self.follow(end.name)
        return end

    def _remove(self, end: AnyEnd) -> None:
        with self._lock:
            self._ends.discard(end)

    def _probed(self, link: Registration) -> None:
        self.follow(link.topic)
        self._context.found()

    def close(self) -> None:
        with self._lock:
            ends, self._ends = list(self._ends), set()
        for end in ends:
            end.close()
