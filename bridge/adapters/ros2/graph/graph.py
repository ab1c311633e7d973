"""The ROS 2 graph as Midspan's participant discovers it, kept up to date by a thread.

The middleware's graph guard condition wakes the thread; it then reads the whole graph, which takes about 20 ms for 500
topics with two endpoints each, and pauses ten times as long.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.graph.marks import PRESENCE, Marks
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.participant import Participant, from_rclpy, reply_topic, request_topic, service_type
from bridge.adapters.ros2.versions import EndpointVersions
from bridge.messages.actions import TOPICS, part_name
from bridge.routing.edge import Endpoint, Kind, MadeBy, Obstacle

_UNKNOWN_NODES = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_")
"""rmw's names for the node of an endpoint whose participant has not announced its nodes, or is not a ROS program."""

_SETTLE = 0.02
_POLL, _LONGEST_POLL = 5.0, 60.0
_SHARE = 1000
"""Pause between reads while nothing changes, as a multiple of the last read's CPU time: they use 0.1 % of a core."""

_PAUSE = 10

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """The graph at one moment, without Midspan's own endpoints.

    ``endpoints`` omits hidden topics except those of actions; ``publishers`` are by topic and GID; ``servers`` has, by
    service, the GIDs of the native servers that Midspan calls; ``participants`` are the GUID prefixes of all other ROS
    participants; ``subscribed`` has the topics that another participant subscribes to; ``obstacles`` has, by service,
    the reason why its native servers cannot be called.
    """

    endpoints: tuple[Endpoint, ...] = ()
    publishers: Mapping[str, Mapping[bytes, Endpoint]] = field(default_factory=dict)
    servers: Mapping[str, frozenset[bytes]] = field(default_factory=dict)
    participants: frozenset[bytes] = frozenset()
    subscribed: frozenset[str] = frozenset()
    obstacles: Mapping[str, Obstacle] = field(default_factory=dict)


VendorObstacle = Callable[[str, Sequence[Endpoint]], Obstacle | None]
"""Returns why a client on the worker's DDS cannot call a service with these servers; None if it can."""


