"""Metrics of the routes, for a bounded number of routes of each side."""

from __future__ import annotations

import threading

from bridge.metrics.families import Families
from bridge.routing.counters import CARRY_BOUNDS, DROPS, LATENCY_BOUNDS
from bridge.status import RouteStatus, StatusDocument

# the source time of messages from a side is unknown, so only the bridge's own time is reported for them
_LATENCY = "midspan_route_latency_seconds", tuple(bound / 1e9 for bound in LATENCY_BOUNDS)
_CARRY = "midspan_route_carry_seconds", CARRY_BOUNDS
Key = tuple[str, ...]


class RouteMetrics:
    """Reports at most ``most`` routes of each side. A route once reported stays reported while it exists."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._reported: dict[str, set[Key]] = {}

    def add(self, families: Families, document: StatusDocument) -> None:
        """Add the metrics of a side's routes."""
        side = document.worker
        routes = {_key(route): route for route in document.routes}
        chosen = self._choose(side, routes)
        families.add("midspan_side_routes", len(routes), side)
        families.add("midspan_side_routes_untold", len(routes) - len(chosen), side)
        for key in chosen:
            _route(families, routes[key], (side, *key))

    def _choose(self, side: str, routes: dict[Key, RouteStatus]) -> list[Key]:
        with self._lock:
            before = self._reported.get(side, set()) & routes.keys()
            chosen = sorted(before) + sorted(routes.keys() - before)[: self._most - len(before)]
            self._reported[side] = set(chosen)
        return sorted(chosen)


def _key(route: RouteStatus) -> Key:
    return route.direction, route.kind, route.hub_topic, route.type


def _route(families: Families, route: RouteStatus, labels: Key) -> None:
    add = families.add
    add("midspan_route_messages_total", route.messages, *labels)
    add("midspan_route_bytes_total", route.bytes, *labels)
    add("midspan_route_lane_messages_total", route.ways.get("lane"), *labels)
    for reason in DROPS:
        add("midspan_route_drops_total", route.drops.get(reason), *labels, reason)
    carried = (route.direction, route.kind) == ("in", "topic")
    histogram, (name, bounds) = (route.carry, _CARRY) if carried else (route.latency, _LATENCY)
    counts = histogram.buckets if len(histogram.buckets) == len(bounds) + 1 else [0] * (len(bounds) + 1)
    families.add_histogram(name, bounds, counts, histogram.seconds, *labels)
    if route.kind == "service":
        for result, count in (("reply", route.replies), ("error", route.errors), ("abandoned", route.abandoned)):
            add("midspan_route_calls_total", count, *labels, result)
        add("midspan_route_calls_pending", route.pending, *labels)
