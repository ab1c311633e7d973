"""The topics that this node publishes and subscribes to."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.handshake import Header, encode
from bridge.adapters.ros1.topics.bus import TopicConnection
from bridge.adapters.ros1.topics.connection import PublisherConnection
from bridge.adapters.ros1.topics.publication import ANY, Publication, figure
from bridge.adapters.ros1_peers import DeadlineSocket
from bridge.concurrency import DelayedCalls
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.conversion import SideType

_MAX_REJECTED = 1000
_MAX_ENDED = 2000
_NEEDED = ("topic", "md5sum", "callerid")


class SubscribedTopic:
    """One topic that this node subscribes to, shared by ``users`` subscriptions."""

    def __init__(self, topic: str) -> None:
        self.topic, self.users = topic, 0
        self._lock = Lock()
        self.connections: tuple[PublisherConnection, ...] = ()

    def add(self, connection: PublisherConnection) -> None:
        """Add a connection to a publisher."""
        with self._lock:
            self.connections = (*self.connections, connection)

    def remove(self, connection: PublisherConnection) -> None:
        """Remove a connection to a publisher."""
        with self._lock:
            self.connections = tuple(c for c in self.connections if c is not connection)

    def bus_stats(self) -> list[Any]:
        """Return an entry of ``getBusStats``; messages that are too large to be delivered count as dropped."""
        connections = [[c.id, *map(figure, c.counts()), figure(c.dropped), not c.done] for c in self.connections]
        return [self.topic, connections]


class TopicBook:
    """The topics for which this node should be registered, and their connections. Thread-safe.

    ``changed`` is called when a topic is added or removed, so that the registration with the master is updated;
    ``peer_changed`` is called when a subscriber has joined or left.
    """

    def __init__(
        self, loop: ConnectionLoop, node: Callable[[], str], origin: str, changed: Callable[[], None],
        peer_changed: Callable[[], None],
    ) -> None:  # fmt: skip
        self._loop, self._node, self._origin = loop, node, origin
        self._changed, self._peer_changed = changed, peer_changed
        self._later = DelayedCalls("midspan-ros1-commands")
        self._lock = Lock()
        self._published: dict[str, Publication] = {}
        self._subscribed: dict[str, SubscribedTopic] = {}
        self._removed: set[str] = set()
        self._ended_headers: dict[str, Header] = {}
        self._rejected: dict[tuple[str, str], str] = {}

    # -- this node's endpoints -----------------------------------------------------------------------------------------

    def publish(self, topic: str, side_type: SideType, *, latched: bool, lifespan: float | None = None) -> Publication:
        """Return the publication of a topic, for one more publisher.

        Raises `MessageTypeError` for another type, and if only one of the topic's publishers sends commands: the
        connections of a ROS 1 topic have one queue for all of them, and commands are not queued. ``lifespan``: time in
        seconds after which a command is too old; None: no commands.
        """
        with self._lock:
            publication = self._published.get(topic)
            new = publication is None
            if publication is None:
                publication = self._published[topic] = Publication(
                    topic, side_type, self._node, self._origin, self._loop, self._peer_changed, self._later, lifespan
                )
            elif publication.side_type.type_id != side_type.type_id:
                raise MessageTypeError(
                    f"{topic} is already published on ROS 1 as {publication.side_type.name}, so it cannot also be"
                    f" {side_type.name} (md5 {side_type.type_id})",
                    "rename one of the two with a rule, because a ROS 1 node has one type per topic",
                )
            elif (publication.lifespan is None) != (lifespan is None):
                kinds = ("messages that are queued", "commands, which are not queued")
                here, other = kinds if publication.lifespan is None else kinds[::-1]
                raise MessageTypeError(
                    f"{topic} is already published on ROS 1 for {here}, so it cannot also be for {other}",
                    "set `priority: command` in the rules of both topics, or rename one of the two",
                )
            publication.latches += latched
            publication.users += 1
        if new:
            self._changed()
        return publication

    def unpublish(self, publication: Publication, *, latched: bool) -> None:
        """Release a publication; the last publisher of the topic ends it."""
        topic = publication.topic
        with self._lock:
            header = publication.header()
            publication.latches -= latched
            publication.users -= 1
            if publication.users:
                return
            del self._published[topic]
            self._removed.add(topic)
            self._rejected = {(t, node): reason for (t, node), reason in self._rejected.items() if t != topic}
            self._ended_headers.pop(topic, None)
            self._ended_headers[topic] = header
            if len(self._ended_headers) > _MAX_ENDED:
                del self._ended_headers[next(iter(self._ended_headers))]
        publication.close()
        self._changed()

    def subscribe(self, topic: str) -> SubscribedTopic:
        """Return the entry of a topic, for one more subscription."""
        with self._lock:
            entry = self._subscribed.get(topic)
            new = entry is None
            if entry is None:
                entry = self._subscribed[topic] = SubscribedTopic(topic)
            entry.users += 1
        if new:
            self._changed()
        return entry

    def unsubscribe(self, entry: SubscribedTopic) -> None:
        """Release an entry; the last subscription of the topic removes it."""
        with self._lock:
            entry.users -= 1
            if entry.users:
                return
            del self._subscribed[entry.topic]
        self._changed()

    def close(self) -> None:
        self._later.close()
        for publication in self._publications():
            publication.close()

    # -- for the master and the slave API ------------------------------------------------------------------------------

    def publications(self) -> dict[str, str]:
        """Return the published topics with their types."""
        return {p.topic: p.side_type.name for p in self._publications()}

    def subscriptions(self) -> dict[str, str]:
        """Return the subscribed topics, all with the type "*", because publishers of several types may be read."""
        with self._lock:
            return dict.fromkeys(self._subscribed, ANY)

    def take_removed(self) -> set[str]:
        """Return the topics whose publications ended since the last call, even if they began again at once."""
        with self._lock:
            removed, self._removed = self._removed, set()
            return removed

    def subscribers(self) -> frozenset[tuple[str, str]]:
        """Return the connected subscribers, by node and topic."""
        return frozenset((c.peer, p.topic) for p in self._publications() for c in p.connections)

    def unconnected(self, listed: frozenset[Registration]) -> frozenset[Registration]:
        """Return the listed subscribers that are neither connected nor rejected."""
        connected, rejected = self.subscribers(), self.rejected()
        return frozenset(s for s in listed if (s.node, s.topic) not in connected and (s.topic, s.node) not in rejected)

    def bus_stats(self) -> list[list[Any]]:
        """Return the published and the subscribed topics as ``getBusStats`` does."""
        return [[p.bus_stats() for p in self._publications()], [s.bus_stats() for s in self._entries()]]

    def bus_info(self) -> list[Any]:
        """Return the connections as ``getBusInfo`` does."""
        return [connection.bus_info(topic) for topic, connection in self.connections()]

    def connections(self) -> list[tuple[str, TopicConnection]]:
        """Return the connections with their topics."""
        entries: list[Publication | SubscribedTopic] = [*self._publications(), *self._entries()]
        return [(entry.topic, connection) for entry in entries for connection in entry.connections]

    def _publications(self) -> list[Publication]:
        with self._lock:
            return list(self._published.values())

    def _entries(self) -> list[SubscribedTopic]:
        with self._lock:
            return list(self._subscribed.values())

    # -- subscribers ---------------------------------------------------------------------------------------------------

    def rejected(self) -> dict[tuple[str, str], str]:
        """Return why subscribers, by topic and node, are rejected: they use another type or definition."""
        with self._lock:
            return dict(self._rejected)

    def admit(self, sock: DeadlineSocket, header: Header) -> str:
        """Admit a subscriber; return "" or why it is rejected. Raises `OSError`."""
        missing = [field for field in _NEEDED if field not in header]
        if missing:
            return f"the header of a subscriber needs the field {missing[0]}"
        topic, caller = header["topic"], header["callerid"]
        with self._lock:
            publication, ended = self._published.get(topic), self._ended_headers.get(topic)
            self._rejected.pop((topic, caller), None)
        if publication is not None:
            error = publication.mismatch(header)
            if error:
                self._note_rejected(publication, header)
            else:
                publication.admit(sock, caller)
            return error
        # rospy never retries a publisher whose connection header was an error or missing: the failed connection stays
        # in rospy's list, and while it is listed, the master's updates about that publisher are ignored (rospy 1.15.15;
        # observed with workers that were killed in sequence). A connection that ends after its header is removed as
        # usual. So a subscriber that connects just after a publication has ended still gets the publication's header.
        if ended is not None and header["md5sum"] in (ANY, ended["md5sum"]):
            sock.sendall(encode(ended))
            sock.close()
            return ""
        return f"{self._node()} is not a publisher of {topic}"

    def _note_rejected(self, publication: Publication, header: Header) -> None:
        """Record a subscriber with another type or definition; otherwise at most its own node would report it."""
        ours = publication.side_type
        theirs = f"{header.get('type', ours.name)} with md5 {header['md5sum']}"
        with self._lock:
            current = self._published.get(publication.topic) is publication
            if current and len(self._rejected) < _MAX_REJECTED:
                self._rejected[publication.topic, header["callerid"]] = (
                    f"it requests {theirs}, but Midspan publishes {ours.name} with md5 {ours.type_id}"
                )
