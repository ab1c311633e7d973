"""What a YARP port carries and who is connected to it, in words."""

from __future__ import annotations

from collections.abc import Iterable

from bridge.cli.routes_table import Document, dicts
from bridge.cli.text import clean, plural

_FORMS = {"bottle": "nested lists, as YARP's own converter of ROS messages writes them", "natural": "YARP's own type"}
_DOES = {"out": "writes it", "in": "reads it"}
_BYTES = {"yarp3": "YARP 3's bytes", "yarp4": "YARP 4's bytes"}


def port_list(document: Document) -> list[Document]:
    """The YARP ports of a worker's status document."""
    return dicts(document.get("ports"))


def content_text(port: Document) -> str:
    """``sensor_msgs/msg/LaserScan as YARP's own type, YARP 3's bytes``; "" where it does not say it."""
    said = []
    if port.get("type") and port.get("carries"):
        said.append(f"{port['type']} as {_form(port['carries'])}")
    if port.get("replies"):
        said.append(f"answered by {_form(port['replies'])}")
    if port.get("profile"):
        said.append(_bytes(port))
    return clean(", ".join(said))


def _form(carries: object) -> str:
    return _FORMS.get(str(carries), f"a Bottle of the {carries}")


def port_lines(port: Document) -> list[str]:
    """Sentences on one port, a line for each of its peers."""
    does = _DOES.get(str(port.get("direction")), "answers calls")
    content, peers = content_text(port), dicts(port.get("peers"))
    who = plural(len(peers), "port") + " connected" if peers else "nobody is connected"
    lines = [f"YARP port {clean(port.get('port', '?'))} {does}: {content + '; ' if content else ''}{who}."]
    for peer in peers:
        said = [f"{_bytes(peer)} ({peer.get('profile_why')})"] if peer.get("profile") else []
        if peer.get("generation"):
            said.append(f"its calls are answered as YARP {peer['generation']} does ({peer.get('generation_why')})")
        lines.append(clean(f"    {_peer(peer)}: {'; '.join(said)}"))
    return lines


def connected_lines(ports: Iterable[Document]) -> list[str]:
    """A line for each port that somebody is connected to, and one for the others."""
    lines, idle = [], 0
    for port in ports:
        peers = dicts(port.get("peers"))
        idle += not peers
        if peers:
            mark = "->" if port.get("direction") == "out" else "<-"
            who = ", ".join(map(_peer, peers))
            lines.append(clean(f"{port.get('port')}: {content_text(port)} {mark} {who}"))
    if idle:
        lines.append(f"{plural(idle, 'port')} to which nobody is connected")
    return lines


def _peer(peer: Document) -> str:
    return f"{peer.get('port')} over {peer.get('carrier')}"


def _bytes(port: Document) -> str:
    return _BYTES.get(str(port.get("profile")), "bytes of an unknown YARP")
