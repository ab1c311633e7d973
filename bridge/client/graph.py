"""Views of topics, services and actions: the hub's graph, and the workers' decisions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from typing_extensions import override

from bridge.client.errors import ClientError
from bridge.client.session import Client
from bridge.client.types import ros2_spelling
from bridge.hub.control import WorkerAnswer
from bridge.hub.graph import HubEndpoint, origin_side
from bridge.hub.graph.owners import owner
from bridge.hub.graph.releases import endpoint_releases
from bridge.hub.graph.tokens import TAPS, EndpointKind
from bridge.messages.actions import split
from bridge.messages.releases import release_text
from bridge.routing.limits import qos_text
from bridge.status import StatusDocument
from bridge.text import arrow, clean, near, side_name

Kind = Literal["topic", "service", "action"]

_PROVIDERS = (EndpointKind.PUBLISHER, EndpointKind.SERVER)


@dataclass(frozen=True, slots=True)
class Decision:
    """One worker's decision on a topic, with the fields of the reply to ``explain``."""

    daemon: str
    worker: str
    direction: str
    topic: str
    hub_topic: str
    type: str
    decision: str
    why: str
    cure: str
    users: tuple[str, ...] = ()
    """The side's nodes with their middleware and release, in words."""

    def as_dict(self) -> dict[str, Any]:
        """Return the object for ``--json``."""
        return {name: getattr(self, name) for name in self.__slots__}

    @override
    def __str__(self) -> str:
        return f"{arrow(self.worker, self.direction)}: {clean(self.decision)}: {clean(self.why)}"


_TEXTS = ("direction", "topic", "hub_topic", "type", "decision", "why", "cure")
_MOST_USERS = 100


@dataclass(slots=True)
class GraphView:
    """One topic, service or action with its endpoints on the hub; an action is known by its ``send_goal`` service."""

    kind: Kind
    name: str
    types: set[str] = field(default_factory=set)
    providers: list[HubEndpoint] = field(default_factory=list)
    users: list[HubEndpoint] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)

    def add(self, item: HubEndpoint | Decision, type_name: str) -> None:
        """Add an endpoint or a decision, and its type unless that is empty."""
        if isinstance(item, Decision):
            self.decisions.append(item)
        else:
            (self.providers if item.kind in _PROVIDERS else self.users).append(item)
        self.types |= {type_name} - {""}

    @property
    def ends(self) -> dict[str, list[HubEndpoint]]:
        """Return the endpoints under the names that ROS uses for this kind."""
        providers, users = ("publishers", "subscriptions") if self.kind == "topic" else ("servers", "clients")
        return {providers: self.providers, users: self.users}

    @property
    def sides(self) -> list[str]:
        """Return the sides that the topic, service or action comes from."""
        decided = {d.worker for d in self.decisions if d.direction == "in" and d.decision != "own"}
        return sorted({origin_side(endpoint) for endpoint in self.providers} | decided)

    @property
    def state(self) -> str:
        """Return ``hub`` if usable on the hub, else the workers' decisions, else ``no server`` or, for a topic, ""."""
        if self.providers or (self.users and self.kind == "topic"):
            return "hub"
        decided = ", ".join(sorted({d.decision for d in self.decisions}))
        return decided if decided or self.kind == "topic" else "no server"

    def as_dict(self) -> dict[str, Any]:
        """Return the object for ``--json``."""
        return {
            self.kind: self.name,
            "types": sorted(self.types),
            "from": self.sides,
            **{role: len(endpoints) for role, endpoints in self.ends.items()},
            "state": self.state,
            "decisions": [decision.as_dict() for decision in self.decisions],
        }


Views = dict[str, GraphView]


def absolute(topic: str) -> str:
    """Return the topic's name with its leading slash."""
    return topic if topic.startswith("/") else f"/{topic}"


def ask_decisions(client: Client, topic: str, kind: str | None = "topic") -> list[Decision]:
    """Return all workers' decisions on a topic or service; with ``kind`` None on both, with an empty name on all."""
    return decisions_in(client.ask("explain", {"topic": topic}), kind)


def decisions_in(answers: Iterable[WorkerAnswer], kind: str | None = None) -> list[Decision]:
    """Return the decisions on topics or services (``kind`` None: both) in the workers' answers to ``explain``."""
    decisions: list[Decision] = []
    for answer in answers:
        for entry in answer.value if isinstance(answer.value, list) else ():
            if isinstance(entry, dict) and kind in (None, entry.get("kind", "topic")):
                texts = {name: str(entry.get(name, "")) for name in _TEXTS}
                users = entry.get("users", ())
                texts_of_users = map(str, users[:_MOST_USERS]) if isinstance(users, list) else ()
                decisions.append(Decision(answer.daemon, answer.worker, **texts, users=tuple(texts_of_users)))
    return decisions


