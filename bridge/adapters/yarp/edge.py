"""The adapter of the YARP side: joins one YARP network, Midspan's own or an existing one.

One thread, the name-server thread, polls the name server and manages the ports; other threads make and close their
connections. So no caller of the edge waits for the network, except for `YarpEdge.stop`.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from typing_extensions import override

from bridge.adapters.announced_address import AnnouncedAddress
from bridge.adapters.side_edge import SideEdge
from bridge.adapters.yarp.contents import Contents
from bridge.adapters.yarp.endpoints import PortEndpoints
from bridge.adapters.yarp.graph import Ros1Ports, YarpContext, YarpGraph
from bridge.adapters.yarp.network import PortNames, YarpNetwork, new_id
from bridge.adapters.yarp.plan import make_plan
from bridge.adapters.yarp.ports import OwnPorts
from bridge.adapters.yarp.presence import WorkerPresence
from bridge.adapters.yarp.routed import RoutedTopics, YarpSubscription
from bridge.adapters.yarp.services import OfferedService, PortCaller, YarpServices
from bridge.adapters.yarp.topics import YarpPublisher
from bridge.config.model import Config
from bridge.hub.endpoints.calls import Call
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import split
from bridge.messages.definitions.text import full_text
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.reconnecting_clients import ReconnectingClients, clients_file
from bridge.routing.edge import Deliver, EdgeListener, Endpoint
from bridge.state_file import keep
from yarp_compat.ports.naming import NamingError
from yarp_compat.wire.text import from_text

_log = logging.getLogger(__name__)

_SETTLE = 0.02
_MARK_AGAIN = 3.0
"""For this many seconds after the name server's return, ports may be registered without their marks."""

_STOP_TIMEOUT = 1.0
"""Seconds for all name-server commands together while the adapter stops; a name server may be slow for a moment."""


