"""Interfaces served and called over real ports."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.wait import until
from tests.yarp_compat.dev.test_service import KITCHEN, Places, PlacesServer
from tests.yarp_compat.ports.conftest import MakePort, make_port, naming
from yarp_compat.dev.client import PortChannel, ServiceClient
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, Navigation2DServer
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.returnvalue import OK, ReturnCode, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.ports.naming import Naming
from yarp_compat.wire import binary
from yarp_compat.wire.errors import Incomplete
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile

__all__ = ["make_port", "naming"]


def whole(data: Buffer, size: int) -> int:
    if len(data) < size:
        raise Incomplete(f"{size} bytes")
    return size


@pytest.mark.parametrize("carrier", ["tcp", "fast_tcp"])
@pytest.mark.parametrize("generation", Generation)
def test_a_client_calls_a_server_of_each_generation(make_port: MakePort, generation: Generation, carrier: str) -> None:
    make_port("/server/rpc", Server(PlacesServer(), Generations(generation)), rpc=True)
    client = make_port("/client/rpc", rpc=True, profile=generation.profile)
    assert client.add_output(f"{carrier}://server/rpc")[0]
    places = Places(PortChannel(client, generation, timeout=10))
    assert places.get_location_RPC("kitchen")[0].code is ReturnCode.METHOD_FAILED
    assert places.store_location_RPC("kitchen", KITCHEN) == OK
    assert places.get_location_RPC("kitchen") == (OK, KITCHEN)
    assert places.names() == ["kitchen"]
    assert places.introduce() == ((3, 4, 0, 0) if generation is Generation.YARP_4 else (3, 3, 12, 0))
    assert places.get_location_RPC("kitchen") == (OK, KITCHEN)


def test_a_client_reads_failures_after_a_restart_of_its_server(make_port: MakePort, naming: Naming) -> None:
    """The server stores the release of an introduced client only until that connection ends."""
    service = Navigation2DServer(SimpleNamespace(stopNavigation=lambda: ReturnValue(ReturnCode.METHOD_FAILED)))
    server = make_port("/server/rpc", Server(service), rpc=True)
    with ServiceClient(INavigation2DMsgs, "/server/rpc", naming=naming, timeout=10) as client:
        assert client.remote.stop_navigation_RPC().code is ReturnCode.METHOD_FAILED
        server.close()
        until(lambda: not client.core.connections.outputs, "the client detects the end of the connection", 10)
        make_port("/server/rpc", Server(service), rpc=True)
        for _ in range(2):
            assert client.remote.stop_navigation_RPC().code is ReturnCode.METHOD_FAILED


class _LostPort:
    """A port that has lost its connection; it counts how often it is asked whether it is open."""

    def __init__(self) -> None:
        self.connections = SimpleNamespace(outputs=[])
        self.asked = 0

    @property
    def is_open(self) -> bool:
        self.asked += 1
        return True

    def request(self, payload: bytes, **_: object) -> bytes:
        return payload


def test_two_calls_at_once_reconnect_only_once() -> None:
    """The second connection would close the first one, on which a call waits for its reply."""
    lost, begun, go_on = _LostPort(), list[int](), threading.Event()

    def connect() -> None:
        begun.append(1)
        assert go_on.wait(20)
        lost.connections.outputs.append("output")

    port: Any = lost
    channel = PortChannel(port, connect=connect)
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(channel.request, b"first", len)
        until(lambda: begun, "the first call connects")
        second = pool.submit(channel.request, b"second", len)
        until(lambda: lost.asked == 2, "the second call finds no connection")
        go_on.set()
        assert (first.result(20), second.result(20)) == (b"first", b"second")
    assert begun == [1]


def test_a_reply_of_a_megabyte_arrives(make_port: MakePort) -> None:
    make_port("/server/rpc", Server(PlacesServer(), Generations(Generation.YARP_3_11)), rpc=True)
    client = make_port("/client/rpc", rpc=True)
    assert client.add_output("/server/rpc")[0]
    places = Places(PortChannel(client, Generation.YARP_3_11, timeout=30))
    large = Map2DLocation("m", 0, 0, 0, "x" * 1_000_000)
    places.store_location_RPC("large", large)
    assert places.get_location_RPC("large") == (OK, large)


def test_the_server_distinguishes_clients_of_three_releases(make_port: MakePort) -> None:
    """A client of 4.0 introduces itself, a rule matches a client of 3.9, and the default applies to the third."""
    generations = Generations(Generation.YARP_3_12, [("/old/*", Generation.YARP_3_6)])
    make_port("/server/rpc", Server(PlacesServer(), generations), rpc=True)
    dialects = {"/new/rpc": Profile.YARP4, "/old/rpc": Profile.YARP3, "/other/rpc": Profile.YARP3}
    ports = {name: make_port(name, rpc=True, profile=profile) for name, profile in dialects.items()}
    for port in ports.values():
        assert port.add_output("/server/rpc")[0]
    assert Places(PortChannel(ports["/new/rpc"], timeout=10)).introduce() is not None
    store = Places.calls()["clear_RPC"].request([], Profile.YARP3)
    ok = "00010000 01000000 09000000 6f6b0000"
    for name, reply in [("/new/rpc", ok), ("/old/rpc", ok), ("/other/rpc", "01000000 00000000")]:
        expected = bytes.fromhex(reply)
        received = ports[name].request(store, timeout=10, parse=lambda data: whole(data, len(expected)))  # noqa: B023
        assert received == expected
    assert [(known.peer, known.generation) for known in generations.explain()] == [("/new/rpc", Generation.YARP_4)]


def test_a_release_is_forgotten_with_its_connection(make_port: MakePort) -> None:
    server = Server(PlacesServer())
    make_port("/server/rpc", server, rpc=True, on_event=server.on_event)
    client = make_port("/client/rpc", rpc=True)
    for _ in range(2):
        assert client.add_output("/server/rpc")[0]
        places = Places(PortChannel(client, timeout=10))
        assert places.clear_RPC() == OK
        until(lambda: server.generations.explain() == [], "the end of the previous connection is handled")
        assert places.introduce() is not None
        assert len(server.generations.explain()) == 1
        assert client.remove_output("/server/rpc")


def test_a_text_client_receives_text(make_port: MakePort) -> None:
    """`yarp rpc` and `telnet` use text, whatever the generation."""
    kept = PlacesServer()
    kept.at["kitchen"] = KITCHEN
    make_port("/server/rpc", Server(kept), rpc=True)
    client = make_port("/user", rpc=True)
    assert client.add_output("text_ack://server/rpc")[0]
    reply = client.request(binary.encode(["get_location_RPC", "kitchen"], Profile.YARP3), timeout=10)
    assert reply == b'[ok] (m1 1.5 -2.0 90.0 "by the door")\r\n' or binary.decode(reply) == [
        "ok",
        ["m1", 1.5, -2.0, 90.0, "by the door"],
    ]