class Ros2Graph:
    """Follows the graph; `snapshot` is its latest state.

    ``prepare`` is called with the endpoints of each new snapshot before other threads see it, ``changed`` afterwards.
    """

    def __init__(
        self, participant: Participant, own_prefix: bytes, changed: Callable[[GraphSnapshot], None],
        obstacle: VendorObstacle, versions: EndpointVersions | None = None, *, separates_versions: bool = False,
        prepare: Callable[[Sequence[Endpoint]], None] = lambda _endpoints: None,
    ) -> None:  # fmt: skip
        self._participant, self._own, self._changed, self._versions = participant, own_prefix, changed, versions
        self._vendor_obstacle, self._separates, self._prepare = obstacle, separates_versions, prepare
        self.snapshot = GraphSnapshot()
        self._closed = vendors.ClosedEndpoints()
        self._guard = participant.make_guard_condition()
        self._graph_guard = rcl.graph_guard_condition(participant.pointer)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-ros2-graph", daemon=True)

    def start(self) -> None:
        """Read the graph once, then follow it."""
        snapshot = self.read()
        self._prepare(snapshot.endpoints)
        self.snapshot = snapshot
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        self._guard.trigger_guard_condition()
        if self._thread.is_alive():
            self._thread.join()
        self._participant.destroy(self._guard)

    def publishers(self, topic: str) -> Mapping[bytes, Endpoint]:
        """Return a topic's publishers by GID, from the last snapshot."""
        return self.snapshot.publishers.get(topic, {})

    def readers(self, topic: str) -> list[Endpoint]:
        """Return a topic's current subscriptions; reads the graph."""
        return [e for _, e in self._endpoints_of(topic, Kind.SUBSCRIPTION)]

    def find(self, topic: str, gid: bytes) -> Endpoint | None:
        """Return one publisher; the graph is queried if the last snapshot lacks it."""
        publisher = self.publishers(topic).get(gid)
        if publisher is None:
            publisher = next((e for g, e in self._endpoints_of(topic, Kind.PUBLISHER) if g == gid), None)
        return publisher

    def read(self) -> GraphSnapshot:
        """Read the whole graph."""
        endpoints: list[Endpoint] = []
        publishers: dict[str, dict[bytes, Endpoint]] = {}
        self._participant.marks.refresh()
        self._endpoints_of(PRESENCE, Kind.PUBLISHER)  # so that `marks` learns which on Cyclone DDS are Midspan's
        for topic in self._participant.topics():
            if is_hidden(topic):
                continue
            topic_publishers = self._endpoints_of(topic, Kind.PUBLISHER)
            if topic_publishers:
                publishers[topic] = dict(topic_publishers)
            endpoints += [e for _, e in topic_publishers]
            endpoints += [e for _, e in self._endpoints_of(topic, Kind.SUBSCRIPTION)]
        servers: dict[str, frozenset[bytes]] = {}
        obstacles: dict[str, Obstacle] = {}
        for service, requests in self._participant.service_topics():
            service_servers = self._servers(service, requests)
            of_service = [server for _, server in service_servers]
            called = {server.id for server in self.called(of_service)}
            servers[service] = frozenset(gid for gid, server in service_servers if server.id in called)
            obstacle = self.obstacle(service, of_service)
            if obstacle is not None:
                obstacles[service] = obstacle
            of_service = [replace(server, obstacle=obstacle) for server in of_service]
            endpoints += of_service if self._versions is None else self._versions.with_uncalled(of_service, called)
            endpoints += self._clients(service, requests)
        prefixes = {gid[:PREFIX_BYTES] for gid in self._participant.participants()}
        self._closed.retain(prefixes)
        subscribed = frozenset(e.topic for e in endpoints if e.kind is Kind.SUBSCRIPTION)
        return GraphSnapshot(
            tuple(endpoints), publishers, servers, frozenset(prefixes - {self._own}), subscribed, obstacles
        )

    def servers(self, service: str) -> list[Endpoint]:
        """Return a service's current servers; reads the graph."""
        return [e for _, e in self._servers(service, request_topic(service))]

    def called(self, servers: Sequence[Endpoint]) -> list[Endpoint]:
        """Return the servers of a service that get its requests."""
        called = vendors.called(servers)
        return self._versions.called(called) if self._versions is not None and self._separates else called

    def obstacle(self, service: str, servers: Sequence[Endpoint], expected: str | None = None) -> Obstacle | None:
        """Return why a client of the ``expected`` version cannot call these servers of a service; None if it can."""
        obstacle = self._vendor_obstacle(service, servers)
        if obstacle is None and self._versions is not None:
            obstacle = self._versions.obstacle(service, self.called(servers), expected)
        return obstacle

    def client_types(self, service: str) -> dict[bytes, str]:
        """Return the type hash of each client of a service, by its participant's GUID prefix; reads the graph.

        Clients whose version is not known yet are omitted.
        """
        clients, versions = self._clients(service, request_topic(service)), self._versions
        known = (client for client in clients if versions is None or versions.is_resolved(client))
        return {bytes.fromhex(client.id)[:PREFIX_BYTES]: client.type_id for client in known}

    def client_made_by(self, service: str, prefix: bytes) -> MadeBy:
        """Return who created the participant with this GUID prefix, judged by its client of a service; reads the graph.

        UNKNOWN if the participant has no such client, or its clients disagree.
        """
        clients = self._others(service, Kind.CLIENT, self._participant.writers(request_topic(service), dds=True))
        found = {client.made_by for gid, client in clients if gid[:PREFIX_BYTES] == prefix}
        return found.pop() if len(found) == 1 else MadeBy.UNKNOWN

    def reply_readers(self, service: str) -> list[bytes]:
        """Return the GIDs of all readers of a service's replies; reads the graph."""
        return [bytes(info["endpoint_gid"]) for info in self._participant.readers(reply_topic(service), dds=True)]

    def own_writer(self, dds_topic: str) -> bytes | None:
        """Return the GID of this participant's newest writer of a DDS topic; reads the graph.

        An older writer may belong to a closed server. Fast DDS numbers a participant's endpoints in ascending order.
        """
        gids = (bytes(info["endpoint_gid"]) for info in self._participant.writers(dds_topic, dds=True))
        return max((gid for gid in gids if gid[:PREFIX_BYTES] == self._own), default=None)

    def clients(self, service: str) -> set[bytes]:
        """Return the GIDs that a service's clients may use in requests; reads the graph."""
        asking = self._others(service, Kind.CLIENT, self._participant.writers(request_topic(service), dds=True))
        return {gid for gid, _ in asking} | set(self.reply_readers(service))

    def _servers(self, service: str, requests: str) -> list[tuple[bytes, Endpoint]]:
        servers = self._others(service, Kind.SERVER, self._participant.readers(requests, dds=True))
        return self._with_versions(servers, service, self._participant.writers)

    def _clients(self, service: str, requests: str) -> list[Endpoint]:
        clients = self._others(service, Kind.CLIENT, self._participant.writers(requests, dds=True))
        return [e for _, e in self._with_versions(clients, service, self._participant.readers)]

    def _with_versions(
        self, ends: list[tuple[bytes, Endpoint]], service: str, reply_ends: Callable[..., Sequence[Mapping[str, Any]]]
    ) -> list[tuple[bytes, Endpoint]]:
        """Return servers or clients, each with the hash of its service's version if the type has several versions.

        Such an endpoint announces only the hash of the requests; the participant's endpoint of the reply topic
        announces the hash of the replies.
        """
        versions = self._versions
        if versions is None or not any(end.type_id and versions.varies(end.type) for _, end in ends):
            return ends
        hashes: dict[bytes, set[str]] = {}
        for info in reply_ends(reply_topic(service), dds=True):
            hashes.setdefault(bytes(info["endpoint_gid"])[:PREFIX_BYTES], set()).add(_type_hash(info))
        resolved: list[tuple[bytes, Endpoint]] = []
        for gid, end in ends:
            announced = hashes.get(gid[:PREFIX_BYTES], set())
            reply = next(iter(announced)) if len(announced) == 1 else ""
            varies = versions.varies(end.type)
            resolved.append(
                (gid, replace(end, type_id=versions.of_service(end.type, end.type_id, reply)) if varies else end)
            )
        return resolved

    def _endpoints_of(self, topic: str, kind: Kind) -> list[tuple[bytes, Endpoint]]:
        query = self._participant.writers if kind is Kind.PUBLISHER else self._participant.readers
        return self._others(topic, kind, query(topic))

    def _others(self, name: str, kind: Kind, infos: Sequence[Mapping[str, Any]]) -> list[tuple[bytes, Endpoint]]:
        gids = [(bytes(info["endpoint_gid"]), info) for info in infos]
        ends = [
            (gid, _endpoint(name, kind, gid, info, self._participant.marks))
            for gid, info in gids
            if gid[:PREFIX_BYTES] != self._own
        ]
        ends = [(gid, end) for gid, end in ends if not self._closed.is_closed(gid, end.node)]
        versions = self._versions
        if versions is None or not any(versions.may_be_humble(end) for _, end in ends):
            return ends
        programs = {gid[:PREFIX_BYTES] for gid in self._participant.participants()}
        return [(gid, end if gid[:PREFIX_BYTES] in programs else versions.of_plain_dds(end)) for gid, end in ends]

    def _run(self) -> None:
        wait_set = self._participant.make_wait_set(2)
        with self._guard, wait_set:
            while not self._stopping.is_set():
                started = time.thread_time()  # CPU time, which on a busy machine is less than the elapsed time
                try:
                    self._prepare_versions()
                    started = time.thread_time()
                    self._update()
                except Exception:
                    _log.exception("reading the ROS 2 graph failed")
                duration = time.thread_time() - started
                self._stopping.wait(max(_SETTLE, _PAUSE * duration))
                if self._stopping.is_set():
                    break
                wait_set.clear_entities()
                wait_set.add_guard_condition(self._guard)
                rcl.wait_set_add_guard_condition(wait_set.pointer, self._graph_guard)
                wait_set.wait(int(min(max(_POLL, _SHARE * duration), _LONGEST_POLL) * 1e9))
                self._stopping.wait(_SETTLE)

    def _prepare_versions(self) -> None:
        """Find the versions of the services' types.

        This takes up to 20 ms per type, but only once, so the pause after a read does not include it.
        """
        if self._versions is not None:
            for type_name in self._participant.service_types():
                self._versions.varies(type_name)

    def _update(self) -> None:
        snapshot = self.read()
        if snapshot != self.snapshot:
            self._prepare(snapshot.endpoints)  # a writer that another thread creates for a new endpoint relies on this
            self.snapshot = snapshot
            self._changed(snapshot)


_ACTION_TOPICS = tuple(part_name("", part) for part in TOPICS)


def is_hidden(topic: str) -> bool:
    """Return whether ROS 2 hides a name, because a part begins with an underscore; False for an action's topics."""
    action = next((topic.removesuffix(end) for end in _ACTION_TOPICS if topic.endswith(end)), topic)
    return "/_" in action


def _endpoint(topic: str, kind: Kind, gid: bytes, info: Mapping[str, Any], marks: Marks) -> Endpoint:
    name, type_hash = str(info["node_name"]), _type_hash(info)
    node = "" if name in _UNKNOWN_NODES else f"{str(info['node_namespace']).rstrip('/')}/{name}"
    return Endpoint(
        id=gid.hex(),
        kind=kind,
        topic=topic,
        type=service_type(str(info["topic_type"])),
        qos=from_rclpy(info["qos_profile"]),
        made_by=marks.of_endpoint(gid, node, has_hash=bool(type_hash)),
        node=node,
        type_id=type_hash,
    )


def _type_hash(info: Mapping[str, Any]) -> str:
    type_hash = info["topic_type_hash"]
    return f"RIHS01_{bytes(type_hash['value']).hex()}" if type_hash["version"] == 1 else ""
