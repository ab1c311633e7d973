"""A halt of everything on the hub: zero velocity, and all goals canceled."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Any

from bridge.client.errors import ClientError
from bridge.client.publishing import encode
from bridge.client.services import ServiceCaller
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.client.velocity import VELOCITIES, subscribers, velocity_message
from bridge.clock import RunClock
from bridge.config.sections.navigation import NavigationSection
from bridge.hub.control import RECORDED
from bridge.hub.endpoints.calls import CallError
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import CANCEL_GOAL, part_name

CANCEL = part_name("", CANCEL_GOAL)

DEFAULT_SECONDS = 2.0
"""Seconds for which zero is repeated: a topic that only now crosses to a side reaches it within this time."""

_PERIOD = 0.05
_ANSWER_SECONDS = 5.0
"""The gateway waits for the confirmation of the stop."""

_ALL: dict[str, Any] = {"goal_info": {}}
"""A `CancelGoal` request without id and stamp: all goals (action_msgs/srv/CancelGoal)."""


@dataclass(frozen=True)
class Halted:
    """What was halted.

    Attributes:
        topics: the topics of velocities, with their number of subscribers on the hub.
        cancels: the result for each action's goals.
        bases: the modules that were asked to halt, and why they may not stand; "" if they do.
        trouble: why the configured planner may drive on, or a base did not get zero; "" otherwise.
        published: name, type and type hash of each topic of velocities.
    """

    topics: dict[str, int]
    cancels: list[GoalCancellation]
    bases: dict[str, str]
    trouble: str
    published: list[tuple[str, str, str]] = field(default_factory=list)

    @property
    def failed(self) -> list[GoalCancellation]:
        """The actions whose goals could not be cancelled."""
        return [cancel for cancel in self.cancels if cancel.error]


def halt(client: Client, types: Types, seconds: float = DEFAULT_SECONDS) -> Halted:
    """Halt everything on the hub, and repeat zero for some seconds."""
    zeros = ZeroVelocities(client, types)
    cancels = [GoalCancellation(client, types, name) for name in actions(client)]
    zeros.put()
    bases: dict[str, str] = {}
    asking = threading.Thread(target=lambda: bases.update(_halted(client)), daemon=True)
    asking.start()
    end = time.monotonic() + seconds
    never = threading.Event()
    while time.monotonic() < end:
        never.wait(_PERIOD)
        zeros.put()
    asking.join()  # it has its own time limit
    topics = {topic: zeros.listeners(topic) for topic in zeros.topics}
    missed = zeros.missed()
    zeros.close()
    trouble = unreached(client.config.navigation, bases, [cancel.name for cancel in cancels])
    return Halted(topics, cancels, bases, "; ".join(filter(None, (trouble, missed))), zeros.published)


def unreached(section: NavigationSection, asked: Iterable[str], cancelled: Collection[str]) -> str:
    """Why the configured planner may drive on: neither it nor the gateway is on the hub; else ""."""
    planner = section.planner
    if not planner or section.at(planner) in cancelled or any(worker.split()[0] == "gateway" for worker in asked):
        return ""
    return (
        f"neither the gateway nor the planner {planner} is on the hub now, so none could be asked to stop: the robot"
        " may still be moving; ask again, and see `midspan status`"
    )


def actions(client: Client) -> list[str]:
    """The names of the actions that are served on the hub."""
    return sorted({e.topic.removesuffix(CANCEL) for e in client.hub.graph.servers() if e.topic.endswith(CANCEL)})


class ZeroVelocities:
    """Publishes zero velocity on every topic of velocities of the hub, and on those that nodes of a side subscribe to.

    A side has one type for each topic. So a topic with subscribers to one form gets only that form.
    """

    def __init__(self, client: Client, types: Types) -> None:
        graph = self._graph = client.hub.graph
        self._types, self._frame = types, client.config.navigation.base_frame
        self._clock = RunClock(simulated=client.config.clock.simulated)  # a simulated one is not fed: 0 means now
        ends = [*graph.publishers(), *graph.subscriptions()]
        known = {(e.topic, e.type_name, e.type_hash) for e in ends if e.type_name in VELOCITIES}
        known |= {(topic, name, types.hash_of(name)) for _, topic, name in graph.velocities() if name in VELOCITIES}
        wanted = {topic: subscribers(graph, topic) for topic, _, _ in known}
        self.published = sorted(kind for kind in known if kind[1] in (wanted[kind[0]] or VELOCITIES))
        self.topics = [topic for topic, _, _ in self.published]
        self._publishers = [
            (client.hub.publisher(*kind, Qos(depth=1), priority="command"), kind[1]) for kind in self.published
        ]

    def put(self) -> None:
        """Publish zero once on each topic."""
        for publisher, name in self._publishers:
            publisher.put(encode(self._types, name, velocity_message(name, self._clock, self._frame)))

    def listeners(self, topic: str) -> int:
        """Return a topic's number of subscribers on the hub."""
        return len(self._graph.subscriptions(topic))

    def missed(self) -> str:
        """Return which nodes of a side no zero can reach, "" if there are none: the side has another type there."""
        reached = {(end.zid, end.topic, end.type_name) for end in self._graph.subscriptions()}
        return "; ".join(
            f"{topic}: nodes of a side subscribe to {name}, and zero does not reach them: the robot may still be"
            f" moving; see 'midspan explain {topic}'"
            for zid, topic, name in self._graph.velocities()
            if (zid, topic, name) not in reached
        )

    def close(self) -> None:
        """Withdraw the publishers."""
        for publisher, _ in self._publishers:
            publisher.close()


class GoalCancellation:
    """Cancels all goals of one action; ``found`` counts them, ``error`` is the reason of a failure."""

    def __init__(self, client: Client, types: Types, name: str) -> None:
        self.name, self.found, self.error = name, 0, "it has not answered"
        try:
            ServiceCaller(client, types, f"{name}{CANCEL}").call(_ALL, self._answered)
        except ClientError as err:
            self.error = str(err)

    def _answered(self, reply: dict[str, Any] | CallError) -> None:
        if isinstance(reply, CallError):
            self.error = str(reply)
            return
        self.found, self.error = len(reply["goals_canceling"]), ""


def _halted(client: Client) -> dict[str, str]:
    """Return the modules that were asked to halt, and why they may not stand; "" if they do."""
    answers = client.ask("halt", timeout=_ANSWER_SECONDS)
    return {f"{a.worker} of {a.daemon}": a.error for a in answers if a.value != RECORDED}
