"""The ROS 1 edge: what is on the ROS 1 graph, and our endpoints there."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from bridge.adapters.base import (
    Deliver,
    Edge,
    EdgeCaller,
    EdgeListener,
    EdgePublisher,
    EdgeServer,
    EdgeSubscription,
    Endpoint,
    Kind,
    MadeBy,
    Sighting,
)
from bridge.adapters.ros1 import names
from bridge.adapters.ros1.actions import parts
from bridge.adapters.ros1.actions.actions import Actions
from bridge.adapters.ros1.actions.network import Network
from bridge.adapters.ros1.environment import master_uri
from bridge.adapters.ros1.graph import Link, Look
from bridge.adapters.ros1.intake import Intake
from bridge.adapters.ros1.lanes import Lanes
from bridge.adapters.ros1.limits import raise_descriptor_limit
from bridge.adapters.ros1.links import Links
from bridge.adapters.ros1.presence import Ledger, Presence, others
from bridge.adapters.ros1.probe import Facts, Prober
from bridge.adapters.ros1.service import Services
from bridge.config.model import Config
from bridge.hub.call import Call
from bridge.hub.origin import Origin
from bridge.hub.qos import Durability, Qos
from bridge.messages.conversion import Conversion, ServiceConversion, SideType
from bridge.messages.registry import Registry

if TYPE_CHECKING:
    from bridge.adapters.ros1.master import Master
    from bridge.adapters.ros1.node import Node
    from bridge.adapters.ros1.parameters.follower import Parameters
    from bridge.adapters.ros1.publisher import Publisher
    from bridge.adapters.ros1.subscription import Subscription
    from bridge.config.sections.parameters import ParameterRule
    from bridge.hub.session import Hub

_log = logging.getLogger(__name__)

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_VOLATILE = Qos()
_CHECK_PERIOD = 2.0
"""Seconds between two looks for connections whose peers are gone; a look asks the system for each topic."""


class Ros1Edge(Edge):
    """Joins one ROS 1 graph. rospy is one per process, and so is this edge; once stopped it does not start again."""

    side: ClassVar[str] = "ros1"
    services: ClassVar[bool] = True

    def __init__(self, config: Config, registry: Registry, state: Path) -> None:
        self._config, self._registry = config, registry
        self._ledger = Ledger(state)
        self._lanes = Lanes()
        self._intake: Intake | None = None
        self._prober = Prober(self._lanes, self._caller, self._probed)
        self._names = names.NameTable()
        self._lock = threading.Lock()
        self._following = threading.Lock()  # what was known before must not be followed after what is known now
        self._look: Look | None = None
        self._publishers: frozenset[Link] = frozenset()
        self._check_due = 0.0
        self._subscriptions: set[_Open] = set()
        self._links = Links(self._caller, self._presence_changed, self._wake_master)
        self._services = Services(
            self._lanes, self._caller, config.name,
            found=self._graph_changed, wake=self._wake_master, doubt=self._doubt_service,
            limit=config.limits.message_bytes,
        )  # fmt: skip
        check = config.ros1.goal_frames == "check"
        self._actions = Actions(Network(
            self._caller, self._prober.facts, registry, lambda: self.clock, self._hear, self._tell, self._refuse, check
        ))  # fmt: skip
        self._settled = float("-inf")
        self._listener: EdgeListener | None = None
        self._node: Node | None = None
        self._master: Master | None = None
        self._parameters: Parameters | None = None
        self._stopped = False

    # -- life ----------------------------------------------------------------------------------------------------------

    def start(self, listener: EdgeListener) -> None:
        """Put our node up and begin to look for the master; see `Edge.start`."""
        for logger in ("rospy", "rosout", "xmlrpc"):
            logging.getLogger(logger).setLevel(logging.WARNING)
        from bridge.adapters.ros1.master import Master
        from bridge.adapters.ros1.node import Node

        raise_descriptor_limit()
        self._listener = listener
        self._intake = Intake() if Intake.available() else None
        uri = master_uri(self._config, os.environ)
        name = "/" + self._config.ros1.node.strip("/")
        servers = self._services.servers
        self._node = Node(name, uri, self._wake_master, self._asked_to_stop, self._links.admit, servers)
        period, daemon = self._config.ros1.poll, self._config.name
        self._master = Master(
            uri, self._node, daemon, self._ledger, period, self._seen, listener.edge_failed, self._services.is_gone,
            simulated=self._config.clock.simulated,
        )  # fmt: skip
        self._master.start()

    def stop(self) -> None:
        """Unregister everything and close; see `Edge.stop`."""
        with self._lock:
            if self._stopped:
                return
            self._stopped = True
            subscriptions, self._subscriptions = list(self._subscriptions), set()
        self._links.close()
        if self._master is not None:
            self._master.stop()
        self._services.stop()
        self._actions.stop()
        for opened in subscriptions:
            opened.close()
        if self._intake is not None:
            self._intake.stop()
        self._lanes.stop()
        if self._node is not None:
            self._node.stop()
        self._look = None

    def _caller(self) -> str:
        return self._node.name if self._node is not None else "/midspan"

    def _asked_to_stop(self, reason: str) -> None:
        if self._master is not None and self._listener is not None:
            self._master.evicted()
            self._listener.edge_failed(reason)

    def _wake_master(self) -> None:
        if self._master is not None:
            self._master.wake()

    def _doubt_service(self, name: str) -> None:
        if self._master is not None:
            self._master.doubt(name)

    # -- the graph -----------------------------------------------------------------------------------------------------

    def network(self) -> str | None:
        """The master's run id, None while it is away."""
        look = self._look
        return look.network if look is not None else None

    def is_own_network(self, origin: Origin) -> bool:
        """Whether an origin is the very master that we are joined to."""
        return origin.side == self.side and origin.network == self.network()

    def endpoints(self) -> Sequence[Endpoint]:
        """The other nodes' publishers, subscriptions and servers; ROS 1 knows nothing of clients.

        The topics of actions are shown as the parts of ROS 2 actions.
        """
        look = self._look
        if look is None:
            return ()
        own, facts = self._caller(), self._prober.facts()
        found = [self._publisher(link, look, facts.get(link)) for link in look.publishers if link.node != own]
        found += [self._subscriber(link, look) for link in look.subscribers if link.node != own]
        found = [e for e in found if not self._actions.is_part(e.topic, e.type)]
        return [*found, *self._services.endpoints(look), *self._actions.endpoints()]

    def is_heard(self, topic: str) -> bool:
        """See `Edge.is_heard`; asked each second, so without making endpoints of everything."""
        look, own = self._look, self._caller()
        return look is not None and any(s.topic == topic and s.node != own for s in look.subscribers)

    def others(self) -> Sequence[Presence]:
        """Other nodes of Midspan's on this network that are alive, in the order of their names."""
        return self._links.living()

    def announce(self, record: bytes) -> None:
        """See `Edge.announce`."""
        self._links.announce(record)

    def sightings(self) -> Sequence[Sighting]:
        """See `Edge.sightings`."""
        return self._links.sightings()

    def settled(self, since: float) -> bool:
        """Whether we have looked at the master since then, with our own entry on it: who came later sees that one."""
        if self._settled < since:
            self._wake_master()
            return False
        return True

    def warnings(self) -> list[str]:
        """What a person should know of this side."""
        warnings = []
        if self._look is None and self._master is not None and self._master.trouble:
            warnings.append(f"no ROS 1 master: {self._master.trouble}")
        if self._master is not None and self._master.simulated and not self._config.clock.simulated:
            warnings.append(
                "the ROS 1 nodes run on /clock (parameter /use_sim_time) and this daemon on the machine's clock: set"
                " clock.source to sim, or the parameter to false"
            )
        for link, trouble in sorted(self._prober.troubles().items()):
            warnings.append(f"{link.topic}: its publisher {link.node} does not tell its type: {trouble}")
        heard = {(s.topic, s.node) for s in self._look.subscribers} if self._look is not None else set()
        turned_away = self._node.turned_away() if self._node is not None else {}
        for (topic, node), why in sorted(turned_away.items()):
            if (topic, node) in heard:
                warnings.append(f"{topic}: {node} does not hear us: {why}")
        return [*warnings, *self._services.warnings(), *self._actions.warnings(), *self._parameter_warnings()]

    @staticmethod
    def _publisher(link: Link, look: Look, facts: Facts | None) -> Endpoint:
        from bridge.adapters.ros1.subscription import publisher_id

        if facts is None:
            type_, qos, made_by, md5, definition = look.types.get(link.topic, ""), _VOLATILE, MadeBy.UNKNOWN, "", ""
        else:
            type_, md5, definition = facts.type, facts.md5, facts.definition
            qos = _LATCHED if facts.latching else _VOLATILE
            made_by = MadeBy.NATIVE if facts.native else MadeBy.MIDSPAN
        name = publisher_id(link, latching=qos.latched)
        return Endpoint(name, Kind.PUBLISHER, link.topic, type_, qos, made_by, link.node, md5, definition)

    @staticmethod
    def _subscriber(link: Link, look: Look) -> Endpoint:
        made_by = MadeBy.MIDSPAN if any(p.get("node") == link.node for p in look.presence.values()) else MadeBy.NATIVE
        name = f"subscription {link.topic} {link.node} {link.uri}"
        type_ = look.types.get(link.topic, "").replace("*", "")
        return Endpoint(name, Kind.SUBSCRIPTION, link.topic, type_, _VOLATILE, made_by, link.node)

    def _seen(self, look: Look | None) -> None:
        """One look at the master; called on its thread."""
        assert self._node is not None
        if self._stopped:
            return
        changed = look is not self._look
        self._look = look
        if changed:
            publishers = frozenset(p for p in look.publishers if p.node != self._node.name) if look else frozenset()
            self._publishers = publishers
            self._actions.seen(look)
            links = publishers | look.subscribers | look.servers if look else frozenset()
            self._names.learn({k.topic for k in links} | self._actions.names())
            self._lanes.forget({k.uri for k in publishers | (look.servers if look else frozenset())})
        if changed or self._prober.waiting:
            self._prober.follow(self._publishers)
        with self._lock:
            restless = any(opened.subscription.restless for opened in self._subscriptions)
        if changed or restless:
            self._follow_subscriptions()
        self._services.seen(look)
        if time.monotonic() >= self._check_due:
            self._check_due = time.monotonic() + _CHECK_PERIOD
            self._node.drop_dead_connections()
        self._watch_others(look)
        if changed:
            self._graph_changed()

    def _probed(self, link: Link) -> None:
        self._follow_subscriptions(link.topic)
        self._graph_changed()

    def _graph_changed(self) -> None:
        if self._listener is not None:
            self._listener.graph_changed()

    def _follow_subscriptions(self, topic: str = "") -> None:
        """Have subscriptions follow what is known of the publishers: all, or those of one topic."""
        with self._lock:
            subscriptions = [opened for opened in self._subscriptions if topic in ("", opened.subscription.topic)]
        if not subscriptions:
            return
        with self._following:
            by_topic: dict[str, dict[Link, Facts]] = {}
            for link, facts in self._prober.facts(topic).items():
                by_topic.setdefault(link.topic, {})[link] = facts
            for opened in subscriptions:
                opened.subscription.follow(by_topic.get(opened.subscription.topic, {}))

    def _watch_others(self, look: Look | None) -> None:
        """Follow the entries of the other Midspan nodes; while the master is away the nodes still tell each other."""
        assert self._master is not None
        own = self._master.presence()
        if look is None or Presence.parse(look.presence.get(own.key)) != own:
            self._settled = float("-inf")
            return
        self._links.follow(others(look, own))
        self._settled = self._master.looked
        self._presence_changed()

    def _presence_changed(self) -> None:
        if self._listener is not None:
            self._listener.presence_changed()

    # -- types and names -----------------------------------------------------------------------------------------------

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """See `Edge.to_hub`."""
        if parts.split(endpoint.topic, endpoint.type):
            self._actions.learn(endpoint.topic)
        return self._registry.ros1_to_hub(endpoint.type, endpoint.type_id, endpoint.definition)

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """See `Edge.from_hub`."""
        return self._registry.hub_to_ros1(type_name, type_hash)

    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """See `Edge.service_to_hub`."""
        if parts.split(endpoint.topic, endpoint.type):
            self._actions.learn(endpoint.topic)
        return self._registry.service_ros1_to_hub(endpoint.type, endpoint.type_id)

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """See `Edge.service_from_hub`."""
        return self._registry.service_hub_to_ros1(type_name, type_hash)

    def learn(self, type_name: str, definition: str) -> None:
        """See `Edge.learn`."""
        self._registry.learn_ros2(type_name, definition)

    def side_name(self, hub_name: str) -> str:
        """The ROS 1 spelling of a hub topic name; see `bridge.adapters.ros1.names`."""
        return self._names.side_name(hub_name)

    def hub_name(self, side_name: str) -> str:
        """The hub's spelling of a ROS 1 topic name; see `bridge.adapters.ros1.names`."""
        return names.hub_name(side_name)

    # -- our endpoints -------------------------------------------------------------------------------------------------

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:  # noqa: ARG002
        """Hear the native publishers of a topic that have this type; ROS 1 has no QoS to ask for."""
        part = parts.split(topic, side_type.name)
        return (
            self._actions.subscribe(*part, side_type.name, deliver) if part else self._hear(topic, side_type, deliver)
        )

    def _hear(self, topic: str, side_type: SideType, deliver: Deliver, suffix: str = "") -> _Open:
        from bridge.adapters.ros1.subscription import Subscription

        subscription = Subscription(
            topic, side_type.type_id, deliver,
            lanes=self._lanes, caller=lambda: self._caller() + suffix,
            doubt=self._prober.doubt, learned=self._prober.learned,
            refused=lambda reason, why: self._refuse(topic, reason, why), limit=self._config.limits.message_bytes,
            intake=self._intake,
        )  # fmt: skip
        opened = _Open(self, subscription)
        with self._lock:
            self._subscriptions.add(opened)
        self._follow_subscriptions(topic)
        return opened

    def _refuse(self, topic: str, reason: str, why: str) -> None:
        if self._listener is not None:
            self._listener.message_refused(topic, reason, why)

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:
        """Publish on a topic; latched QoS keeps the last ``depth`` messages of each source for late joiners."""
        part = parts.split(topic, side_type.name)
        return self._actions.advertise(*part) if part else self._tell(topic, side_type, qos)

    def _tell(self, topic: str, side_type: SideType, qos: Qos) -> Publisher:
        from bridge.adapters.ros1.publisher import Publisher

        return Publisher(topic, side_type, qos, self._config.name)

    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        """Calls the native server of a service, over persistent connections; see `Edge.caller`."""
        part = parts.split(name, side_type.name)
        return self._actions.caller(*part, side_type.name) if part else self._services.caller(name, side_type)

    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Serve a service; a native server of the name keeps it, see `Edge.serve`."""
        part = parts.split(name, side_type.name)
        if part:
            return self._actions.serve(*part, side_type.name, call)
        return self._services.servers.open(name, side_type, call)

    def carry_parameters(
        self, rules: Sequence[ParameterRule], hub: Hub, active: Callable[[], bool]
    ) -> Callable[[], None]:
        """Carry them between the master's parameter server and the hub; see `Edge.carry_parameters`."""
        self._parameters = None
        if not rules or self._node is None or self._master is None:
            return super().carry_parameters(rules, hub, active)
        from bridge.adapters.ros1.parameters.follower import Parameters
        from bridge.adapters.ros1.parameters.store import Store

        store = Store(self._master.uri, self._caller, self._node.uri)
        self._parameters = Parameters(rules, hub, self._registry, store, active)
        self._node.hear_parameters(self._parameters.changed)
        return self._parameters.stop

    def details(self) -> dict[str, Any]:
        """The shared parameters."""
        return {} if self._parameters is None else {"parameters": self._parameters.details()}

    def _parameter_warnings(self) -> list[str]:
        return [] if self._parameters is None else self._parameters.warnings()

    def closed(self, opened: _Open) -> None:
        """A subscription was given back."""
        with self._lock:
            self._subscriptions.discard(opened)


class _Open:
    """An open subscription, as the engine holds it."""

    def __init__(self, edge: Ros1Edge, subscription: Subscription) -> None:
        self._edge, self.subscription = edge, subscription

    @property
    def lost(self) -> int:
        """TCP loses nothing, and a publisher does not tell what its queue dropped."""
        return 0

    @property
    def connected(self) -> frozenset[Link]:
        """The publishers that are heard now."""
        return self.subscription.connected

    def close(self) -> None:
        """Stop delivering and give the registration back."""
        self._edge.closed(self)
        with contextlib.suppress(RuntimeError):
            self.subscription.close()