class YarpEdge(SideEdge):
    """The adapter of a YARP network."""

    side: ClassVar[str] = "yarp"
    awaited: ClassVar[str] = "the name server"
    services: ClassVar[bool] = True

    def __init__(self, config: Config, registry: Registry, state: Path) -> None:
        super().__init__(config, registry)
        section = config.yarp
        self._poll = section.poll
        self._names = PortNames(section.output, section.input, section.rpc, config.name)
        self._contents = Contents(section, registry)
        self._network = YarpNetwork(section, state)
        self._graph, naming = YarpGraph(registry), self._network.naming
        self._ros1 = Ros1Ports(config, naming)
        context = YarpContext(
            registry, naming, _owner(state / "yarp_owner"), config.name, self._names, self._contents, self._graph,
            self._refuse, self._wake_up, config.limits.message_bytes, section.ip,
        )  # fmt: skip
        self._presence: WorkerPresence = WorkerPresence(context, self._presence_changed)
        clients = ReconnectingClients(naming, clients_file(state, "worker yarp"))
        self.ports = OwnPorts(context, self._presence.is_alive, clients)
        self._services = YarpServices(context)
        self._wake = threading.Event()
        self._topics = RoutedTopics(registry, self._contents, self.ports, self._wake.set)
        self._endpoints = PortEndpoints(context, self.ports, self._services, self._topics.outputs)
        self._last_graph: tuple[object, ...] = ()
        self._disconnected = True
        self._address = AnnouncedAddress("yarp", "YARP ports are", "yarp.address, yarp.ip")
        self._mark_until = 0.0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-yarp-names", daemon=True)

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    @override
    def start(self, listener: EdgeListener) -> None:
        """Start the name-server thread, which joins the network as soon as the name server answers."""
        self._listener = listener
        self._contents.now_ns = self.clock.now_ns
        self._thread.start()

    @override
    def stop(self) -> None:
        if self._stopping.is_set():
            return
        self._stopping.set()
        self._wake.set()
        self._network.naming.hurry(_STOP_TIMEOUT)
        if self._thread.is_alive():
            self._thread.join(_STOP_TIMEOUT / 2)
        self.ports.stop()
        self._presence.close()
        self._ros1.close()
        self._network.close()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._update()
            except (NamingError, OSError) as err:
                self._network.trouble = str(err)
                _log.debug("yarp: %s", err)
            except Exception:
                _log.exception("yarp: cannot update the ports and connections")
            if self._wake.wait(self._poll):
                self._wake.clear()
                self._stopping.wait(_SETTLE)

    def _update(self) -> None:
        """Read the name server's list, and adapt graph, ports and connections to it."""
        started, peers = time.monotonic(), self.ports.peers()  # before the list, which then includes all peers
        contacts = self._network.list_ports()
        if contacts is None:
            self._disconnected = True
            return
        by_name = {contact.name: contact for contact in contacts}
        if not self._presence.is_open:
            self.ports.unregister_dead(by_name)
            self._presence.open()
        self.ports.unregister_unmarked(by_name)
        self.ports.close_replaced(by_name)
        returned = self._disconnected or started < self._mark_until
        if self._disconnected:
            self._disconnected, self._mark_until = False, started + _MARK_AGAIN
        if returned:
            self._presence.mark()
        self.ports.restore_marks(by_name, returned=returned)
        ros1 = frozenset[str]() if self._network.is_own else self._ros1.select(by_name)
        self._graph.update(self._network.naming, contacts, peers, ros1)
        self._presence.connect(self._graph.contacts, started)
        if own := by_name.get(self._presence.name):
            self._address.check(own.host)
        self._update_ports()
        previous, self._last_graph = self._last_graph, (self.network(), *self.endpoints())
        if previous != self._last_graph:
            self._graph_changed()

    def _update_ports(self) -> None:
        """Open the ports that the routes need, and connect them."""
        outputs, served = self._topics.published(), self._services.served()
        plan = make_plan(
            [self._topics.routed_topic(topic, output.side_type) for topic, output in outputs.items()],
            self._topics.subscribed(),
            self._contents,
            self._names,
            self._graph,
        )
        self.ports.apply(plan | self._services.plan(served), outputs, served)
        self.ports.abandon_calls()
        for input_port in self.ports.input_ports():
            self._topics.connect(input_port)
            input_port.mark_listed()
        self.ports.connect()

    def _wake_up(self) -> None:
        self._wake.set()
        self._graph_changed()

    # -- the network ---------------------------------------------------------------------------------------------------

    @override
    def network(self) -> str | None:
        """Return the network's id, stored at its name server; it stays valid while the server is unreachable."""
        return self._network.identity if self._presence.is_open else None

    @override
    def is_own_network(self, origin: Origin) -> bool:
        return origin.side == self.side and origin.network == self._network.identity

    @override
    def settled(self, since: float) -> bool:
        """Return whether the name server's full list was requested and read after ``since``; if not, read it soon."""
        if self._presence.is_open and self._presence.settled(since):
            return True
        self._wake.set()
        return False

    @override
    def warnings(self) -> list[str]:
        """Report an unreachable name server, a lost address, ports that cannot open or connect, and unknown types."""
        unreachable = [f"the YARP network: {self._network.trouble}"] if self._network.trouble else []
        untyped = [
            f"{node.port} does not announce its type; set one in yarp.topics for the topic {node.topic}"
            for node in self._endpoints.untyped()
        ]
        unreachable += [self._address.trouble] if self._address.trouble else []
        return [*unreachable, *self.ports.warnings(), *sorted(self._graph.trouble.values()), *untyped]

    @override
    def details(self) -> dict[str, Any]:
        return {"ports": self.ports.status()}

    # -- the graph -----------------------------------------------------------------------------------------------------

    @override
    def endpoints(self) -> Sequence[Endpoint]:
        return self._endpoints.all()

    @override
    def has_subscribers(self, topic: str) -> bool:
        """Return whether a topic has subscribers; readers of its port count, though the graph does not list them."""
        output = self._topics.outputs.get(topic)
        return (output is not None and output.has_readers) or super().has_subscribers(topic)

    # -- types ---------------------------------------------------------------------------------------------------------

    @override
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """Return a conversion that does nothing; the adapter itself converts, as ports can have different contents."""
        side_type = self._side_type(endpoint.type, endpoint.type_id)
        return Conversion(side_type, side_type, None)

    @override
    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """Return only a check: each port's content is converted when it is written."""
        side_type = self._side_type(type_name, type_hash)
        return Conversion(side_type, side_type, self._registry.hub_check(type_name, type_hash))

    def _side_type(self, type_name: str, type_hash: str) -> SideType:
        if type_hash:
            schema = self._registry.schema(type_name, type_hash)
            return SideType(type_name, type_hash, full_text(schema))
        return self._registry.ros2(type_name)

    @override
    def why_not(self, topic: str, type_name: str) -> str:
        """Exclude the parts of actions, because YARP programs send goals through the gateway's ports."""
        return "part of an action; YARP programs send goals through the ports of the gateway" if split(topic)[1] else ""

    # -- services ------------------------------------------------------------------------------------------------------

    @override
    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """Return only checks: the adapter itself converts calls, since the content can differ between ports."""
        return self._services.conversion(endpoint.type)

    @override
    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        return self._services.conversion(type_name, type_hash)

    @override
    def caller(self, name: str, side_type: SideType) -> PortCaller:
        return self._services.caller(name, side_type)

    @override
    def serve(self, name: str, side_type: SideType, call: Call) -> OfferedService:
        """Serve a service through an RPC port, which opens as soon as the name server registers it."""
        return self._services.serve(name, side_type, call)

    # -- own endpoints -------------------------------------------------------------------------------------------------

    @override
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> YarpSubscription:
        return self._topics.subscribe(topic, side_type, qos, deliver)

    @override
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> YarpPublisher:
        """Publish a topic; its ports open as soon as the name server registers them."""
        return self._topics.advertise(topic, side_type, qos)


def _owner(file: Path) -> str:
    """Return the id of this daemon's YARP worker, which is the same after a restart."""
    try:
        owner = file.read_text(encoding="utf-8").strip()
    except OSError:
        owner = ""
    if len(owner) != 12 or not owner.isalnum() or from_text(owner) != [owner]:  # yarpserver would return a number
        owner = new_id(12)
        keep(file, owner + "\n", "the ports of a killed worker stay registered at the name server for a while")
    return owner
