"""Leftovers of dead processes on the networks."""

from __future__ import annotations

import contextlib
import time
import xmlrpc.client
from collections import Counter
from collections.abc import Callable
from typing import Any

from benchmarks.losses.field import Field
from bridge.adapters.ros1.graph.state import PRESENCE

SECONDS = 5.0
_OURS = "midspan"


def left_behind(field: Field) -> list[str]:
    """Return leftovers on the ROS master, the hub and DDS, after a short wait."""
    return [
        *_patiently(lambda: _on_master(field)),
        *_patiently(lambda: _twice(field, "hub", ("midspan_ros1", "midspan_ros2"))),
        *_patiently(lambda: _twice(field, "ros2", (_OURS,))),
    ]


def _patiently(find: Callable[[], list[str]]) -> list[str]:
    end = time.monotonic() + SECONDS
    while (stale := find()) and time.monotonic() < end:
        time.sleep(0.2)
    return stale


def _on_master(field: Field) -> list[str]:
    """Return Midspan's stale registrations: of dead nodes, and those that the live node itself does not report."""
    state = field.master("getSystemState")
    if state is None:
        return ["the master does not reply"]
    pid = field.worker("ros1").pid
    registered: dict[str, list[set[str]]] = {}
    for kind, listed in enumerate(state[:2]):
        for topic, nodes in listed:
            for node in nodes:
                if _OURS in node:
                    registered.setdefault(node, [set(), set()])[kind].add(topic)
    stale = []
    for node, kinds in registered.items():
        uri = field.master("lookupNode", node)
        if _ask(uri, "getPid") != pid:
            stale.append(f"the dead node {node}")
            continue
        for topics, method in zip(kinds, ("getPublications", "getSubscriptions"), strict=True):
            stale += [f"{node} for {t}" for t in sorted(topics - {str(t) for t, _ in _ask(uri, method) or ()})]
    entries = field.master("getParam", PRESENCE) or {}
    stale += [f"{PRESENCE}/{key} of process {e['pid']}" for key, e in entries.items() if e.get("pid") != pid]
    if not registered or not entries:
        stale.append("no registration of the live node")
    return [f"{thing} on the master" for thing in stale]


def _ask(uri: Any, method: str) -> Any:
    with contextlib.suppress(OSError, xmlrpc.client.Error), xmlrpc.client.ServerProxy(str(uri)) as proxy:
        code, _, value = getattr(proxy, method)("/field")
        return value if code == 1 else None
    return None


def _twice(field: Field, program: str, names: tuple[str, ...]) -> list[str]:
    counts = Counter(field.command(program, "nodes", "nodes")["names"])
    return [f"{counts[name]} nodes {name} as {program} sees it" for name in names if counts[name] != 1]
