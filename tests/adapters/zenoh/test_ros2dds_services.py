"""Services of the ros2dds dialect: exact tokens and bytes. The contract suite has the tests shared by all sides."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import zenoh

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.adapters.zenoh.conftest import Place, until_linked
from tests.contract.hubside import HubSide
from tests.peers.hub.quick import QuickHub
from tests.peers.zenoh.programs import Ros2ddsBridge
from tests.support.wait import until

SET, TRIGGER = "std_srvs/SetBool", "std_srvs/Trigger"
SIDE = "zenoh_ros2dds"
YES = {"success": True, "message": "yes"}
TRUE = bytes.fromhex("00010000 01")
REPLY = bytes.fromhex("00010000 01000000 04000000 79657300")


def until_called(bridge: Ros2ddsBridge, service: str, type_: str = SET) -> None:
    """Call a hub server until it replies, because its token arrives shortly before zenoh can route queries to it."""
    until_linked(bridge)
    request = {"data": True} if type_ == SET else {}
    until(lambda: bridge.call(service, type_, request).result()["reply"] == YES, "the server replies", every=0.1)


def test_a_bridge_receives_tokens_and_exact_replies(place: Place) -> None:
    """Calls come from a bridge, and from plain zenoh programs without the bridge's attachment."""
    bridge = place.ros2dds("robot1")
    place.bridge({"dialect": "ros2dds", "namespace": "/robot1"})
    serving = place.far.serve("/arm/light", SET, reply=YES)
    place.far.serve("/beep", TRIGGER, reply=YES)
    token = until(lambda: bridge.tokens("/arm/light", "SS"), "Midspan's token arrives")[0]
    zid = token.split("/")[1]
    assert token == f"@/{zid}/@ros2_lv/SS/robot1§arm§light/std_srvs§srv§SetBool"
    until_called(bridge, "/arm/light")

    def plain(key: str, **more: Any) -> list[zenoh.Reply]:
        return until(lambda: list(bridge.session.get(key, timeout=20.0, **more)), "a reply arrives", every=0.1)

    (reply,) = plain("robot1/arm/light", payload=TRUE)
    assert (reply.ok.payload.to_bytes(), reply.ok.attachment) == (REPLY, None)
    until_called(bridge, "/beep", TRIGGER)
    for payload in ({}, {"payload": b""}, {"payload": b"\0\1\0\0\0"}):
        (reply,) = plain("robot1/beep", **payload)
        assert reply.ok.payload.to_bytes() == REPLY
    # a query without payload is invalid if the request has fields, and a query with a wildcard is never a call
    assert "has no payload" in plain("robot1/arm/light")[0].err.payload.to_bytes().decode()
    assert list(bridge.session.get("robot1/**", payload=TRUE, timeout=20.0)) == []
    assert serving.requests() == [{"data": True}] * 2
    place.far.servers["/arm/light"].close()
    until(lambda: not bridge.tokens("/arm/light", "SS"), "the token disappears with the server")


def test_invalid_requests_are_errors(place: Place) -> None:
    """Each invalid request returns an error, is counted, and does not affect valid calls."""
    bridge = place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    serving = place.far.serve("/do", SET, reply=YES)
    until_called(bridge, "/do")
    for invalid in (b"\0", b"\0\1\0\0", b"\0\0\0\0\1", TRUE + b"more of it", b"\xff" * 100_000):
        assert "does not match its type" in bridge.call("/do", SET, invalid).result()["error"]
    assert serving.requests(0) == [{"data": True}]
    assert bridge.call("/do", SET, {"data": True}).result()["reply"] == YES
    route = place.route(SIDE, "/do", "out")
    assert (route["errors"], route["replies"], route["pending"]) == (5, 2, 0)
    assert route["drops"]["bad"] == 5


def test_a_bridge_receives_the_token_and_the_request_id_of_another_bridge(place: Place) -> None:
    bridge = place.ros2dds()
    served = bridge.ask("serve", service="/do", type=SET, reply=YES)["id"]
    place.bridge({"dialect": "ros2dds"})
    until_linked(bridge)
    assert place.far.call("/do", SET, data=True).result()["reply"] == YES
    assert place.far.call("/do", SET, data=False).result()["reply"] == YES
    token = until(lambda: bridge.tokens("/do", "SC"), "Midspan's token arrives")[0]
    assert token == f"@/{token.split('/')[1]}/@ros2_lv/SC/do/std_srvs§srv§SetBool"
    first, second = bridge.servings[served].attachments
    assert (len(first), first[:3], first[-1:]) == (20, b"rqh", b"\1")
    assert first[3:11] == second[3:11]
    assert int.from_bytes(second[11:19], "little") == int.from_bytes(first[11:19], "little") + 1
    bridge.drop(served)
    until(lambda: not bridge.tokens("/do", "SC"), "the token disappears with the server")