def all_topics(client: Client) -> Views:
    """Return every topic of the hub and of the workers' sides, by name."""
    decisions = ask_decisions(client, "")
    client.settle()
    return _topics(client, decisions)


def all_services(client: Client) -> Views:
    """Return every service of the hub and of the workers' sides by name, without the parts of actions."""
    views: Views = {}
    for name, type_name, item in _services_and_parts(client, "srv"):
        if not split(name)[1]:
            views.setdefault(name, GraphView("service", name)).add(item, type_name)
    return views


def all_actions(client: Client) -> Views:
    """Return every action of the hub and of the workers' sides, by name."""
    views: Views = {}
    for part_name, type_name, item in _services_and_parts(client, "action"):
        name, part = split(part_name)
        if part == "send_goal":
            views.setdefault(name, GraphView("action", name)).add(item, type_name.removesuffix("_SendGoal"))
    return views


def _topics(client: Client, decisions: Iterable[Decision]) -> Views:
    views: Views = {}
    for endpoint in _on_hub(client, EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION):
        views.setdefault(endpoint.topic, GraphView("topic", endpoint.topic)).add(endpoint, endpoint.type_name)
    for decision in decisions:
        name = decision.hub_topic if decision.hub_topic in views else decision.topic
        view = views.setdefault(name, GraphView("topic", name))
        view.add(decision, "" if view.state == "hub" else ros2_spelling(decision.type, "msg"))
    return views


def _services_and_parts(client: Client, middle: str) -> Iterator[tuple[str, str, HubEndpoint | Decision]]:
    """Yield name and type of each service, including the parts of actions, with its endpoint or decision."""
    decisions = ask_decisions(client, "", kind="service")
    client.settle()
    for endpoint in _on_hub(client, EndpointKind.SERVER, EndpointKind.CLIENT):
        yield endpoint.topic, endpoint.type_name, endpoint
    for decision in decisions:
        yield decision.hub_topic or decision.topic, ros2_spelling(decision.type, middle), decision


def _on_hub(client: Client, *kinds: EndpointKind) -> Iterator[HubEndpoint]:
    for endpoint in client.endpoints():
        if endpoint.kind in kinds and not endpoint.topic.startswith(TAPS):
            yield endpoint


def known_names(client: Client, documents: Iterable[StatusDocument], decisions: Iterable[Decision]) -> set[str]:
    """Return the names of known topics, for hints."""
    return {*_topics(client, decisions), *(route.topic for document in documents for route in document.routes)}


def find(views: Mapping[str, GraphView], name: str, kind: Kind) -> GraphView:
    """Return the view with a name on the hub or on a side; raises `ClientError` if the name is unknown."""
    name = absolute(name)
    if name in views:
        return views[name]
    for view in views.values():
        if any(name in (d.topic, d.hub_topic) for d in view.decisions):
            return view
    raise ClientError(unknown(kind, name, views))


def unknown(kind: Kind, name: str, names: Iterable[str]) -> str:
    """Return the error for an unknown name, with the names that the user may have meant."""
    meant = near(name, names)
    hint = f" Did you mean {', '.join(meant)}?" if meant else f" 'midspan {kind} list' shows all."
    return f"no {kind} {name} on the hub or on any side.{hint}"


def endpoint_text(endpoint: HubEndpoint) -> str:
    """Return one endpoint as text."""
    if endpoint.origin is None:
        release = release_text(endpoint_releases(endpoint))
        of_release = f", ROS 2 {release}" if release else ""
        owner = "origin not known yet" if endpoint.pending else f"zenoh, on the hub itself{of_release}"
    else:
        owner = f"for {side_name(endpoint.origin.side)}, daemon {endpoint.origin.daemon}"
    return f"{clean(node_name(endpoint))} ({clean(owner)}), {qos_text(endpoint.qos)}, {clean(endpoint.type_name)}"


def endpoint_json(endpoint: HubEndpoint) -> dict[str, Any]:
    """Return one endpoint as a JSON object."""
    origin = endpoint.origin
    return {
        "node": node_name(endpoint),
        "kind": str(endpoint.kind),
        "type": endpoint.type_name,
        "hash": endpoint.type_hash,
        "qos": qos_text(endpoint.qos),
        "gid": endpoint.gid.hex(),
        "zid": endpoint.zid,
        "release": release_text(endpoint_releases(endpoint)) if origin is None and not endpoint.pending else "",
        "side": "zenoh" if origin is None else origin.side,
        "network": None if origin is None else origin.network,
        "daemon": None if origin is None else origin.daemon,
    }


def owners(endpoints: Iterable[HubEndpoint]) -> str:
    """Return the nodes or sides of some endpoints as text."""
    return ", ".join(sorted({owner(endpoint) for endpoint in endpoints}))


def node_name(endpoint: HubEndpoint) -> str:
    """Return the full name of an endpoint's node."""
    return f"{endpoint.namespace.rstrip('/')}/{endpoint.node}"
