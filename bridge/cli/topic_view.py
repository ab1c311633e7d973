"""What is known of topics: from the hub's graph, and from the workers' decisions on their sides' topics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from bridge.cli.hubclient import Client
from bridge.cli.routes_table import route_list
from bridge.hub.graph import HubEndpoint
from bridge.hub.liveliness import EndpointKind
from bridge.messages.names import is_ros1_name
from bridge.routing.guard import TAPS, origin_side


@dataclass(frozen=True, slots=True)
class Decision:
    """What one worker decided of a topic; the fields are those of its answer to ``explain``."""

    daemon: str
    worker: str
    direction: str
    topic: str
    hub_topic: str
    type: str
    decision: str
    why: str
    cure: str

    def as_dict(self) -> dict[str, str]:
        """For ``--json``."""
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(slots=True)
class TopicView:
    """One topic.

    Attributes:
        types: types by which it is known, as ROS 2 spells them.
        publishers: on the hub.
        subscriptions: on the hub.
        decisions: what the workers decided of it.
    """

    name: str
    types: set[str] = field(default_factory=set)
    publishers: list[HubEndpoint] = field(default_factory=list)
    subscriptions: list[HubEndpoint] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)

    @property
    def sides(self) -> list[str]:
        """Where its messages come from."""
        hub = {origin_side(endpoint) for endpoint in self.publishers}
        told = {d.worker for d in self.decisions if d.direction == "in" and d.decision != "own"}
        return sorted(hub | told)

    @property
    def state(self) -> str:
        """One word: ``hub`` where it is on the hub, else what was decided of it."""
        if self.publishers or self.subscriptions:
            return "hub"
        return ", ".join(sorted({d.decision for d in self.decisions}))


def absolute(topic: str) -> str:
    """The topic's name with its leading slash."""
    return topic if topic.startswith("/") else f"/{topic}"


def ask_decisions(client: Client, topic: str, kind: str | None = "topic") -> list[Decision]:
    """What every worker decided of a topic, a service, or with None either; of all of them where the name is ""."""
    found: list[Decision] = []
    for answer in client.ask("explain", {"topic": topic}):
        for entry in answer.value if isinstance(answer.value, list) else ():
            if isinstance(entry, dict) and kind in (None, entry.get("kind", "topic")):
                words = {name: str(entry.get(name, "")) for name in Decision.__slots__[2:]}
                found.append(Decision(answer.daemon, answer.worker, **words))
    return found


def all_topics(client: Client) -> dict[str, TopicView]:
    """Every topic of the hub and of the workers' sides, by name."""
    views: dict[str, TopicView] = {}
    decisions = ask_decisions(client, "")
    client.settle()
    for endpoint in client.hub.graph.endpoints():
        if endpoint.own or endpoint.topic.startswith(TAPS):
            continue
        if endpoint.kind is EndpointKind.PUBLISHER:
            view = views.setdefault(endpoint.topic, TopicView(endpoint.topic))
            view.publishers.append(endpoint)
        elif endpoint.kind is EndpointKind.SUBSCRIPTION:
            view = views.setdefault(endpoint.topic, TopicView(endpoint.topic))
            view.subscriptions.append(endpoint)
        else:
            continue
        view.types.add(endpoint.type_name)
    for decision in decisions:
        name = decision.hub_topic if decision.hub_topic in views else decision.topic
        view = views.setdefault(name, TopicView(name))
        view.decisions.append(decision)
        if not view.publishers and not view.subscriptions:
            view.types.add(_ros2_spelling(decision.type))
    return views


def _ros2_spelling(type_name: str) -> str:
    """One spelling for a type that several sides name."""
    return type_name.replace("/", "/msg/") if is_ros1_name(type_name) else type_name


def known_names(client: Client, documents: Iterable[Any] = ()) -> set[str]:
    """Names of topics that anybody knows, for hints."""
    names = set(all_topics(client))
    for document in documents:
        names.update(str(route.get("topic")) for route in route_list(document))
    return names
