"""The node ``/rosout``, which publishes all messages of the topic ``/rosout`` on ``/rosout_agg``.

Tools subscribe to ``/rosout_agg``, so that each node sends its log only once. ``roscore`` starts such a node, too.
"""

from __future__ import annotations

import logging
from threading import Lock
from urllib.parse import urlsplit

from bridge.adapters.ros1.master.api import MasterApi
from bridge.adapters.ros1.master.registrations import Kind
from bridge.adapters.ros1.node.address import NodeAddress
from bridge.adapters.ros1.node.plain import PlainNode, PlainNodeEvents
from bridge.adapters.ros1_peers import Ros1Error, ask
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

_DEPTH = 1000
_MAX_MESSAGE = 2**20


def is_elsewhere(api: MasterApi) -> bool:
    """Return whether another program's node ``/rosout`` is registered and publishes ``/rosout_agg``.

    The node is asked, because another node may now have the port of a registered node that has ended.
    """
    node = api.registrations.nodes.get(NODE)
    if node is None:
        return False
    try:
        topics = ask(node.api, 1.0, "getPublications", NODE)
        return any(isinstance(topic, list) and topic[:1] == [AGGREGATED] for topic in topics)
    except (Ros1Error, TypeError):
        return False


class RosoutNode:
    """The node, in the master's process.

    Args:
        api: the master's API.
        master_uri: the master's address; this node uses the same host.
        bind: the address on which to listen.

    Raises:
        OSError: the node cannot listen on this address.
    """

    def __init__(self, api: MasterApi, master_uri: str, bind: str) -> None:
        self._api = api
        self._lock = Lock()
        self._closed = False
        address = NodeAddress(urlsplit(master_uri).hostname or bind, bind, ":" in bind)
        events = PlainNodeEvents(self._publishers, lambda: None, self._on_shutdown)
        self._node = PlainNode(NODE, master_uri, address, events, label="midspan-rosout")
        self.uri = self._node.uri
        self._output = self._node.publish(AGGREGATED, LOG)
        self._node.subscribe(TOPIC, LOG, self._on_log, _MAX_MESSAGE)

    def start(self) -> None:
        """Register, and connect to all publishers; close if another program's rosout has registered meanwhile."""
        with self._api.lock:
            taken = NODE in self._api.registrations.nodes
            for method, topic in (("registerPublisher", AGGREGATED), ("registerSubscriber", TOPIC)):
                if not taken:
                    self._api.methods[method](NODE, topic, LOG.name, self.uri)
        if taken:
            self.close()
        else:
            self._node.follow()

    def close(self) -> None:
        """Unregister, and close all connections. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        for method, topic in (("unregisterPublisher", AGGREGATED), ("unregisterSubscriber", TOPIC)):
            self._api.methods[method](NODE, topic, self.uri)
        self._node.close()

    def _publishers(self, topic: str) -> list[str]:
        # not from registerSubscriber's reply: if another program's rosout has this name by now, registering would
        # evict it
        with self._api.lock:
            return [link.api for link in self._api.registrations.links(Kind.PUBLISHER, topic)]

    def _on_log(self, payload: bytes, uri: str) -> None:
        self._output.send(payload, uri, _DEPTH, retain=False)

    def _on_shutdown(self, reason: str) -> None:
        _log.info("this master's node %s ends: %s", NODE, reason)
        self.close()
