"""Velocities on the hub: whether the base expects ``Twist`` or ``TwistStamped``, and a publisher of that form."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from bridge.client.publishing import Publisher
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.clock import RunClock
from bridge.config.sections.section import Enabled
from bridge.hub.graph import HubGraph
from bridge.hub.node import follow_clock
from bridge.hub.wire.qos import Qos
from bridge.messages.velocities import TWIST, TWIST_STAMPED, VELOCITIES

STOP_SECONDS = 0.7
"""Seconds for which zero is repeated after driving: a worker that was starved for a moment drops commands for half a
second, and would drop a single zero."""

_WATCHERS = re.compile(r"midspan_cli_\d+|foxglove|record(_\d+)?|web")
"""Midspan's nodes that subscribe to whichever type is published, and drive no base."""


class VelocityOutput(Protocol):
    """A publisher of one type."""

    def publish(self, message: Mapping[str, Any]) -> None:
        """Publish a message by its fields."""

    def close(self) -> None:
        """Close the publisher."""


@dataclass(frozen=True, slots=True)
class VelocityForm:
    """The form of a topic's velocities.

    Attributes:
        topic: the topic's name on the hub.
        stamped: whether velocities are ``TwistStamped``; ``auto``: in the form that the base subscribes to.
        frame: the frame of stamped velocities.
    """

    topic: str
    stamped: Enabled = "auto"
    frame: str = "base_link"


def velocity_message(
    type_name: str, clock: RunClock, frame: str, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> dict[str, Any]:
    """Return a velocity message of a type, by default zero; ``velocity`` in m/s and rad/s."""
    x, y, turn = velocity
    twist: dict[str, Any] = {"linear": {"x": x, "y": y}, "angular": {"z": turn}}
    if type_name != TWIST_STAMPED:
        return twist
    return {"header": {"stamp": clock.stamp(), "frame_id": frame}, "twist": twist}


def subscribers(graph: HubGraph, topic: str) -> dict[str, list[str]]:
    """Return, by type, the hub's nodes that subscribe to velocities of only this type, and the sides with such nodes.

    Nodes that accept both types, such as BaseControl and the simulator, do not count.
    """
    accepted: dict[tuple[str, str], set[str]] = defaultdict(set)
    for end in graph.subscriptions(topic):
        native = end.origin is None and not end.pending
        if native and end.type_name in VELOCITIES and not _WATCHERS.fullmatch(end.node):
            accepted[end.zid, f"{end.namespace.rstrip('/')}/{end.node}"].add(end.type_name)
    by_type: dict[str, set[str]] = defaultdict(set)
    for (_, node), types in accepted.items():
        if len(types) == 1:
            by_type[types.pop()].add(node)
    for zid, name, type_name in graph.velocities():
        if name == topic and type_name in VELOCITIES:
            origin = graph.origin_of(zid)
            by_type[type_name].add("a side" if origin is None else origin.side)
    return {type_name: sorted(names) for type_name, names in by_type.items()}


def driven_forms(graph: HubGraph, topic: str) -> set[str]:
    """Return the types of velocities that may drive a base on a topic.

    They include the types that routes carry, because a route may lead to a base whose type its side does not announce.
    Empty if no route exists and all known nodes accept both types.
    """
    carried = {e.type_name for e in graph.subscriptions(topic) if e.origin is not None or e.pending}
    return {*subscribers(graph, topic), *carried} & set(VELOCITIES)


class VelocityPublisher:
    """Publishes velocities in the base's form only: a side would refuse the second type, or a base be driven twice.

    Before a change of the form, zero is published in the old form if that was used. Without a subscriber, or if both
    forms have subscribers, the form does not change; at first it is ``Twist``. Use it on one thread only.

    Args:
        graph: the hub's graph.
        form: the topic and its settings.
        clock: the clock for stamps.
        open_as: opens the publisher of a type.
        report: receives a text for people if both forms have subscribers.
    """

    def __init__(
        self, graph: HubGraph, form: VelocityForm, clock: RunClock, open_as: Callable[[str], VelocityOutput],
        report: Callable[[str], object],
    ) -> None:  # fmt: skip
        self.type_name = ""
        self._graph, self._form, self._clock, self._open_as, self._report = graph, form, clock, open_as, report
        self._out: VelocityOutput | None = None
        self._reported, self._used = "", False
        self.follow()

    def follow(self) -> None:
        """Change to the base's message type if it has changed."""
        wanted = self._choose_type()
        if wanted == self.type_name:
            return
        if self._used:
            self._publish(0.0, 0.0, 0.0)
        self.close()
        self._out = self._open_as(wanted)
        self.type_name, self._used = wanted, False

    def publish(self, x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> None:
        """Publish a velocity in m/s and rad/s."""
        self.follow()
        self._publish(x, y, turn)

    def _publish(self, x: float, y: float, turn: float) -> None:
        assert self._out is not None
        self._used = True
        self._out.publish(velocity_message(self.type_name, self._clock, self._form.frame, (x, y, turn)))

    def _choose_type(self) -> str:
        if self._form.stamped != "auto":
            return TWIST_STAMPED if self._form.stamped else TWIST
        names = subscribers(self._graph, self._form.topic)
        (wanted,) = names if len(names) == 1 else [self.type_name or TWIST]
        doubt = "" if len(names) < 2 else (
            f"{self._form.topic} has subscribers to both forms, {_list_names(names)}: only {wanted} is published;"
            " navigation.stamped chooses the form"
        )  # fmt: skip
        if doubt != self._reported:
            self._reported = doubt
            if doubt:
                self._report(doubt)
        return wanted

    def close(self) -> None:
        """Close the publisher. Safe to call twice."""
        if self._out is not None:
            self._out.close()
            self._out = None


def open_velocity(
    client: Client, types: Types, form: VelocityForm, report: Callable[[str], object]
) -> VelocityPublisher:
    """Open a program's publisher of velocities, with stamps of the run's clock."""
    client.catch_up()
    clock = RunClock(simulated=client.config.clock.simulated)
    follow_clock(clock, client.hub)

    def open_as(type_name: str) -> Publisher:
        return Publisher(client, types, form.topic, type_name, Qos(depth=1), "command")

    return VelocityPublisher(client.hub.graph, form, clock, open_as, report)


def _list_names(names: Mapping[str, list[str]]) -> str:
    return " and ".join(f"{type_name} ({', '.join(names[type_name])})" for type_name in sorted(names))
