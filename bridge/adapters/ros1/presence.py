"""Who of Midspan is on a ROS 1 network: a master parameter per node, and the dead predecessors of this daemon.

Each node of ours has an entry below ``/midspan/nodes`` on the master: ``{owner, daemon, node, uri, pid, port}``. Its
key comes from the node's address alone, so that two nodes of one name never write over each other's. ``owner`` is a
random identity that stays in the state folder, so that a daemon knows its own dead selves again; what they left on the
master is removed, and nobody else's.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from bridge.adapters.keep import keep
from bridge.adapters.ros1.errors import Ros1Error
from bridge.adapters.ros1.graph import PRESENCE, Look
from bridge.adapters.ros1.rpc import Call, ask

_LIVENESS_SECONDS = 1.0


@dataclass(frozen=True, slots=True)
class Presence:
    """One Midspan node on a ROS 1 network.

    Attributes:
        owner: random identity of the daemon's state folder.
        daemon: the daemon's name, for people.
        node: the node's name on the graph.
        uri: the node's XML-RPC address.
        pid: its process on its machine.
        port: its TCPROS port, where it tells more; see `bridge.adapters.ros1.links`.
    """

    owner: str
    daemon: str
    node: str
    uri: str
    pid: int
    port: int = 0

    @property
    def key(self) -> str:
        """The last part of the entry's parameter name."""
        return "node_" + sha256(self.uri.encode()).hexdigest()[:12]

    @property
    def parameter(self) -> str:
        """The entry's parameter name."""
        return f"{PRESENCE}/{self.key}"

    def as_dict(self) -> dict[str, Any]:
        """The entry as it stands on the master."""
        return asdict(self)

    @classmethod
    def parse(cls, entry: Any) -> Presence | None:
        """An entry read from a master or the state folder, None where it is none."""
        match entry:
            case {
                "owner": str(owner), "daemon": str(daemon), "node": str(node), "uri": str(uri), "pid": int(pid),
            } if (owner + daemon + node + uri).isprintable():  # fmt: skip
                port = entry.get("port")
                return cls(owner, daemon, node, uri, pid, port if isinstance(port, int) else 0)
        return None


def others(look: Look, own: Presence) -> list[Presence]:
    """The entries of all other nodes of Midspan's, dead ones among them."""
    entries = [Presence.parse(entry) for entry in look.presence.values()]
    return [e for e in entries if e is not None and e.uri != own.uri]


def is_alive(caller: str, entry: Presence) -> bool:
    """Whether an entry's node answers, and is the process that made the entry. Blocks up to a second."""
    try:
        return bool(ask(entry.uri, _LIVENESS_SECONDS, "getPid", caller) == entry.pid)
    except Ros1Error:
        return False


def burial(look: Look, dead: Iterable[Presence]) -> list[Call]:
    """The calls to the master that remove what dead nodes left there."""
    calls: list[Call] = []
    for entry in dead:
        node, uri = entry.node, entry.uri
        # The master ignores these where another process has taken the node's name meanwhile: its address differs.
        for method, links in (("unregisterPublisher", look.publishers), ("unregisterSubscriber", look.subscribers)):
            calls += [(method, (node, k.topic, uri)) for k in links if k.node == node and k.uri == uri]
        calls += [
            ("unregisterService", (node, k.topic, k.uri))
            for k in look.servers
            if k.node == node and k.uri.endswith(f":{entry.port}")
        ]
        if Presence.parse(look.presence.get(entry.key)) == entry:
            calls.append(("deleteParam", (node, entry.parameter)))
    return calls


class Ledger:
    """What the state folder knows of this daemon's ROS 1 nodes."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "ros1.json"
        saved = self._load()
        owner = saved.get("owner")
        self.owner = owner if isinstance(owner, str) and owner else uuid.uuid4().hex
        self.last = Presence.parse(saved.get("last"))

    def remember(self, entry: Presence | None) -> None:
        """Note the node that now lives, None once it has stopped cleanly."""
        if entry == self.last and self._path.exists():
            return
        self.last = entry
        document = {"owner": self.owner, "last": entry.as_dict() if entry else None}
        keep(self._path, json.dumps(document), "what a killed worker leaves on the master will stay there")

    def predecessors(self, look: Look, own: Presence) -> list[Presence]:
        """Entries of this daemon's earlier nodes, from the master and from the state folder."""
        found = {e.uri: e for e in others(look, own) if e.owner == self.owner}
        if self.last is not None and self.last.uri != own.uri:
            found.setdefault(self.last.uri, self.last)
        return list(found.values())

    def _load(self) -> Mapping[str, Any]:
        try:
            document = json.loads(self._path.read_text())
        except (OSError, ValueError, RecursionError):
            return {}
        return document if isinstance(document, dict) else {}
