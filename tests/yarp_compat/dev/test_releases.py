"""Clients of all releases at one server: each gets its own replies, and none reads a failure as success."""

from __future__ import annotations

import itertools
import logging
import random
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.peers.yarp.processes import library, processes
from tests.support.wait import until
from tests.yarp_compat.dev.interfaces import All
from tests.yarp_compat.dev.releases import RELEASES, Release
from tests.yarp_compat.dev.test_transcripts import exchanges, parse_request
from tests.yarp_compat.ports.conftest import MakePort, make_port, naming
from yarp_compat.dev.inavigation2d import NavigationStatusEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DObject
from yarp_compat.dev.release_trial import ReleaseTrials
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.server import Server
from yarp_compat.dev.service import INTRODUCTION, VERSION, Call
from yarp_compat.ports import client_process
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import Naming
from yarp_compat.wire import carriers, framing
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import Incomplete
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

__all__ = ["make_port", "naming"]

BY_NAME = {release.name: release for release in RELEASES}
KITCHEN = Map2DLocation("m1", 1.0, 2.0, 90.0, "")


class Planner(All):
    """A planner that has only the kitchen, and refuses goals elsewhere."""

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
    """A program of a release, connected to a server's port: a socket that reads like its generated code."""

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
        """Make a call; return whether the client reads a success."""
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
        """Introduce the client, the first request of clients of 4.0."""
        self.send(encode([INTRODUCTION], Profile.YARP4))
        self.receive(VERSION.size + 8)

    def read(self, call: Call) -> bool:
        while True:
            try:
                ok, end = self._release.read(call, self._buffer, acked=self._acked)
            except Incomplete:
                part = self._sock.recv(4096)
                assert part, "the server closed"
                self._buffer += part
            else:
                self._buffer = self._buffer[end:]
                return ok

    @property
    def in_step(self) -> bool:
        """Whether the last reply is consumed completely."""
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


@pytest.mark.parametrize("release", ["3.6", "3.9", "3.11", "3.12"])
def test_no_client_of_an_unknown_release_reads_a_failure_as_success(
    connect: Callable[..., Client], release: str
) -> None:
    """With tcp, all also stay in step: no reply is read as the reply to a later call."""
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
    """The next failure has its number, which is not sent to a client that may be older."""
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
    """Names without a slash belong to programs without a port, and several programs may share one."""
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


# -- without a setting -------------------------------------------------------------------------------------------------


@pytest.fixture
def loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, Client]], None]:
    """Let the processes of clients load the library of a release."""
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
    assert not caplog.records


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


def test_a_map_client_with_tcp_is_taken_for_one_before_3_10(connect: Callable[..., Client]) -> None:
    """``map2D_nwc_yarp`` connects by fast_tcp since 3.10; as this is only a hint, replies stay unambiguous."""
    server = Server(Planner())
    old = connect(server, "/module/mapClient_rpc", "3.9", carriers.TCP)
    new = connect(server, "/other/mapClient_rpc", "3.12", carriers.FAST_TCP)
    assert reads_all_replies(old)
    assert reads_all_replies(new)
    decision = server.generations.of("/module/mapClient_rpc", link=old.address)
    assert (decision.generation, decision.sure) == (Generation.YARP_3_6, False)
    unsure = connect(server, "/third/mapClient_rpc", "3.12", carriers.TCP)
    for name, arguments in BAD:
        assert not unsure.call(name, arguments), name
        assert unsure.in_step


@pytest.mark.parametrize(("name", "rounds"), [("3.12", 0), ("3.9", 1), ("3.6", 1)])
def test_a_request_for_the_area_shows_that_the_location_was_not_read(
    connect: Callable[..., Client], name: str, rounds: int
) -> None:
    """As in ``navigation2D_nwc_yarp``'s ``gotoTargetByLocationName``; the finding applies to all the device's ports."""
    server = Server(Planner())
    maps, goals = connect(server, "/nav/locations/rpc", name), connect(server, "/nav/navigation/rpc", name)
    needed = 0
    while not maps.call("get_location_RPC", ["kitchen"]):
        maps.call("get_area_RPC", ["kitchen"])
        needed += 1
        assert needed <= 1
    assert needed == rounds
    for client in (maps, goals):
        assert client.call("get_navigation_status_RPC", [])
        for method, arguments in BAD:
            assert not client.call(method, arguments), method
            assert client.in_step
    decision = server.generations.of("/nav/navigation/rpc", link=goals.address)
    assert (decision.generation, decision.sure) == (Generation.of(name), False)


