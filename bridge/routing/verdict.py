"""What was decided of one topic or service at one gate, with its reason: the matter of ``midspan explain``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.routing.rules import Decision
from bridge.routing.subject import split


@dataclass(slots=True)
class Verdict:
    """One topic or service, one direction, one decision.

    It is refused where rules allow it but something else stands in the way. ``of`` is ``topic`` or ``service``.
    """

    direction: str
    topic: str
    hub_topic: str
    type: str
    decision: Decision
    refused: bool = False
    own: str = ""
    rests: bool = False
    reason: str = ""
    cure: str = field(default="")
    of: str = "topic"

    @classmethod
    def not_native(cls, endpoint: Endpoint) -> Self:
        """An endpoint on the side that a Midspan made, or of which that is not known yet."""
        if endpoint.made_by is MadeBy.MIDSPAN:
            why = f"{endpoint.node or endpoint.id} was made by a Midspan and is never taken up again"
        else:
            why = f"it is not known yet who made {endpoint.node or endpoint.id}"
        name = endpoint.topic
        of = "service" if endpoint.kind in (Kind.SERVER, Kind.CLIENT) else "topic"
        return cls("in", name, name, endpoint.type, Decision(allowed=False, why=why, name=name), own=why, of=of)

    @classmethod
    def own_network(cls, direction: str, topic: str, type_name: str, of: str = "topic") -> Self:
        """What the hub has from this very network."""
        why = "it comes from this very network"
        return cls(direction, topic, topic, type_name, Decision(allowed=False, why=why, name=topic), own=why, of=of)

    @classmethod
    def resting(cls, direction: str, topic: str, type_name: str, why: str, of: str = "topic") -> Self:
        """What another daemon carries in our stead, or of which that is not known yet."""
        decision = Decision(allowed=False, why=why, name=topic)
        return cls(direction, topic, topic, type_name, decision, rests=True, of=of)

    @classmethod
    def placeless(cls, topic: str, hub_topic: str, type_name: str, why: str, of: str = "topic") -> Self:
        """What the hub has and the side has no place for."""
        return cls("out", topic, hub_topic, type_name, Decision(allowed=False, why=why, name=topic), own=why, of=of)

    @classmethod
    def one_ended(cls, topic: str, type_name: str, why: str, of: str = "topic") -> Self:
        """What has nothing to cross: subscriptions or clients only, or the part of an action that has no others."""
        return cls("out", topic, topic, type_name, Decision(allowed=True, why=why, name=topic), own=why, of=of)

    def refuse(self, reason: str, cure: str) -> None:
        """Something stands in the way."""
        self.refused, self.reason, self.cure = True, reason, cure

    @property
    def kind(self) -> str:
        """One word: bridged, denied, private, refused, unseen, own or standby."""
        if self.rests:
            return "standby"
        if self.own or self.decision.settled:
            return "unseen" if self.decision.allowed else "own"
        if self.refused:
            return "refused"
        if self.decision.allowed:
            return "bridged"
        return "private" if self.decision.private else "denied"

    def as_dict(self) -> dict[str, Any]:
        """As it stands in the answers to ``explain`` and ``status``."""
        cure = self.cure
        if self.kind == "private":
            cure = "name it in a rule that allows it, or set routing.private: false"
        elif self.kind == "denied":
            cure = "change the rule, or add one that allows it"
        return {
            "kind": self.of,
            "action": split(self.hub_topic)[0],
            "direction": self.direction,
            "topic": self.topic,
            "hub_topic": self.hub_topic,
            "type": self.type,
            "decision": self.kind,
            "why": self.reason or self.decision.why,
            "reason": self.reason or self.decision.why,
            "cure": cure,
        }
