"""The table of routes: topics and services in one."""

from __future__ import annotations

import io
from typing import Any

from rich.console import Console

from bridge.cli.routes_table import routes_table

ROW: dict[str, Any] = {
    "direction": "in",
    "state": "active",
    "latency_ms": {"p50": 0.5, "p99": 2.0},
    "messages": 7,
    "drops": {"queue": 2, "bad": 0},
}


def shown(**row: Any) -> str:
    """The table's last line for one route of the ROS 1 worker."""
    console = Console(width=200, file=io.StringIO(), record=True)
    console.print(routes_table([{"daemon": "d", "side": "ros1", "routes": [{**ROW, **row}]}]))
    return " ".join(console.export_text().strip().splitlines()[-1].split())


def test_a_service_tells_what_became_of_its_calls() -> None:
    calls = {"calls": 7, "replies": 3, "errors": 2, "abandoned": 1, "pending": 1}
    names = {"kind": "service", "action": "", "topic": "/do", "hub_topic": "/do", "priority": "", "type": "a/srv/B"}
    text = "- 0.50 2.00 7 pending 1, errors 2, abandoned 1, queue 2 - active"
    assert shown(**names, **calls) == f"ROS 1 -> hub /do a/srv/B service {text}"
    part = {"topic": "/go/_action/send_goal", "hub_topic": "/go/_action/send_goal", "action": "/go"}
    assert " action " in shown(**names | part, **calls)


def test_a_topic_tells_its_class() -> None:
    names = {"kind": "topic", "topic": "/scan", "hub_topic": "/scan", "priority": "stream", "type": "a/msg/B"}
    assert shown(**names) == "ROS 1 -> hub /scan a/msg/B stream - 0.50 2.00 7 queue 2 - active"