def test_a_request_for_another_area_shows_nothing(connect: Callable[..., Client]) -> None:
    client = connect(Server(Planner()), "/nav/locations/rpc", "3.12")
    for method, arguments in (("get_area_RPC", ["bedroom"]), ("get_navigation_status_RPC", [])):
        assert client.call("get_location_RPC", ["kitchen"])
        client.call(method, arguments)
        client.call("get_area_RPC", ["kitchen"])
        assert client.call("get_location_RPC", ["kitchen"]), "the area was not the next request"


def settled(client: Client) -> Client:
    """Return a client after the server has registered its connection, which a call ensures."""
    client.call("stop_navigation_RPC", [])
    return client


class Places(Planner):
    """A planner with a location; ``names`` are those of its list."""

    def __init__(self, *names: str) -> None:
        super().__init__()
        self.names = list(names)

    def get_locations_list_RPC(self) -> Any:
        return OK, self.names


class Commands:
    """The ``<local>/user_commands/rpc`` of a ``navigation2D_nwc_yarp``, which requests the list from its map server."""

    def __init__(self, maps: Client, names: list[str]) -> None:
        self.maps, self.names = maps, names
        self.requests: list[Any] = []

    def __call__(self, message: PortMessage) -> None:
        self.requests.append(decode(message.payload, Profile.YARP3))
        read = self.maps.call("get_locations_list_RPC", [])
        message.reply(encode([Vocab("many"), *(self.names if read else [])], Profile.YARP3))


@pytest.mark.parametrize(
    ("name", "names", "generation", "sure"),
    [
        ("3.9", ["kitchen", "bed room"], Generation.YARP_3_6, True),
        ("3.6", ["kitchen"], Generation.YARP_3_6, True),
        ("3.12", ["kitchen"], Generation.YARP_3_12, False),
        ("3.9", [], Generation.YARP_3_12, False),  # an empty list shows nothing
    ],
)
def test_a_list_of_locations_shows_the_release_of_a_navigation_client(
    connect: Callable[..., Client], make_port: MakePort, naming: Naming, name: str, names: list[str],
    generation: Generation, sure: bool,
) -> None:  # fmt: skip
    server = Server(Places(*names))
    maps = settled(connect(server, "/nav/locations/rpc", name))
    goals = settled(connect(server, "/nav/navigation/rpc", name))
    trials = ReleaseTrials(server.generations, naming)
    trials.connected("/nav/navigation/rpc", goals.address)
    commands = Commands(maps, names)
    make_port("/nav/user_commands/rpc", commands, rpc=True)
    until(lambda: commands.requests == [["listLocations"]], "the request")
    until(lambda: not trials.running, "the end of the trial")
    decision = server.generations.of("/nav/navigation/rpc", link=goals.address)
    assert (decision.generation, decision.sure) == (generation, sure)
    if names:
        for client in (maps, goals):
            assert reads_all_replies(client)
    trials.close()


def test_a_client_of_another_map_server_stays_unknown(
    connect: Callable[..., Client], make_port: MakePort, naming: Naming
) -> None:
    ours, theirs = Server(Places("kitchen")), Places("kitchen")
    goals = settled(connect(ours, "/nav/navigation/rpc", "3.12"))
    other = make_port("/real/rpc", Server(theirs, Generations(Generation.YARP_3_12)), rpc=True)
    maps = Client("/nav/locations/rpc", BY_NAME["3.12"], other.contact)
    commands = Commands(maps, ["kitchen"])
    make_port("/nav/user_commands/rpc", commands, rpc=True)
    trials = ReleaseTrials(ours.generations, naming)
    trials.connected("/nav/navigation/rpc", goals.address)
    until(lambda: commands.requests and not trials.running, "the end of the trial")
    assert ours.generations.findings.get("/nav/navigation/rpc") is None
    maps.close()
    trials.close()


def test_no_trial_starts_for_a_known_client(
    connect: Callable[..., Client], make_port: MakePort, naming: Naming
) -> None:
    server = Server(Places("kitchen"), Generations(None, [("/nav/*", Generation.YARP_3_12)]))
    maps = connect(server, "/nav/locations/rpc", "3.12")
    commands = Commands(maps, ["kitchen"])
    make_port("/nav/user_commands/rpc", commands, rpc=True)
    trials = ReleaseTrials(server.generations, naming)
    for peer in ("/nav/locations/rpc", "/nav/other", "nav/locations/rpc"):
        trials.connected(peer, maps.address)
    until(lambda: not trials.running, "the end of the trials")
    assert commands.requests == []
    trials.close()


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
    until(lambda: not trials.running, "the end of the look-ups")
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


