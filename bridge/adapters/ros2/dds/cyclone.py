"""A worker on Cyclone DDS (``ros2.rmw: rmw_cyclonedds_cpp``)."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from typing_extensions import override

from bridge.adapters.ros2.context import Dds, Joined, Replied, Ros2Context
from bridge.adapters.ros2.cyclonedds import Discovery, use_settings
from bridge.adapters.ros2.environment import CYCLONE, domain
from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.graph.heartbeats import Heartbeats
from bridge.adapters.ros2.graph.marks import EnclaveMarks
from bridge.adapters.ros2.participant import SERVICE, Participant, reply_topic, request_topic
from bridge.adapters.ros2.profile import addresses, static_peers
from bridge.adapters.ros2.rmw import RmwPublisher, RmwSubscription
from bridge.adapters.ros2.services.port import ClientPort, ServerPort
from bridge.adapters.ros2.services.raw import RawClient, RawServer
from bridge.adapters.ros2.types import RawTypeSupports
from bridge.config.model import Config
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import Endpoint, Obstacle

Topic = tuple[int, str]
"""The address of the type support of a DDS topic's messages, and its name."""


class CyclonePair(RmwSubscription):
    """A reader, and a writer in the other direction; the reader is announced first.

    Raises `MessageTypeError` if rmw_cyclonedds_cpp refuses the reader or writer, or has an unknown version.
    """

    def __init__(self, node: int, reads: Topic, writes: Topic, discovery: Discovery) -> None:
        super().__init__(node, *reads, SERVICE.depth)
        self._discovery = discovery
        try:
            self._writer = RmwPublisher(node, *writes, SERVICE.depth)
        except MessageTypeError:
            super().destroy_when_not_in_use()
            raise
        try:
            self._entity = discovery.entity(self._writer.data, self._writer.gid)
        except MessageTypeError:
            self.destroy_when_not_in_use()
            raise

    def publish(self, payload: bytes) -> None:
        """Publish CDR bytes; raises `RclError`."""
        self._writer.publish(payload)

    def matched_readers(self) -> frozenset[bytes]:
        """Return the GUIDs of the readers that the writer has matched; b"" for an unknown reader."""
        return self._discovery.matched_readers(self._entity)

    @override
    def destroy_when_not_in_use(self) -> None:
        super().destroy_when_not_in_use()
        self._writer.destroy()


class CycloneParticipant(Participant):
    """A participant on Cyclone DDS, which chooses its GUID ``prefix`` itself."""

    rmw: ClassVar[str] = CYCLONE

    def __init__(self, name: str, domain: int) -> None:
        super().__init__(name, domain)
        self._discovery = Discovery(domain)
        self.prefix = self._discovery.prefix
        self.marks = EnclaveMarks(self._discovery.enclave)
        self.resolve = self._discovery.writer

    def make_pair(self, reads: Topic, writes: Topic) -> CyclonePair:
        """Create a reader of a service's requests or replies, and a writer of the others."""
        with self._lock:
            return CyclonePair(self.pointer, reads, writes, self._discovery)


class CycloneDds(Dds):
    """Cyclone DDS: services go through raw endpoints, and are bridged to nodes on Cyclone DDS only."""

    _participant: CycloneParticipant

    def __init__(self, config: Config) -> None:
        self._config = config
        self.types = RawTypeSupports()

    @override
    def join(self, state: Path, node: str) -> Joined:
        use_settings(self._config, tuple(addresses(static_peers(os.environ))))
        self._participant = CycloneParticipant(node, domain(self._config, os.environ))
        return Joined(self._participant, self._participant.prefix, 0)

    @override
    def separates_versions(self) -> bool:
        return False

    @override
    def obstacle(self, service: str, servers: Sequence[Endpoint]) -> Obstacle | None:
        return vendors.of_servers_not_on_cyclone(service, servers)

    @override
    def open_client(
        self, name: str, service_class: Any, context: Ros2Context, replied: Replied, type_id: str | None
    ) -> ClientPort:
        replies, requests = service_class.response_support, service_class.request_support
        pair = self._participant.make_pair((replies, reply_topic(name)), (requests, request_topic(name)))
        return RawClient(name, pair, context, type_id)

    @override
    def open_server(self, name: str, service_class: Any, context: Ros2Context) -> ServerPort:
        replies, requests = service_class.response_support, service_class.request_support
        pair = self._participant.make_pair((requests, request_topic(name)), (replies, reply_topic(name)))
        return RawServer(pair, partial(context.graph.reply_readers, name))

    @override
    def follow(self, heartbeats: Heartbeats, endpoints: Iterable[Endpoint]) -> None:
        """Do nothing: Cyclone DDS itself sends what its readers need before the first message."""

    @override
    def refresh(self, prefix: bytes, dead: Sequence[bytes], also: int) -> None:
        """Do nothing: Cyclone DDS receives before it announces itself, and responds to others' announcements."""

    @override
    def clean(self, prefix: bytes, past: Iterable[bytes]) -> None:
        """Do nothing: the participant has no shared memory."""

    @override
    def details(self, endpoints: Collection[Endpoint]) -> dict[str, Any]:
        return {"cyclone": vendors.report_on_cyclone(endpoints)}

    @override
    def notes(self, endpoints: Collection[Endpoint]) -> Mapping[str, list[str]]:
        return vendors.mixed_notes(endpoints)  # a refused service has its obstacle

    @override
    def warnings(self, endpoints: Collection[Endpoint], served: Collection[str]) -> list[str]:
        return vendors.warnings_on_cyclone(endpoints, served)
