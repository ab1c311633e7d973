"""The messages of several bags in order of time, and the latched messages at the start."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bridge.bags.bag import Bag, BagError, BagTopic
from bridge.bags.play.topics import PlayTopic
from bridge.messages.errors import ConversionError
from bridge.routing.rewrites import StaticTransforms

MAX_LATCHED = 100
"""Maximum number of messages from before the start that are replayed for a latched topic."""

MAX_LATCHED_BYTES = 64 << 20
"""Maximum bytes of the latched messages from before the start; messages of further topics are skipped."""

_NS = 1e9


@dataclass(frozen=True)
class PlayPart:
    """The part to play: from ``start`` seconds after the first bag's start, for ``duration`` seconds or to the end."""

    start: float = 0.0
    duration: float | None = None


class PlayMessage(NamedTuple):
    """A message: ``data`` in the bag's serialization, or CDR if ``ready``."""

    topic: PlayTopic
    time_ns: int
    data: bytes
    ready: bool = False


class PlaySource:
    """The messages to play, which can be read repeatedly.

    Attributes:
        begin_ns: the start, on the bags' clock.
        end_ns: the end, on the bags' clock.
        bad: messages of `kept` that could not be converted, with the reason; cleared by the player.
        troubles: other problems found by `kept`.

    Raises:
        BagError: the bags have no messages, or the part starts after the last one.
    """

    def __init__(self, bags: Mapping[Bag, Sequence[PlayTopic]], part: PlayPart) -> None:
        self._bags = bags
        spans = [(bag.start_ns, bag.end_ns) for bag in bags if bag.end_ns]
        if not spans:
            raise BagError(next(iter(bags)).path, "has no messages")
        first, last = min(start for start, _ in spans), max(end for _, end in spans)
        self.begin_ns = first + int(part.start * _NS)
        if self.begin_ns > last:
            raise BagError(next(iter(bags)).path, f"has {(last - first) / _NS:.1f} s, but --start is {part.start:g}")
        self.end_ns = last if part.duration is None else min(last, self.begin_ns + int(part.duration * _NS))
        self.bad: list[tuple[PlayTopic, str]] = []
        self.troubles: list[str] = []
        self._kept: list[PlayMessage] | None = None

    def kept(self) -> list[PlayMessage]:
        """Return the latched messages at the part's start, and all static transforms of the bags, merged."""
        if self._kept is None:
            self._kept = [*self._static(), *self._latched()]
        return self._kept

    def messages(self) -> Iterator[PlayMessage]:
        """Yield the other messages of the part, in order of time."""
        return self._merged(lambda topic: not topic.static, self.begin_ns, self.end_ns + 1)

    def _static(self) -> Iterator[PlayMessage]:
        merged: dict[tuple[str, str], tuple[PlayTopic, StaticTransforms, bytes]] = {}
        for topic, _, data, _ in self._selected(lambda topic: topic.static, None):
            key = topic.name, topic.type_hash
            first, transforms, before = merged.get(key, (topic, StaticTransforms(), b""))
            try:
                before = transforms.merge(topic.convert(data) if topic.convert else data)
            except (ConversionError, ValueError) as err:
                self.bad.append((topic, str(err)))
            merged[key] = first, transforms, before
        for topic, _, data in merged.values():
            if data:
                yield PlayMessage(topic, self.begin_ns, data, ready=True)

    def _latched(self) -> Iterator[PlayMessage]:
        """Yield the latched messages from before the start."""
        if all(bag.start_ns >= self.begin_ns for bag in self._bags):
            return
        latched: dict[PlayTopic, deque[PlayMessage]] = {}
        for message in self._selected(lambda topic: topic.qos.latched and not topic.static, self.begin_ns):
            depth = min(max(message.topic.qos.depth, 1), MAX_LATCHED)
            latched.setdefault(message.topic, deque(maxlen=depth)).append(message)
        size = 0
        for messages in latched.values():
            size += sum(len(message.data) for message in messages)
            if size > MAX_LATCHED_BYTES:
                return
            yield from messages

    def _selected(self, wanted: Callable[[PlayTopic], bool], end_ns: int | None) -> Iterator[PlayMessage]:
        """Yield all messages of the ``wanted`` topics before ``end_ns``; stop reading the bags after the last one."""
        left = sum(topic.topic.count for topics in self._bags.values() for topic in topics if wanted(topic))
        if not left:
            return
        try:
            for message in self._merged(wanted, None, end_ns):
                yield message
                left -= 1
                if not left:
                    return
        except BagError as err:  # messages before the damage are played nevertheless
            self.troubles.append(str(err))

    def _merged(
        self, wanted: Callable[[PlayTopic], bool], start_ns: int | None, end_ns: int | None
    ) -> Iterator[PlayMessage]:  # fmt: skip
        streams = []
        for bag, topics in self._bags.items():
            chosen = {topic.topic: topic for topic in topics if wanted(topic)}
            if chosen:
                streams.append(_messages(bag, chosen, start_ns, end_ns))
        return heapq.merge(*streams, key=lambda message: message.time_ns)


def _messages(
    bag: Bag, topics: Mapping[BagTopic, PlayTopic], start_ns: int | None, end_ns: int | None
) -> Iterator[PlayMessage]:  # fmt: skip
    for message in bag.messages(list(topics), start_ns, end_ns):
        yield PlayMessage(topics[message.topic], message.time_ns, message.data)
