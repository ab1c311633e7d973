"""Clients of all releases at one server: each gets its own replies, and none reads a failure as success."""

from __future__ import annotations

import logging
import random
from collections.abc import Callable

import pytest

from tests.support.wait import until
from tests.yarp_compat.dev.interfaces import All
from tests.yarp_compat.dev.release_clients import (
    BAD,
    GOOD,
    LOADED,
    Client,
    Load,
    Planner,
    connect,
    loads,
    reads_all_replies,
    settled,
)
from tests.yarp_compat.ports.conftest import make_port, naming
from yarp_compat.dev.release_trial import ReleaseTrials
from yarp_compat.dev.server import Server
from yarp_compat.ports.naming import Naming
from yarp_compat.wire import carriers, framing
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile

__all__ = ["connect", "loads", "make_port", "naming"]


@pytest.mark.parametrize("release", ["3.6", "3.9", "3.11", "3.12"])
def test_no_client_of_an_unknown_release_reads_a_failure_as_success(
    connect: Callable[..., Client], release: str
) -> None:
    """Over tcp, clients also stay in step: no reply is read as the reply to a later call."""
    client = connect(Server(Planner()), "/nav/rpc", release)
    calls = [(call, True) for call in GOOD] + [(call, False) for call in BAD]
    chance = random.Random(7)
    for (name, arguments), succeeds in chance.choices(calls, k=200):
        success = client.call(name, arguments)
        assert client.in_step, name
        assert succeeds or not success, name
        if release == "3.12" or (release in ("3.6", "3.9") and All.calls()[name].single):
            assert success is succeeds, name


def test_a_map_client_of_3_12_works_without_acknowledgements(connect: Callable[..., Client]) -> None:
    client = connect(Server(Planner()), "/maps/rpc", "3.12", carriers.FAST_TCP)
    for (name, arguments), succeeds in [*((c, True) for c in GOOD), *((c, False) for c in BAD)] * 3:
        assert client.call(name, arguments) is succeeds, name
        assert client.in_step


def test_a_method_of_3_12_shows_the_release(connect: Callable[..., Client]) -> None:
    """The reply to the next failed call contains the failure's number; clients that may be older do not get it."""
    server = Server(Planner())
    client = connect(server, "/nav/rpc", "3.12")
    assert client.call("get_object_RPC", ["cup"])
    (decision,) = server.generations.explain()
    assert (decision.peer, decision.generation, decision.sure) == ("/nav/rpc", Generation.YARP_3_12, True)
    assert "get_object_RPC" in decision.reason
    client.send(All.calls()["resume_navigation_RPC"].request([], Profile.YARP3))
    assert client.receive(16) == bytes.fromhex("01000000 05000000") + framing.ACK


def test_a_typed_request_gets_a_bottle(connect: Callable[..., Client]) -> None:
    """`yarp rpc` sends the name in one word, which generated code never does."""
    client = connect(Server(Planner()), "/user", "3.12")
    for typed, vocab in (("stop_navigation_RPC", b"ok\0\0"), ("resume_navigation_RPC", b"fail")):
        client.send(encode([typed], Profile.YARP3))
        assert client.receive(16 + 8) == bytes.fromhex("00010000 01000000 09000000") + vocab + framing.ACK
    client.send(encode(["get_location_RPC", "nowhere"], Profile.YARP3))
    assert decode(client.receive(76 + 8)[:-8], Profile.YARP3)[0] == "fail"


def test_two_clients_of_one_name_are_distinguished(connect: Callable[..., Client]) -> None:
    """Names without a slash belong to programs without a port, and several programs may share such a name."""
    server = Server(Planner())
    new, old = connect(server, "nav", "4.0"), connect(server, "nav", "3.12")
    new.introduce()
    for name, arguments in GOOD:
        assert old.call(name, arguments), name
        assert new.call(name, arguments), name
    for name, arguments in BAD:
        assert not old.call(name, arguments), name
        assert not new.call(name, arguments), name
    assert [decision.generation.value for decision in server.generations.explain()] == ["4.0"]


