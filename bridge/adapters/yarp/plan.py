"""Which ports the bridge is to have, and whom they are to be connected with: from what is routed and what is there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from bridge.adapters.yarp.contents import BOTTLE, Contents
from bridge.adapters.yarp.graph import Graph
from bridge.adapters.yarp.names import PortNames
from bridge.messages.yarp.contents import Content
from yarp_compat.wire.profile import Profile


@dataclass(frozen=True, slots=True)
class Link:
    """A connection that is to be made.

    Attributes:
        carrier: "" for the usual one.
        profile: the other port's, None for what it says itself.
    """

    carrier: str = ""
    profile: Profile | None = None


@dataclass(frozen=True, slots=True)
class PortPlan:
    """One port of ours.

    Attributes:
        writes: it is an output of its topic; else an input.
        type: ROS 2 name; with the hash where it is not this machine's own definition.
        own: whether it is the topic's own port, to which anybody connects; else the ports in ``links`` alone count.
        source: the id of the endpoint that its messages count as, None for that of each peer.
        reply: what it answers, for a service; ``topic`` is its name then, and ``content`` what it is asked.
    """

    name: str
    writes: bool
    topic: str
    type: str
    type_hash: str
    content: Content
    own: bool = True
    source: str | None = None
    links: Mapping[str, Link] = field(default_factory=dict, compare=False, hash=False)
    reply: Content | None = None

    @property
    def rpc(self) -> bool:
        """Whether it answers."""
        return self.reply is not None


@dataclass(frozen=True, slots=True)
class Wanted:
    """A topic that is routed.

    Attributes:
        type: ROS 2 name.
        type_hash: its hash, "" for this machine's own definition.
    """

    topic: str
    type: str
    type_hash: str


def make_plan(
    outputs: Iterable[Wanted], inputs: Iterable[Wanted], contents: Contents, names: PortNames, graph: Graph
) -> dict[str, PortPlan]:
    """The ports by name.

    Args:
        outputs: topics that are published on YARP.
        inputs: topics that are heard there.
        contents: the rules.
        names: the scheme.
        graph: what is on the network.
    """
    plan: dict[str, PortPlan] = {}
    for wanted in outputs:
        for port in (*_outputs(wanted, contents, names, graph), _input(wanted, contents, names, None)):
            plan.setdefault(port.name, port)
    for wanted in inputs:
        for port in _inputs(wanted, contents, names, graph):
            plan[port.name] = port
    return plan


def _outputs(wanted: Wanted, contents: Contents, names: PortNames, graph: Graph) -> Iterable[PortPlan]:
    topic, own = wanted.topic, contents.of(wanted.topic)
    links: dict[str, Link] = {}
    nodes = {
        node.port: Link()
        for node in graph.nodes
        if not node.publishes and node.topic == topic and node.type in ("", wanted.type)
    }
    for port in contents.outgoing:
        if port.topic != topic or port.type not in ("", wanted.type):
            continue
        link = Link(port.carrier, port.profile)
        if _same(port.content, own):
            links[port.port] = link
        else:
            yield _output(wanted, names.output_to(topic, port.port), port.content, {port.port: link}, own=False)
    if _same(own, BOTTLE):
        links |= nodes
    elif nodes:
        yield _output(wanted, names.output_to_nodes(topic), BOTTLE, nodes, own=False)
    yield _output(wanted, names.output(topic), own, links)


def _output(wanted: Wanted, name: str, content: Content, links: Mapping[str, Link], *, own: bool = True) -> PortPlan:
    return PortPlan(name, True, wanted.topic, wanted.type, wanted.type_hash, content, own, links=links)


def _input(wanted: Wanted, contents: Contents, names: PortNames, source: str | None) -> PortPlan:
    content = contents.of(wanted.topic)
    name = names.input(wanted.topic)
    return PortPlan(name, False, wanted.topic, wanted.type, wanted.type_hash, content, source=source)


def _inputs(wanted: Wanted, contents: Contents, names: PortNames, graph: Graph) -> Iterable[PortPlan]:
    topic = wanted.topic
    declared = any(rule.topic == topic and rule.type == wanted.type for rule in contents.declared)
    yield _input(wanted, contents, names, names.input(topic) if declared else None)
    for port in contents.incoming:
        if port.topic == topic and port.type == wanted.type and graph.is_there(port.port):
            name = names.input_from(topic, port.port)
            links = {port.port: Link(port.carrier, port.profile)}
            yield PortPlan(name, False, topic, wanted.type, wanted.type_hash, port.content, False, port.port, links)
    nodes = {
        node.port: Link()
        for node in graph.nodes
        if node.publishes and node.topic == topic and node.type in ("", wanted.type) and graph.is_there(node.port)
    }
    if nodes:
        name = names.input_from_nodes(topic)
        yield PortPlan(name, False, topic, wanted.type, wanted.type_hash, BOTTLE, False, links=nodes)


def _same(one: Content, other: Content) -> bool:
    """Whether two contents are one but for the profile."""
    return (one.form, one.fields, one.missing) == (other.form, other.fields, other.missing)
