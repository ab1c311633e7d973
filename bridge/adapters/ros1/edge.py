"""The ROS 1 edge: the ROS 1 graph, and Midspan's endpoints on it."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from typing_extensions import override

from bridge.adapters.announced_address import AnnouncedAddress
from bridge.adapters.ros1 import names
from bridge.adapters.ros1.actions import discovery
from bridge.adapters.ros1.actions.actions import Ros1Actions
from bridge.adapters.ros1.actions.network import ActionNetwork
from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.environment import master_uri
from bridge.adapters.ros1.graph.master import Master
from bridge.adapters.ros1.graph.presence import Ledger, NodeConnections, NodeEntry, others
from bridge.adapters.ros1.graph.probe import Ros1Context
from bridge.adapters.ros1.graph.standing import Connections, StandingGraph
from bridge.adapters.ros1.graph.state import MasterState, Registration
from bridge.adapters.ros1.node.node import NodeEvents, Ros1Node
from bridge.adapters.ros1.node.slave import ParameterUpdate
from bridge.adapters.ros1.peer_pool import PeerPool
from bridge.adapters.ros1.services.services import Ros1Services
from bridge.adapters.ros1.topics.book import TopicBook
from bridge.adapters.ros1.topics.topics import Ros1Topics
from bridge.adapters.side_edge import SideEdge
from bridge.concurrency import DelayedCalls
from bridge.config.model import Config
from bridge.hub.endpoints.calls import Call
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.routing.edge import Deliver, EdgeCaller, EdgeListener, EdgePublisher, EdgeServer, EdgeSubscription, Endpoint
from bridge.status import ConnectionStatus

if TYPE_CHECKING:
    from bridge.adapters.ros1.parameters.follower import ParameterSharing
    from bridge.adapters.ros1.parameters.store import ParameterServer
    from bridge.config.sections.routing import ParameterRule
    from bridge.hub.node import Hub

_log = logging.getLogger(__name__)

_MAX_GAP = 1.0
"""The watch for other workers is notified if more than this many seconds passed between two reads of the master."""


class Ros1Edge(SideEdge):
    """Joins one ROS 1 graph. It cannot be restarted."""

    side: ClassVar[str] = "ros1"
    awaited: ClassVar[str] = "the ROS master"
    services: ClassVar[bool] = True
    own_threads: ClassVar[bool] = True
    outlives_network: ClassVar[bool] = True
    one_queue: ClassVar[bool] = True

    def __init__(self, config: Config, registry: Registry, state: Path) -> None:
        super().__init__(config, registry)
        self._ledger = Ledger(state)
        self._pool, self._loop = PeerPool(), ConnectionLoop()
        self._timer = DelayedCalls("midspan-ros1-later")
        self._names = names.NameTable()
        self._lock = threading.Lock()
        self._state: MasterState | None = None
        self._standing = StandingGraph(self._connections)
        self._publishers: frozenset[Registration] = frozenset()
        self._presence = self._links = NodeConnections(self._caller, self._presence_changed, self._wake_master)
        peer_changed, limit = self._peer_changed, config.limits.message_bytes
        self._book = TopicBook(self._loop, self._caller, config.name, self._wake_master, peer_changed)
        self._context = context = Ros1Context(
            self._pool, self._loop, self._timer, self._book, self._caller, config.name, peer_changed, limit
        )
        self._topics = Ros1Topics(context, self._refuse)
        self._services = Ros1Services(context, self._wake_master, self._recheck_service)
        check = config.ros1.goal_frames == "check"
        self._actions = Ros1Actions(ActionNetwork(
            self._caller, self._topics.prober.facts, registry, lambda: self.clock,
            partial(self._topics.subscribe, settle=False),
            self._topics.advertise, self._refuse, check,
        ))  # fmt: skip
        self._settled = float("-inf")
        self._node: Ros1Node | None = None
        self._master: Master | None = None
        self._parameters: ParameterSharing | None = None
        self._address = AnnouncedAddress("ros1", "ROS 1 node is", "ros1.ip, ros1.hostname")
        self._joined = False
        self._stopped = False

    # -- life ----------------------------------------------------------------------------------------------------------

    @override
    def start(self, listener: EdgeListener) -> None:
        self._listener = listener
        uri = master_uri(self._config, os.environ)
        name = "/" + self._config.ros1.node.strip("/")
        servers = self._services.servers
        events = NodeEvents(self._wake_master, self._on_shutdown_request, self._links.admit, self._on_subscriber)
        self._node = Ros1Node(name, uri, self._context, servers, events)
        period, daemon = self._config.ros1.poll, self._config.name
        self._master = Master(
            uri, self._node, daemon, self._ledger, period, self._on_master_state, listener.edge_failed,
            self._services.is_gone, self._pool, simulated=self._config.clock.simulated,
        )  # fmt: skip
        self._node.parameter_listeners.add(self._master.on_parameter)
        self._master.start()

    @override
    def stop(self) -> None:
        with self._lock:
            if self._stopped:
                return
            self._stopped = True
        self._links.close()
        if self._master is not None:
            self._master.stop()
        self._services.stop()
        self._actions.stop()
        self._topics.close()
        self._loop.stop()
        self._pool.stop()
        self._timer.close()
        self._topics.prober.close()
        if self._node is not None:
            self._node.stop()
        self._state = None
        if self._master is not None:
            self._master.release()

    def _caller(self) -> str:
        return self._node.name if self._node is not None else "/midspan"

    def _on_shutdown_request(self, reason: str) -> None:
        if self._master is not None and self._listener is not None:
            self._master.stop_registering()
            self._listener.edge_failed(reason)

    def _wake_master(self) -> None:
        if self._master is not None:
            self._master.wake()

    def _on_subscriber(self, topic: str) -> None:
        """Handle a new subscriber of a published topic; called on a thread of the node."""
        if self._actions.expects_server(topic):
            self._wake_master()

    def _peer_changed(self) -> None:
        """Handle a connection of another node that began, ended, or revealed its type; called on any thread."""
        if self._standing.unlisted:
            self._wake_master()
        self._graph_changed()

    def _connections(self) -> Connections:
        return Connections(self._topics.connected(), self._book.subscribers(), self._services.connected())

    def _recheck_service(self, name: str) -> None:
        if self._master is not None:
            self._master.recheck_service(name)

    # -- the graph -----------------------------------------------------------------------------------------------------

    @override
    def network(self) -> str | None:
        """Return the master's run id; None if the master is unreachable and no connection to another node is left."""
        state = self._state
        return state.network if state is not None else None

    @override
    def is_own_network(self, origin: Origin) -> bool:
        return origin.side == self.side and origin.network == self.network()

    @override
    def endpoints(self) -> Sequence[Endpoint]:
        """Return the other nodes' publishers, subscriptions, servers and actions; service clients are invisible."""
        state = self._state
        if state is None:
            return ()
        topics = (e for e in self._topics.endpoints(state) if not self._actions.is_part(e.topic, e.type))
        return [*topics, *self._services.endpoints(state), *self._actions.endpoints()]

    @override
    def has_subscribers(self, topic: str) -> bool:
        """Return whether another node subscribes to a topic; called every second, so it creates no endpoints."""
        state, node = self._state, self._caller()
        return state is not None and any(s.topic == topic and s.node != node for s in state.subscribers)

    def others(self) -> Sequence[NodeEntry]:
        """Return the other Midspan nodes on this network that are alive, in the order of their names."""
        return self._links.living()

    @override
    def settled(self, since: float) -> bool:
        """Return whether the master was read after ``since``, and lists this node's entry for nodes that join later."""
        if self._settled < since:
            self._wake_master()
            return False
        return True

    @override
    def warnings(self) -> list[str]:
        warnings = []
        wanted = self._joined or self._config.ros1.enabled is True or self._config.ros1.master is not None
        if self._master is not None and self._master.trouble and wanted:
            warnings.append(f"no ROS 1 master: {self._master.trouble}")
        if self._master is not None and self._master.simulated and not self._config.clock.simulated:
            warnings.append(
                "the ROS 1 nodes run on /clock (parameter /use_sim_time) and this daemon on the machine's clock: set"
                " clock.source to sim, or the parameter to false"
            )
        warnings += [self._address.trouble] if self._address.trouble else []
        warnings += self._topics.warnings()
        subscribed = {(s.topic, s.node) for s in self._state.subscribers} if self._state is not None else set()
        for (topic, node), reason in sorted(self._book.rejected().items()):
            if (topic, node) in subscribed:
                warnings.append(f"{topic}: {node} does not receive it: {reason}")
        parameters = [] if self._parameters is None else self._parameters.warnings()
        return [*warnings, *self._services.warnings(), *self._actions.warnings(), *parameters]

    def _on_master_state(self, listed: MasterState | None) -> None:
        """Adopt the master's state, None while it is unreachable; called on the master's thread."""
        assert self._node is not None
        if self._stopped:
            return
        if listed is not None and not self._joined:
            self._joined = True
            # an earlier worker that had parameter rules and was killed may have left copies on the master
            if not self._config.routing.parameters:
                self._parameter_server().close()
        if self._joined:
            self._address.check(self._node.host)
        state = self._standing.update(listed)
        changed = state is not self._state
        self._state = state
        if changed:
            publishers = frozenset(p for p in state.publishers if p.node != self._node.name) if state else frozenset()
            self._publishers = publishers
            self._actions.on_master_changed(state)
            links = publishers | state.subscribers | state.servers if state else frozenset()
            self._names.learn({k.topic for k in links} | self._actions.names())
            self._pool.retain({k.uri for k in links})
        self._pool.resume()
        self._topics.update(self._publishers)
        self._services.on_master_read(state)
        self._actions.on_master_read()
        self._watch_others(listed)
        if changed:
            self._graph_changed()

    def _watch_others(self, state: MasterState | None) -> None:
        """Follow the entries of the other Midspan nodes; without a master only their connections remain."""
        assert self._master is not None
        entry = self._master.presence()
        if state is None or NodeEntry.parse(state.presence.get(entry.key)) != entry:
            self._settled = float("-inf")
            return
        self._links.follow(others(state, entry))
        before, self._settled = self._settled, self._master.polled_at
        if self._settled - before > _MAX_GAP:  # the watch waits for the first read, and the first after a suspension
            self._presence_changed()

    # -- types and names -----------------------------------------------------------------------------------------------

    @override
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """Return the conversion of a type to the hub; an action's types are learned first."""
        if discovery.split_part(endpoint.topic, endpoint.type):
            self._actions.learn(endpoint.topic)
        return self._registry.ros1_to_hub(endpoint.type, endpoint.type_id, endpoint.definition)

    @override
    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        return self._registry.hub_to_ros1(type_name, type_hash)

    @override
    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """Return the conversion of a server's type; an action's types are learned first."""
        if discovery.split_part(endpoint.topic, endpoint.type):
            self._actions.learn(endpoint.topic)
        return self._registry.service_ros1_to_hub(endpoint.type, endpoint.type_id)

    @override
    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        return self._registry.service_hub_to_ros1(type_name, type_hash)

    @override
    def side_name(self, hub_name: str) -> str:
        return self._names.side_name(hub_name)

    @override
    def hub_name(self, side_name: str) -> str:
        return names.hub_name(side_name)

    # -- Midspan's endpoints -------------------------------------------------------------------------------------------

    @override
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:
        """Subscribe to a topic's native publishers of this type; a volatile subscription receives no older messages."""
        part = discovery.split_part(topic, side_type.name)
        if part:
            return self._actions.subscribe(*part, side_type.name, deliver)
        fresh = qos.durability is Durability.VOLATILE
        return self._topics.subscribe(topic, side_type, deliver, fresh=fresh)

    @override
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:
        """Publish on a topic; latched QoS retains the last ``depth`` messages of each source for late joiners."""
        part = discovery.split_part(topic, side_type.name)
        return self._actions.advertise(*part) if part else self._topics.advertise(topic, side_type, qos)

    @override
    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        """Return a client of the native server of a service, with persistent connections."""
        part = discovery.split_part(name, side_type.name)
        return self._actions.caller(*part, side_type.name) if part else self._services.caller(name, side_type)

    @override
    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Serve a service; it is not registered while a native server of that name exists."""
        part = discovery.split_part(name, side_type.name)
        if part:
            return self._actions.serve(*part, side_type.name, call)
        return self._services.servers.open(name, side_type, call)

    @override
    def carry_parameters(
        self, rules: Sequence[ParameterRule], hub: Hub, active: Callable[[], bool]
    ) -> Callable[[], None]:
        """Share parameters between the master's parameter server and the hub, until the returned function is called."""
        node = self._node
        if not rules or node is None or self._master is None:
            return super().carry_parameters(rules, hub, active)
        from bridge.adapters.ros1.parameters.follower import ParameterSharing

        self._parameters = sharing = ParameterSharing(rules, hub, self._registry, self._parameter_server(), active)

        def changed(_update: ParameterUpdate) -> bool:
            sharing.compare_soon()
            return True

        def stop() -> None:
            self._parameters = None
            node.parameter_listeners.discard(changed)
            sharing.stop()

        node.parameter_listeners.add(changed)

        return stop

    def _parameter_server(self) -> ParameterServer:
        from bridge.adapters.ros1.parameters.store import ParameterServer

        assert self._node is not None
        assert self._master is not None
        return ParameterServer(self._master.uri, self._caller, self._node.uri, self._ledger.owner)

    @override
    def connections(self) -> list[ConnectionStatus]:
        state = self._state
        nodes = {p.uri: p.node for p in state.publishers} if state is not None else {}
        directions = {"i": "in", "o": "out"}
        return [
            ConnectionStatus(
                topic=topic, node=nodes.get(c.peer, c.peer), host=c.host, direction=directions[c.direction],
                transport=c.transport, bytes=size, messages=messages, dropped=c.dropped,
            )
            for topic, c in self._book.connections()
            for size, messages in (c.counts(),)
        ]  # fmt: skip

    @override
    def details(self) -> dict[str, Any]:
        return {} if self._parameters is None else {"parameters": self._parameters.details()}
