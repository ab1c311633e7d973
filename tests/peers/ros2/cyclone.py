"""Cyclone DDS programs on the domain of a test's ROS 2 side."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from tests.peers.peer import Peer
from tests.peers.ros2.network import ros2_domain, ros2_environment
from tests.support.missing import CYCLONE, need

PROGRAM = Path(__file__).with_name("cyclone_peer.py")

_CONFIG = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>120</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
"""On this machine only. Midspan's participant index is above 31, where Cyclone DDS does not look by default."""


class CyclonePeer(Peer):
    """A program of `tests.peers.ros2.cyclone_peer` on this test process's domain.

    Args:
        domain: a domain other than the test process's.
        user_data: the participant's user data, in which ROS 2 programs name their enclave.
    """

    def __init__(self, domain: int | None = None, user_data: str = "") -> None:
        need(CYCLONE)
        number = ros2_domain() if domain is None else domain
        env = ros2_environment(CYCLONEDDS_URI=_CONFIG, ROS_DOMAIN_ID=str(number))
        super().__init__(PROGRAM, Path(sys.executable), env, user_data)

    def serve(self, service: str, type_: str, reply: bytes) -> int:
        """Serve one reply to all requests, and return the server's id."""
        return int(self.ask("serve", service=service, type=type_, reply=reply.hex())["id"])

    def act(self, action: str, type_: str, result: bytes = b"\0\1\0\0\1") -> int:
        """Serve an action's three services and two topics; each goal is accepted. Return the id of the servers."""
        return int(self.ask("act", action=action, type=type_, result=result.hex())["id"])

    def requests(self, server: int) -> list[bytes]:
        """Return all requests as received, with their headers."""
        return _payloads(self.ask("requests", id=server))

    def call(self, service: str, type_: str, request: bytes) -> int:
        """Call a service; return the call's id."""
        return int(self.ask("call", service=service, type=type_, request=request.hex())["id"])

    def reply(self, call: int, seconds: float = 20.0) -> bytes:
        """Return the reply to a call, or b"" if none arrives in time."""
        return bytes.fromhex(self.ask("result", id=call, seconds=seconds)["reply"])

    def advertise_raw(self, topic: str, type_: str, *, latched: bool = False) -> int:
        """Advertise a DDS topic by its own name and its type's name in DDS; return the publisher's id."""
        return int(self.ask("advertise_raw", topic=topic, type=type_, latched=latched)["id"])

    def put(self, endpoint: int, payload: bytes) -> None:
        """Publish one message as CDR."""
        self.ask("publish", id=endpoint, payload=payload.hex())

    def received(self, endpoint: int, count: int, seconds: float = 20.0) -> list[bytes]:
        """Return all messages of a subscription as CDR, once ``count`` have arrived or the time is over."""
        return _payloads(self.ask("wait", id=endpoint, count=count, seconds=seconds))


def _payloads(answer: dict[str, Any]) -> list[bytes]:
    return [bytes.fromhex(payload) for payload in answer["payloads"]]
