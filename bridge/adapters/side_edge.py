"""The common base of the built-in edges: types, the listener, and other Midspan workers on the network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from typing_extensions import override

from bridge.config.model import Config
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.routing.edge import Edge, EdgeListener, Endpoint, Sighting


class Presence(Protocol):
    """The Midspan workers on one network."""

    def announce(self, record: bytes) -> None:
        """Send a record to all other workers."""

    def sightings(self) -> Sequence[Sighting]:
        """Return the other workers that are on the network now."""


class SideEdge(Edge):
    """An edge with a registry of types and one listener."""

    def __init__(self, config: Config, registry: Registry) -> None:
        self._config, self._registry = config, registry
        self._listener: EdgeListener | None = None
        self._presence: Presence | None = None

    @override
    def learn(self, type_name: str, definition: str) -> None:
        self._registry.learn_ros2(type_name, definition)

    @override
    def announce(self, record: bytes) -> None:
        """Send a record to all Midspan workers on this network; dropped if the edge has not joined the network yet."""
        presence = self._presence
        if presence is not None:
            presence.announce(record)

    @override
    def sightings(self) -> Sequence[Sighting]:
        presence = self._presence
        return () if presence is None else presence.sightings()

    def _graph_changed(self) -> None:
        if self._listener is not None:
            self._listener.graph_changed()

    def _presence_changed(self) -> None:
        if self._listener is not None:
            self._listener.presence_changed()

    def _refuse(self, topic: str, reason: str, why: str) -> None:
        if self._listener is not None:
            self._listener.message_refused(topic, reason, why)

    def _own_type(self, type_name: str, type_hash: str) -> SideType:
        """Return this machine's definition of a hub type; raises `MessageTypeError` if the publisher's hash differs."""
        known = self._registry.ros2(type_name)
        if type_hash and type_hash != known.type_id:
            raise MessageTypeError(
                f"{type_name}: its publisher has {type_hash}, but this machine's definition has {known.type_id}",
                "install the same version of the message package on both, or give its .msg folder in types.folders",
            )
        return known

    @override
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """Return a conversion that keeps the bytes but validates them, as programs on the side may send anything."""
        return self.from_hub(endpoint.type, endpoint.type_id)

    @override
    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """Return a conversion that keeps the bytes but validates them, as DDS silently drops malformed messages."""
        known = self._own_type(type_name, type_hash)
        return Conversion(known, known, self._registry.hub_check(type_name))

    @override
    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """Return the conversion of `service_from_hub`; the side does not report the hash of a service's type."""
        return self.service_from_hub(endpoint.type, "")

    @override
    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """Return a conversion that keeps the bytes and validates them, as for topics."""
        known = self._registry.service_ros2(type_name, type_hash)
        request, response = self._registry.hub_service_check(type_name, type_hash)
        return ServiceConversion(known, known, request, request, response, response)
