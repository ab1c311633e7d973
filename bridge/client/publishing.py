"""Publishers on the hub for client programs, which pass messages as JSON values."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from bridge.client.errors import ClientError
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import ConversionError
from bridge.routing.limits import Priority
from bridge.routing.rules import RuleSet

MATCH_SECONDS = 2.0
_POLL_SECONDS = 0.02


class Publisher:
    """Publishes on one topic. ``type_name`` is in ROS 1's or ROS 2's spelling.

    ``priority`` defaults to `RuleSet.native_class`: messages that a rule makes commands are commands here, too. Raises
    `ClientError` if the type is unknown, and for commands with a latching ``qos``: late joiners would receive old ones.

    Attributes:
        kind: name of the topic, its type and the type's hash.
        end: the publisher on the hub, which accepts CDR.
    """

    def __init__(
        self, client: Client, types: Types, topic: str, type_name: str, qos: Qos | None = None, priority: str = ""
    ) -> None:
        self._types, type_name, qos = types, types.name(type_name), qos or Qos()
        self.kind = topic, type_name, types.hash_of(type_name)
        if not priority:
            priority = RuleSet(client.config.rules).native_class(topic, type_name, latched=qos.latched).value
        if qos.latched and priority == Priority.COMMAND.value:
            raise ClientError(
                f"the messages on {topic} are commands, which are never latched: leave out --latch, or use volatile QoS"
            )
        self.end = client.hub.publisher(*self.kind, qos, priority=priority)

    def publish(self, message: Mapping[str, Any]) -> None:
        """Publish a message; raises the errors of `encode`."""
        self.end.put(encode(self._types, self.kind[1], message))

    def close(self) -> None:
        self.end.close()


def encode(types: Types, type_name: str, message: Mapping[str, Any]) -> bytes:
    """Return a message as CDR; raises `ClientError` if its type or a field is unknown, or a value does not fit."""
    from bridge.messages.json import from_json  # imported here, because many programs never publish

    types.hash_of(type_name)
    try:
        return from_json(types.registry, type_name, message)
    except ConversionError as err:
        raise ClientError(f"{type_name}: {err}") from None


def await_subscribers(publisher: HubPublisher, settle: float) -> bool:
    """Wait for a subscriber on the hub; return whether there is one.

    It may be a worker that subscribes for its side. ``settle``: seconds to wait then, until the side's own subscribers
    have connected to the worker's publisher.
    """
    deadline = time.monotonic() + MATCH_SECONDS
    while not publisher.matched() and time.monotonic() < deadline:
        time.sleep(_POLL_SECONDS)
    if publisher.matched():
        time.sleep(settle)
    return publisher.matched()
