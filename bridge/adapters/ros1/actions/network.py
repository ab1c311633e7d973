"""What the actions use of the edge that they belong to."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from bridge.adapters.base import Deliver
from bridge.adapters.ros1.actions.finding import CANCEL_TYPE, STATUS_TYPE
from bridge.adapters.ros1.graph import Link
from bridge.adapters.ros1.probe import Facts
from bridge.clock import RunClock
from bridge.hub.qos import Qos
from bridge.messages.conversion import SideType
from bridge.messages.definition import Schema, World
from bridge.messages.errors import MessageTypeError
from bridge.messages.parser import closure, parse_full
from bridge.messages.registry import Registry

_log = logging.getLogger(__name__)


class Ear(Protocol):
    """A subscription of a ROS 1 topic."""

    @property
    def connected(self) -> frozenset[Link]:
        """The publishers that it hears now."""

    def close(self) -> None:
        """Give it back."""


class Mouth(Protocol):
    """A publication of a ROS 1 topic."""

    @property
    def hearers(self) -> frozenset[str]:
        """The nodes that hear it now."""

    @property
    def dropped(self) -> int:
        """Messages that slow subscribers missed."""

    def send(self, payload: bytes, source: str) -> None:
        """Publish."""

    def forget(self, source: str) -> None:
        """Drop what is retained of a source."""

    def close(self) -> None:
        """Give it back."""


@dataclass(frozen=True, slots=True)
class Network:
    """The edge, as the actions see it.

    Attributes:
        own: our node's name.
        facts: what is known of all publishers.
        registry: the types.
        clock: the time of this side.
        hear: subscribe: ``hear(topic, side_type, deliver, suffix)``; a publisher of rospy's has one connection from
            each name of a node, so who hears a topic that may also cross adds a suffix to ours.
        tell: publish: ``tell(topic, side_type, qos)``.
        refuse: report a bad message: ``refuse(topic, reason, why)``.
        check_frames: goals in frames that are not there are rejected.
    """

    own: Callable[[], str]
    facts: Callable[[], Mapping[Link, Facts]]
    registry: Registry
    clock: Callable[[], RunClock]
    hear: Callable[[str, SideType, Deliver, str], Ear]
    tell: Callable[[str, SideType, Qos], Mouth]
    refuse: Callable[[str, str, str], None]
    check_frames: bool


@dataclass(frozen=True, slots=True)
class ActionTypes:
    """What is known of an action's type.

    Attributes:
        goal: its ActionGoal message; likewise the next two.
        cancel: actionlib_msgs/GoalID.
        status: actionlib_msgs/GoalStatusArray.
        goal_body: the goal itself.
        result_body: the result itself.
    """

    goal: SideType
    result: SideType
    feedback: SideType
    cancel: SideType
    status: SideType
    goal_body: Schema
    result_body: Schema


def types_of(registry: Registry, action_type: str) -> ActionTypes:
    """The messages of an action; raises `MessageTypeError`."""
    known = registry.ros1_action(action_type)
    return ActionTypes(
        known.goal, known.result, known.feedback, registry.ros1(CANCEL_TYPE), registry.ros1(STATUS_TYPE),
        _body(known.goal, f"{action_type}Goal"), _body(known.result, f"{action_type}Result"),
    )  # fmt: skip


def _body(message: SideType, name: str) -> Schema:
    """A type that an action message nests."""
    found = parse_full(message.definition, message.name, World.ROS1)
    if name not in found:
        msg = f"{message.name} has no {name}: it is not an action's message"
        raise MessageTypeError(msg)
    return closure(found[name], found)


def learn(network: Network, topics: Mapping[str, str]) -> None:
    """Take up what the publishers of an action's topics tell of their types."""
    for link, facts in network.facts().items():
        if link.topic in topics and facts.type == topics[link.topic] and facts.definition:
            try:
                network.registry.learn_ros1(facts.type, facts.definition, facts.md5)
            except MessageTypeError as err:
                _log.debug("%s of %s: %s", link.topic, link.node, err)