def test_invalid_replies_and_error_replies_are_errors_for_the_client(place: Place) -> None:
    """A plain zenoh program can provide an announced service; the client receives zenoh's error reply."""
    bridge = place.ros2dds()
    answers = iter([None, b"\0\1\0\0", b"", REPLY])

    def answer(query: zenoh.Query) -> None:
        data = next(answers)
        with query:
            if data is None:
                query.reply_err("the arm is stuck")
            else:
                query.reply("do", data)

    queryable = bridge.session.declare_queryable("do", zenoh.handlers.Callback(answer, indirect=False))
    token = bridge.declare_token("SS", "/do", "std_srvs/srv/SetBool")
    place.bridge({"dialect": "ros2dds"})
    until_linked(bridge)
    assert place.far.call("/do", SET).result()["error"] == "the arm is stuck"
    for _ in range(2):
        assert "the reply does not match its type" in place.far.call("/do", SET).result()["error"]
    assert place.far.call("/do", SET).result()["reply"] == YES
    queryable.undeclare()  # the token remains
    # until zenoh has removed the queryable from its routes, calls can fail with another error
    until(lambda: "no server" in place.far.call("/do", SET).result()["error"], "the error gives the reason")
    token.undeclare()


@pytest.mark.parametrize("dialect", ["ros2dds", "ros1"])
def test_a_hundred_held_calls_delay_no_others(place: Place, dialect: str) -> None:
    """The calls run in both directions; held calls do not delay the replies to others."""
    bridge = place.ros2dds() if dialect == "ros2dds" else place.ros1()
    place.bridge({"dialect": dialect})
    until_linked(bridge)
    slow = bridge.ask("serve", service="/slow", type=SET, reply=YES, held=True)["id"]
    bridge.ask("serve", service="/quick", type=SET, reply=YES)
    pending = [place.far.call("/slow", SET, data=True) for _ in range(100)]
    quick = [place.far.call("/quick", SET) for _ in range(100)]
    assert [call.result(60)["reply"] for call in quick] == [YES] * 100
    bridge.ask("requests", id=slow, count=100)
    assert not any(call.result(0)["done"] for call in pending)
    bridge.ask("release", id=slow)
    assert [call.result(60)["reply"] for call in pending] == [YES] * 100
    held = place.far.serve("/held", SET, reply=YES, held=True)
    place.until_route(f"zenoh_{dialect}", "/held", "out")

    def reachable() -> bool:
        return bool(held.requests(1, 0)) or not bridge.call("/held", SET, {"data": True}).ended.wait(0.3)

    until(reachable, "the server is reachable")
    calls = [bridge.call("/held", SET, {"data": False}) for _ in range(100)]
    held.requests(101)
    held.release()
    assert [call.result(60)["reply"] for call in calls] == [YES] * 100


def test_a_client_that_disconnects_only_loses_its_own_reply(place: Place) -> None:
    leaver, other = place.ros2dds(), place.ros2dds()
    place.bridge({"dialect": "ros2dds"})
    serving = place.far.serve("/do", SET, reply=YES, held=True)
    until(lambda: leaver.call("/do", SET, {"data": True}) and serving.requests(1, 0.3), "a request arrives")
    count = len(serving.requests())
    until(
        lambda: other.call("/do", SET, {"data": False}) and serving.requests(count + 1, 0.3)[count:],
        "a request of the other client arrives",
    )
    pending = other.call("/do", SET, {"data": False})
    leaver.session.close()
    leaver.session = None
    serving.release()
    assert pending.result()["reply"] == YES
    until(lambda: place.route(SIDE, "/do", "out")["pending"] == 0, "no call is pending", every=0.1)


def expect_single_request(call: Callable[[], Any], requests: Callable[[], list[Any]]) -> None:
    """Call until a call succeeds. Each call reaches the server at most once; during the election, none may reach it."""

    def succeeds() -> bool:
        count = len(requests())
        reply = call()
        new = requests()[count:]
        assert new in ([], [{"data": True}])
        return bool(new) and reply == YES

    until(succeeds, "a call reaches the server once", every=0.1)


@pytest.mark.parametrize("hubs", ["one hub", "two hubs"])
def test_two_daemons_on_one_network_send_each_call_once(place: Place, hubs: str) -> None:
    """Each call is sent once, each service is served once, and neither daemon bridges the other's services."""
    bridge = place.ros2dds()
    served = bridge.ask("serve", service="/in", type=SET, reply=YES)["id"]
    with QuickHub() as other:
        place.bridge({"dialect": "ros2dds"}, name="one")
        hub = {"listen": other.endpoint if hubs == "two hubs" else place.hubs.endpoint}
        second = place.bridge({"dialect": "ros2dds"}, name="two", hub=hub, state=place.folder / "two")
        ends = [place.far]
        if hubs == "two hubs":
            ends.append(HubSide(Hub.open(other.settings("far")), Registry()))
        try:
            for end in ends:  # a call may fail while the two daemons discover each other
                until(lambda end=end: end.call("/in", SET).result()["reply"] == YES, "a reply", every=0.1)
                until(lambda end=end: len(end.hub.graph.servers("/in")) == 1, "one daemon offers the service")
                expect_single_request(
                    lambda end=end: end.call("/in", SET, data=True).result()["reply"],
                    lambda: list(bridge.servings[served].taken),
                )
            serving = place.far.serve("/out", SET, reply=YES)
            until_called(bridge, "/out")
            expect_single_request(
                lambda: bridge.call("/out", SET, {"data": True}).result()["reply"], lambda: serving.requests(0)
            )
            until(lambda: len(bridge.tokens("/out", "SS")) == 1, "one daemon announces the service")
            assert not ends[-1].hub.graph.servers("/out") or hubs == "one hub"
        finally:
            for end in ends[1:]:
                end.hub.close()
        second.stop()
