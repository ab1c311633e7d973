"""Services and RPC ports: YARP programs call the hub's services, and rules offer ports as services."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.yarp.services import ServedPort
from bridge.hub.endpoints.calls import Abandon, CallError, Done
from bridge.routing.edge import MadeBy
from tests.adapters.yarp.conftest import Place
from tests.peers.hub.node import HubNode
from tests.peers.yarp.native_client import NativeClient
from tests.support.wait import until
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import PortError
from yarp_compat.pythonic import Client, Server
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

BOOL, PLAN, EMPTY = "std_srvs/srv/SetBool", "nav_msgs/srv/GetPlan", "std_srvs/srv/Empty"


class Robot(HubNode):
    """A node on the hub."""

    def __init__(self, place: Place) -> None:
        super().__init__(place.hubs.settings("robot"))
        self.held: list[Any] = []

    def switch(self, request: dict[str, Any], answer: Any) -> None:
        if request["data"]:
            answer({"success": True, "message": "is on"})
        else:
            self.held.append(answer)

    def call(self, client: Any, request: dict[str, Any]) -> list[Any]:
        replies: list[Any] = []
        until(lambda: client.ready, "the server is available", 20)
        client.call(request, replies.append)
        return replies


@pytest.fixture
def robot(place: Place) -> Iterator[Robot]:
    return place.keep(Robot(place))


def connect_client(place: Place, port: str, profile: Profile = Profile.YARP3, name: str = "/asks") -> Client:
    client = Client(port, name, naming=place.names.client, profile=profile)

    def opened() -> bool:  # a port is registered before it listens
        try:
            client.open()
        except PortError:
            return False
        return True

    until(opened, f"{port} is open", 20)
    return place.keep(_Closing(client)).end


class _Closing:
    def __init__(self, end: Any) -> None:
        self.end = end

    def stop(self) -> None:
        self.end.close()


@pytest.mark.parametrize("profile", Profile)
def test_hub_service_is_an_rpc_port(place: Place, robot: Robot, profile: Profile) -> None:
    robot.node.server("/lamp", BOOL, robot.switch)
    robot.node.server("/plan", PLAN, lambda request, answer: answer({"plan": {"header": request["start"]["header"]}}))
    place.bridge(yarp={"profile": profile.value})
    client = connect_client(place, "/midspan/lamp/rpc", profile)
    assert client.ask([True], timeout=20) == [1, "is on"]
    assert client.ask(["on"], timeout=20)[0] == Vocab("fail")
    with connect_client(place, "/midspan/plan/rpc", profile, "/plans") as plans:
        pose = [[0, [12, 5], "map"], [[1.5, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]]
        assert plans.ask([pose, pose, 0.5], timeout=20)[0][0][1:] == [[12, 5], "map"]


def test_a_rule_chooses_the_fields_of_request_and_reply(place: Place, robot: Robot) -> None:
    robot.node.server("/lamp", BOOL, robot.switch)
    cleared: list[Any] = []
    robot.node.server("/clear", EMPTY, lambda request, answer: (cleared.append(request), answer({})))
    rule = {"service": "/lamp", "request": ["'set'", "data"], "reply": ["message"]}
    place.bridge(yarp={"services": [rule]})
    client = connect_client(place, "/midspan/lamp/rpc")
    assert client.ask(["set", 1], timeout=20) == ["is on"]
    (port,) = [entry for entry in place.far.status()["ports"] if entry["port"] == "/midspan/lamp/rpc"]
    assert (port["direction"], port["carries"], port["replies"]) == ("rpc", "fields 'set' data", "fields message")
    failed = client.ask(["get", 1], timeout=20)
    assert failed[0] == Vocab("fail")
    assert "'set'" in failed[1]
    with connect_client(place, "/midspan/clear/rpc", name="/clears") as other:
        assert other.ask([], timeout=20) == [Vocab("ok")]
    assert cleared


def test_slow_call_does_not_block_others_and_is_abandoned_when_its_client_leaves(place: Place, robot: Robot) -> None:
    server = robot.node.server("/lamp", BOOL, robot.switch)
    place.bridge()
    slow = connect_client(place, "/midspan/lamp/rpc")

    def ask() -> None:
        with pytest.raises(ConnectionError):
            slow.ask([False])

    thread = threading.Thread(target=ask)
    thread.start()
    until(lambda: robot.held, "the slow call is pending")
    with Client("/midspan/lamp/rpc", naming=place.names.client) as quick:
        assert quick.ask([True], timeout=20)[1] == "is on"
    slow.close()
    thread.join()
    until(lambda: server.waiting == 0, "the call is abandoned", 20)


def test_pending_call_fails_when_the_server_leaves(place: Place, robot: Robot) -> None:
    robot.node.server("/lamp", BOOL, robot.switch)
    place.bridge()
    client = connect_client(place, "/midspan/lamp/rpc")
    answers: list[Any] = []
    thread = threading.Thread(target=lambda: answers.append(client.ask([False])))
    thread.start()
    until(lambda: robot.held, "the call is pending")
    robot.node.close()
    thread.join(20)
    assert answers[0][0] == Vocab("fail")
    until(lambda: place.names.client.query("/midspan/lamp/rpc") is None, "the port is closed", 20)


def test_native_client_is_served_again_when_the_server_returns(place: Place, robot: Robot) -> None:
    """The port closes and returns with the server, such as a module whose worker was killed."""
    robot.node.server("/lamp", BOOL, robot.switch)
    place.bridge()
    client = NativeClient("/native/rpc", place.names.client)
    place.keep(_Closing(client))
    on = binary.encode([1], Profile.YARP3)
    until(lambda: client.connect("/midspan/lamp/rpc"), "the port is open", 20)
    answer = client.call(on)
    assert answer
    assert b"is on" in answer
    robot.node.close()
    until(lambda: place.names.client.query("/midspan/lamp/rpc") is None, "the port is closed", 20)
    assert client.call(on) is None
    place.keep(Robot(place)).node.server("/lamp", BOOL, robot.switch)
    until(lambda: client.call(on) == answer, "the client is served again", 20)


@pytest.mark.parametrize("profile", Profile)
def test_port_in_a_rule_is_a_service(place: Place, robot: Robot, profile: Profile) -> None:
    rule = {"service": "/lamp", "port": "/lamp/rpc:i", "type": BOOL, "request": ["'set'", "data"], "reply": ["message"]}
    place.bridge(yarp={"services": [rule]})
    requests: list[Any] = []

    def respond(values: list[Any]) -> list[Any]:
        requests.append(values)
        return ["is on"] if values[1] else [Vocab("fail"), "no current"]

    port = Server("/lamp/rpc:i", respond, naming=place.names.client, profile=profile)
    place.keep(_Closing(port.open()))
    client = robot.node.client("/lamp", BOOL)
    replies = robot.call(client, {"data": True})
    assert until(lambda: replies, "a reply", 20)[0]["message"] == "is on"
    assert requests[0] == ["set", 1]
    errors = robot.call(client, {"data": False})
    assert str(until(lambda: errors, "an error", 20)[0]) == "no current"


def test_calls_end_when_the_port_closes_and_work_again_when_it_returns(place: Place, robot: Robot) -> None:
    rule = {"service": "/lamp", "port": "/lamp/rpc:i", "type": BOOL}
    place.bridge(yarp={"services": [rule]})
    gate = threading.Event()
    client = robot.node.client("/lamp", BOOL)
    for text in ("first", "second"):
        gate.clear()
        begun = threading.Event()

        def respond(values: list[Any], text: str = text, begun: threading.Event = begun) -> list[Any]:
            begun.set()
            if not values[0]:
                gate.wait(30)
            return [1, text]

        port = Server("/lamp/rpc:i", respond, naming=place.names.client).open()
        done = robot.call(client, {"data": True})
        assert until(lambda d=done: d, "a reply", 20)[0]["message"] == text
        begun.clear()
        waiting = [robot.call(client, {"data": False}) for _ in range(3)]
        assert begun.wait(20)
        quick = robot.call(client, {"data": True})
        assert until(lambda q=quick: q, "slow calls do not block others", 20)[0]["message"] == text
        threading.Timer(0.2, gate.set).start()
        port.close()
        ends = [until(lambda r=replies: r, "the call ends", 20)[0] for replies in waiting]
        assert all(isinstance(end, CallError) or end["message"] == text for end in ends)
        until(lambda: not client.ready, "the service is withdrawn", 20)


def test_malformed_reply_is_an_error(place: Place, robot: Robot) -> None:
    rule = {"service": "/lamp", "port": "/lamp/rpc:i", "type": BOOL}
    place.bridge(yarp={"services": [rule]})
    place.keep(_Closing(Server("/lamp/rpc:i", lambda _values: ["maybe"], naming=place.names.client).open()))
    errors = robot.call(robot.node.client("/lamp", BOOL), {"data": True})
    assert "malformed reply" in str(until(lambda: errors, "an error", 20)[0])


def test_port_of_midspan_is_not_called(place: Place, robot: Robot) -> None:
    """A rule that offered a hub service's own port as another service would cause a loop."""
    robot.node.server("/lamp", BOOL, robot.switch)
    rule = {"service": "/again", "port": "/midspan/lamp/rpc", "type": BOOL}
    place.bridge(yarp={"services": [rule]})
    errors = robot.call(robot.node.client("/again", BOOL), {"data": True})
    assert "a port of Midspan" in str(until(lambda: errors, "an error", 20)[0])


def test_call_that_begins_while_its_service_closes_is_abandoned() -> None:
    ended: list[str] = []
    bottles: Any = SimpleNamespace(
        request_to_hub=lambda payload, profile: (payload, profile), reply_to_yarp=lambda *_: b"no more"
    )
    peer: Any = SimpleNamespace(route=SimpleNamespace(source="/asks"), profile=None)

    def call(_request: bytes, _done: Done) -> Abandon:
        served.close()
        return lambda: ended.append("abandoned")

    served = ServedPort("/lamp", bottles, call, lambda _: MadeBy.NATIVE, lambda *_: None)
    message = PortMessage(b"on", "", peer, wants_reply=True)
    served.on_message(message)
    assert message.wait() == b"no more"
    assert ended == ["abandoned"]
