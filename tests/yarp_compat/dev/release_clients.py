"""Programs of YARP's releases, and a server with the methods that they call."""

from __future__ import annotations

import itertools
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.peers.yarp.processes import library, processes
from tests.yarp_compat.dev.interfaces import All
from tests.yarp_compat.dev.releases import RELEASES, Release
from tests.yarp_compat.ports.conftest import MakePort, make_port, naming
from yarp_compat.dev.inavigation2d import NavigationStatusEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DObject
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.dev.service import INTRODUCTION, VERSION, Call
from yarp_compat.ports import client_process
from yarp_compat.wire import carriers, framing
from yarp_compat.wire.binary import encode
from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import Incomplete
from yarp_compat.wire.profile import Profile

__all__ = ["make_port", "naming"]
BY_NAME = {release.name: release for release in RELEASES}
KITCHEN = Map2DLocation("m1", 1.0, 2.0, 90.0, "")


class Planner(All):
    """A planner whose only location is the kitchen, and which refuses goals elsewhere."""

    def get_location_RPC(self, location_name: str) -> Any:
        if location_name != "kitchen":
            raise CallFailed
        return OK, KITCHEN

    def get_object_RPC(self, object_name: str) -> Any:  # noqa: ARG002
        return OK, Map2DObject()

    def get_navigation_status_RPC(self) -> Any:
        return OK, NavigationStatusEnum.navigation_status_idle

    def goto_target_by_absolute_location_RPC(self, loc: Map2DLocation) -> ReturnValue:
        if loc.map_id != "m1":
            raise CallFailed
        return OK

    def stop_navigation_RPC(self) -> ReturnValue:
        return OK

    def resume_navigation_RPC(self) -> ReturnValue:
        raise CallFailed


GOOD: list[tuple[str, list[Any]]] = [
    ("get_location_RPC", ["kitchen"]),
    ("get_navigation_status_RPC", []),
    ("goto_target_by_absolute_location_RPC", [KITCHEN]),
    ("stop_navigation_RPC", []),
]
BAD: list[tuple[str, list[Any]]] = [
    ("get_location_RPC", ["nowhere"]),
    ("get_absolute_location_of_current_target_RPC", []),
    ("goto_target_by_absolute_location_RPC", [Map2DLocation("m2", 1.0, 2.0, 0.0, "")]),
    ("resume_navigation_RPC", []),
]


class Client:
    """A program of a release, connected to a server's port: a socket that reads like the release's generated code."""

    def __init__(self, name: str, release: Release, at: PortContact, carrier: Carrier = carriers.TCP) -> None:
        self._release, self._acked = release, carrier.ack
        self._sock = socket.create_connection((at.host, at.port))
        self._sock.settimeout(30)
        self._sock.sendall(carriers.opening(carrier, name))
        self.receive(8)
        self._buffer = b""
        self.address: tuple[str, int] = self._sock.getsockname()

    def close(self) -> None:
        self._sock.close()

    def call(self, name: str, arguments: list[Any]) -> bool:
        """Make a call; return whether the client reads its reply as a success."""
        call = All.calls()[name]
        self.send(call.request(arguments, self._release.profile))
        return self.read(call)

    def send(self, payload: bytes) -> None:
        self._sock.sendall(framing.prefix(len(payload), "d") + payload)

    def receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size and (part := self._sock.recv(size - len(data))):
            data += part
        return data

    def introduce(self) -> None:
        """Introduce the client: clients of 4.0 send this request first."""
        self.send(encode([INTRODUCTION], Profile.YARP4))
        self.receive(VERSION.size + 8)

    def read(self, call: Call) -> bool:
        while True:
            try:
                ok, end = self._release.read(call, self._buffer, acked=self._acked)
            except Incomplete:
                part = self._sock.recv(4096)
                assert part, "the server closed the connection"
                self._buffer += part
            else:
                self._buffer = self._buffer[end:]
                return ok

    @property
    def in_step(self) -> bool:
        """Whether the client has consumed the last reply completely."""
        return not self._buffer


@pytest.fixture
def connect(make_port: MakePort) -> Iterator[Callable[..., Client]]:
    clients: list[Client] = []
    ports: dict[int, PortContact] = {}

    def connected(server: Server, name: str, release: str, carrier: Carrier = carriers.TCP) -> Client:
        if id(server) not in ports:
            port = make_port("/server/rpc", server, rpc=True, on_event=server.on_event)
            ports[id(server)] = port.contact
        clients.append(Client(name, BY_NAME[release], ports[id(server)], carrier))
        return clients[-1]

    yield connected
    for client in clients:
        client.close()


@pytest.fixture
def loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, Client]], None]:
    """Make the clients' processes appear to have loaded the library of a release."""
    numbers = itertools.count()

    def load(clients: dict[str, Client]) -> None:
        owners = {client.address: [library(release)] for release, client in clients.items()}
        monkeypatch.setattr(client_process, "_PROC", processes(tmp_path / str(next(numbers)), owners))

    return load


Load = Callable[[dict[str, Client]], None]
LOADED = {"3.9": "3.9.1", "3.11": "3.11.2", "3.12": "3.12.3", "4.0": "4.0.0"}


def reads_all_replies(client: Client) -> bool:
    """Assert that a client reads each reply correctly; return True."""
    for (name, arguments), succeeds in [*((c, True) for c in GOOD), *((c, False) for c in BAD)] * 2:
        assert client.call(name, arguments) is succeeds, name
        assert client.in_step, name
    return True


def settled(client: Client) -> Client:
    """Make a call, so that the server has registered the client's connection; return the client."""
    client.call("stop_navigation_RPC", [])
    return client
