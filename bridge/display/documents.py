"""Display of the workers' status documents: the table of routes, and the YARP ports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.client.status import Document, dicts, route_list
from bridge.doctor.causes import cause, same_for
from bridge.text import arrow, clean, duration, is_number, milliseconds, plural, rate


def routes_table(documents: Iterable[Document], *, errors: bool = True) -> Table:
    """Return a table of all routes of these workers by topic, with the last errors if asked for."""
    rows = sorted(
        ((document, route) for document in documents for route in route_list(document)),
        key=lambda row: (str(row[1].get("hub_topic", "")), str(row[1].get("direction")), str(row[0].get("side"))),
    )
    several = len({str(document.get("daemon")) for document, _ in rows}) > 1
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in (*(["daemon"] if several else []), "direction", "topic", "type", "class", "way"):
        table.add_column(name, no_wrap=name not in ("topic", "type"), overflow="fold")
    for name in ("msg/s", "p50 ms", "p99 ms", "messages"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("drops")
    table.add_column("age", justify="right", no_wrap=True)
    table.add_column("state")
    last = _errors(route for _, route in rows) if errors else {}
    for document, route in rows:
        cells = _cells(document, route)
        table.add_row(*([Text(clean(document.get("daemon", "")))] if several else []), *cells)
        if error := last.get(id(route)):
            blank = [Text("")] * (2 if several else 1)
            table.add_row(*blank, Text(f"  {clean(error)}", style="red"))
    return table


def _errors(routes: Iterable[Document]) -> dict[int, str]:
    """The last error of each route; what several have in common stands under the first of them, with their topics."""
    groups: dict[str, list[Document]] = {}
    for route in routes:
        if route.get("error"):
            groups.setdefault(cause(str(route["error"])), []).append(route)
    errors = {}
    for first, *others in groups.values():
        topics = list(
            dict.fromkeys(str(route.get("topic")) for route in others if route.get("topic") != first.get("topic"))
        )
        errors[id(first)] = str(first["error"]) + same_for(topics)
    return errors


def topic_text(route: Document) -> str:
    """Return the topic's name, or both names if a rule or a side's spelling changes it."""
    side, hub = clean(route.get("topic", "")), clean(route.get("hub_topic", ""))
    if side == hub or not hub:
        return side
    return f"{side} -> {hub}" if route.get("direction") == "in" else f"{hub} -> {side}"


def way_text(route: Document) -> str:
    """``by the lane``, or ``over zenoh, as ...``; "" if nothing crosses the hub."""
    transport, reason = route.get("way"), clean(route.get("why", ""))
    if transport == "lane":
        return "by the lane"
    because = f", as {reason}" if reason else ""
    return {"zenoh": f"over zenoh{because}", "both": f"by the lane and over zenoh{because}"}.get(str(transport), "")


def drops_text(route: Document) -> str:
    """Return the drops by reason, ``-`` without any."""
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
        Text(clean(route.get("way") or "-")),
        Text(rate(route.get("rate"))),
        Text(milliseconds(late.get("p50"))),
        Text(milliseconds(late.get("p99"))),
        Text(str(route.get("messages", "-"))),
        Text(drops, style="" if drops == "-" else "yellow"),
        Text(duration(route.get("age"))),
        Text(state, style="green" if state == "active" else "dim"),
    ]


_FORMS = {"bottle": "nested lists, as YARP's own converter of ROS messages writes them", "natural": "YARP's own type"}
_DOES = {"out": "writes it", "in": "reads it"}
_BYTES = {"yarp3": "YARP 3's bytes", "yarp4": "YARP 4's bytes"}


def content_text(port: Document) -> str:
    """``sensor_msgs/msg/LaserScan as YARP's own type, YARP 3's bytes``; "" if that is unknown."""
    parts = []
    if port.get("type") and port.get("carries"):
        parts.append(f"{port['type']} as {_form(port['carries'])}")
    if port.get("replies"):
        parts.append(f"answered by {_form(port['replies'])}")
    if port.get("profile"):
        parts.append(_bytes(port))
    return clean(", ".join(parts))


def _form(carries: object) -> str:
    return _FORMS.get(str(carries), f"a Bottle of the {carries}")


def port_lines(port: Document) -> list[str]:
    """Sentences on one port, a line for each of its peers."""
    does = _DOES.get(str(port.get("direction")), "answers calls")
    content, peers = content_text(port), dicts(port.get("peers"))
    connected = plural(len(peers), "port") + " connected" if peers else "no connection"
    lines = [f"YARP port {clean(port.get('port', '?'))} {does}: {content + '; ' if content else ''}{connected}."]
    for peer in peers:
        details = [f"{_bytes(peer)} ({peer.get('profile_why')})"] if peer.get("profile") else []
        if peer.get("generation"):
            details.append(f"its calls are answered as YARP {peer['generation']} does ({peer.get('generation_why')})")
        lines.append(clean(f"    {_peer(peer)}: {'; '.join(details)}"))
        if peer.get("generation_cure"):
            lines.append(clean(f"        cure: {peer['generation_cure']}"))
    return lines


def connected_lines(ports: Iterable[Document]) -> list[str]:
    """Return a line for each port with a connection, and one for the others."""
    lines, idle = [], 0
    for port in ports:
        peers = dicts(port.get("peers"))
        idle += not peers
        if peers:
            mark = "->" if port.get("direction") == "out" else "<-"
            names = ", ".join(map(_peer, peers))
            lines.append(clean(f"{port.get('port')}: {content_text(port)} {mark} {names}"))
    if idle:
        lines.append(f"{plural(idle, 'port')} without a connection")
    return lines


def _peer(peer: Document) -> str:
    return f"{peer.get('port')} over {peer.get('carrier')}"


def _bytes(port: Document) -> str:
    return _BYTES.get(str(port.get("profile")), "bytes of an unknown YARP")
