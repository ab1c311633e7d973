"""Prompts subscribers to connect to this node: those that the master lists, but that have missed a publication.

rospy ignores a publisher that the master reports while it still has an earlier connection to the same node. It reads
the end of a connection only after the callback for the last message has returned, and does not connect again then.
Neither rospy nor roscpp retries a ``requestTopic`` that a publisher rejects, for example just before it advertises.

A topic's subscribers are prompted by registering its publisher once more: the master then reports the publishers to
all of them, and those that are connected do nothing (``Subscription::pubUpdate`` of roscpp, ``_connect_topic`` of
rospy; both 1.15). The topic is not unregistered first, since roscpp would disconnect. This node does not call the
subscriber's ``publisherUpdate`` itself: its list could arrive after a newer one of the master, and roscpp would
disconnect from a publisher that has just registered.

``rosmaster`` calls nodes on three threads, without a deadline. So a subscriber is prompted only after its node has
answered this one.

Not cured: rospy keeps a connection whose header it could not read before the publication ended, and ignores the
publisher from then on; see ``TopicBook.admit``.
"""

from __future__ import annotations

import logging
import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice

from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1_peers import RefusedError, Ros1Error, UnreachableError, ask
from bridge.concurrency import Backoff

_log = logging.getLogger(__name__)

FIRST, LONGEST = 1.0, 30.0
"""Seconds after which a subscriber without a connection is prompted, and the longest pause between its prompts."""

_SECONDS = 2.0
"""Time for the node's answer."""

_MOST = 50
"""Maximum number of subscribers that fall due at one read of the master; the others wait for the next read."""


@dataclass(slots=True)
class _Prompt:
    """The next prompt of one subscriber, due at a monotonic time."""

    pauses: Backoff = field(default_factory=lambda: Backoff(FIRST, LONGEST))
    due: float = 0.0

    def postpone(self, now: float) -> None:
        self.due = now + self.pauses.pause(0.0)


class Prompts:
    """Selects the topics whose subscribers are to be prompted.

    ``caller`` returns this node's name; ``answered`` is called on a thread of the pool when a subscriber can be
    prompted.
    """

    def __init__(self, pool: PeerPool, caller: Callable[[], str], answered: Callable[[], None]) -> None:
        self._pool, self._caller, self._answered = pool, caller, answered
        self._lock = threading.Lock()
        self._prompts: dict[Registration, _Prompt] = {}
        self._asked: set[str] = set()
        self._responsive: set[Registration] = set()

    def topics(self, unconnected: frozenset[Registration], now: float) -> set[str]:
        """Return the topics to register again, given all subscribers that are not connected; never blocks."""
        due: defaultdict[str, set[Registration]] = defaultdict(set)
        with self._lock:
            for link in self._prompts.keys() - unconnected:
                del self._prompts[link]
            for link in unconnected - self._prompts.keys():
                self._prompts[link] = prompt = _Prompt()
                prompt.postpone(now)
            ready = (k for k, prompt in self._prompts.items() if prompt.due <= now and k.uri not in self._asked)
            for link in islice(ready, _MOST):
                self._prompts[link].postpone(now)
                due[link.uri].add(link)
            self._asked |= due.keys()
            responsive, self._responsive = self._responsive & unconnected, set()
        for uri, links in due.items():
            self._pool.submit(uri, lambda uri=uri, links=links: self._ask(uri, links))  # type: ignore[misc]
        for link in responsive:
            _log.debug("%s: prompting %s, which is not connected", link.topic, link.node)
        return {link.topic for link in responsive}

    def _ask(self, uri: str, links: set[Registration]) -> None:
        responds = False
        try:
            responds = self._responds(uri)
        finally:
            with self._lock:
                self._asked.discard(uri)
                if responds:
                    self._responsive |= links
        if responds:
            self._answered()

    def _responds(self, uri: str) -> bool:
        try:
            ask(uri, _SECONDS, "getPid", self._caller())
        except RefusedError:  # it has no such method
            pass
        except Ros1Error as err:
            if isinstance(err, UnreachableError):
                self._pool.failed(uri)
            return False
        self._pool.answered(uri)
        return True
