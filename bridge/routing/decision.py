"""The decisions on topics and services in each direction, with their reasons, which ``midspan explain`` shows."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Self, TypeVar

from bridge.hub.endpoints.variants import TypeVersions
from bridge.hub.graph.endpoints import HubEndpoint
from bridge.messages.actions import split
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.conversion import Conversion, ServiceConversion
from bridge.routing.edge import Endpoint, Kind, MadeBy, Obstacle
from bridge.routing.rules import RoutePolicy

Converts = TypeVar("Converts", Conversion, ServiceConversion)

_log = logging.getLogger(__name__)

OWN_NETWORK = "it comes from this network"


class RouteKey(NamedTuple):
    """Identifies a route among those of its direction."""

    topic: str
    type_name: str
    type_id: str


@dataclass(slots=True)
class RouteDecision:
    """The decision on one topic or service (``of``).

    ``refused``: the rules allow it, but it cannot be bridged. ``barred``: its route exists, but refuses calls. ``own``:
    why it is never routed in this direction. ``rests``: it may be routed, but not now by this worker. ``note``: what
    its messages lose.
    """

    direction: str
    topic: str
    hub_topic: str
    type: str
    policy: RoutePolicy
    refused: bool = False
    own: str = ""
    rests: bool = False
    reason: str = ""
    cure: str = ""
    of: str = "topic"
    barred: bool = False
    note: str = ""

    @classmethod
    def not_native(cls, endpoint: Endpoint) -> Self:
        """Decide on an endpoint of the side that a Midspan worker created, or whose origin is not known yet."""
        if endpoint.made_by is MadeBy.MIDSPAN:
            reason = f"{endpoint.node or endpoint.id} was created by a Midspan and is never routed again"
        else:
            reason = f"the origin of {endpoint.node or endpoint.id} is not known yet"
        of = "service" if endpoint.kind in (Kind.SERVER, Kind.CLIENT) else "topic"
        return cls.unrouted("in", endpoint.topic, endpoint.type, reason, of)

    @classmethod
    def unrouted(
        cls, direction: str, topic: str, type_name: str, why: str, of: str = "topic", hub_topic: str = ""
    ) -> Self:
        """Decide on a topic or service that is not native to its network, or that the side cannot have."""
        policy = RoutePolicy(allowed=False, why=why, name=topic)
        return cls(direction, topic, hub_topic or topic, type_name, policy, own=why, of=of)

    @classmethod
    def resting(cls, direction: str, topic: str, type_name: str, why: str, of: str = "topic") -> Self:
        """Decide on a topic or service that another daemon forwards, or whose forwarder is not elected yet."""
        policy = RoutePolicy(allowed=False, why=why, name=topic)
        return cls(direction, topic, topic, type_name, policy, rests=True, of=of)

    @classmethod
    def carried_by(cls, daemon: str, topic: str, type_name: str, of: str = "topic") -> Self:
        """Decide on a hub topic or service that ``daemon`` ("" before the election) forwards to the side's network."""
        reason = f"on standby: {daemon} carries it to this network" if daemon else "the carrier is not elected yet"
        return cls.resting("out", topic, type_name, reason, of)

    @classmethod
    def one_ended(cls, topic: str, type_name: str, why: str, of: str = "topic") -> Self:
        """Decide on a name that has only subscriptions, or only clients."""
        return cls("out", topic, topic, type_name, RoutePolicy(allowed=True, why=why, name=topic), own=why, of=of)

    def refuse(self, reason: str, cure: str) -> None:
        """Refuse the route, with the reason and the cure."""
        self.refused, self.reason, self.cure = True, reason, cure

    def bar(self, obstacle: Obstacle) -> None:
        """Refuse the calls of a service but keep its route, so that clients receive the reason."""
        self.barred, self.reason, self.cure = True, obstacle.reason, obstacle.cure

    def convert(self, make: Callable[[], Converts]) -> Converts | None:
        """Create the route's conversion; if its type cannot be converted, refuse the route and return None.

        An unexpected exception, too, refuses only this route.
        """
        try:
            return make()
        except MessageTypeError as err:
            self.refuse(str(err), err.cure)
        except Exception as err:
            self.refuse(f"{self.type} cannot be converted: {type(err).__name__}: {err}", "")
            _log_once(self.reason)
        return None

    @property
    def kind(self) -> str:
        """The decision in one word: bridged, denied, private, refused, unseen, own or standby."""
        if self.rests:
            return "standby"
        if self.own or self.policy.settled:
            return "unseen" if self.policy.allowed else "own"
        if self.refused or self.barred:
            return "refused"
        if self.policy.allowed:
            return "bridged"
        return "private" if self.policy.private else "denied"

    def as_dict(self) -> dict[str, Any]:
        """Return the decision as shown by ``explain`` and ``status``."""
        why = "; ".join(filter(None, (self.reason or self.policy.why, self.note)))
        cure = self.policy.cure if self.kind in ("private", "denied") else self.cure
        return {
            "kind": self.of,
            "action": split(self.hub_topic)[0],
            "direction": self.direction,
            "topic": self.topic,
            "hub_topic": self.hub_topic,
            "type": self.type,
            "decision": self.kind,
            "why": why,
            "reason": why,
            "cure": cure,
        }


@lru_cache(maxsize=256)  # the routes are checked again and again
def _log_once(reason: str) -> None:
    _log.exception("%s", reason)


def native_groups(
    endpoints: Sequence[Endpoint], kind: Kind, decisions: list[RouteDecision]
) -> dict[RouteKey, list[Endpoint]]:
    """Group a side's native endpoints of one kind by their routes; append decisions on those that are not native."""
    groups: dict[RouteKey, list[Endpoint]] = defaultdict(list)
    for endpoint in endpoints:
        if endpoint.kind is kind and endpoint.made_by is MadeBy.NATIVE:
            groups[RouteKey(endpoint.topic, endpoint.type, endpoint.type_id)].append(endpoint)
        elif endpoint.kind is kind:
            decisions.append(RouteDecision.not_native(endpoint))
    return groups


def hub_key(endpoint: HubEndpoint, versions: TypeVersions) -> RouteKey:
    """Return the route of a hub endpoint; all known versions of a type share the route of this machine's version."""
    return RouteKey(endpoint.topic, endpoint.type_name, versions.here(endpoint.type_name, endpoint.type_hash))


def hub_groups(endpoints: Sequence[HubEndpoint], versions: TypeVersions) -> dict[RouteKey, list[HubEndpoint]]:
    """Group the hub endpoints of other sessions by their routes."""
    groups: dict[RouteKey, list[HubEndpoint]] = defaultdict(list)
    for endpoint in endpoints:
        if not endpoint.own:
            groups[hub_key(endpoint, versions)].append(endpoint)
    return groups
