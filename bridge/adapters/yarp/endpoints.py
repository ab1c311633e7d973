"""The publishers, subscriptions and servers that the ports of a YARP network represent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bridge.adapters.yarp.graph import NodePort, YarpContext
from bridge.adapters.yarp.ports import OwnPorts
from bridge.adapters.yarp.services import YarpServices
from bridge.adapters.yarp.topics import TopicOutput
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy


class PortEndpoints:
    """The endpoints of other programs on the network."""

    def __init__(
        self, context: YarpContext, ports: OwnPorts, services: YarpServices, outputs: Mapping[str, TopicOutput]
    ) -> None:
        self._names, self._contents, self._graph = context.names, context.contents, context.graph
        self._ports, self._services, self._outputs = ports, services, outputs

    def all(self) -> Sequence[Endpoint]:
        """Return ports in rules, writers to topics' input ports, and ports opened as ``/topic@/node``."""
        return [*self._declared(), *self._rule_ports(), *self._node_ports(), *self._writers(), *self._called_ports()]

    def untyped(self) -> list[NodePort]:
        """Return the node ports whose type is unknown."""
        return [node for node in self._graph.nodes if not self._type_of(node.topic, node.type)]

    def _called_ports(self) -> list[Endpoint]:
        """Return the RPC ports that rules offer as services."""
        return [
            self._endpoint(port, Kind.SERVER, service, type_name, port)
            for port, service, type_name in self._services.called_ports()
            if self._graph.is_present(port)
        ]

    def _declared(self) -> list[Endpoint]:
        return [
            self._endpoint(name := self._names.input(rule.topic), Kind.PUBLISHER, rule.topic, rule.type or "", name)
            for rule in self._contents.declared
        ]

    def _rule_ports(self) -> list[Endpoint]:
        ports = [(Kind.PUBLISHER, port) for port in self._contents.incoming]
        ports += [(Kind.SUBSCRIPTION, port) for port in self._contents.outgoing]
        return [
            self._endpoint(port.port, kind, port.topic, port.type, port.port, latched=port.latched)
            for kind, port in ports
            if self._graph.is_present(port.port)
        ]

    def _node_ports(self) -> list[Endpoint]:
        return [
            self._endpoint(
                node.port,
                Kind.PUBLISHER if node.publishes else Kind.SUBSCRIPTION,
                node.topic,
                type_name,
                node.node,
                latched=node.latched,
            )
            for node in self._graph.nodes
            if self._graph.is_present(node.port) and (type_name := self._type_of(node.topic, node.type))
        ]

    def _writers(self) -> list[Endpoint]:
        endpoints = []
        for plan, peers in self._ports.inputs():
            if plan.source is None:
                endpoints += [
                    self._endpoint(peer, Kind.PUBLISHER, plan.topic, plan.type, peer, made_by, type_id=plan.type_hash)
                    for peer in peers
                    if (made_by := self._ports.made_by(peer)) is not MadeBy.MIDSPAN
                ]
        return endpoints

    def _endpoint(
        self, name: str, kind: Kind, topic: str, type_name: str, node: str, made_by: MadeBy = MadeBy.NATIVE, *,
        latched: bool = False, type_id: str = "",
    ) -> Endpoint:  # fmt: skip
        qos = LATCHED if latched or self._contents.latched(topic) else Qos()
        return Endpoint(name, kind, topic, type_name, qos, made_by, node, type_id)

    def _type_of(self, topic: str, named: str) -> str:
        """Return the type of a node's port: ``named``, which it announces, else its topic's, by a rule or route."""
        if named:
            return named
        rule = next((rule for rule in self._contents.declared if rule.topic == topic), None)
        if rule is not None and rule.type is not None:
            return rule.type
        output = self._outputs.get(topic)
        return "" if output is None else output.side_type.name
