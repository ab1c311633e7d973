"""The edge of the YARP side: joins one YARP network, ours or the site's.

One thread, the clerk, asks the name server and opens, closes and connects ports; nothing else waits for anybody.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from bridge.adapters.base import (
    Deliver,
    Edge,
    EdgeCaller,
    EdgeListener,
    EdgePublisher,
    EdgeServer,
    EdgeSubscription,
    Endpoint,
    Sighting,
)
from bridge.adapters.keep import keep
from bridge.adapters.yarp.contents import Contents
from bridge.adapters.yarp.endpoints import Endpoints
from bridge.adapters.yarp.graph import Graph
from bridge.adapters.yarp.inlet import Inlet
from bridge.adapters.yarp.names import PRESENCE, PortNames
from bridge.adapters.yarp.network import YarpNetwork
from bridge.adapters.yarp.outlet import TopicOutput, TopicPublisher
from bridge.adapters.yarp.plan import Wanted, make_plan
from bridge.adapters.yarp.ports import OwnPorts
from bridge.adapters.yarp.presence import Presence
from bridge.adapters.yarp.services import Services
from bridge.config.model import Config
from bridge.hub.call import Call
from bridge.hub.origin import Origin
from bridge.hub.qos import Qos
from bridge.messages.conversion import Conversion, ServiceConversion, SideType
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.text import full_text
from bridge.messages.yarp.codec import is_stamped
from bridge.routing.subject import split
from yarp_compat.naming.errors import NamingError

_log = logging.getLogger(__name__)

_SETTLE = 0.02
_MARK_AGAIN = 3.0
"""Seconds after the name server's return for which ports may be registered without their marks."""

_LAST_WORDS = 0.4
"""Seconds that a name server has for each command when we stop; one that hangs is given up."""

_AWAKE = 0.9
"""Seconds since its last record for which another worker is awake; less than `bridge.routing.election.SILENCE`."""


