"""The node ``/rosout``: it publishes all messages of the topic ``/rosout`` on ``/rosout_agg``.

Tools subscribe to the latter, so that each node sends its log once. ``roscore`` starts such a node, too.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from threading import Lock
from urllib.parse import urlsplit

from bridge.adapters.ros1.epoll_loop import EpollLoop
from bridge.adapters.ros1.handshake import Header, connect
from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.registrations import Kind, Link
from bridge.adapters.ros1.node.address import NodeAddress
from bridge.adapters.ros1.node.greeting import TcprosServer
from bridge.adapters.ros1.node.slave import SlaveApi, SlaveEvents, SlaveState
from bridge.adapters.ros1.topics.book import TopicBook
from bridge.adapters.ros1.topics.connection import PublisherConnection
from bridge.adapters.ros1.xmlrpc import XmlRpcServer
from bridge.adapters.ros1.xmlrpc_request import Limits
from bridge.adapters.ros1_peers import DeadlineSocket, Ros1Error, ask
from bridge.concurrency import DelayedCalls, WorkerPool
from bridge.messages.transcode.conversion import SideType

_log = logging.getLogger("midspan.ros1.master")

NODE = TOPIC = "/rosout"
AGGREGATED = "/rosout_agg"
LOG = SideType(
    "rosgraph_msgs/Log",
    "acffd30cd6b6de30f120938c17c593fb",
    "byte DEBUG=1\nbyte INFO=2\nbyte WARN=4\nbyte ERROR=8\nbyte FATAL=16\nHeader header\nbyte level\nstring name\n"
    f"string msg\nstring file\nstring function\nuint32 line\nstring[] topics\n{'=' * 80}\nMSG: std_msgs/Header\n"
    "uint32 seq\ntime stamp\nstring frame_id\n",
)
"""rosgraph_msgs 1.11's definition."""

_LIMITS = Limits(connections=128, body=2**20, buffered=4 * 2**20, threads=2)
_DEPTH = 1000
_MAX_MESSAGE = 2**20
_SECONDS = 5.0
_RETRY_SECONDS = 2.0
_THREADS = 8


def is_elsewhere(api: MasterApi) -> bool:
    """Return whether another program's node of this name is registered and publishes.

    Another node may have the port of one that has ended.
    """
    node = api.registrations.nodes.get(NODE)
    if node is None:
        return False
    try:
        return any(topic[:1] == [AGGREGATED] for topic in ask(node.api, 1.0, "getPublications", NODE))
    except (Ros1Error, TypeError):
        return False


class RosoutNode:
    """The node, in the master's process.

    Args:
        api: the master's.
        master_uri: its address; this node has the same host.
        bind: the address on which to listen.

    Raises:
        OSError: it cannot listen there.
    """

    def __init__(self, api: MasterApi, master_uri: str, bind: str) -> None:
        self._api = api
        self._lock = Lock()
        self._readers: dict[Link, PublisherConnection | None] = {}
        self._closed = False
        self._loop = EpollLoop("midspan-rosout")
        self._timer = DelayedCalls("midspan-rosout-timer")
        self._pool = WorkerPool(_THREADS, "midspan-rosout-connect")
        self._book = TopicBook(self._loop, lambda: NODE, "rosout", lambda: None, lambda: None)
        address = NodeAddress(urlsplit(master_uri).hostname or bind, bind, ":" in bind)
        self._tcpros = TcprosServer(address.listen(), self._loop, self._timer, self._admit)
        place = lambda: (address.host, self._tcpros.port)  # noqa: E731
        state = SlaveState(lambda: NODE, lambda: self.uri, master_uri, place, self._book, lambda: [0, 0, 0])
        methods = SlaveApi(state, SlaveEvents(self._follow, lambda: False, self._on_shutdown)).methods
        self._server = XmlRpcServer(methods, bind, name="midspan-rosout-slave", limits=_LIMITS)
        self.uri = f"http://{address.in_uri}:{self._server.port}/"
        self._topic = self._book.subscribe(TOPIC)
        self._output = self._book.publish(AGGREGATED, LOG, latched=False)

    def start(self) -> None:
        """Register, and connect to all publishers."""
        self._server.start()
        for method, topic in (("registerPublisher", AGGREGATED), ("registerSubscriber", TOPIC)):
            self._api.methods[method](NODE, topic, LOG.name, self.uri)
        self._follow()

    def close(self) -> None:
        """Unregister, and close all connections. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            readers, self._readers = self._readers, {}
        for method, topic in (("unregisterPublisher", AGGREGATED), ("unregisterSubscriber", TOPIC)):
            self._api.methods[method](NODE, topic, self.uri)
        self._timer.close(0.0)
        self._pool.close()
        for reader in filter(None, readers.values()):
            reader.close()
        self._tcpros.close()
        self._book.close()
        self._server.close()
        self._loop.stop()

    def _on_shutdown(self, reason: str) -> None:
        _log.info("this master's node %s ends: %s", NODE, reason)
        self._pool.submit(self.close)

    def _admit(self, sock: DeadlineSocket, header: Header) -> str:
        return self._book.admit(sock, header)

    # -- publishers ----------------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        """Connect to the publishers that the master lists, and disconnect from others."""
        with self._api.lock:
            listed = set(self._api.registrations.links(Kind.PUBLISHER, TOPIC))
        with self._lock:
            if self._closed:
                return
            removed = [self._readers.pop(link) for link in self._readers.keys() - listed]
            added = listed - self._readers.keys()
            self._readers.update(dict.fromkeys(added))
        for reader in filter(None, removed):
            self._drop(reader)
        for link in added:
            self._pool.submit(partial(self._connect, link))

    def _connect(self, link: Link) -> None:
        try:
            sock, header = connect(NODE, link.api, TOPIC, _SECONDS)
        except Ros1Error as err:
            _log.debug("%s does not accept the connection of %s: %s", link.node, NODE, err)
            self._timer.after(_RETRY_SECONDS, partial(self._retry, link))
            return
        try:
            self._read(link, sock, header)
        except OSError:  # it has disconnected
            sock.close()
            self._timer.after(_RETRY_SECONDS, partial(self._retry, link))

    def _read(self, link: Link, sock: DeadlineSocket, header: Mapping[str, str]) -> None:
        if header.get("md5sum") != LOG.type_id:
            _log.warning("%s publishes %s on %s; it is not collected", link.node, header.get("type"), TOPIC)
            sock.close()
            return
        reader = PublisherConnection(
            sock, TOPIC, link.api, lambda payload: self._output.send(payload, link.api, _DEPTH, retain=False),
            lambda _trouble: self._on_end(link, reader), lambda _reason, _why: None, _MAX_MESSAGE, self._loop,
        )  # fmt: skip
        with self._lock:
            wanted = not self._closed and link in self._readers
            if wanted:
                self._readers[link] = reader
        if wanted:
            self._topic.add(reader)
            reader.start()
        else:
            reader.close()

    def _on_end(self, link: Link, reader: PublisherConnection) -> None:
        self._topic.remove(reader)
        self._timer.after(_RETRY_SECONDS, partial(self._retry, link))

    def _drop(self, reader: PublisherConnection) -> None:
        self._topic.remove(reader)
        reader.close()

    def _retry(self, link: Link) -> None:
        """Connect again to a publisher that the master still lists."""
        with self._lock:
            self._readers.pop(link, None)
        self._follow()
