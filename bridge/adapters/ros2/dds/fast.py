"""A worker on Fast DDS (rmw_fastrtps_cpp), the default."""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import filters, own_profile, rcl, rmw, security
from bridge.adapters.ros2.context import Dds, Joined, Replied, Ros2Context
from bridge.adapters.ros2.environment import domain
from bridge.adapters.ros2.graph import neighbors, spdp, vendors
from bridge.adapters.ros2.graph.heartbeats import Heartbeats
from bridge.adapters.ros2.graph.marks import PRESENCE
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES, is_marked, new_prefix, participant_number, remember
from bridge.adapters.ros2.participant import Participant
from bridge.adapters.ros2.profile import remove_temporary, use_profile
from bridge.adapters.ros2.services.fast import FastClient, FastServer
from bridge.adapters.ros2.services.port import ClientPort, ServerPort
from bridge.adapters.ros2.types import TypeSupports
from bridge.config.model import Config
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.errors import MessageTypeError
from bridge.routing.edge import Endpoint, Obstacle

_STRING = ("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")
"""The type of the presence topic, and its hash."""
_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)

_log = logging.getLogger(__name__)


class FastDds(Dds):
    """Fast DDS: services go through rcl, and calls reach servers on Cyclone DDS, too."""

    def __init__(self, config: Config) -> None:
        self._config, self._domain = config, domain(config, os.environ)
        self._localhost_only = config.ros2.localhost_only and config.ros2.profile is None
        self.types = TypeSupports()
        self._trouble = ""
        self._number = 0
        self._peers: tuple[str, ...] = ()

    @override
    def join(self, state: Path, node: str) -> Joined:
        profile = use_profile(self._config, state)
        custom = self._config.ros2.profile
        self._trouble = "" if custom is None else own_profile.trouble(custom)
        if self._trouble:
            _log.warning("%s", self._trouble)
        self._number, self._peers = participant_number(profile.prefix), profile.peers
        participant = Participant(node, self._domain)
        remove_temporary()
        if not security.is_enabled(os.environ):
            return Joined(participant, profile.prefix, profile.segment)
        remember(profile.prefix, state / "ros2")  # the prefix in use does not contain the number
        return Joined(participant, self._prefix_in_use(participant), profile.segment)

    def _prefix_in_use(self, participant: Participant) -> bytes:
        """Return the participant's GUID prefix as DDS reports it, by means of a writer of the presence topic.

        Raises `RuntimeError` if the enclave's permissions do not allow this topic.
        """
        try:
            writer = participant.make_writer(self.types.message_class(*_STRING), PRESENCE, _LATCHED)
        except MessageTypeError as err:
            raise RuntimeError(
                f"DDS Security does not allow {PRESENCE}, by which Midspan daemons recognize each other; {err.cure}"
            ) from err
        gid = rmw.publisher_gid(int(writer.pointer))
        participant.destroy(writer)
        return gid[:PREFIX_BYTES]

    @override
    def separates_versions(self) -> bool:
        return filters.is_available()

    @override
    def obstacle(self, service: str, servers: Sequence[Endpoint]) -> Obstacle | None:
        return None if filters.is_available() else vendors.of_servers(service, servers)

    @override
    def open_client(
        self, name: str, service_class: Any, context: Ros2Context, replied: Replied, type_id: str | None
    ) -> ClientPort:
        return FastClient(name, service_class, context, replied, type_id)

    @override
    def open_server(self, name: str, service_class: Any, context: Ros2Context) -> ServerPort:
        return FastServer(name, service_class, context)

    @override
    def follow(self, heartbeats: Heartbeats, endpoints: Iterable[Endpoint]) -> None:
        heartbeats.follow(endpoints)

    @override
    def refresh(self, prefix: bytes, dead: Sequence[bytes], also: int) -> None:
        pseudo = new_prefix(rcl.host_prefix())
        prompt = [spdp.announcement(pseudo, self._domain, self._number, also), spdp.disposal(pseudo)]
        disposals = [*map(spdp.disposal, dead)]
        spdp.send_all([*disposals, *prompt], self._domain, localhost_only=self._localhost_only)
        spdp.send_to(self._peers, disposals, self._domain)

    @override
    def clean(self, prefix: bytes, past: Iterable[bytes]) -> None:
        """Remove the shared-memory ports of dead participants, except those with this participant's number."""
        numbers = {participant_number(dead) for dead in past if is_marked(dead)} - {self._number}
        neighbors.clean_ports(port for number in numbers for port in spdp.unicast_ports(self._domain, number))

    @override
    def details(self, endpoints: Collection[Endpoint]) -> dict[str, Any]:
        cyclone = vendors.report(endpoints)
        return {"cyclone": cyclone} if cyclone else {}

    @override
    def notes(self, endpoints: Collection[Endpoint]) -> Mapping[str, list[str]]:
        return vendors.notes(endpoints)

    @override
    def warnings(self, endpoints: Collection[Endpoint], served: Collection[str]) -> list[str]:
        cyclone = vendors.report(endpoints)
        texts = (vendors.warning(cyclone), vendors.mixed_warning(cyclone["mixed"])) if cyclone else ()
        return [text for text in (self._trouble, *texts) if text]
