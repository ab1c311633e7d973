"""Which requests reveal the release of a client whose release is unknown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.wait import until
from tests.yarp_compat.dev.release_clients import (
    BAD,
    BY_NAME,
    Client,
    Planner,
    connect,
    loads,
    reads_all_replies,
    settled,
)
from tests.yarp_compat.ports.conftest import MakePort, make_port, naming
from yarp_compat.dev import release_trial
from yarp_compat.dev.release_trial import ReleaseTrials
from yarp_compat.dev.returnvalue import OK
from yarp_compat.dev.server import Server
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import Naming
from yarp_compat.wire import carriers
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.generation import Generation, Generations
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

__all__ = ["connect", "loads", "make_port", "naming"]


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a trial wait on a busy machine for the client's port, and for its reply; a second trial would ask again."""
    monkeypatch.setattr(release_trial, "_OPENING", 60.0)
    monkeypatch.setattr(release_trial, "_PATIENCE", 60.0)


def test_a_map_client_over_tcp_counts_as_older_than_3_10(connect: Callable[..., Client]) -> None:
    """``map2D_nwc_yarp`` connects by fast_tcp since 3.10; this is only a hint, so replies stay unambiguous."""
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
    """``gotoTargetByLocationName`` of ``navigation2D_nwc_yarp`` does this. The finding applies to all its ports."""
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


class Places(Planner):
    """A planner with a location; ``names`` are the names in the planner's list."""

    def __init__(self, *names: str) -> None:
        super().__init__()
        self.names = list(names)

    def get_locations_list_RPC(self) -> Any:
        return OK, self.names


class Commands:
    """The ``<local>/user_commands/rpc`` of a ``navigation2D_nwc_yarp``, which requests the list from the map server."""

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
    until(lambda: commands.requests == [["listLocations"]], "the trial's request has arrived")
    until(lambda: not trials.running, "the trial has ended")
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
    until(lambda: commands.requests and not trials.running, "the trial has ended")
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
    until(lambda: not trials.running, "all trials have ended")
    assert commands.requests == []
    trials.close()
