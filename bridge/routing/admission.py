"""How a topic's rule and priority class decide on its messages: class, latching, rate, and the age of commands."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.velocities import VELOCITIES, is_zero
from bridge.routing.counters import Counters
from bridge.routing.limits import Priority, RateLimit
from bridge.routing.rules import RoutePolicy
from bridge.routing.stall import AgeGate, StallDetector

_log = logging.getLogger(__name__)


def carries_commands(policy: RoutePolicy, topics: tuple[str, ...], type_name: str) -> bool:
    """Return whether the messages of a topic with these names and this ROS 2 type are commands."""
    return policy.class_of(topics, type_name, latched=False) is Priority.COMMAND


class TopicAdmission:
    """The base of topics that are bridged (`bridge.routing.route`) or relayed (`bridge.routing.relay`).

    Args:
        topics: the topic's names on the hub and on the side.
        type_name: its ROS 2 type.
        counters: counts what is dropped.
    """

    def __init__(
        self, topics: tuple[str, ...], type_name: str, policy: RoutePolicy, counters: Counters,
        stall_detector: StallDetector,
    ) -> None:  # fmt: skip
        self.policy, self.counters = policy, counters
        self._topics, self._type_name, self._stall_detector = topics, type_name, stall_detector
        self._limit = RateLimit(policy.rate) if policy.rate and policy.priority != Priority.STATE.value else None
        if policy.qos.durability == "transient_local" and self.priority_of(latched=True) is Priority.COMMAND:
            _log.warning(
                "%s: the rule's durability transient_local has no effect: commands are never latched", topics[0]
            )

    def priority_of(self, *, latched: bool) -> Priority:
        """Return the priority class; see `RoutePolicy.class_of`."""
        return self.policy.class_of(self._topics, self._type_name, latched=latched)

    @property
    def commands(self) -> bool:
        """Whether its messages are commands."""
        return carries_commands(self.policy, self._topics, self._type_name)

    def latches(self, qos: Qos) -> bool:
        """Return whether the messages of a publisher with this QoS are latched; commands never are."""
        return self.override(qos).latched

    def override(self, qos: Qos) -> Qos:
        """Return the QoS with the policies that the rule sets; commands are never latched."""
        qos = self.policy.override(qos)
        if qos.latched and self.priority_of(latched=True) is Priority.COMMAND:
            return replace(qos, durability=Durability.VOLATILE)
        return qos

    def over_rate(self, data: Callable[[], bytes], *, latched: bool) -> bool:
        """Return whether the rule's ``rate`` drops a message that arrives now; latched ones and zeros always pass."""
        if self._limit is None or latched or self._limit.passes() or self._stops(data):
            return False
        self.counters.dropped("rate")
        return True

    def is_stale(self, data: Callable[[], bytes], age: AgeGate, time_ns: int | None) -> bool:
        """Return whether a command is too old, or may have waited while this process hung; zeros never are.

        ``age`` is that of its publisher, ``time_ns`` its source timestamp if it has one.
        """
        timeout = self.policy.timeout
        stale = self._stall_detector.stood_still(timeout) or (time_ns is not None and age.age(time_ns) > timeout)
        return stale and not self._stops(data)

    def _stops(self, data: Callable[[], bytes]) -> bool:
        """Return whether a message, as CDR or ROS 1 bytes, stops a base: it must pass even if it is late."""
        return self._type_name in VELOCITIES and is_zero(self._type_name, data())

    def crowded_out(self) -> None:
        """Count a message that a newer message displaced from a queue."""
        self.counters.dropped("queue")
