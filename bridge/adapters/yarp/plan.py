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
        reply: content of the reply if the port serves a service, whose name is then in ``topic``, while ``content`` is
            that of the request.
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
class Wanted:
    """A routed topic; ``type_hash`` is "" for this machine's definition of the type."""

    topic: str
    type: str
    type_hash: str


def make_plan(
    outputs: Iterable[Wanted], inputs: Iterable[Wanted], contents: Contents, names: PortNames, graph: YarpGraph
) -> dict[str, PortPlan]:
    """Return the ports by name for the topics that the bridge publishes (``outputs``) or reads (``inputs``) on YARP."""
    plan: dict[str, PortPlan] = {}
    for wanted in outputs:
        for port in (*_outputs(wanted, contents, names, graph), _input(wanted, contents, names, None)):
            plan.setdefault(port.name, port)
    for wanted in inputs:
        for port in _inputs(wanted, contents, names, graph):
            plan[port.name] = port
    return plan


def _outputs(wanted: Wanted, contents: Contents, names: PortNames, graph: YarpGraph) -> Iterable[PortPlan]:
    topic, content = wanted.topic, contents.of_topic(wanted.topic)
    links: dict[str, PlannedLink] = {}
    nodes = {
        node.port: PlannedLink()
        for node in graph.nodes
        if not node.publishes and node.topic == topic and node.type in ("", wanted.type)
    }
    for port in contents.outgoing:
        if port.topic != topic or port.type not in ("", wanted.type):
            continue
        link = PlannedLink(port.carrier, port.profile)
        if _same(port.content, content):
            links[port.port] = link
        else:
            yield _output(wanted, names.output(f"{topic}/to{port.port}"), port.content, {port.port: link}, own=False)
    if _same(content, BOTTLE):
        links |= nodes
    elif nodes:
        yield _output(wanted, names.output(f"{topic}/nodes"), BOTTLE, nodes, own=False)
    yield _output(wanted, names.output(topic), content, links)


def _output(
    wanted: Wanted, name: str, content: Content, links: Mapping[str, PlannedLink], *, own: bool = True
) -> PortPlan:
    return PortPlan(name, True, wanted.topic, wanted.type, wanted.type_hash, content, own, links=links)


def _input(wanted: Wanted, contents: Contents, names: PortNames, source: str | None) -> PortPlan:
    content = contents.of_topic(wanted.topic)
    name = names.input(wanted.topic)
    return PortPlan(name, False, wanted.topic, wanted.type, wanted.type_hash, content, source=source)


def _inputs(wanted: Wanted, contents: Contents, names: PortNames, graph: YarpGraph) -> Iterable[PortPlan]:
    topic = wanted.topic
    declared = any(rule.topic == topic and rule.type == wanted.type for rule in contents.declared)
    yield _input(wanted, contents, names, names.input(topic) if declared else None)
    for port in contents.incoming:
        if port.topic == topic and port.type == wanted.type and graph.is_present(port.port):
            name = names.input(f"{topic}/from{port.port}")
            links = {port.port: PlannedLink(port.carrier, port.profile)}
            yield PortPlan(name, False, topic, wanted.type, wanted.type_hash, port.content, False, port.port, links)
    nodes = {
        node.port: PlannedLink()
        for node in graph.nodes
        if node.publishes and node.topic == topic and node.type in ("", wanted.type) and graph.is_present(node.port)
    }
    if nodes:
        name = names.input(f"{topic}/nodes")
        yield PortPlan(name, False, topic, wanted.type, wanted.type_hash, BOTTLE, False, links=nodes)


def _same(first: Content, second: Content) -> bool:
    """Return whether two contents are equal apart from the profile."""
    return (first.form, first.fields, first.missing) == (second.form, second.fields, second.missing)


def shown(plan: PortPlan, core: PortCore) -> dict[str, Any]:
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
