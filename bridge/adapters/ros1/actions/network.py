"""The part of the edge that its actions use."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from bridge.adapters.ros1.actions.discovery import CANCEL_TYPE, STATUS_TYPE
from bridge.adapters.ros1.graph.probe import Facts
from bridge.adapters.ros1.graph.state import Registration
from bridge.clock import RunClock
from bridge.concurrency import InlineExecutor
from bridge.hub.wire.qos import Qos
from bridge.messages.definitions.schema import Schema, World
from bridge.messages.definitions.text import closure, parse_full
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType
from bridge.routing.edge import Deliver, EdgePublisher, EdgeSubscription

_log = logging.getLogger(__name__)


class TopicSubscription(EdgeSubscription, Protocol):
    """A subscription of a ROS 1 topic."""

    @property
    def connected(self) -> frozenset[Registration]:
        """The connected publishers."""

    def unread(self, node: str, uri: str, *, listed: bool) -> bool:
        """Return whether a node may have published a message that is not delivered yet."""


class TopicPublisher(EdgePublisher, Protocol):
    """A publication of a ROS 1 topic."""

    @property
    def subscribers(self) -> Mapping[str, int]:
        """The connected nodes, with the number of each node's connection, which is another one after a reconnection."""


@dataclass(frozen=True, slots=True)
class ActionNetwork:
    """The edge's services for its actions.

    Attributes:
        own: returns this node's name.
        facts: returns the known properties of all publishers.
        registry: the types.
        clock: returns the clock of this side.
        subscribe: ``subscribe(topic, side_type, deliver, suffix)``; a rospy publisher accepts one connection from each
            node name, so a second subscription to a topic that may also be bridged appends a suffix to this node's
            name.
        publish: ``publish(topic, side_type, qos)``.
        refuse: ``refuse(topic, reason, why)`` reports a rejected message; ``reason`` is a keyword such as ``bad``,
            ``why`` the error's text.
        check_frames: whether goals in unknown frames are rejected.
    """

    own: Callable[[], str]
    facts: Callable[[], Mapping[Registration, Facts]]
    registry: Registry
    clock: Callable[[], RunClock]
    subscribe: Callable[[str, SideType, Deliver, str], TopicSubscription]
    publish: Callable[[str, SideType, Qos], TopicPublisher]
    refuse: Callable[[str, str, str], None]
    check_frames: bool


@dataclass(frozen=True, slots=True)
class ActionMessages:
    """The message types of an action: ActionGoal, ActionResult, ActionFeedback, and the two types of actionlib_msgs.

    ``goal_body`` and ``result_body`` are the Goal and the Result without headers.
    """

    goal: SideType
    result: SideType
    feedback: SideType
    cancel: SideType
    status: SideType
    goal_body: Schema
    result_body: Schema


def types_of(registry: Registry, action_type: str) -> ActionMessages:
    """Return the message types of an action; raises `MessageTypeError`."""
    known = registry.ros1_action(action_type)
    return ActionMessages(
        known.goal, known.result, known.feedback, registry.ros1(CANCEL_TYPE), registry.ros1(STATUS_TYPE),
        _body(known.goal, f"{action_type}Goal"), _body(known.result, f"{action_type}Result"),
    )  # fmt: skip


def _body(message: SideType, name: str) -> Schema:
    definitions = parse_full(message.definition, message.name, World.ROS1)
    if name not in definitions:
        raise MessageTypeError(f"{message.name} has no {name}: it is not the message of an action")
    return closure(definitions[name], definitions)


def learn(network: ActionNetwork, topics: Mapping[str, str]) -> None:
    """Learn the types that the publishers of an action's topics announce."""
    for link, facts in network.facts().items():
        if link.topic in topics and facts.type == topics[link.topic] and facts.definition:
            try:
                network.registry.learn_ros1(facts.type, facts.definition, facts.md5)
            except MessageTypeError as err:
                _log.debug("%s of %s: %s", link.topic, link.node, err)


class OpenPart:
    """An open part of an action: a `bridge.routing.edge.EdgeSubscription` or `bridge.routing.edge.EdgeServer`."""

    lost = 0

    def __init__(self, close: Callable[[], None]) -> None:
        self._close: Callable[[], None] | None = close

    def close(self) -> None:
        """Close the part; if it is a service, the action's goals end. Safe to call twice."""
        close, self._close = self._close, None
        if close is not None:
            close()