class YarpEdge(Edge):
    """Joins a YARP network."""

    side: ClassVar[str] = "yarp"
    services: ClassVar[bool] = True

    def __init__(self, config: Config, registry: Registry, state: Path) -> None:
        section = config.yarp
        self._config, self._registry = config, registry
        self._poll = section.poll
        self._names = PortNames(section.output, section.input, section.rpc, config.name)
        self._contents = Contents(section, registry)
        self._network = YarpNetwork(section, state)
        self._owner = _owner(state / "yarp_owner")
        self._graph = Graph(registry)
        self._ports = OwnPorts(
            self._network.naming,
            self._owner,
            config.name,
            self._contents,
            self._graph,
            self._refused,
            self._wake_up,
            config.limits.message_bytes,
            section.ip,
            self._awake,
            self._names,
        )
        self._presence = Presence(
            self._owner, config.name, self._network.naming, registry, self._presence_changed, self._wake_up, section.ip
        )
        self._services = Services(
            self._contents, registry, self._network.naming, config.limits.message_bytes, self._wake_up
        )
        self._lock = threading.Lock()
        self._outputs: dict[str, TopicOutput] = {}
        self._endpoints = Endpoints(
            self._names, self._contents, self._graph, self._ports, self._services, self._outputs
        )
        self._heard: dict[tuple[str, str], _Subscription] = {}
        self._listener: EdgeListener | None = None
        self._told: tuple[object, ...] = ()
        self._away = True
        self._mark_until = 0.0
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._clerk = threading.Thread(target=self._run, name="midspan-yarp-clerk", daemon=True)

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self, listener: EdgeListener) -> None:
        """Join the network when its name server answers."""
        self._listener = listener
        self._contents.now_ns = self.clock.now_ns
        self._clerk.start()

    def stop(self) -> None:
        """Give back everything; see `Edge.stop`."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        self._wake.set()
        self._network.naming.hurry(_LAST_WORDS)
        if self._clerk.is_alive():
            self._clerk.join(2 * _LAST_WORDS)
        self._ports.stop()
        self._presence.close()
        self._network.close()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._turn()
            except (NamingError, OSError) as err:
                self._network.trouble = str(err)
                _log.debug("yarp: %s", err)
            except Exception:
                _log.exception("yarp: following the network failed")
            self._wake.wait(self._poll)
            self._wake.clear()
            self._stopping.wait(_SETTLE)

    def _turn(self) -> None:
        started, peers = time.monotonic(), self._ports.peers()  # before the list, which then has them all
        contacts = self._network.look()
        if contacts is None:
            self._away = True
            return
        found = {contact.name: contact for contact in contacts}
        if not self._presence.is_open:
            self._ports.bury(found, self._names)
            self._presence.open()
        self._ports.leave_taken(found)
        returned = self._away or started < self._mark_until
        if self._away:
            self._away, self._mark_until = False, started + _MARK_AGAIN
        if returned:
            self._presence.mark()
        self._ports.mark_again(found, returned=returned)
        self._graph.update(self._network.naming, contacts, peers)
        self._presence.look(self._graph.contacts, started)
        self._follow()
        told, self._told = self._told, (self.network(), *self.endpoints())
        if told != self._told and self._listener is not None:
            self._listener.graph_changed()

    def _follow(self) -> None:
        """Have the ports that what is routed needs."""
        with self._lock:
            outputs, heard = dict(self._outputs), dict(self._heard)
        served = self._services.served()
        plan = make_plan(
            [self._wanted(topic, output.side_type) for topic, output in outputs.items()],
            [self._wanted(subscription.topic, subscription.side_type) for subscription in heard.values()],
            self._contents,
            self._names,
            self._graph,
        )
        self._ports.follow(plan | self._services.plan(self._names, served), outputs, served)
        self._ports.look_for_callers()
        for inlet in self._ports.inlets():
            self._let_hear(inlet)
        self._ports.connect()

    def _let_hear(self, inlet: Inlet) -> None:
        """Give an input port to whoever hears its topic now: several threads may find that out at once."""
        with self._lock:
            subscription = self._heard.get((inlet.topic, inlet.type))
            inlet.hear(None if subscription is None else subscription.deliver)
        inlet.release()

    def _wanted(self, topic: str, side_type: SideType) -> Wanted:
        known = self._registry.ros2(side_type.name).type_id
        return Wanted(topic, side_type.name, "" if side_type.type_id == known else side_type.type_id)

    def _wake_up(self) -> None:
        self._wake.set()
        if self._listener is not None:
            self._listener.graph_changed()

    def _presence_changed(self) -> None:
        if self._listener is not None:
            self._listener.presence_changed()

    def _refused(self, topic: str, reason: str, why: str) -> None:
        if self._listener is not None:
            self._listener.message_refused(topic, reason, why)

    # -- the network ---------------------------------------------------------------------------------------------------

    def network(self) -> str | None:
        """The network's name, which stands at its name server; it stays while that one is away."""
        return self._network.identity if self._presence.is_open else None

    def is_own_network(self, origin: Origin) -> bool:
        """See `Edge.is_own_network`."""
        return origin.side == self.side and origin.network == self._network.identity

    def announce(self, record: bytes) -> None:
        """See `Edge.announce`."""
        self._presence.announce(record)

    def sightings(self) -> Sequence[Sighting]:
        """See `Edge.sightings`."""
        return self._presence.sightings()

    def settled(self, since: float) -> bool:
        """See `Edge.settled`: the name server was asked for all since then."""
        if self._presence.is_open and self._presence.settled(since):
            return True
        self._wake.set()
        return False

    def _awake(self, owner: str) -> bool:
        now = time.monotonic()
        sightings = self._presence.sightings()
        return any(s.id == PRESENCE + owner and s.record is not None and now - s.heard < _AWAKE for s in sightings)

    def warnings(self) -> list[str]:
        """The name server that is away, ports that cannot be opened or connected, types that are unknown."""
        away = [f"the YARP network: {self._network.trouble}"] if self._network.trouble else []
        untyped = [
            f"{node.port} does not tell its type; give one: yarp.topics, topic {node.topic}"
            for node in self._endpoints.untyped()
        ]
        return [*away, *self._ports.warnings(), *sorted(self._graph.trouble.values()), *untyped]

    def details(self) -> dict[str, Any]:
        """The ports: what they carry, and who is connected."""
        return {"ports": self._ports.shown()}

    # -- the graph -----------------------------------------------------------------------------------------------------

    def endpoints(self) -> Sequence[Endpoint]:
        """See `Endpoints`."""
        return self._endpoints.all()

    # -- types ---------------------------------------------------------------------------------------------------------

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """The edge itself converts what comes: each port may carry something else."""
        known = self._side_type(endpoint.type, endpoint.type_id)
        return Conversion(known, known, None)

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """The message is checked; what each port carries is made of it when it is written."""
        known = self._side_type(type_name, type_hash)
        return Conversion(known, known, self._registry.hub_check(type_name, type_hash))

    def _side_type(self, type_name: str, type_hash: str) -> SideType:
        if type_hash:
            schema = self._registry.schema(type_name, type_hash)
            return SideType(type_name, type_hash, full_text(schema))
        return self._registry.ros2(type_name)

    def learn(self, type_name: str, definition: str) -> None:
        """See `Edge.learn`."""
        self._registry.learn_ros2(type_name, definition)

    def why_not(self, topic: str, type_name: str) -> str:  # noqa: ARG002
        """An action's parts are not for YARP programs one by one."""
        return "a part of an action; YARP programs have other ports for goals" if split(topic)[1] else ""

    # -- services ------------------------------------------------------------------------------------------------------

    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """The edge itself converts what is asked and answered: each port may carry something else."""
        return self._services.conversion(endpoint.type)

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """See `service_to_hub`."""
        return self._services.conversion(type_name, type_hash)

    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        """Call the RPC port that a rule names."""
        return self._services.caller(name, side_type)

    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Serve a service by an RPC port, which is opened as soon as the name server takes it."""
        return self._services.serve(name, side_type, call)

    # -- endpoints of ours ---------------------------------------------------------------------------------------------

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:  # noqa: ARG002
        """Hear a topic's ports."""
        subscription = _Subscription(self, topic, side_type, deliver)
        with self._lock:
            self._heard[topic, side_type.name] = subscription
        for inlet in self._ports.inlets():
            if (inlet.topic, inlet.type) == (topic, side_type.name):
                self._let_hear(inlet)
        self._wake.set()
        return subscription

    def unsubscribe(self, subscription: _Subscription) -> None:
        """A subscription is closed."""
        key = subscription.topic, subscription.side_type.name
        with self._lock:
            if self._heard.get(key) is not subscription:
                return
            del self._heard[key]
        for inlet in self._ports.inlets():
            if (inlet.topic, inlet.type) == key:
                self._let_hear(inlet)
        self._wake.set()

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:
        """Publish a topic; its ports are opened as soon as the name server takes them."""
        content = self._contents.of(topic)
        known = self._wanted(topic, side_type)
        self._contents.codec(content, side_type.name, known.type_hash, content.profile)
        with self._lock:
            output = self._outputs.get(topic)
            if output is None:
                stamped = is_stamped(self._registry.schema(side_type.name, known.type_hash))
                output = self._outputs[topic] = TopicOutput(topic, side_type, stamped, self._contents)
            elif output.side_type != side_type:
                msg = f"{topic} is {output.side_type.name} on YARP already"
                raise MessageTypeError(msg, "rename one of the topics by a rule")
            publisher = output.publisher(qos, self._closed)
        self._wake.set()
        return publisher

    def _closed(self, publisher: TopicPublisher) -> None:
        output = publisher.output
        with self._lock:
            if output.remove(publisher) and self._outputs.get(output.topic) is output:
                del self._outputs[output.topic]
        self._wake.set()


class _Subscription:
    """See `EdgeSubscription`."""

    lost = 0

    def __init__(self, edge: YarpEdge, topic: str, side_type: SideType, deliver: Deliver) -> None:
        self._edge = edge
        self.topic, self.side_type, self.deliver = topic, side_type, deliver

    def close(self) -> None:
        """Stop delivering. Safe to call twice."""
        self._edge.unsubscribe(self)


def _owner(file: Path) -> str:
    """The id of this daemon's YARP worker, the same after a restart."""
    try:
        known = file.read_text().strip()
    except OSError:
        known = ""
    if len(known) != 12 or not known.isalnum():
        known = uuid.uuid4().hex[:12]
        keep(file, known + "\n", "ports that a killed worker leaves at the name server will stay there for a while")
    return known
