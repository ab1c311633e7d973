"""A subscription to a latched topic, which also requests the samples that the topic's publishers cache."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import zenoh
from typing_extensions import override

from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.latched import HistoryListener, LatchedHistory
from bridge.hub.endpoints.sinks import cache_depth
from bridge.hub.endpoints.subscription import MAX_HELD_BYTES, HubSample, HubSubscription, PublisherState, Refused
from bridge.hub.endpoints.variants import Convert, ConvertedSample
from bridge.hub.wire.qos import Qos, Reliability
from bridge.messages.unchanged import same

_MAX_HELD = 1000
"""Maximum number of held samples of one publisher, in addition to its history."""


class _OtherHistory:
    """Converts and passes on a history whose samples are of another version of the type."""

    def __init__(self, subscription: LatchedHubSubscription, convert: Convert) -> None:
        self._convert, self._on_other, self._receive = convert, subscription._on_other, subscription.on_stored
        self.on_query, self.done = subscription.on_query, subscription.done

    def on_stored(self, sample: zenoh.Sample) -> None:
        self._on_other(self._convert, self._receive, sample)


class LatchedHubSubscription(HubSubscription):
    """Receives one latched topic.

    With a depth above 1, live samples of a session are held while it is queried for its cached samples, so that the
    history is delivered first. A publisher is then also queried if the first live sample received from it is not its
    first, and, if the subscription is reliable, after each gap in its samples, or after the query that ran meanwhile.

    ``_lock`` also guards the counts of unfinished queries. It is held during the callback, to preserve the order.
    """

    why = "a latched topic"

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        topic: str,
        qos: Qos,
        callback: Callable[[HubSample], None],
        on_refused: Refused | None = None,
        *,
        exact: bool = False,
    ) -> None:
        self._depth = cache_depth(qos)
        self._recovers = qos.reliability is Reliability.RELIABLE
        self._asked: Counter[str] = Counter()  # by session
        self._histories: tuple[LatchedHistory, ...] = ()  # one for each key
        super().__init__(context, token, key, topic, callback, on_refused, exact=exact)

    @override
    def _declare(self, context: EndpointContext, key: str) -> Callable[[], None]:
        return self._with_history(context, key, super()._declare(context, key))

    @override
    def _declare_more(self, context: EndpointContext, key: str, convert: Convert) -> Callable[[], None]:
        listener = self if convert is same else _OtherHistory(self, convert)
        return self._with_history(context, key, super()._declare_more(context, key, convert), listener)

    def _with_history(
        self, context: EndpointContext, key: str, end: Callable[[], None], listener: HistoryListener | None = None
    ) -> Callable[[], None]:
        history = LatchedHistory(
            context.session, key, self._depth, listener or self, context.asking, context.ends, context.delays,
            reach=context.reach, recovers=self._recovers,
        )  # fmt: skip
        self._histories += (history,)
        history.open()

        def undeclare_all() -> None:
            end()
            history.close()
            self._histories = tuple(other for other in self._histories if other is not history)

        return undeclare_all

    def _read(self, sample: zenoh.Sample | ConvertedSample) -> HubSample | None:
        message = self._reader.read(sample)
        if message is not None:
            for history in self._histories:
                history.on_sample(sample.source_info)
        return message

    @override
    def _on_sample(self, sample: zenoh.Sample | ConvertedSample) -> None:
        message = self._read(sample)
        if message is None:
            return
        with self._lock:
            source = self.sources.of(message, sample)
            zid, gap = source.zid, source.gap(message)
            if gap is None:
                return
            # with a history of one, only the newest sample matters
            deep = self._depth > 1 and len(source.held) < self._depth + _MAX_HELD
            # a live sample may arrive before its publisher's token, which triggers the query
            past = gap > 0 if source.sequence is not None else message.sequence > 1
            missing = deep and past and bool(zid) and (self._recovers or source.sequence is None)
            if not ((missing or (deep and self._asked[zid])) and self.sources.hold(source, message)):
                self._release(source)
                self._deliver(source, message)
            missing = missing and not self._asked[zid]
            if missing:
                source.queried = message.sequence
        if missing:
            self._ask(zid)

    def _ask(self, zid: str) -> None:
        for history in self._histories:
            history.ask_session(zid)

    @override
    def request_again(self, gid: bytes, zid: str, forget: Callable[[], None]) -> None:
        with self._lock:
            forget()
            # a publisher that has sent nothing under its own GID may invent GIDs, as that of zenoh-ros2-sdk
            invented = [g for g, source in self.sources.items() if source.zid == zid and not self._graph.zid_of(g)]
            for departed in [gid] if gid in self.sources else invented:
                self.sources.pop_all_held(self.sources.pop(departed))
        self._ask(zid)

    def on_query(self, zid: str) -> None:
        """Handle the start of a query for the samples that a session's publishers cache; see `LatchedHistory`."""
        with self._lock:
            self._asked[zid] += 1

    def on_stored(self, sample: zenoh.Sample | ConvertedSample) -> None:
        """Handle one of the samples that a publisher caches; see `LatchedHistory`."""
        message = self._read(sample)
        if message is None:
            return
        with self._lock:
            source = self.sources.of(message, sample)
            if source.gap(message) is None:
                return
            if not self.sources.hold(source, message):
                self._reader.refuse("large", f"more than {MAX_HELD_BYTES} bytes are stored for late joiners")

    def done(self, zid: str) -> None:
        """Handle the end of a query; see `LatchedHistory`."""
        again = False
        with self._lock:
            self._asked[zid] -= 1
            if self._asked[zid] > 0:
                return
            del self._asked[zid]
            for source in self.sources.values():
                if not source.held or self._asked[source.zid]:
                    continue
                # samples that were lost during the query may be missing from its answer
                gap = _newest_gap(source) if self._recovers and source.zid == zid else 0
                if gap > source.queried:
                    source.queried, again = gap, True
                else:
                    self._release(source)
        if again:
            self._ask(zid)

    def _release(self, source: PublisherState) -> None:
        if source.held:
            for message in self.sources.pop_all_held(source):
                self._deliver(source, message)

    def _deliver(self, source: PublisherState, message: HubSample) -> None:
        gap = None if self._reader.closed else source.accept(message)
        if gap is not None:
            if gap:
                self._losses.add(gap, message)
            self._callback(message)


def _newest_gap(source: PublisherState) -> int:
    """Return the number of the newest held sample that follows a gap, 0 if there is none."""
    if source.sparse or not source.held:
        return 0
    last = min(source.held) - 1 if source.sequence is None else source.sequence
    return max((number for number in source.held if number - 1 != last and number - 1 not in source.held), default=0)
