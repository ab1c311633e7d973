"""The ports that the bridge opens and connects, derived from routes and graph, and their status document."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from bridge.adapters.yarp.contents import BOTTLE, Contents
from bridge.adapters.yarp.graph import YarpGraph
from bridge.adapters.yarp.network import PortNames
from bridge.messages.yarp.contents import Content
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.profile import Profile


@dataclass(frozen=True, slots=True)
class PlannedLink:
    """A planned connection; a ``carrier`` of "" is the default, a ``profile`` of None is what the peer announces."""

    carrier: str = ""
    profile: Profile | None = None


@dataclass(frozen=True, slots=True)
class PortPlan:
    """One port of the bridge.

    Attributes:
        writes: True for an output of its topic, False for an input.
        type: ROS 2 name.
        type_hash: "" for this machine's definition of the type.
        own: True for the topic's main port, open to any peer; False for a port that serves only the peers in ``links``.
        source: id of the endpoint to which messages are attributed; None attributes them to the sending peers.
        reply: content of the reply if the port serves a service; then ``topic`` is the service's name, and ``content``
            the content of the request.
    """

    name: str
    writes: bool
    topic: str
    type: str
    type_hash: str
    content: Content
    own: bool = True
    source: str | None = None
    links: Mapping[str, PlannedLink] = field(default_factory=dict, compare=False, hash=False)
    reply: Content | None = None

    @property
    def rpc(self) -> bool:
        """Whether the port serves a service."""
        return self.reply is not None


@dataclass(frozen=True, slots=True)
class RoutedTopic:
    """A routed topic; ``type_hash`` is "" for this machine's definition of the type."""

    topic: str
    type: str
    type_hash: str


def make_plan(
    outputs: Iterable[RoutedTopic], inputs: Iterable[RoutedTopic], contents: Contents, names: PortNames,
    graph: YarpGraph,
) -> dict[str, PortPlan]:  # fmt: skip
    """Return the ports by name for the topics that the bridge publishes (``outputs``) or reads (``inputs``) on YARP."""
    plan: dict[str, PortPlan] = {}
    for routed in outputs:
        for port in (*_outputs(routed, contents, names, graph), _input(routed, contents, names, None)):
            plan.setdefault(port.name, port)
    for routed in inputs:
        for port in _inputs(routed, contents, names, graph):
            plan[port.name] = port
    return plan


def _outputs(routed: RoutedTopic, contents: Contents, names: PortNames, graph: YarpGraph) -> Iterable[PortPlan]:
    topic, content = routed.topic, contents.of_topic(routed.topic)
    links: dict[str, PlannedLink] = {}
    nodes = {
        node.port: PlannedLink()
        for node in graph.nodes
        if not node.publishes and node.topic == topic and node.type in ("", routed.type)
    }
    for port in contents.outgoing:
        if port.topic != topic or port.type not in ("", routed.type):
            continue
        link = PlannedLink(port.carrier, port.profile)
        if _same(port.content, content):
            links[port.port] = link
        else:
            yield _output(routed, names.output(f"{topic}/to{port.port}"), port.content, {port.port: link}, own=False)
    if _same(content, BOTTLE):
        links |= nodes
    elif nodes:
        yield _output(routed, names.output(f"{topic}/nodes"), BOTTLE, nodes, own=False)
    yield _output(routed, names.output(topic), content, links)


def _output(
    routed: RoutedTopic, name: str, content: Content, links: Mapping[str, PlannedLink], *, own: bool = True
) -> PortPlan:
    return PortPlan(name, True, routed.topic, routed.type, routed.type_hash, content, own, links=links)


def _input(routed: RoutedTopic, contents: Contents, names: PortNames, source: str | None) -> PortPlan:
    content = contents.of_topic(routed.topic)
    name = names.input(routed.topic)
    return PortPlan(name, False, routed.topic, routed.type, routed.type_hash, content, source=source)


def _inputs(routed: RoutedTopic, contents: Contents, names: PortNames, graph: YarpGraph) -> Iterable[PortPlan]:
    topic = routed.topic
    declared = any(rule.topic == topic and rule.type == routed.type for rule in contents.declared)
    yield _input(routed, contents, names, names.input(topic) if declared else None)
    for port in contents.incoming:
        if port.topic == topic and port.type == routed.type and graph.is_present(port.port):
            name = names.input(f"{topic}/from{port.port}")
            links = {port.port: PlannedLink(port.carrier, port.profile)}
            yield PortPlan(name, False, topic, routed.type, routed.type_hash, port.content, False, port.port, links)
    nodes = {
        node.port: PlannedLink()
        for node in graph.nodes
        if node.publishes and node.topic == topic and node.type in ("", routed.type) and graph.is_present(node.port)
    }
    if nodes:
        name = names.input(f"{topic}/nodes")
        yield PortPlan(name, False, topic, routed.type, routed.type_hash, BOTTLE, False, links=nodes)


def _same(first: Content, second: Content) -> bool:
    """Return whether two contents are equal apart from the profile."""
    return (first.form, first.fields, first.missing) == (second.form, second.fields, second.missing)


def status_of(plan: PortPlan, core: PortCore) -> dict[str, Any]:
    """Return the port's entry in the worker's status document."""
    connections = core.connections.outputs if plan.writes else core.connections.inputs
    peers = []
    for connection in connections:
        name = connection.route.target if plan.writes else connection.route.source
        peer = _peer(name, connection.carrier.name, connection.profile, plan)
        peers.append(peer | _dropped(connection.counters.dropped))
    service = {} if plan.reply is None else {"direction": "rpc", "replies": plan.reply.shown(plan.type)}
    return {
        "port": core.name,
        "direction": "out" if plan.writes else "in",
        "topic": plan.topic,
        "type": plan.type,
        "carries": plan.content.shown(plan.type),
        "profile": plan.content.profile.value,
        **_dropped(core.counters.dropped + core.lost),
        "peers": sorted(peers, key=lambda peer: peer["port"]),
        **service,
    }


def _dropped(counted: Counter[str]) -> dict[str, Any]:
    """Return the number of dropped messages by reason, empty if no message was dropped."""
    reasons = {reason: count for reason, count in sorted(counted.items()) if count}
    return {"dropped": reasons} if reasons else {}


def _peer(name: str, carrier: str, announced: Profile | None, plan: PortPlan) -> dict[str, str]:
    link = plan.links.get(name)
    if link is not None and link.profile is not None:
        profile, reason = link.profile, "set by its rule"
    elif announced is not None:
        profile, reason = announced, "announced by the peer"
    else:
        profile, reason = plan.content.profile, "set by yarp.profile; messages in the other profile are detected"
    return {"port": name, "carrier": carrier, "profile": profile.value, "profile_why": reason}
