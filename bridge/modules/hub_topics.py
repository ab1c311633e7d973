"""All topics of the hub, and the messages of chosen ones as bytes: for those that keep or show whatever there is.

`HubTopics` tells which topics there are, with all publishers, and hears those that are asked for: CDR as it came, with
the attachment's number, source time and publisher. Nobody builds message objects here.

What waits for its turn, and how much of it, is for the one who hears: `heard` is called on zenoh's threads.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from threading import Event, Lock
from typing import NamedTuple

from bridge.concurrency import SerialExecutor
from bridge.hub.definitions import VERB, definition_among
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.errors import HubError
from bridge.hub.graph import HubEndpoint, origin_side
from bridge.hub.graph.tokens import TAPS, Origin
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.definitions.text import full_text
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.routing.limits import combined_qos

_log = logging.getLogger(__name__)

ASK_AGAIN_SECONDS = 10.0
"""After so long the workers are asked again for a definition that nobody had."""

_ASK_SECONDS = 2.0
_LATCHED_DEPTH = 1000
"""Samples of each latched publisher that are asked for at most; one that keeps fewer gives fewer."""

_MAX_SEEN = 4096
_MAX_ASKED = 10_000


class TopicKey(NamedTuple):
    """What tells topics apart: one name may carry several types, and a type several versions."""

    topic: str
    type_name: str
    """As ROS 2 spells it, ``std_msgs/msg/String``."""
    type_hash: str


@dataclass(frozen=True, slots=True)
class HubTopic:
    """A topic as it is published on the hub now.

    Attributes:
        publishers: all but those of this very session, in the order in which they came; at least one.
    """

    key: TopicKey
    publishers: tuple[HubEndpoint, ...]

    @property
    def sides(self) -> tuple[str, ...]:
        """The sides that it comes from, sorted; ``zenoh`` for native participants of the hub."""
        return tuple(sorted({origin_side(publisher) for publisher in self.publishers}))

    @property
    def latched(self) -> bool:
        """Whether a publisher keeps messages for late joiners."""
        return any(publisher.qos.latched for publisher in self.publishers)


def published(endpoints: Iterable[HubEndpoint], *, taps: bool = False) -> dict[TopicKey, HubTopic]:
    """The topics of these publishers.

    Args:
        endpoints: publishers on the hub.
        taps: also what workers show of a side to those who ask for it (`bridge.hub.graph.tokens.TAPS`).
    """
    found: dict[TopicKey, list[HubEndpoint]] = {}
    for endpoint in endpoints:
        # one that is pending is told again once its origin is known
        if not (endpoint.own or endpoint.pending) and (taps or not endpoint.topic.startswith(TAPS)):
            found.setdefault(TopicKey(endpoint.topic, endpoint.type_name, endpoint.type_hash), []).append(endpoint)
    return {key: HubTopic(key, tuple(publishers)) for key, publishers in found.items()}


class HeardTopic:
    """A topic that is heard; made by `HubTopics.hear`, renewed by `HubTopics.look`.

    Once a publisher keeps messages for late joiners they come too, each once. Messages of one publisher come in order,
    but for what it kept from before, where it appeared beside others that keep nothing.

    Attributes:
        key: which one.
        trouble: why it cannot be heard, "" where it can.
    """

    def __init__(self, hub: Hub, key: TopicKey, heard: Callable[[HubSample], None]) -> None:
        self.key, self.trouble = key, ""
        self._hub, self._heard = hub, heard
        self._lock, self._renewing = Lock(), Lock()
        self._seen: dict[bytes, tuple[int, int]] = {}
        self._ends: list[HubSubscription] = []
        self._latched = False
        self._closed = False
        self._lost = self._refused = 0

    @property
    def lost(self) -> int:
        """Messages that publishers numbered and that never came."""
        return self._lost + sum(end.lost for end in self._ends)

    @property
    def refused(self) -> int:
        """Messages that the hub left out: too large, or without the attachment that rmw_zenoh puts on each."""
        return self._refused + sum(end.refused for end in self._ends)

    def renew(self, publishers: Iterable[HubEndpoint]) -> None:
        """Subscribe as these publishers need it; where it is done already, nothing."""
        with self._renewing:
            self._renew(combined_qos([publisher.qos for publisher in publishers]))

    def _renew(self, qos: Qos) -> None:
        if self._closed or (self._ends and (self._latched or not qos.latched)):
            return
        # of one that is latched from the start nothing comes twice
        take = self._heard if qos.latched and not self._ends else self._take
        if qos.latched:
            qos = Qos(qos.reliability, Durability.TRANSIENT_LOCAL, depth=_LATCHED_DEPTH)
        try:
            end = self._hub.subscription(*self.key, qos, take)
        except HubError as err:
            self.trouble = str(err)
            return
        before, self._ends, self._latched, self.trouble = self._ends, [end], qos.latched, ""
        self._leave(before)  # only now, so that nothing is missed; what comes twice is left out by `_take`

    def _take(self, sample: HubSample) -> None:
        if self._is_new(sample):
            self._heard(sample)

    def _is_new(self, sample: HubSample) -> bool:
        number = sample.sequence
        with self._lock:
            first, last = self._seen.get(sample.gid, (number, number - 1))
            if first <= number <= last:
                return False
            self._seen[sample.gid] = min(first, number), max(last, number)
            if len(self._seen) > _MAX_SEEN:
                del self._seen[next(iter(self._seen))]
        return True

    def close(self) -> None:
        """Hear no more. Safe to call twice."""
        with self._renewing:
            self._closed = True
            self._leave(self._ends)
            self._ends = []

    def _leave(self, ends: list[HubSubscription]) -> None:
        for end in ends:
            end.close()
            self._lost += end.lost
            self._refused += end.refused


@dataclass(slots=True)
class _Asked:
    """A question for a definition; ``since`` in monotonic seconds."""

    since: float
    answered: Event = field(default_factory=Event)


class Definitions:
    """Full definitions of types by their very hash: of those installed here, and of those that the workers know.

    Safe to use from any thread. A thread of its own asks.
    """

    def __init__(self, hub: Hub, registry: Registry) -> None:
        self._hub, self._registry = hub, registry
        self._executor = SerialExecutor("hub-definitions")
        self._lock = Lock()
        self._found: dict[tuple[str, str], str] = {}
        self._asked: dict[tuple[str, str], _Asked] = {}

    def find(self, type_name: str, type_hash: str, seconds: float = 0.0) -> str | None:
        """A type's definition, its own first, then those that it nests (the form of ``ros2msg``).

        Args:
            type_name: as ROS 2 spells it.
            type_hash: of the very version.
            seconds: how long to wait for the workers' answer where it is not installed.

        Returns:
            None where nobody has told it by then; the workers are asked, and are asked again later.
        """
        key = type_name, type_hash
        found = self._found.get(key)
        if found is not None:
            return found
        if (found := self._look(key)) is not None:
            return found
        asked = self._ask(key)
        if seconds > 0.0 and asked.answered.wait(seconds):
            return self._found.get(key)
        return None

    def _look(self, key: tuple[str, str]) -> str | None:
        try:
            text = full_text(self._registry.schema(*key))
        except MessageTypeError:
            return None
        self._found[key] = text
        return text

    def _ask(self, key: tuple[str, str]) -> _Asked:
        now = time.monotonic()
        with self._lock:
            asked = self._asked.get(key)
            if asked is None or (asked.answered.is_set() and now - asked.since > ASK_AGAIN_SECONDS):
                if len(self._asked) > _MAX_ASKED:
                    self._asked.clear()
                asked = self._asked[key] = _Asked(now)
                self._executor.submit(partial(self._learn, key, asked))
        return asked

    def _learn(self, key: tuple[str, str], asked: _Asked) -> None:
        try:
            answers = self._hub.ask(VERB, {"name": key[0]}, timeout=_ASK_SECONDS)
            definition = definition_among(answers, key[1])
            if definition is not None:
                self._registry.learn_ros2(key[0], definition)
                self._look(key)
        except (HubError, MessageTypeError) as err:
            _log.warning("the definition of %s: %s", key[0], err)
        finally:
            asked.answered.set()

    def close(self) -> None:
        """Ask no more."""
        self._executor.close()


class HubTopics:
    """The hub's topics, and those of them that are heard. Safe to use from any thread.

    Args:
        hub: the session; it stays open.
        registry: of types.
        changed: called after each change of the hub's graph, on a thread of zenoh: it only wakes a thread, which then
            calls `look`.
        taps: whether what workers show of a side to those who ask for it counts, too.

    Attributes:
        definitions: of the topics' types.
    """

    def __init__(
        self, hub: Hub, registry: Registry, changed: Callable[[], None] | None = None, *, taps: bool = False
    ) -> None:
        self._hub, self._taps = hub, taps
        self._lock = threading.RLock()
        self._heard: dict[TopicKey, HeardTopic] = {}
        self.definitions = Definitions(hub, registry)
        self._watch = hub.graph.watch(changed) if changed is not None else None

    def look(self) -> dict[TopicKey, HubTopic]:
        """The topics that are published now; those that are heard are heard as their publishers need it."""
        found = published(self._hub.graph.publishers(), taps=self._taps)
        with self._lock:
            heard = list(self._heard.values())
        for topic in heard:
            if topic.key in found:
                topic.renew(found[topic.key].publishers)
        return found

    def hear(self, topic: HubTopic, heard: Callable[[HubSample], None]) -> HeardTopic:
        """Hear a topic, until `close` or `unhear`; one that is heard already stays as it is.

        ``heard`` is called on zenoh's threads, several at a time: it keeps what it is given, and wakes. A sample's
        payload may lie in its sender's shared memory, of which there is little: who keeps it keeps a copy
        (`HubSample.data`).
        """
        with self._lock:
            found = self._heard.get(topic.key)
            if found is None:
                found = self._heard[topic.key] = HeardTopic(self._hub, topic.key, heard)
        found.renew(topic.publishers)
        return found

    def unhear(self, key: TopicKey) -> HeardTopic | None:
        """Hear a topic no more; what was heard, with its counts, None where it was not."""
        with self._lock:
            topic = self._heard.pop(key, None)
        if topic is not None:
            topic.close()
        return topic

    def heard(self) -> list[HeardTopic]:
        """The topics that are heard."""
        with self._lock:
            return list(self._heard.values())

    def publisher(self, gid: bytes) -> HubEndpoint | None:
        """The publisher of a sample, None where it is gone or not known yet; to be kept, not to be asked each time."""
        return self._hub.graph.endpoint(gid)

    def origin(self, sample: HubSample) -> Origin | None:
        """The foreign network that a sample comes from, None for a native participant of the hub. Quick."""
        return self._hub.graph.origin_of(sample.zid)

    def close(self) -> None:
        """Hear nothing more. Safe to call twice."""
        if self._watch is not None:
            self._watch()
        with self._lock:
            topics, self._heard = list(self._heard.values()), {}
        for topic in topics:
            topic.close()
        self.definitions.close()
