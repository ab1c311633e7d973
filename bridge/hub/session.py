"""Sessions on the hub, for workers, modules and tools of Midspan."""

from __future__ import annotations

import atexit
import itertools
import json
import logging
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import RLock
from typing import Any, Literal, Protocol

import zenoh

from bridge.hub.control import WorkerAnswer, ask
from bridge.hub.daemons import DaemonIdentity
from bridge.hub.errors import HubClosedError, HubConfigError, HubError, zenoh_reason
from bridge.hub.graph import HubGraph
from bridge.hub.graph.tokens import wire_key
from bridge.hub.lane.folder import possible
from bridge.hub.lane.lane import Lane
from bridge.hub.links import MEMBERS, Mesh
from bridge.hub.listeners import open_hub_session
from bridge.hub.rejoin import REJOIN
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree, without_shared_memory

_log = logging.getLogger(__name__)

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_NODE = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,254}")
_NAMESPACE = re.compile(r"/|(?:/[A-Za-z_][A-Za-z0-9_]*){1,32}")


class SessionNode(Protocol):
    """A node of a session, which closes with it."""

    def close(self) -> None:
        """Close the node, and remove it from the session's nodes. Safe to call twice."""


@dataclass(frozen=True, slots=True)
class HubSettings:
    """How a session joins the hub.

    Attributes:
        domain: ROS domain id, the first part of each key.
        router: zenoh endpoint of the router, None if ``zenoh`` has all endpoints.
        zenoh: zenoh configuration that overrides Midspan's, inline or as the path of a JSON5 or YAML file.
        shared_memory: whether large messages between sessions on one machine go through shared memory.
        node: node name in the hub's graph.
        namespace: the node's namespace.
        daemon: name of the daemon on the control plane.
        worker: name of the worker on the control plane.
        max_payload: maximum size of a message in bytes.
        max_tokens: maximum number of endpoints and nodes in the graph.
        lane: folder of the sockets for small messages to other sessions with the same folder; None: zenoh only.
        identity: the daemon to which the worker belongs, None for a program that does not belong to a daemon.
    """

    domain: int = 0
    router: str | None = "tcp/127.0.0.1:7447"
    zenoh: Mapping[str, Any] | str | Path | None = None
    shared_memory: bool = True
    node: str = "midspan"
    namespace: str = "/"
    daemon: str = "midspan"
    worker: str = "tool"
    max_payload: int = MAX_PAYLOAD
    max_tokens: int = 50_000
    lane: str | Path | None = None
    identity: DaemonIdentity | None = None

    def __post_init__(self) -> None:
        """Raise `HubConfigError` for names that a key cannot contain."""
        for name, value, form in (
            ("daemon", self.daemon, _NAME),
            ("worker", self.worker, _NAME),
            ("node", self.node, _NODE),
            ("namespace", self.namespace, _NAMESPACE),
        ):
            if not form.fullmatch(value):
                raise HubConfigError(f"hub {name} {value[:80]!r} is not a valid name: it must match {form.pattern}")


def _config(settings: HubSettings) -> zenoh.Config:
    # Even if this session's limit is lower, links accept MAX_PAYLOAD: this session counts the messages that it refuses;
    # a link would drop them silently.
    room = max(settings.max_payload, MAX_PAYLOAD)
    tree = session_tree(settings.router, shared_memory=settings.shared_memory, max_payload=room)
    return make_config(tree, settings.zenoh)


def _rules_messages(config: zenoh.Config) -> bool:
    """Return whether zenoh is configured to refuse or drop some messages, which is impossible on the lane."""
    tree = json.loads(str(config))
    ruled = tree.get("access_control") or {}
    return bool(ruled.get("enabled") or tree.get("downsampling") or tree.get("low_pass_filter"))


