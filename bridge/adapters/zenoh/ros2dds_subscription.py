"""A latched subscription in the ros2dds dialect: what publishers keep, and what they say meanwhile, once and in order.

The plugin's transient-local publishers are zenoh's advanced publishers, numbered by time stamps (its
``src/route_publisher.rs``); other programs' may number their samples instead.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

import zenoh

from bridge.adapters.zenoh.inbox import Inbox
from bridge.adapters.zenoh.mark import sender, time_ns
from bridge.adapters.zenoh.subscription import KeySubscription
from bridge.hub.errands import Errands
from bridge.hub.history import History

_MAX_HELD = 1000
_MAX_PUBLISHERS = 4096


class LatchedSubscription(KeySubscription):
    """Hears live samples, and asks each publisher once for what it keeps.

    Args:
        depth: how many of the samples that were kept count, for the source with this id.
        wanted: samples that each publisher is asked for.
        errands: where what may wait for zenoh is done.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        inbox: Inbox,
        source_of: Callable[[zenoh.Sample], str],
        closed: Callable[[KeySubscription], None],
        depth: Callable[[str], int],
        wanted: int,
        errands: Errands,
    ) -> None:
        self._depth = depth
        self._asking = threading.Lock()
        self._asked: Counter[str] = Counter()
        self._kept: dict[str, list[tuple[zenoh.Sample, str]]] = {}
        self._held: dict[str, list[tuple[zenoh.Sample, str]]] = {}
        self._last: dict[tuple[str, str], int] = {}
        super().__init__(session, key, inbox, source_of, closed)
        self._history = History(session, key, wanted, self, errands, recovers=False)
        self._history.open()

    def ask_for(self, wanted: int) -> None:
        """Ask publishers that come from now on for at least so many samples."""
        self._history.depth = max(self._history.depth, wanted)

    def close(self) -> None:
        """Stop delivering. Safe to call twice."""
        if self._open:
            self._history.close()
        super().close()

    def take(self, sample: zenoh.Sample, source: str) -> None:
        """A live sample: it waits while its session is asked."""
        zid = sender(sample)
        with self._asking:
            if self._asked[zid] and len(self._held.get(zid, ())) < _MAX_HELD:
                self._held.setdefault(zid, []).append((sample, source))
            else:
                self._deliver(sample, source)

    # -- see `bridge.hub.history.Listener` -----------------------------------------------------------------------------

    def asked(self, zid: str) -> None:
        """A session's publishers were asked."""
        with self._asking:
            self._asked[zid] += 1

    def came(self, sample: zenoh.Sample) -> None:
        """One of the samples that a publisher keeps."""
        source = self.native(sample)
        if source:
            with self._asking:
                self._kept.setdefault(sender(sample), []).append((sample, source))

    def done(self, zid: str) -> None:
        """All that was asked of a session has come."""
        with self._asking:
            self._asked[zid] -= 1
            if self._asked[zid] > 0:
                return
            del self._asked[zid]
            by_source: dict[str, list[tuple[zenoh.Sample, str]]] = {}
            for entry in sorted(self._kept.pop(zid, []), key=lambda entry: _order(entry[0])):
                by_source.setdefault(entry[1], []).append(entry)
            for source, entries in by_source.items():
                for entry in entries[-self._depth(source) :]:
                    self._deliver(*entry)
            for entry in self._held.pop(zid, []):
                self._deliver(*entry)

    def _deliver(self, sample: zenoh.Sample, source: str) -> None:
        info = sample.source_info
        publisher = sender(sample), "" if info is None else str(info.source_id.eid)
        order = _order(sample)
        if order and order <= self._last.get(publisher, 0):
            return  # it came both ways
        if len(self._last) >= _MAX_PUBLISHERS:
            del self._last[next(iter(self._last))]
        self._last[publisher] = order
        super().take(sample, source)


def _order(sample: zenoh.Sample) -> int:
    """What grows from sample to sample of one publisher; 0 where nothing does."""
    stamp, info = time_ns(sample), sample.source_info
    return stamp if stamp is not None else 0 if info is None else info.source_sn + 1
