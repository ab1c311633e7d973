"""A plain ROS 1 node, which publishes and receives serialized messages, including those of Midspan's publishers."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterable
from functools import partial
from threading import Lock
from typing import NamedTuple

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.handshake import Header, connect
from bridge.adapters.ros1.node.address import NodeAddress
from bridge.adapters.ros1.node.greeting import TcprosServer
from bridge.adapters.ros1.node.slave import SlaveApi, SlaveEvents, SlaveState
from bridge.adapters.ros1.topics.book import SubscribedTopic, TopicBook
from bridge.adapters.ros1.topics.connection import MAX_MESSAGE, PublisherConnection
from bridge.adapters.ros1.topics.publication import Publication
from bridge.adapters.ros1.xmlrpc import XmlRpcServer
from bridge.adapters.ros1.xmlrpc_request import Limits
from bridge.adapters.ros1_peers import DeadlineSocket, Ros1Error
from bridge.concurrency import DelayedCalls, InlineExecutor, WorkerPool
from bridge.messages.transcode.conversion import SideType

_log = logging.getLogger(__name__)

_LIMITS = Limits(connections=128, body=2**20, buffered=4 * 2**20, threads=2)
_SECONDS = 5.0
_RETRY_SECONDS = 2.0
_THREADS = 8

Deliver = Callable[[bytes, str], None]
"""``deliver(payload, uri)``: a message, and the address of its publisher's node; called on any thread."""


class PlainNodeEvents(NamedTuple):
    """The node's callbacks, which may be called on any thread.

    Attributes:
        publishers: returns the addresses of the nodes that the master lists as publishers of a topic; may raise
            `Ros1Error`.
        changed: called when a connection of a topic has begun or ended.
        shutdown: called with the reason when another node, the master or a user requests this node's shutdown; may
            close the node.
    """

    publishers: Callable[[str], Iterable[str]]
    changed: Callable[[], None]
    shutdown: Callable[[str], None]


class _Subscription:
    """One subscribed topic; ``readers`` are its connections by the publisher node's address, None until connected."""

    def __init__(self, side_type: SideType, deliver: Deliver, limit: int, entry: SubscribedTopic) -> None:
        self.type, self.deliver, self.limit, self.entry = side_type, deliver, limit, entry
        self.readers: dict[str, PublisherConnection | None] = {}
        self.nodes: dict[PublisherConnection, str] = {}