# -- the transcripts ---------------------------------------------------------------------------------------------------

Talk = list[tuple[bytes, bytes]]


def recorded() -> dict[str, Talk]:
    """Return requests and replies of four releases.

    Those of 3.12.3 and 4.0 were recorded. Requests of 3.6 and 3.9 equal 3.12's (captured with 3.9.1; the interfaces and
    writers of v3.6.0 and v3.9.1 are the same for all of these), and their replies have a boolean as outcome.
    """
    older = []
    for request, reply in exchanges("nav-3.12.3.txt"):
        _, call, _ = parse_request(request, Profile.YARP3)
        assert call is not None
        results = call.read_reply(reply, Generation.YARP_3_12).results
        older.append((request, call.reply(results, Generation.YARP_3_6)))
    newer = [(request, reply) for name in ("nav-3.12.3.txt", "nav-4.0.txt") for request, reply in exchanges(name)]
    split = len(older)
    return {"3.6": older, "3.9": older, "3.12": newer[:split], "4.0": newer[split:]}


class Replaying(All):
    """A server whose methods return the recorded results of the client's release, taken from the thread's name."""

    def __init__(self, talks: dict[str, Talk]) -> None:
        super().__init__()
        self.results: dict[str, list[list[Any]]] = {}
        for release, talk in talks.items():
            generation = Generation.of(release)
            for request, reply in talk:
                _, call, _ = parse_request(request, generation.profile)
                if call is not None:
                    self.results.setdefault(release, []).append(call.read_reply(reply, generation).results)

    def __getattribute__(self, name: str) -> Any:
        if name.endswith("RPC"):
            return lambda *_: self.next_results()
        return super().__getattribute__(name)

    def next_results(self) -> Any:
        release = threading.current_thread().name.split()[1].removeprefix("/nav")
        results = self.results[release].pop(0)
        return results[0] if len(results) == 1 else tuple(results)


def test_transcripts_of_four_releases_are_reproduced_at_one_server(connect: Callable[..., Client]) -> None:
    """The clients take turns; each reply equals that of the real server byte for byte."""
    talks = recorded()
    rules = [(f"/nav{release}", Generation.of(release)) for release in ("3.6", "3.9", "3.12")]
    replaying = Replaying(talks)
    server = Server(replaying, Generations(None, rules))
    clients = {release: connect(server, f"/nav{release}", release) for release in talks}
    for requests in itertools.zip_longest(*([(release, *pair) for pair in talk] for release, talk in talks.items())):
        sent = [request for request in requests if request is not None]
        for release, request, _ in sent:
            clients[release].send(request)
        for release, _, reply in sent:
            assert clients[release].receive(len(reply) + 8) == reply + framing.ACK, release
    assert not any(replaying.results.values())


def test_transcripts_of_four_unknown_releases_contain_no_false_success(connect: Callable[..., Client]) -> None:
    """Clients of 3.12 and 4.0 read all results; the older ones never read a false success."""
    talks = recorded()
    server = Server(Replaying(talks), Generations())
    clients = {release: connect(server, f"/nav{release}", release) for release in talks}
    for requests in itertools.zip_longest(*([(release, *pair) for pair in talk] for release, talk in talks.items())):
        for recorded_call in requests:
            if recorded_call is None:
                continue
            release, request, reply = recorded_call
            generation, client = Generation.of(release), clients[release]
            _, call, _ = parse_request(request, generation.profile)
            client.send(request)
            if call is None:
                assert client.receive(len(reply) + 8) == reply + framing.ACK
                continue
            succeeded = bool(call.read_reply(reply, generation).results[0])
            success = client.read(call)
            assert client.in_step
            if release in ("3.12", "4.0") or call.single:
                assert success is succeeded, (release, call.name)
            else:
                assert not success


def test_outcomes_have_the_numbers_and_names_of_the_bindings() -> None:
    failed = ReturnValue(ReturnCode.METHOD_FAILED)
    number = getattr(ReturnValue, "return_code_return_value_error_method_failed")  # noqa: B009 - set from a table
    assert number == int.from_bytes(b"err5", "little")
    assert failed == number
    assert hash(failed) == hash(number), "equal objects have equal hashes"
    assert failed.isEqual(number)
    assert ReturnValue(number) == failed
    assert failed.toString() == "return_value_error_method_failed"
    assert not ReturnValue()
    assert ReturnValue().toString() == "return_value_uninitialized"
    outcome = ReturnValue(OK)
    outcome &= failed
    outcome &= OK
    assert outcome == failed
