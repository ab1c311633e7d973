"""Publishes the routes' counters as ``/diagnostics`` on the side, for tools such as rqt_robot_monitor.

The state of the daemon's parts is published on the hub by one of its processes (`bridge.metrics.diagnostics`), and
bridged to the side.
"""

from __future__ import annotations

import logging
import struct
import time
from typing import Any

from bridge.hub.diagnostics import DIAGNOSTICS_WANTED, TOPIC, TYPE
from bridge.hub.endpoints.subscription import HubSubscription
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageError
from bridge.messages.registry import Registry
from bridge.routing.edge import Edge, EdgePublisher
from bridge.routing.engine import Engine
from bridge.routing.route import Route
from bridge.status import RouteStatus

_log = logging.getLogger(__name__)

_PERIOD = 1.0
_OK, _WARN, _ERROR = 0, 1, 2
_HEADER = struct.Struct("<III")  # sequence number, seconds, nanoseconds
_COUNT, _LEVEL = struct.Struct("<I"), struct.Struct("<B")
_OF_CALLS = ("type", "calls", "replies", "errors", "abandoned", "pending")
ROUTES_AT_ONCE = 100
"""Maximum number of routes in one message. If there are more, successive messages contain different routes, so that a
thousand routes do not delay traffic."""


class Diagnostics:
    """Publishes the status of the worker and its routes, `ROUTES_AT_ONCE` per second, while the side has subscribers.

    Without ``counters`` it only requests the status of the daemon's parts while the side has subscribers.
    """

    def __init__(self, edge: Edge, registry: Registry, engine: Engine, hardware_id: str, *, counters: bool) -> None:
        self._edge, self._engine, self._counters = edge, engine, counters
        self._hardware_id = hardware_id
        self._publisher: EdgePublisher | None = None
        self._asked: HubSubscription | None = None
        self._due = 0.0
        self._turn = 0
        self._hash = registry.ros2(TYPE).type_id
        conversion = edge.from_hub(TYPE, self._hash)
        self._convert, self._type = conversion.convert, conversion.target
        to_hub = registry.ros1_to_hub(registry.hub_to_ros1(TYPE).target.name).convert
        assert to_hub is not None
        self._to_hub = to_hub

    def publish(self) -> None:
        """Publish if a message is due and the side is available."""
        now = time.monotonic()
        if now < self._due or self._edge.network() is None:
            return
        self._due = now + _PERIOD
        try:
            if self._publisher is None and self._counters:
                self._publisher = self._edge.advertise(TOPIC, self._type, Qos(depth=10))
            wanted = self._edge.has_subscribers(TOPIC)
            self._ask_for_all(wanted=wanted)
            if not wanted or self._publisher is None:
                return
            cdr = self._to_hub(self._array())
            self._publisher.send(cdr if self._convert is None else self._convert(cdr), "diagnostics")
        except MessageError as err:
            _log.warning("no diagnostics on %s: %s", self._edge.side, err)
            self._due = now + 60.0

    def close(self) -> None:
        self._ask_for_all(wanted=False)
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None

    def _ask_for_all(self, *, wanted: bool) -> None:
        """Request the status of the daemon's other parts if the side has subscribers; see `bridge.hub.diagnostics`."""
        if wanted and self._asked is None:
            self._asked = self._engine.hub.subscription(
                DIAGNOSTICS_WANTED, TYPE, self._hash, Qos(), lambda _sample: None
            )
        elif not wanted and self._asked is not None:
            self._asked.close()
            self._asked = None

    def _array(self) -> bytes:
        """Encode the message in the ROS 1 serialization, which has no padding, so that its parts can be concatenated.

        `bridge.messages.json` would take five times as long, 0.3 % of a core for 100 routes.
        """
        routes = [route.status() for route in self._next_routes()]
        summary = self._engine.summary()
        worker = self._status(
            "worker", _OK, f"{summary.routes} routes, {summary.rate:.0f} msg/s", {"network": summary.network}
        )
        stamp = _HEADER.pack(0, *divmod(self._edge.clock.now_ns(), 1_000_000_000))
        return b"".join([stamp, _text(""), _COUNT.pack(1 + len(routes)), worker, *map(self._route, routes)])

    def _next_routes(self) -> list[Route]:
        routes = list(self._engine.routes())
        start = self._turn if self._turn < len(routes) else 0
        self._turn = start + ROUTES_AT_ONCE
        return routes[start : self._turn]

    def _route(self, route: RouteStatus) -> bytes:
        counts = route.drops
        drops = {f"dropped ({reason})": n for reason, n in counts.items() if n}
        level = _ERROR if counts["bad"] or counts["large"] else _WARN if counts["lost"] or counts["queue"] else _OK
        arrow = "to the hub" if route.direction == "in" else "from the hub"
        of = _OF_CALLS if route.kind == "service" else ("type", "priority", "way", "messages")
        values = {name: getattr(route, name) for name in (*of, "bytes", "rate", "age")} | drops
        values |= {f"messages ({transport})": n for transport, n in route.ways.items()}
        return self._status(f"{route.topic} {arrow}", level, route.error or route.state, values)

    def _status(self, name: str, level: int, message: str, values: dict[str, Any]) -> bytes:
        texts = (f"{self._hardware_id}: {name}", message, self._hardware_id)
        pairs = (_text(key) + _text(str(value)) for key, value in values.items())
        return b"".join([_LEVEL.pack(level), *map(_text, texts), _COUNT.pack(len(values)), *pairs])


def _text(words: str) -> bytes:
    content = words.encode(errors="replace")
    return _COUNT.pack(len(content)) + content