def test_the_log_names_each_unknown_client_and_its_setting_once(
    connect: Callable[..., Client], caplog: pytest.LogCaptureFixture
) -> None:
    server = Server(Planner(), Generations(cure="set the release of {peer}"))
    with caplog.at_level(logging.WARNING):
        for peer in ("/a", "/b"):
            client = connect(server, peer, "3.9")
            for name, arguments in [*GOOD, *BAD]:
                client.call(name, arguments)
    lines = [record.getMessage() for record in caplog.records if "release" in record.getMessage()]
    assert ["set the release of /a" in lines[0], "set the release of /b" in lines[1]] == [True, True]
    assert len(lines) == 2
    assert server.generations.of("/b").as_dict()["generation_cure"] == "set the release of /b"
    named = Server(Planner(), Generations(Generation.YARP_3_6))
    assert "generation_cure" not in named.generations.of("/a").as_dict()


def test_local_clients_get_replies_for_their_library(
    connect: Callable[..., Client], loads: Load, caplog: pytest.LogCaptureFixture
) -> None:
    """All generations at one server, without a setting; also with fast_tcp, which has no unambiguous replies."""
    for carrier in (carriers.TCP, carriers.FAST_TCP):
        server = Server(Planner())
        clients = {loaded: connect(server, f"/of{name}/rpc", name, carrier) for name, loaded in LOADED.items()}
        loads(clients)
        for client in clients.values():
            assert reads_all_replies(client)
        for name, loaded in LOADED.items():
            decision = server.generations.of(f"/of{name}/rpc", link=clients[loaded].address)
            assert (decision.generation, decision.sure) == (Generation.of(loaded), True)
            assert loaded in decision.reason
    assert not [record for record in caplog.records if record.name.startswith("yarp")]


def test_a_setting_overrides_the_library(connect: Callable[..., Client], loads: Load) -> None:
    for settings in (Generations(None, [("/odd/*", Generation.YARP_3_6)]), Generations(Generation.YARP_3_6)):
        client = connect(Server(Planner(), settings), "/odd/rpc", "3.9")
        loads({"3.12.3": client})
        assert reads_all_replies(client)


def test_another_release_may_connect_under_the_same_name(connect: Callable[..., Client], loads: Load) -> None:
    server = Server(Planner())
    for name in ("3.9", "3.12", "3.9"):
        client = connect(server, "/nav/navigation/rpc", name)
        loads({LOADED[name]: client})
        assert reads_all_replies(client)
        client.close()


def test_all_devices_of_a_process_have_one_release(connect: Callable[..., Client], naming: Naming) -> None:
    """The process is identified by its host and the property ``process`` that C++ ports set (``NameClient.cpp``)."""
    server = Server(Planner())
    trials = ReleaseTrials(server.generations, naming)
    clients: dict[str, Client] = {}
    for device, host, process in (
        ("/map", "127.0.0.1", 7), ("/near", "127.0.0.1", 7), ("/other", "127.0.0.1", 8), ("/far", "192.0.2.7", 7),
    ):  # fmt: skip
        port = f"{device}/mapClient_rpc"
        naming.register(port, host, 10_000)
        naming.set_property(port, "process", process)
        clients[device] = settled(connect(server, port, "3.12", carriers.FAST_TCP))
        trials.connected(port, clients[device].address)
    until(lambda: not trials.running, "all look-ups have ended")
    assert clients["/map"].call("get_object_RPC", ["cup"])
    decisions = {
        device: server.generations.of(f"{device}/mapClient_rpc", link=client.address)
        for device, client in clients.items()
    }
    assert [device for device, decision in decisions.items() if decision.sure] == ["/map", "/near"]
    assert decisions["/near"].reason.startswith("its process also has /map, and it called get_object_RPC")
    trials.close()


def test_all_ports_of_a_device_have_one_release(connect: Callable[..., Client]) -> None:
    server = Server(Planner(), Generations(Generation.YARP_3_6))
    nav, maps = connect(server, "/nav/navigation/rpc", "4.0"), connect(server, "/nav/locations/rpc", "4.0")
    nav.introduce()
    assert reads_all_replies(maps)
    old = connect(server, "/old/locations/rpc", "3.9")
    assert reads_all_replies(old)