class ActionTopics:
    """Midspan's ends of the five topics of one action; their events are handled one at a time."""

    def __init__(self, name: str, network: ActionNetwork) -> None:
        self.name, self._network = name, network
        self._executor = InlineExecutor()
        self._lock = threading.Lock()
        self._subscriptions: dict[str, TopicSubscription] = {}
        self._publishers: dict[str, TopicPublisher] = {}
        self._states = b""

    def publish(self, part: str, payload: bytes, source: str = "") -> None:
        """Publish on a topic while it is open; latched messages are retained per source."""
        if part in self._publishers:
            self._publishers[part].send(payload, source)

    def _advertise(self, part: str, side_type: SideType, qos: Qos) -> None:
        self._publishers[part] = self._network.publish(f"{self.name}/{part}", side_type, qos)

    def _subscribe(self, part: str, side_type: SideType, deliver: Deliver) -> None:
        self._subscriptions[part] = self._network.subscribe(f"{self.name}/{part}", side_type, deliver, "")

    def _close_topics(self) -> None:
        ends: list[EdgeSubscription | EdgePublisher] = [*self._subscriptions.values(), *self._publishers.values()]
        for end in ends:
            end.close()
        self._subscriptions, self._publishers = {}, {}

    def _read(self, part: str, read: Callable[[], None]) -> None:
        try:
            read()
        except ConversionError as err:
            self._network.refuse(f"{self.name}/{part}", "bad", str(err))


# -- publications for actionlib servers --------------------------------------------------------------------------------
# The master does not announce new subscribers. But an actionlib server subscribes to its goals and cancel requests last
# (``ActionServer.initialize`` of actionlib, in C++ and in Python), and then connects to their publishers at once. If
# Midspan still publishes these topics, the connection shows that a restarted server is complete.

KEPT_SECONDS = 60.0
"""How long a publication lingers. A server that starts later is discovered by the regular polling of the master."""

_MOST = 100
"""Maximum number of lingering publications; beyond it, those released first are closed."""

Publish = Callable[[str, SideType, Qos], TopicPublisher]


class LingeringPublishers:
    """Opens publications, and closes released ones, at once if a server is present, else after `KEPT_SECONDS`.

    ``publish`` opens a publication; ``is_gone`` returns whether an action currently has no server.
    """

    def __init__(self, publish: Publish, is_gone: Callable[[str], bool]) -> None:
        self._publish, self._is_gone = publish, is_gone
        self._lock = threading.Lock()
        self._open: dict[str, _LentPublisher] = {}
        """The publications by topic; those that were released are in the order of their release."""

    def publish(self, topic: str, side_type: SideType, qos: Qos) -> TopicPublisher:
        """Publish on a topic, reusing a lingering publication of the same type."""
        with self._lock:
            kept = self._open.pop(topic, None)
            if kept is not None and kept.type_id != side_type.type_id:  # a node has one type per topic
                kept.publisher.close()
                kept = None
            publisher = kept.publisher if kept is not None else self._publish(topic, side_type, qos)
            lent = self._open[topic] = _LentPublisher(topic, side_type.type_id, publisher, self._give_back)
        return lent

    def __contains__(self, topic: str) -> bool:
        """Return whether a topic is published here, for a server that is present or expected to return."""
        return topic in self._open

    def tidy(self) -> None:
        """Close publications that have lingered long enough; called periodically."""
        if self._open:
            now = time.monotonic()
            with self._lock:
                self._close([m for m in self._open.values() if m.until <= now])

    def close(self) -> None:
        with self._lock:
            self._close([m for m in self._open.values() if m.until < math.inf])

    def _give_back(self, lent: _LentPublisher) -> None:
        absent = self._is_gone(lent.topic.rpartition("/")[0])
        with self._lock:
            if self._open.get(lent.topic) is not lent or lent.until < math.inf:
                return
            del self._open[lent.topic]
            if not absent:
                lent.publisher.close()
                return
            lent.until = time.monotonic() + KEPT_SECONDS
            self._open[lent.topic] = lent
            kept = [m for m in self._open.values() if m.until < math.inf]
            self._close(kept[:-_MOST])

    def _close(self, kept: list[_LentPublisher]) -> None:
        for lent in kept:
            del self._open[lent.topic]
            lent.publisher.close()


@dataclass(eq=False, slots=True)
class _LentPublisher:
    """A publication in use, or one that lingers ``until`` a monotonic time."""

    topic: str
    type_id: str
    publisher: TopicPublisher
    give_back: Callable[[_LentPublisher], None]
    until: float = math.inf

    @property
    def subscribers(self) -> Mapping[str, int]:
        return self.publisher.subscribers

    @property
    def dropped(self) -> int:
        return self.publisher.dropped

    @property
    def has_subscribers(self) -> bool:
        return self.publisher.has_subscribers

    def send(self, payload: bytes, source: str) -> None:
        self.publisher.send(payload, source)

    def drop_source(self, source: str) -> None:
        self.publisher.drop_source(source)

    def close(self) -> None:
        self.give_back(self)
