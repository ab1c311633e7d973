"""What each publisher and server on the graph is: asked by a TCPROS handshake, of which no message is read."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bridge.adapters.ros1.deadline import DeadlineSocket
from bridge.adapters.ros1.errors import Ros1Error, UnreachableError
from bridge.adapters.ros1.graph import Link
from bridge.adapters.ros1.handshake import ORIGIN_FIELD, Header, connect
from bridge.adapters.ros1.lanes import Lanes

_log = logging.getLogger(__name__)

HANDSHAKE_SECONDS = 2.0
_FIRST_WAIT = 0.5
_LONGEST_WAIT = 10.0


@dataclass(frozen=True, slots=True)
class Facts:
    """What a publisher or server says of itself in its connection header."""

    type: str
    md5: str
    definition: str
    latching: bool
    native: bool

    @classmethod
    def of(cls, header: Header) -> Facts:
        """The facts in a header."""
        return cls(
            header["type"],
            header["md5sum"],
            header.get("message_definition", ""),
            header.get("latching", "0").strip() == "1",
            ORIGIN_FIELD not in header,
        )


@dataclass(slots=True)
class _Attempt:
    """How asking one goes: when next, and what went wrong; ``refused``: nobody listens there."""

    due: float = 0.0
    wait: float = _FIRST_WAIT
    under_way: bool = False
    trouble: str = ""
    refused: bool = False


Handshake = Callable[[str, str, str, float], tuple[DeadlineSocket, Header]]
"""``handshake(caller, uri, topic, seconds)``: connect, up to and with the peer's header; raises `Ros1Error`."""


class Prober:
    """Asks every new publisher (or server) once, and those that do not answer again and again, ever more seldom.

    Args:
        lanes: threads for conversations.
        caller: our node's name now.
        changed: called with each one of which something else is known by now.
        handshake: how they are asked.
        kind: what they are called.
    """

    def __init__(
        self,
        lanes: Lanes,
        caller: Callable[[], str],
        changed: Callable[[Link], None],
        handshake: Handshake = connect,
        kind: str = "publisher",
    ) -> None:
        self._lanes, self._caller, self._changed = lanes, caller, changed
        self._handshake, self._kind = handshake, kind
        self._lock = threading.Lock()
        self._facts: dict[Link, Facts] = {}
        self._open: dict[Link, _Attempt] = {}

    def follow(self, links: frozenset[Link]) -> None:
        """Take up the publishers that are on the graph now, and ask those whose turn it is."""
        now = time.monotonic()
        with self._lock:
            for gone in self._facts.keys() - links:
                del self._facts[gone]
            for gone in self._open.keys() - links:
                del self._open[gone]
            for new in links - self._facts.keys() - self._open.keys():
                self._open[new] = _Attempt()
            due = [link for link, a in self._open.items() if link.uri and not a.under_way and a.due <= now]
            for link in due:
                self._open[link].under_way = True
        for link in due:
            self._lanes.submit(link.uri, lambda link=link: self._probe(link))  # type: ignore[misc]

    @property
    def waiting(self) -> bool:
        """Whether there are publishers of which nothing is known."""
        return bool(self._open)

    def facts(self, topic: str = "") -> Mapping[Link, Facts]:
        """What is known now, of one topic where one is given."""
        with self._lock:
            return {link: facts for link, facts in self._facts.items() if topic in ("", link.topic)}

    def doubt(self, link: Link, trouble: str) -> None:
        """A publisher broke off or turned out different: what is known of it counts no more until it is asked again."""
        with self._lock:
            if self._facts.pop(link, None) is None:
                return
            self._open[link] = _Attempt(due=time.monotonic() + _FIRST_WAIT, trouble=trouble)
        self._changed(link)

    def check(self, link: Link) -> None:
        """Ask one again of which something is known; where it does not answer, it is doubted."""
        self._lanes.submit(link.uri, lambda: self._check(link))

    def _check(self, link: Link) -> None:
        try:
            sock, header = self._shake(link)
        except Ros1Error as err:
            self.doubt(link, str(err))
        else:
            sock.close()
            self.learned(link, Facts.of(header))

    def learned(self, link: Link, facts: Facts) -> None:
        """A publisher said of itself what it is, when a subscription connected to it; it may have advertised anew."""
        with self._lock:
            if self._facts.get(link) in (None, facts):
                return
            self._facts[link] = facts
        self._changed(link)

    def troubles(self) -> dict[Link, str]:
        """Publishers that did not answer, and why."""
        with self._lock:
            return {link: a.trouble for link, a in self._open.items() if a.trouble}

    def is_gone(self, link: Link) -> bool:
        """Whether nobody listened where this one should be, when it was asked."""
        with self._lock:
            attempt = self._open.get(link)
        return attempt is not None and attempt.refused

    def _shake(self, link: Link) -> tuple[DeadlineSocket, Header]:
        # rospy drops an older connection of the same caller, so a probe calls itself otherwise than the node.
        return self._handshake(f"{self._caller()}_probe", link.uri, link.topic, HANDSHAKE_SECONDS)

    def _probe(self, link: Link) -> None:
        try:
            sock, header = self._shake(link)
        except Ros1Error as err:
            if isinstance(err, UnreachableError):
                self._lanes.failed(link.uri)
            self._again(link, str(err), refused=isinstance(err, UnreachableError) and err.refused)
            return
        except Exception as err:
            self._again(link, f"{type(err).__name__}: {err}")
            raise
        with contextlib.closing(sock):
            self._lanes.answered(link.uri)
            with self._lock:
                if self._open.pop(link, None) is None:
                    return
                self._facts[link] = Facts.of(header)
        self._changed(link)

    def _again(self, link: Link, trouble: str, *, refused: bool = False) -> None:
        with self._lock:
            attempt = self._open.get(link)
            if attempt is None:
                return
            if trouble != attempt.trouble:
                _log.info("the %s of %s in %s does not tell its type: %s", self._kind, link.topic, link.node, trouble)
            attempt.trouble, attempt.refused = trouble, refused
            attempt.under_way = False
            attempt.due = time.monotonic() + attempt.wait
            attempt.wait = min(2 * attempt.wait, _LONGEST_WAIT)
