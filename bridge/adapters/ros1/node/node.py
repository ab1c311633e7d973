"""Midspan's node on the ROS 1 graph: its slave API, its TCPROS server, and the topics and services to register.

`bridge.adapters.ros1.graph.master` registers the node. Unlike nodes of rospy and roscpp, it needs no master to start,
and registers again with a restarted master. The process's log is not published on ``/rosout``.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from typing import NamedTuple

from bridge.adapters.ros1.graph.presence import FIELD
from bridge.adapters.ros1.graph.probe import Ros1Context
from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.handshake import Header
from bridge.adapters.ros1.node.address import NodeAddress
from bridge.adapters.ros1.node.greeting import TcprosServer
from bridge.adapters.ros1.node.slave import ParameterUpdate, SlaveApi, SlaveEvents, SlaveState
from bridge.adapters.ros1.services.server import ServiceServers
from bridge.adapters.ros1.topics.publication import figure
from bridge.adapters.ros1.xmlrpc import XmlRpcServer
from bridge.adapters.ros1.xmlrpc_request import Limits
from bridge.adapters.ros1_peers import DeadlineSocket

LIMITS = Limits(connections=512, body=2**20, buffered=16 * 2**20)
"""A master's list of a topic's publishers, the largest request, is a few kilobytes."""

Changed = Callable[[], None]


class NodeEvents(NamedTuple):
    """The node's callbacks; they may be called on any thread.

    Attributes:
        changed: called when the master should be read.
        shutdown: called with the reason when another node, the master or a user requests this node's shutdown.
        visit: called when another Midspan node has connected, with its header and this node's address; returns "" or
            why the other node is rejected.
        subscribed: called with the topic when a subscriber has connected.
    """

    changed: Changed
    shutdown: Callable[[str], None]
    visit: Callable[[DeadlineSocket, Header, str], str]
    subscribed: Callable[[str], None]


class Ros1Node:
    """The node: ``host``, ``uri`` (XML-RPC), ``port`` (TCPROS), ``address`` (of its services).

    Attributes:
        name: the node's name; may be changed while nothing is registered under the old name.
        parameter_listeners: called with the update of a parameter; each returns whether it has subscribed to it.
    """

    def __init__(
        self, name: str, master_uri: str, context: Ros1Context, servers: ServiceServers, events: NodeEvents
    ) -> None:
        self.name = name
        self.parameter_listeners: set[Callable[[ParameterUpdate], bool]] = set()
        self._book, self._servers, self._events = context.book, servers, events
        address = NodeAddress.of(os.environ)
        state = SlaveState(
            lambda: self.name, lambda: self.uri, master_uri, lambda: (address.host, self.port), self._book,
            lambda: [figure(total) for total in servers.traffic.totals()],
        )  # fmt: skip
        api = SlaveApi(state, SlaveEvents(events.changed, self._on_parameter, events.shutdown))
        try:
            with contextlib.ExitStack() as opened:
                self._tcpros = TcprosServer(address.listen(), context.loop, context.timer, self._admit)
                opened.callback(self._tcpros.close)
                self._server = XmlRpcServer(api.methods, address.bind, name="midspan-ros1-slave", limits=LIMITS)
                opened.pop_all()
        except OSError as err:
            msg = f"cannot listen on {address.bind}: {err.strerror}; check ROS_IP, ROS_HOSTNAME and ROS_IPV6"
            raise RuntimeError(msg) from None
        self.host, self.port = address.host, self._tcpros.port
        self.uri = f"http://{address.in_uri}:{self._server.port}/"
        self.address = f"rosrpc://{address.in_uri}:{self.port}"
        self._server.start()

    def publications(self) -> dict[str, str]:
        """Return the published topics with their types."""
        return self._book.publications()

    def unconnected(self, listed: frozenset[Registration]) -> frozenset[Registration]:
        """Return the listed subscribers that are not connected, although this node accepts them."""
        return self._book.unconnected(listed)

    def take_removed(self) -> set[str]:
        """Return the topics whose publications ended since the last call, even if they began again at once."""
        return self._book.take_removed()

    def subscriptions(self) -> dict[str, str]:
        """Return the subscribed topics with their types."""
        return self._book.subscriptions()

    def services(self) -> dict[str, str]:
        """Return the served services with their addresses."""
        return dict.fromkeys(self._servers.names(), self.address)

    def stop(self) -> None:
        """Close everything, after `Master` has unregistered the node."""
        self._tcpros.close()
        self._book.close()
        self._server.close()

    def _on_parameter(self, update: ParameterUpdate) -> bool:
        replies = [listener(update) for listener in tuple(self.parameter_listeners)]
        return any(replies)

    def _admit(self, sock: DeadlineSocket, header: Header) -> str:
        """Pass a peer to the topics, services or links between Midspan nodes; return "" or why it is rejected."""
        if FIELD in header:
            return self._events.visit(sock, header, self.uri)
        if "topic" in header:
            error = self._book.admit(sock, header)
            if not error:
                self._events.subscribed(header["topic"])
            return error
        if "service" in header:
            return self._servers.admit(sock, header)
        return "the header has neither a topic nor a service"
