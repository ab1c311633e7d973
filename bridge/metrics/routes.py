"""Metrics of the routes: of a bounded number for each side."""

from __future__ import annotations

import threading
from typing import Any

from bridge.metrics.families import Families
from bridge.metrics.source import Document
from bridge.routing.counters import CARRY_BOUNDS, DROPS, LATENCY_BOUNDS

# The source time of a side's messages is unknown, so only the bridge's own time is reported for them.
_HISTOGRAMS = {
    "latency": ("midspan_route_latency_seconds", tuple(bound / 1e9 for bound in LATENCY_BOUNDS)),
    "carry": ("midspan_route_carry_seconds", CARRY_BOUNDS),
}
_RESULTS = {"reply": "replies", "error": "errors", "abandoned": "abandoned"}
_KEY = ("direction", "kind", "hub_topic", "type")

Key = tuple[str, ...]


class RouteMetrics:
    """Reports at most ``most`` routes of each side. A route once reported stays reported while it exists."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._reported: dict[str, set[Key]] = {}

    def add(self, families: Families, document: Document) -> None:
        """Add the metrics of a side's routes."""
        side = str(document["worker"])
        routes = {_key(route): route for route in document.get("routes", ()) if isinstance(route, dict)}
        chosen = self._choose(side, routes)
        families.add("midspan_side_routes", len(routes), side)
        families.add("midspan_side_routes_untold", len(routes) - len(chosen), side)
        for key in chosen:
            _route(families, routes[key], (side, *key))

    def _choose(self, side: str, routes: dict[Key, Any]) -> list[Key]:
        with self._lock:
            before = self._reported.get(side, set()) & routes.keys()
            chosen = sorted(before) + sorted(routes.keys() - before)[: self._most - len(before)]
            self._reported[side] = set(chosen)
        return sorted(chosen)


def _key(route: Document) -> Key:
    return tuple(str(route.get(part, "")) for part in _KEY)


def _route(families: Families, route: Document, labels: Key) -> None:
    add = families.add
    add("midspan_route_messages_total", route.get("messages"), *labels)
    add("midspan_route_bytes_total", route.get("bytes"), *labels)
    drops, transports = route.get("drops"), route.get("ways")
    if isinstance(transports, dict):
        add("midspan_route_lane_messages_total", transports.get("lane"), *labels)
    if isinstance(drops, dict):
        for reason in DROPS:
            add("midspan_route_drops_total", drops.get(reason), *labels, reason)
    part = "carry" if (route.get("direction"), route.get("kind")) == ("in", "topic") else "latency"
    histogram, (name, bounds) = route.get(part), _HISTOGRAMS[part]
    if isinstance(histogram, dict):
        counts = histogram.get("buckets")
        if not isinstance(counts, list) or len(counts) != len(bounds) + 1:
            counts = [0] * (len(bounds) + 1)
        families.add_histogram(name, bounds, counts, histogram.get("seconds", 0.0), *labels)
    if route.get("kind") == "service":
        for result, name in _RESULTS.items():
            add("midspan_route_calls_total", route.get(name), *labels, result)
        add("midspan_route_calls_pending", route.get("pending"), *labels)
