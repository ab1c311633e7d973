"""The output of a play on the hub: its publishers, its clock, and the zero velocities that stop the robot."""

from __future__ import annotations

import struct
import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from bridge.bags.play.topics import PlayTopic
from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE
from bridge.concurrency import DelayedCalls
from bridge.hub.definitions import VERB
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.errors import HubClosedError, HubError
from bridge.hub.graph import HubEndpoint
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.json import from_json
from bridge.messages.registry import Registry

_CLOCK = struct.Struct("<4siI")
_LITTLE = b"\x00\x01\x00\x00"
_POLL_SECONDS = 0.02
_ZEROS, _STOP_PERIOD = 7, 0.1
"""How often zero velocity is repeated, and the period in seconds: a worker that was starved for a moment drops commands
for half a second. The zeros are counted, because a stall of the whole machine delays this process, too."""

_STOP_SECONDS = 5.0
"""Seconds to wait for the last zero velocity before the publishers are closed."""

_NS = 1_000_000_000

_Key = tuple[str, str, str, Qos]


class HubOutput:
    """Publishers of all topics to play, with their recorded QoS. Safe to use from any thread.

    Topics of the same name, type and QoS, from several publishers or files, share one publisher; for latched topics,
    its depth is at least the number of the topics.
    """

    def __init__(self, hub: Hub, registry: Registry, topics: Sequence[PlayTopic], *, clock: bool = False) -> None:
        self._hub = hub
        self._definitions = {t.type_name: (t.type_hash, t.definition) for t in topics if t.definition}
        self._publishers: dict[_Key, HubPublisher] = {}
        self._ends: dict[PlayTopic, HubPublisher] = {}
        latched = Counter(_key(topic) for topic in topics if topic.qos.latched and not topic.static)
        for topic in topics:
            self._ends[topic] = self._create(topic, latched[_key(topic)])
        self._zeros = {t: from_json(registry, t.type_name, {}) for t in topics if t.velocity}
        self._lock = threading.Lock()
        self._moving: dict[HubPublisher, bytes] = {}
        self._stopping: dict[HubPublisher, tuple[bytes, int]] = {}  # zero, and how many times it is still repeated
        self._stopped = threading.Event()
        self._stopped.set()
        self._later = DelayedCalls("play-zero")
        self._finished = False
        self._clock: HubPublisher | None = None
        if clock:
            kind = registry.ros2(CLOCK_TYPE).type_id
            self._clock = hub.publisher(CLOCK_TOPIC, CLOCK_TYPE, kind, Qos(depth=1))
        self._unserve = hub.serve(VERB, self._define)

    def _create(self, topic: PlayTopic, latched: int) -> HubPublisher:
        key = _key(topic)
        if key not in self._publishers:
            qos = replace(topic.qos, depth=max(topic.qos.depth, latched)) if topic.qos.latched else topic.qos
            self._publishers[key] = self._hub.publisher(
                topic.name, topic.type_name, topic.type_hash, qos, priority=topic.priority
            )
        return self._publishers[key]

    def _define(self, params: dict[str, Any]) -> dict[str, Any]:
        """Return the definition of a type to a worker that lacks it; called on a thread of the hub."""
        name = str(params.get("name", ""))
        type_hash, definition = self._definitions.get(name, ("", ""))
        return {"name": name, "hash": type_hash, "definition": definition} if definition else {}

    def put(self, topic: PlayTopic, data: bytes) -> None:
        """Publish CDR; raises `bridge.hub.errors.HubError` if the hub refuses it, or after `finish`."""
        end = self._ends[topic]
        zero = self._zeros.get(topic)
        if zero is None:
            end.put(data)
            return
        with self._lock:
            if self._finished:
                raise HubClosedError("the play has ended")
            self._moving[end] = zero
            self._stopping.pop(end, None)
            end.put(data)

    def clock(self, time_ns: int) -> None:
        """Publish the bag's time on /clock, if that is requested."""
        if self._clock is not None:
            seconds, nanoseconds = divmod(time_ns, _NS)
            self._clock.put(_CLOCK.pack(_LITTLE, seconds, nanoseconds))

    def end_velocities(self) -> bool:
        """Command zero velocity on each topic with a played velocity; return whether there was any.

        It is repeated `_ZEROS` times, unless another velocity is played meanwhile.
        """
        with self._lock:
            moving, self._moving = self._moving, {}
            self._stopping |= {end: (zero, _ZEROS) for end, zero in moving.items()}
            if moving:
                self._stopped.clear()
                self._later.after(_STOP_PERIOD, self._repeat_zeros, once=True)
            for end, zero in moving.items():
                end.put(zero)
        return bool(moving)

    def _repeat_zeros(self) -> None:
        with self._lock:
            for end, (zero, _) in self._stopping.items():
                with suppress(HubError):  # the hub is lost
                    end.put(zero)
            self._stopping = {end: (zero, left - 1) for end, (zero, left) in self._stopping.items() if left > 1}
            if self._stopping:
                self._later.after(_STOP_PERIOD, self._repeat_zeros, once=True)
            else:
                self._stopped.set()

    def finish(self) -> None:
        """Refuse further velocities from a thread that is still playing, and end those that were played."""
        with self._lock:
            self._finished = True
        with suppress(HubError):
            self.end_velocities()

    def others(self) -> dict[str, list[str]]:
        """Return the other nodes that publish the topics to play, by topic."""
        ends: Iterable[HubPublisher] = self._publishers.values()
        names = {end.topic for end in ends} | ({CLOCK_TOPIC} if self._clock is not None else set())
        nodes_of = {
            name: [_node_of(e) for e in self._hub.graph.publishers(name) if not e.own] for name in sorted(names)
        }
        return {name: nodes for name, nodes in nodes_of.items() if nodes}

    def await_listeners(self, appear: float, match: float, ended: threading.Event) -> tuple[list[str], list[str]]:
        """Wait until zenoh has matched the subscribers in the hub's graph.

        The wait ends after ``appear`` seconds if there are none, after ``match`` seconds in any case, or when ``ended``
        is set. Return the topics with subscribers, and those of them that are not matched.
        """
        begin, graph = time.monotonic(), self._hub.graph
        ends = [*self._publishers.values(), *([self._clock] if self._clock is not None else [])]
        while True:
            subscribed = [end for end in ends if any(not s.own for s in graph.subscriptions(end.topic))]
            unmatched = [end.topic for end in subscribed if not end.matched()]
            limit = begin + (match if subscribed else appear)
            if (subscribed and not unmatched) or time.monotonic() >= limit or ended.wait(_POLL_SECONDS):
                return [end.topic for end in subscribed], unmatched

    def close(self) -> None:
        """Close the publishers, after the last zero velocity. Safe to call twice."""
        self._stopped.wait(_STOP_SECONDS)
        self._later.close()
        self._unserve()
        for end in [*self._publishers.values(), *([self._clock] if self._clock is not None else [])]:
            end.close()


def _node_of(end: HubEndpoint) -> str:
    return end.node if end.origin is None else f"{end.node} of {end.origin.side}"


def _key(topic: PlayTopic) -> _Key:
    return topic.name, topic.type_name, topic.type_hash, topic.qos
