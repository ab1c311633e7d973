"""What is known of services and actions: from the hub's graph, and from the workers' decisions on their sides'."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from bridge.cli.errors import CliError
from bridge.cli.hubclient import Client
from bridge.cli.text import near
from bridge.cli.topic_view import Decision, absolute, ask_decisions
from bridge.hub.graph import HubEndpoint
from bridge.hub.liveliness import EndpointKind
from bridge.routing.guard import TAPS, origin_side
from bridge.routing.subject import split


@dataclass(slots=True)
class CallView:
    """One service, or one action, which is known by its ``send_goal``.

    Attributes:
        types: types by which it is known, as ROS 2 spells them.
        servers: on the hub.
        clients: on the hub.
        decisions: what the workers decided of it, or of the parts of the action.
    """

    name: str
    types: set[str] = field(default_factory=set)
    servers: list[HubEndpoint] = field(default_factory=list)
    clients: list[HubEndpoint] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)

    @property
    def sides(self) -> list[str]:
        """Where it is served."""
        told = {d.worker for d in self.decisions if d.direction == "in" and d.decision != "own"}
        return sorted({origin_side(endpoint) for endpoint in self.servers} | told)

    @property
    def state(self) -> str:
        """One word: ``hub`` where it can be called on the hub, else what was decided of it."""
        if self.servers:
            return "hub"
        return ", ".join(sorted({d.decision for d in self.decisions})) or "no server"

    def as_dict(self, word: str) -> dict[str, Any]:
        """For ``--json``; ``word`` is ``service`` or ``action``."""
        return {
            word: self.name,
            "types": sorted(self.types),
            "from": self.sides,
            "servers": len(self.servers),
            "clients": len(self.clients),
            "state": self.state,
            "decisions": [decision.as_dict() for decision in self.decisions],
        }


def all_services(client: Client) -> dict[str, CallView]:
    """Every service of the hub and of the workers' sides by name, without those that are parts of actions."""
    views: dict[str, CallView] = {}
    for endpoint, decision in _known(client):
        view = _view(views, endpoint, decision)
        if endpoint is not None:
            view.types.add(endpoint.type_name)
        elif decision is not None:
            view.types.add(_spelled(decision.type, "srv"))
    return {name: view for name, view in views.items() if not split(name)[1]}


def all_actions(client: Client) -> dict[str, CallView]:
    """Every action of the hub and of the workers' sides by name."""
    views: dict[str, CallView] = {}
    for endpoint, decision in _known(client):
        part_name, type_name = "", ""
        if endpoint is not None:
            part_name, type_name = endpoint.topic, endpoint.type_name
        elif decision is not None:
            part_name, type_name = _name(decision), _spelled(decision.type, "action")
        name, part = split(part_name)
        if part == "send_goal":
            view = views.setdefault(name, CallView(name))
            _add(view, endpoint, decision)
            view.types.add(type_name.removesuffix("_SendGoal"))
    return views


def find(views: dict[str, CallView], name: str, word: str) -> CallView:
    """One of the views, by its name on the hub or on a side; raises `CliError` where nobody knows it."""
    name = absolute(name)
    for view in views.values():
        if view.name == name or any(name == d.topic for d in view.decisions):
            return view
    meant = near(name, views)
    hint = f" Did you mean {', '.join(meant)}?" if meant else f" 'midspan {word} list' shows all."
    raise CliError(f"no {word} {name} on the hub or on any side.{hint}")


def _known(client: Client) -> Iterable[tuple[HubEndpoint | None, Decision | None]]:
    decisions = ask_decisions(client, "", kind="service")
    client.settle()
    for endpoint in client.hub.graph.endpoints():
        called = endpoint.kind in (EndpointKind.SERVER, EndpointKind.CLIENT)
        if called and not endpoint.own and not endpoint.topic.startswith(TAPS):
            yield endpoint, None
    for decision in decisions:
        yield None, decision


def _view(views: dict[str, CallView], endpoint: HubEndpoint | None, decision: Decision | None) -> CallView:
    name = endpoint.topic if endpoint is not None else "" if decision is None else _name(decision)
    view = views.setdefault(name, CallView(name))
    _add(view, endpoint, decision)
    return view


def _add(view: CallView, endpoint: HubEndpoint | None, decision: Decision | None) -> None:
    if decision is not None:
        view.decisions.append(decision)
    elif endpoint is not None:
        (view.servers if endpoint.kind is EndpointKind.SERVER else view.clients).append(endpoint)


def _name(decision: Decision) -> str:
    return decision.hub_topic or decision.topic


def _spelled(type_name: str, middle: str) -> str:
    """The ROS 2 spelling of a type, as far as the name alone tells."""
    package, _, name = type_name.partition("/")
    return type_name if "/" in name or not name else f"{package}/{middle}/{name}"
