"""Display of the workers' status documents: the table of routes, the YARP ports, and the shared parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from bridge.doctor.causes import cause, same_for
from bridge.module_keys import ParameterKeys
from bridge.status import ConnectionStatus, PeerStatus, PortStatus, RouteStatus, StatusDocument
from bridge.text import arrow, clean, duration, listed, milliseconds, plural, rate, side_name, size


def routes_table(documents: Iterable[StatusDocument], *, errors: bool = True) -> Table:
    """Return a table of all routes of these workers by topic; with ``errors``, also their last errors."""
    rows = sorted(
        ((document, route) for document in documents for route in document.routes),
        key=lambda row: (row[1].hub_topic, row[1].direction, str(row[0].side)),
    )
    several = len({document.daemon for document, _ in rows}) > 1
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in (*(["daemon"] if several else []), "direction", "topic", "type", "class", "transport"):
        table.add_column(name, no_wrap=name not in ("topic", "type"), overflow="fold")
    for name in ("msg/s", "p50 ms", "p99 ms", "messages"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("drops")
    table.add_column("age", justify="right", no_wrap=True)
    table.add_column("state")
    last = _errors(route for _, route in rows) if errors else {}
    for document, route in rows:
        cells = _cells(document, route)
        table.add_row(*([Text(clean(document.daemon))] if several else []), *cells)
        if error := last.get(id(route)):
            blank = [Text("")] * (2 if several else 1)
            table.add_row(*blank, Text(f"  {clean(error)}", style="red"))
    return table


def _errors(routes: Iterable[RouteStatus]) -> dict[int, str]:
    """Return the routes' last errors by the route's id; errors with one cause appear once, with the other topics."""
    groups: dict[str, list[RouteStatus]] = {}
    for route in routes:
        if route.error:
            groups.setdefault(cause(route.error), []).append(route)
    errors = {}
    for first, *others in groups.values():
        topics = list(dict.fromkeys(route.topic for route in others if route.topic != first.topic))
        errors[id(first)] = first.error + same_for(topics)
    return errors


def topic_text(route: RouteStatus) -> str:
    """Return the topic's name, or both names if a rule or a side's spelling changes it."""
    side, hub = clean(route.topic), clean(route.hub_topic)
    if side == hub or not hub:
        return side
    return f"{side} -> {hub}" if route.direction == "in" else f"{hub} -> {side}"


def transport_text(route: RouteStatus) -> str:
    """Return how messages pass the hub: ``by the lane``, ``over zenoh, as ...``, or both; "" if none do."""
    if route.way == "lane":
        return "by the lane"
    because = f", as {clean(route.why)}" if route.why else ""
    return {"zenoh": f"over zenoh{because}", "both": f"by the lane and over zenoh{because}"}.get(route.way or "", "")


def drops_text(route: RouteStatus) -> str:
    """Return the drops by reason, ``-`` without any."""
    return ", ".join(f"{clean(reason)} {count}" for reason, count in route.drops.items() if count) or "-"


def _call_text(route: RouteStatus) -> str:
    """Return the numbers of a service's calls without a reply: pending, failed and abandoned."""
    counts = {"pending": route.pending, "errors": route.errors, "abandoned": route.abandoned}
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count)


def _cells(document: StatusDocument, route: RouteStatus) -> Sequence[Text]:
    late = route.latency_ms
    drops = ", ".join(text for text in (_call_text(route), drops_text(route)) if text not in ("", "-")) or "-"
    state = clean(route.state)
    return [
        Text(arrow(document.side, route.direction)),
        Text(topic_text(route), style="bold"),
        Text(clean(route.type), style="cyan"),
        Text(clean(route.priority or ("action" if route.action else route.kind))),
        Text(clean(route.way or "-")),
        Text(rate(route.rate)),
        Text(milliseconds(late.get("p50"))),
        Text(milliseconds(late.get("p99"))),
        Text("-" if route.messages is None else str(route.messages)),
        Text(drops, style="" if drops == "-" else "yellow"),
        Text(duration(route.age)),
        Text(state, style="green" if state == "active" else "dim"),
    ]


_FORMS = {"bottle": "nested lists, as YARP's own converter of ROS messages writes them", "natural": "YARP's own type"}
_DOES = {"out": "writes it", "in": "reads it"}
_BYTES = {"yarp3": "YARP 3's bytes", "yarp4": "YARP 4's bytes"}


def content_text(port: PortStatus) -> str:
    """Return a port's content: ``sensor_msgs/msg/LaserScan as YARP's own type, YARP 3's bytes``; "" if unknown."""
    parts = []
    if port.type and port.carries:
        parts.append(f"{port.type} as {_form(port.carries)}")
    if port.replies:
        parts.append(f"answered by {_form(port.replies)}")
    if port.profile:
        parts.append(_bytes(port))
    return clean(", ".join(parts))


def _form(carries: str) -> str:
    return _FORMS.get(carries, f"a Bottle of the {carries}")


def port_lines(port: PortStatus) -> list[str]:
    """Return a sentence about one port, and a line for each of its peers, with cures."""
    does = _DOES.get(port.direction, "answers calls")
    content, peers = content_text(port), port.peers
    connected = plural(len(peers), "port") + " connected" if peers else "no connection"
    lines = [f"YARP port {clean(port.port or '?')} {does}: {content + '; ' if content else ''}{connected}."]
    for peer in peers:
        details = [f"{_bytes(peer)} ({peer.profile_why})"] if peer.profile else []
        if peer.generation:
            details.append(f"its calls are answered as YARP {peer.generation} does ({peer.generation_why})")
        lines.append(clean(f"    {_peer(peer)}: {'; '.join(details)}"))
        if peer.generation_cure:
            lines.append(clean(f"        cure: {peer.generation_cure}"))
    return lines


def connection_line(side: str, whose: str, connection: ConnectionStatus) -> str:
    """Return a sentence: ``Connection of ROS 1 to /viewer at 10.0.0.5:41234 (TCPROS, /scan): 12 messages, 4.1 kB``."""
    preposition = "from" if connection.direction == "in" else "to"
    dropped = f", {connection.dropped} dropped" if connection.dropped else ""
    return (
        f"Connection of {side_name(side)}{whose} {preposition} {connection.node} at {connection.host}"
        f" ({connection.transport}, {connection.topic}): {plural(connection.messages, 'message')},"
        f" {size(connection.bytes)}{dropped}."
    )


def connected_lines(ports: Iterable[PortStatus]) -> list[str]:
    """Return a line for each port with a connection, and a line that counts the other ports."""
    lines, idle = [], 0
    for port in ports:
        idle += not port.peers
        if port.peers:
            mark = "->" if port.direction == "out" else "<-"
            names = ", ".join(map(_peer, port.peers))
            lines.append(clean(f"{port.port}: {content_text(port)} {mark} {names}"))
    if idle:
        lines.append(f"{plural(idle, 'port')} without a connection")
    return lines


def skipped_lines(document: StatusDocument) -> list[str]:
    """Return a line for each node whose parameters are not all shared because of their names."""
    return [
        clean(f"parameters of {rule.node} whose names are not valid in ROS 1: {listed(rule.skipped)}")
        for rule in document.other(ParameterKeys).parameters
        if rule.skipped
    ]


def _peer(peer: PeerStatus) -> str:
    return f"{peer.port} over {peer.carrier}"


def _bytes(port: PortStatus | PeerStatus) -> str:
    return _BYTES.get(port.profile, "bytes of an unknown YARP")
