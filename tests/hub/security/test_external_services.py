"""The services that other machines may call and serve, tested with real servers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bridge.hub.endpoints import calls
from bridge.hub.endpoints.services import abandon_key
from bridge.hub.node import Hub
from bridge.hub.wire.keys import pack_attachment, topic_key
from tests.hub.endpoints.test_services import Called, Serving
from tests.peers.hub.endpoints import HASH, Subscriber, advertise, matched
from tests.peers.hub.machines import Machines, make_keys
from tests.support.wait import until

COMMANDS = {
    "/go/_action/send_goal": "nav2_msgs/action/NavigateToPose_SendGoal",
    "/go/_action/cancel_goal": "action_msgs/srv/CancelGoal",
    "/stop": "std_srvs/srv/SetBool",
}
QUESTIONS = {
    "/go/_action/get_result": "nav2_msgs/action/NavigateToPose_GetResult",
    "/map": "nav_msgs/srv/GetMap",
}


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    machines = Machines(make_keys(tmp_path_factory.mktemp("keys")))
    with machines.network:
        machines.network.start_router()
        with Hub.open(machines.network.settings("robot")) as robot, machines.hub("friend") as other:
            service, type_name = next(iter(QUESTIONS.items()))
            # a call within about 30 ms of the routers' start may reach no server
            until(lambda: called(robot, other, service, type_name)[1], "the routers have routes to each other")
        yield machines


def called(server: Hub, caller: Hub, name: str, type_name: str) -> tuple[bytes | str, bool]:
    """Return the result of a call, and whether the server was called."""
    requests: list[bytes] = []
    serving = Serving(server, name, lambda request: requests.append(request) or b"yes", type_name)
    client = caller.client(name, type_name, HASH)
    until(lambda: client.ready, "the server is seen")
    end = Called()
    client.call(b"go", end.done)
    result = end.wait()
    client.close()
    serving.server.close()
    return result, bool(requests)


def until_called(server: Hub, caller: Hub, name: str, type_name: str) -> bytes | str:
    """Call until the server is called, and return the result of that call.

    Three routers may announce a server before all have a route to it; such a call reaches no server.
    """
    return until(lambda: (end := called(server, caller, name, type_name))[1] and end, f"{name} is called")[0]


@pytest.mark.parametrize(("name", "commands"), [("friend", True), ("guest", False)])
def test_only_a_trusted_machine_calls_services_that_command(
    machines: Machines, name: str, commands: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calls, "_AT_ONCE", 40.0)  # no matter how slow the machine is
    with Hub.open(machines.network.settings("robot")) as robot, machines.hub(name) as other:
        for service, type_name in QUESTIONS.items():
            assert until_called(robot, other, service, type_name) == b"yes"
        for service, type_name in COMMANDS.items():
            if commands:
                assert until_called(robot, other, service, type_name) == b"yes"
                continue
            result, was_called = called(robot, other, service, type_name)
            assert not was_called
            refused = (
                f"the server of {service} left before it answered;"
                " or an external listener between the machines refuses this call (hub.open.trusted)"
            )
            assert result == refused


@pytest.mark.parametrize("name", ["friend", "guest"])
def test_every_machine_answers_calls_of_its_own_services(machines: Machines, name: str) -> None:
    """Its replies to goal requests pass, too, because it serves the action itself."""
    with Hub.open(machines.network.settings("robot")) as robot, machines.hub(name) as other:
        for service, type_name in {**QUESTIONS, **COMMANDS}.items():
            assert until_called(other, robot, service, type_name) == b"yes"


@pytest.mark.parametrize(("name", "works"), [("friend", True), ("guest", False)])
def test_only_a_trusted_machine_could_abandon_the_calls_of_others(machines: Machines, name: str, works: bool) -> None:
    """Abandoned calls are announced on a separate key next to the service's."""
    service, type_name = "/stop", COMMANDS["/stop"]
    with (
        Hub.open(machines.network.settings("robot")) as robot,
        Hub.open(machines.network.settings("local")) as local,
        machines.hub(name) as other,
    ):
        serving = Serving(robot, service, type_name=type_name)
        client = local.client(service, type_name, HASH)
        until(lambda: client.ready, "the server is seen")
        end = Called()
        client.call(b"go", end.done)
        until(lambda: serving.held, "the request has arrived")
        last, subscriber = advertise(other, "/last"), Subscriber(robot, "/last")
        matched(last)
        key = abandon_key(topic_key(other.domain, service, type_name, HASH))
        abandon = pack_attachment(1, 1, client.gid)
        other._session.put(key, abandon)
        until(lambda: last.put(b"end") or subscriber.samples, "the last message arrives")
        # messages sent before the route to the subscriber is known are lost
        until(lambda: not works or other._session.put(key, abandon) or serving.abandoned, "the call is abandoned")
        assert bool(serving.abandoned) == works
