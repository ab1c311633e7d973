"""The table of routes that `midspan status`, `midspan top` and the demo show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.cli.text import clean, duration, is_number, milliseconds, rate, side_name

Document = Mapping[str, Any]
"""One worker's status document: what it answers to the verb ``status``."""


def routes_table(documents: Iterable[Document], *, errors: bool = True) -> Table:
    """All routes of these workers, one line each, in the order of topics.

    Args:
        documents: status documents of workers; those without routes (the router's) are passed over.
        errors: whether a route's last error is shown under it.
    """
    rows = sorted(
        ((document, route) for document in documents for route in route_list(document)),
        key=lambda row: (str(row[1].get("hub_topic", "")), str(row[1].get("direction")), str(row[0].get("side"))),
    )
    several = len({str(document.get("daemon")) for document, _ in rows}) > 1
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    if several:
        table.add_column("daemon", no_wrap=True)
    table.add_column("direction", no_wrap=True)
    table.add_column("topic", overflow="fold")
    table.add_column("type", overflow="fold")
    table.add_column("class", no_wrap=True)
    for name in ("msg/s", "p50 ms", "p99 ms"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("messages", justify="right", no_wrap=True)
    table.add_column("drops")
    table.add_column("age", justify="right", no_wrap=True)
    table.add_column("state")
    for document, route in rows:
        cells = _cells(document, route)
        table.add_row(*([Text(clean(document.get("daemon", "")))] if several else []), *cells)
        if errors and route.get("error"):
            blank = [Text("")] * (2 if several else 1)
            table.add_row(*blank, Text(f"  {clean(route['error'])}", style="red"))
    return table


def route_list(document: Document) -> list[Document]:
    """The routes of a status document; what is no route is left out."""
    return dicts(document.get("routes"))


def dicts(value: object) -> list[Document]:
    """The entries of a list in a document; none where it is no list, and what is no entry is left out."""
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def arrow(side: object, direction: object) -> str:
    """``ROS 1 -> hub`` or ``hub -> ROS 2``."""
    return f"{side_name(side)} -> hub" if direction == "in" else f"hub -> {side_name(side)}"


def topic_text(route: Document) -> str:
    """The topic's name; both names where a rule or a side's spelling changes it on the way."""
    side, hub = clean(route.get("topic", "")), clean(route.get("hub_topic", ""))
    if side == hub or not hub:
        return side
    return f"{side} -> {hub}" if route.get("direction") == "in" else f"{hub} -> {side}"


def drops_text(route: Document) -> str:
    """Drops by reason, ``-`` where there are none."""
    drops = route.get("drops")
    counts = drops.items() if isinstance(drops, dict) else ()
    return ", ".join(f"{clean(reason)} {count}" for reason, count in counts if count) or "-"


def _call_text(route: Document) -> str:
    """Calls of a service that have no reply, or none yet."""
    counts = {name: route.get(name) for name in ("pending", "errors", "abandoned")}
    return ", ".join(f"{name} {count}" for name, count in counts.items() if is_number(count) and count)


def _cells(document: Document, route: Document) -> Sequence[Text]:
    latency = route.get("latency_ms")
    late = latency if isinstance(latency, dict) else {}
    drops = ", ".join(text for text in (_call_text(route), drops_text(route)) if text not in ("", "-")) or "-"
    state = clean(route.get("state", ""))
    return [
        Text(arrow(document.get("side"), route.get("direction"))),
        Text(topic_text(route), style="bold"),
        Text(clean(route.get("type", "")), style="cyan"),
        Text(clean(route.get("priority") or ("action" if route.get("action") else route.get("kind", "")))),
        Text(rate(route.get("rate"))),
        Text(milliseconds(late.get("p50"))),
        Text(milliseconds(late.get("p99"))),
        Text(str(route.get("messages", "-"))),
        Text(drops, style="" if drops == "-" else "yellow"),
        Text(duration(route.get("age"))),
        Text(state, style="green" if state == "active" else "dim"),
    ]
