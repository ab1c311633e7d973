"""The base of the routes of both directions, their shared context, and the set of routes of one direction."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar

from bridge.concurrency import DelayedCalls
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import split
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, native_program
from bridge.messages.transcode.direct import DirectConversion
from bridge.messages.velocities import VELOCITIES
from bridge.resources import OUT, RAISE
from bridge.routing.admission import TopicAdmission
from bridge.routing.counters import Counters
from bridge.routing.decision import RouteDecision, RouteKey
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.edge import Edge, Endpoint
from bridge.routing.hold import Hold
from bridge.routing.limits import Priority, qos_text
from bridge.routing.peer_watch import Lease
from bridge.routing.rules import RoutePolicy
from bridge.routing.services.held import HeldCalls
from bridge.routing.stall import StallDetector
from bridge.routing.type_exchange import TypeExchange
from bridge.status import RouteStatus

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class EngineContext:
    """The shared context of one engine's routes: the hub and the edge that they join, and common helpers.

    Attributes:
        lease: whether messages may be bridged now.
        hold: the velocities that may not enter the hub now.
        types: exchanges definitions with other workers.
        small, bulk: dispatchers of small and large messages to the side.
        wake: schedules a check of the routes.
        registry: creates negative replies.
        held_calls: the calls that wait for the lease.
        later: makes delayed calls.
    """

    hub: Hub
    edge: Edge
    stall_detector: StallDetector
    lease: Lease
    types: TypeExchange
    small: Dispatcher
    bulk: Dispatcher
    wake: Callable[[], None]
    registry: Registry | None = None
    hold: Hold | None = None
    held_calls: HeldCalls = field(init=False)
    later: DelayedCalls = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "held_calls", HeldCalls(self.edge.side, self.lease))
        object.__setattr__(self, "later", DelayedCalls(f"midspan-{self.edge.side}-later"))


class Route:
    """A topic or service that is bridged in one direction.

    ``hub_type`` is the type's ROS 2 name, ``side_type`` its name on the side. ``refused`` is the reason why the last
    update failed, so that the route may lack an endpoint; "" if it succeeded.
    """

    direction = ""
    kind = "topic"

    def __init__(
        self, key: RouteKey, names: tuple[str, str], types: tuple[str, str], policy: RoutePolicy, context: EngineContext
    ) -> None:
        self.key, self.policy = key, policy
        self.hub_topic, self.side_topic = names
        self.hub_type, self.side_type = types
        self.counters = Counters()
        self.refused = ""
        self._context = context
        self._max_payload = context.hub.max_payload

    def status(self) -> RouteStatus:
        """Return the route for the status document."""
        raise NotImplementedError

    def close(self, why: str = "") -> None:
        """Close the endpoints on both networks; pending calls fail with the reason ``why``."""
        raise NotImplementedError

    def too_large(self, size: int) -> bool:
        """Return whether a message of ``size`` bytes is too large, and count it as refused."""
        if size <= self._max_payload:
            return False
        self.bad(f"message of {size} bytes, limits.message allows {self._max_payload}", "large")
        return True

    def bad(self, error: str, reason: str = "bad") -> None:
        """Count a refused message, and log it at a limited rate. May be called from any thread."""
        self.counters.dropped(reason)
        if self.counters.failed(error):
            _log.warning("%s %s: message refused: %s", self.direction, self.side_topic, error)

    def attempt(self, update: Callable[[], None], decision: RouteDecision) -> None:
        """Update the route; report a failure, which does not affect other routes and is retried at the next check."""
        try:
            update()
        except MessageTypeError as err:
            decision.refuse(str(err), err.cure)
        except OSError as err:
            if err.errno in OUT:
                decision.refuse("this process has no file descriptor left", RAISE)
            else:
                decision.refuse(f"system error: {err.strerror or err}", "it is retried every few seconds")
            if decision.reason != self.refused:
                topic, text, cure = decision.topic, decision.reason, decision.cure
                _log.warning("%s %s is refused: %s; %s", decision.direction, topic, text, cure)
        except Exception as err:
            decision.refuse(f"{type(err).__name__}: {err}", "")
            if decision.reason != self.refused:
                _log.exception("%s %s", decision.direction, decision.topic)
        self.refused = decision.reason

    def row(self, *, active: bool, sources: int) -> dict[str, Any]:
        """Return the fields of the status document that topics and services have in common."""
        return {
            "kind": self.kind,
            "action": split(self.hub_topic)[0],
            "direction": self.direction,
            "topic": self.side_topic,
            "hub_topic": self.hub_topic,
            "type": self.hub_type,
            "side_type": self.side_type,
            "state": "refused" if self.refused else "active" if active else "idle",
            "sources": sources,
            **self.counters.as_dict(),
        }


class TopicRoute(Route, TopicAdmission):
    """A topic that is bridged in one direction."""

    def __init__(
        self, key: RouteKey, names: tuple[str, str], conversion: Conversion, policy: RoutePolicy, context: EngineContext
    ) -> None:
        to_hub = self.direction == "in"
        hub, side = (conversion.target, conversion.source) if to_hub else (conversion.source, conversion.target)
        super().__init__(key, names, (hub.name, side.name), policy, context)
        TopicAdmission.__init__(self, names, hub.name, policy, self.counters, context.stall_detector)
        self.conversion = conversion
        self._program = None if conversion.convert is None else native_program(conversion.convert)
        self._direct = DirectConversion(conversion.convert)
        self._priority = Priority.STREAM
        self._qos = Qos()
        self._lease = context.lease

    def _is_plain(self) -> bool:
        """Return whether C code can handle small messages: conversion in C, no rate, and no velocities."""
        converts = self.conversion.convert is None or self._program is not None
        return converts and self._limit is None and self.hub_type not in VELOCITIES

    @property
    def static(self) -> bool:
        """Whether the route publishes merged static transforms, which remain when their publishers leave."""
        raise NotImplementedError

    def describe(self, sources: int, way: tuple[str, str], by_lane: int) -> RouteStatus:
        """Return the route for the status document; ``way``: transport on the hub, and the reason for using zenoh."""
        return RouteStatus(
            **self.row(active=bool(sources), sources=sources),
            priority=self._priority.value,
            qos=qos_text(self._qos),
            way=way[0],
            why=way[1],
            ways={"lane": by_lane, "zenoh": max(self.counters.messages - by_lane, 0)},
        )


AnyKey = TypeVar("AnyKey")
AnyRoute = TypeVar("AnyRoute", bound=Route)


class RouteSet(Generic[AnyKey, AnyRoute]):
    """The routes of one direction and kind. Only the engine's loop changes them; `routes` is thread-safe."""

    direction: ClassVar[str]
    kind: ClassVar[str] = "topic"

    def __init__(self, context: EngineContext) -> None:
        self._context = context
        self._routes: dict[AnyKey, AnyRoute] = {}

    def routes(self) -> list[AnyRoute]:
        """Return all routes."""
        return list(self._routes.values())

    def close(self, why: str = "") -> None:
        for key in list(self._routes):
            self._routes.pop(key).close(why)

    def candidates(self, endpoints: Sequence[Endpoint]) -> set[tuple[str, str]]:
        """Return name and type of everything that could have a route; ``endpoints`` is the side's graph."""
        raise NotImplementedError

    def stand_by(self, endpoints: Sequence[Endpoint], decisions: list[RouteDecision], why: str) -> None:
        """Close all routes, and append a decision on everything that could have one."""
        self.close(f"{why}; call again later")
        decisions += [
            RouteDecision.resting(self.direction, name, type_name, why, self.kind)
            for name, type_name in sorted(self.candidates(endpoints))
        ]