class PlainNode:
    """A node with its slave API and its connections; the caller registers it with the master.

    Args:
        name: the node's global name.
        master_uri: the master's address, which the slave API reports.
        address: the address of this machine, and the address to listen on.
        events: the node's callbacks.
        origin: the daemon's name, which marks the node's publications as Midspan's in their headers; "" for none.
        label: the prefix of the names of the node's threads.

    Attributes:
        uri: the address of the node's slave API.

    Raises:
        OSError: the node cannot listen on this address.
    """

    def __init__(
        self, name: str, master_uri: str, address: NodeAddress, events: PlainNodeEvents, *, origin: str = "",
        label: str = "midspan-ros1-node",
    ) -> None:  # fmt: skip
        self.name, self._events = name, events
        self._lock = Lock()
        self._subscriptions: dict[str, _Subscription] = {}
        self._closed = False
        self._loop = ConnectionLoop(label)
        self._timer = DelayedCalls(f"{label}-timer")
        self._pool = WorkerPool(_THREADS, f"{label}-connect")
        self._updates = InlineExecutor()  # one after the other, so that an old list does not replace a newer one
        self._book = TopicBook(self._loop, lambda: name, origin, lambda: None, events.changed)
        with contextlib.ExitStack() as opened:
            opened.callback(self._loop.stop)
            self._tcpros = TcprosServer(address.listen(), self._loop, self._timer, self._admit)
            opened.callback(self._tcpros.close)
            state = SlaveState(
                lambda: name, lambda: self.uri, master_uri, lambda: (address.host, self._tcpros.port), self._book,
                lambda: [0, 0, 0],
            )  # fmt: skip
            methods = SlaveApi(state, SlaveEvents(self.follow, lambda _: False, self._on_shutdown)).methods
            self._server = XmlRpcServer(methods, address.bind, name=f"{label}-slave", limits=_LIMITS)
            opened.pop_all()
        self.uri = f"http://{address.in_uri}:{self._server.port}/"
        self._server.start()

    def publish(self, topic: str, side_type: SideType, *, latched: bool = False) -> Publication:
        """Open the publication of a topic."""
        return self._book.publish(topic, side_type, latched=latched)

    def subscribe(self, topic: str, side_type: SideType, deliver: Deliver, limit: int = MAX_MESSAGE) -> None:
        """Subscribe to a topic; `follow` connects to its publishers.

        ``limit`` is the maximum message size in bytes. Raises `ValueError` if the topic is already subscribed to.
        """
        if topic in self._subscriptions:
            raise ValueError(f"{topic} is subscribed to already; unsubscribe first")
        self._subscriptions[topic] = _Subscription(side_type, deliver, limit, self._book.subscribe(topic))

    def unpublish(self, publication: Publication, *, latched: bool = False) -> None:
        """End a publication."""
        self._book.unpublish(publication, latched=latched)

    def unsubscribe(self, topic: str) -> None:
        """End the subscription of a topic."""
        with self._lock:
            subscription = self._subscriptions.pop(topic)
            readers = list(filter(None, subscription.readers.values()))
            subscription.readers.clear()
        for reader in readers:
            reader.close()
            subscription.entry.remove(reader)
        self._book.unsubscribe(subscription.entry)

    def publishers(self, topic: str) -> set[str]:
        """Return the names of the connected publishers' nodes."""
        with self._lock:
            return set(self._subscriptions[topic].nodes.values())

    def follow(self) -> None:
        """Connect to the publishers that the master lists, and disconnect from others; returns at once."""
        self._pool.submit(partial(self._updates.submit, self._follow))

    def close(self) -> None:
        """Close all connections. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            readers = [reader for sub in self._subscriptions.values() for reader in sub.readers.values()]
        self._timer.close(0.0)
        self._pool.close()
        for reader in filter(None, readers):
            reader.close()
        self._tcpros.close()
        self._book.close()
        self._server.close()
        self._loop.stop()

    def _admit(self, sock: DeadlineSocket, header: Header) -> str:
        return self._book.admit(sock, header)

    def _on_shutdown(self, reason: str) -> None:
        self._pool.submit(partial(self._events.shutdown, reason))

    # -- publishers ----------------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        for topic in list(self._subscriptions):
            try:
                self._update(topic, set(self._events.publishers(topic)))
            except Ros1Error as err:
                _log.debug("cannot get the publishers of %s: %s", topic, err)
                self._timer.after(_RETRY_SECONDS, self.follow)

    def _update(self, topic: str, listed: set[str]) -> None:
        with self._lock:
            subscription = self._subscriptions.get(topic)
            if self._closed or subscription is None:
                return
            readers = subscription.readers
            removed = [readers.pop(uri) for uri in readers.keys() - listed]
            added = listed - readers.keys()
            readers.update(dict.fromkeys(added))
        for reader in filter(None, removed):
            reader.close()
            self._remove_reader(subscription, reader)
        for uri in added:
            self._pool.submit(partial(self._connect, subscription, topic, uri))

    def _connect(self, subscription: _Subscription, topic: str, uri: str) -> None:
        try:
            sock, header = connect(self.name, uri, topic, _SECONDS)
        except Ros1Error as err:
            _log.debug("%s does not accept the connection of %s: %s", uri, self.name, err)
            self._retry_later(subscription, uri)
            return
        with sock:  # closes the socket unless the reader has taken it over
            try:
                self._read(subscription, topic, uri, sock, header)
            except OSError:  # the publisher has disconnected
                self._retry_later(subscription, uri)

    def _read(self, subscription: _Subscription, topic: str, uri: str, sock: DeadlineSocket, header: Header) -> None:
        node = header.get("callerid", uri)
        if header.get("md5sum") != subscription.type.type_id:
            _log.warning("%s publishes a different %s on %s, which is not read", node, header.get("type"), topic)
            return
        reader = PublisherConnection(
            sock, topic, uri, lambda payload, _source, _time: subscription.deliver(payload, uri), uri,
            lambda _trouble: self._on_end(subscription, uri, reader), lambda _reason, _why: None, subscription.limit,
            self._loop,
        )  # fmt: skip
        with self._lock:
            wanted = not self._closed and subscription.readers.get(uri, reader) is None
            if wanted:
                subscription.readers[uri] = reader
                subscription.nodes[reader] = node
        if not wanted:
            reader.close()
            return
        subscription.entry.add(reader)
        reader.start()
        self._events.changed()

    def _on_end(self, subscription: _Subscription, uri: str, reader: PublisherConnection) -> None:
        self._remove_reader(subscription, reader)
        self._retry_later(subscription, uri)

    def _remove_reader(self, subscription: _Subscription, reader: PublisherConnection) -> None:
        subscription.entry.remove(reader)
        with self._lock:
            subscription.nodes.pop(reader, None)
        self._events.changed()

    def _retry_later(self, subscription: _Subscription, uri: str) -> None:
        self._timer.after(_RETRY_SECONDS, partial(self._retry, subscription, uri))

    def _retry(self, subscription: _Subscription, uri: str) -> None:
        """Connect again to a publisher that the master still lists."""
        with self._lock:
            reader = subscription.readers.get(uri)
            if reader is None or reader.done:
                subscription.readers.pop(uri, None)
        self.follow()