class HubSession:
    """A zenoh session on the hub, with its graph and its links, for one or several of a process's nodes.

    Opening does not wait for the router: the session joins as soon as the router answers, and again after a lost
    connection. Only in zenoh's client mode must the router be running at the start.

    Attributes:
        zenoh: the zenoh session.
        zid: id of the zenoh session.
        settings: the settings with which it joined the hub.
        shared: whether it may have several nodes; otherwise it closes with its only node.
        reach: which sessions its nodes' endpoints reach: only others, or also this one.
        graph: all participants as this session sees them.
        mesh: its direct links to other programs on this machine.
        lane: the local transport for small messages to this daemon's other workers, None without one.
        ids: source of the numbers of its nodes and their endpoints, assigned as in rmw_zenoh.
        nodes: the open nodes.
    """

    def __init__(self, session: zenoh.Session, settings: HubSettings, *, shared: bool = False) -> None:
        self.zenoh, self.settings, self.shared = session, settings, shared
        self.zid = str(session.zid())
        self.reach = zenoh.Locality.ANY if shared else zenoh.Locality.REMOTE
        self.ids = itertools.count()
        self.nodes: set[SessionNode] = set()
        self._lock = RLock()
        self._closed = False
        self.graph = HubGraph(session, settings.domain, settings.max_tokens)
        self.graph.announce(wire_key(settings.domain, self.zid))
        self.lane: Lane | None = None
        if settings.lane is not None and possible():
            self.lane = Lane(Path(settings.lane), self.zid, session, settings.domain, self.graph.renew)
            self.graph.watch(self.lane.graph_changed)
        self.mesh = Mesh(
            session, lambda: without_shared_memory(_config(settings)), partial(self._at_routers, "members"),
            partial(self._at_routers, "peers"), self._rejoin,
        )  # fmt: skip
        self.graph.watch(self.mesh.wake)
        # a process that exits with an open session hangs in zenoh's threads
        atexit.register(self.close)

    @classmethod
    def open(cls, settings: HubSettings, *, shared: bool) -> HubSession:
        """Open a session; raises `HubError` if zenoh cannot open it."""
        config = _config(settings)
        if settings.lane is not None and _rules_messages(config):
            _log.info("no lane: zenoh's configuration restricts messages")
            settings = replace(settings, lane=None)
        try:
            session = open_hub_session(config)
        except zenoh.ZError as err:
            raise HubError(f"cannot join the hub: {zenoh_reason(err)}") from None
        try:
            return cls(session, settings, shared=shared)
        except BaseException:
            session.close()  # type: ignore[no-untyped-call]
            raise

    def add(self, node: SessionNode) -> None:
        """Add a node; raises `HubClosedError` if the session is closed."""
        with self._lock:
            if self._closed:
                raise HubClosedError("the hub session is closed")
            self.nodes.add(node)

    def ask(self, verb: str, params: dict[str, Any], daemon: str, worker: str, timeout: float) -> list[WorkerAnswer]:
        """Query a verb of the control plane; see `bridge.hub.node.Hub.ask`."""
        return ask(self.zenoh, self.settings.domain, verb, params, daemon, worker, timeout)

    def close(self) -> None:
        """Close the session and its nodes. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        atexit.unregister(self.close)
        for node in tuple(self.nodes):
            node.close()
        if self.lane is not None:
            self.lane.close()
        self.mesh.close()
        self.graph.close()
        self.zenoh.close()  # type: ignore[no-untyped-call]

    def _rejoin(self, zids: Collection[str]) -> None:
        """Have sessions join their router again."""
        self.ask(REJOIN, {"sessions": sorted(zids)}, "*", "router", 1.0)

    def _at_routers(self, kind: Literal["members", "peers"]) -> set[str] | None:
        """Return all sessions that are linked to this session's routers, or only the peers; None: no router answers."""
        routers = {str(zid) for zid in self.zenoh.info.routers_zid()}
        answers = self.ask(MEMBERS, {}, "*", "router", 1.0) if routers else []
        values = [a.value for a in answers if isinstance(a.value, dict) and a.value.get("zid") in routers]
        known = [value[kind] for value in values if isinstance(value.get(kind), list)]
        return {str(zid) for members in known for zid in members} if known else None
