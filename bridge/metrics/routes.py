"""Metrics of the routes, for a bounded number of routes of each side."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import zip_longest

from bridge.metrics.families import Families
from bridge.routing.counters import CARRY_BOUNDS, DROPS, LATENCY_BOUNDS
from bridge.status import Histogram, RouteStatus, StatusDocument

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
        routes = _by_key(document.routes)
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


def _by_key(routes: Iterable[RouteStatus]) -> dict[Key, RouteStatus]:
    """Return the routes by their labels; routes with the same labels count as one.

    Several topics of a side may be one topic on the hub, and a topic has a route for each version of its type.
    """
    alike: dict[Key, list[RouteStatus]] = {}
    for route in routes:
        alike.setdefault(_key(route), []).append(route)
    return {key: _sum(group) if len(group) > 1 else group[0] for key, group in alike.items()}


_COUNTS = "messages", "bytes", "replies", "errors", "abandoned", "pending"


def _sum(routes: Sequence[RouteStatus]) -> RouteStatus:
    """Return the sum of the counters of several routes."""
    values = {name: [getattr(route, name) for route in routes] for name in _COUNTS}
    counts = {name: sum(value or 0 for value in known) for name, known in values.items() if any(known)}
    drops, ways = Counter[str](), Counter[str]()
    for route in routes:
        drops.update(route.drops)
        ways.update(route.ways)
    times = {name: _sum_times([getattr(route, name) for route in routes]) for name in ("latency", "carry")}
    return routes[0].model_copy(update={**counts, **times, "drops": dict(drops), "ways": dict(ways)})


def _sum_times(histograms: Sequence[Histogram]) -> Histogram:
    buckets = [sum(counts) for counts in zip_longest(*(h.buckets for h in histograms), fillvalue=0)]
    return Histogram(buckets=buckets, seconds=sum(h.seconds for h in histograms))


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
