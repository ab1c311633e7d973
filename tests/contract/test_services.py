"""Services cross in both directions: each call ends once, with the reply or with an error."""

from __future__ import annotations

from typing import Any

import pytest

from tests.contract.conftest import SIDES
from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, PeerLike, Side
from tests.peers.peer import Peer
from tests.support.wait import until

SET = "std_srvs/SetBool"
YES = {"success": True, "message": "it is ön"}

pytestmark = pytest.mark.parametrize("side", [name for name, side in SIDES.items() if side.has_services], indirect=True)


def result(peer: PeerLike, call: int, seconds: float = 30.0) -> dict[str, Any]:
    """Return the result of a peer's call."""
    ended = peer.ask("result", id=call, seconds=seconds)
    assert ended["done"], "the call ends"
    return ended


def _skip_without_errors(far: HubSide) -> None:
    if not far.tells_errors:
        pytest.skip("a call in ROS 2 does not report errors")


def test_a_call_from_the_hub_reaches_a_server_on_the_side(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    served = peer.ask("serve", service="/do", type=SET, reply=YES)["id"]
    assert far.call("/do", SET, data=True).result()["reply"] == YES
    calls = [far.call("/do", SET, data=bool(n % 2)) for n in range(20)]
    assert [call.result()["reply"] for call in calls] == [YES] * 20
    requests = peer.ask("requests", id=served, count=21)["requests"]
    assert sorted(request["data"] for request in requests) == [False] * 10 + [True] * 11
    route = far.route("/do", "in")
    assert (route["kind"], route["type"]) == ("service", "std_srvs/srv/SetBool")
    assert {name: route[name] for name in ("calls", "replies", "errors", "pending")} == {
        "calls": 21,
        "replies": 21,
        "errors": 0,
        "pending": 0,
    }
    until(  # the check that created the route may not have stored its decisions yet
        lambda: [(line["kind"], line["decision"]) for line in far.explain("/do")] == [("service", "bridged")],
        "the service is explained",
    )


def test_a_call_from_the_side_reaches_a_server_on_the_hub(side: Side, bridge: Bridge, far: HubSide) -> None:
    serving = far.serve("/do", SET, reply=YES)
    far.until_route("/do", "out", 60)
    peer = side.peer()

    def called() -> bool:
        """Call the service, which can fail until a client on the side has discovered the server."""
        return result(peer, peer.ask("call", service="/do", type=SET, request={"data": True})["id"])["reply"] == YES

    until(called, "the server replies", 60)
    assert serving.requests()[0] == {"data": True}
    before = far.route("/do", "out")["replies"]
    calls = [peer.ask("call", service="/do", type=SET, request={"data": False})["id"] for _ in range(5)]
    assert [result(peer, call)["reply"] for call in calls] == [YES] * 5
    until(lambda: far.route("/do", "out")["replies"] == before + 5, "the replies are counted", every=0.1)


def test_a_slow_server_does_not_delay_others(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    slow = peer.ask("serve", service="/slow", type=SET, reply=YES, held=True)["id"]
    peer.ask("serve", service="/quick", type=SET, reply=YES)
    waiting = far.call("/slow", SET)
    peer.ask("requests", id=slow, count=1)
    assert far.call("/quick", SET).result()["reply"] == YES
    assert not waiting.result(0)["done"]
    assert far.route("/slow", "in")["pending"] == 1
    peer.ask("release", id=slow)
    assert waiting.result()["reply"] == YES


def test_calls_fail_when_their_server_leaves(side: Side, bridge: Bridge, far: HubSide) -> None:
    _skip_without_errors(far)
    peer = side.peer()
    served = peer.ask("serve", service="/do", type=SET, reply=YES, held=True)["id"]
    waiting = far.call("/do", SET)
    assert peer.ask("requests", id=served, count=1)["requests"]
    peer.stop(0.0) if isinstance(peer, Peer) and side.reports_death else peer.drop(served)
    ended = waiting.result(30)
    assert (ended["done"], ended["reply"]) == (True, None)
    assert ended["error"]
    until(lambda: not far.hub.graph.servers("/do"), "the server is gone from the hub", 30)
    again = side.peer()
    again.ask("serve", service="/do", type=SET, reply=YES)
    assert far.call("/do", SET).result()["reply"] == YES


def test_a_bridge_that_stops_ends_its_calls(side: Side, bridge: Bridge, far: HubSide) -> None:
    _skip_without_errors(far)
    peer = side.peer()
    served = peer.ask("serve", service="/do", type=SET, reply=YES, held=True)["id"]
    waiting = far.call("/do", SET)
    assert peer.ask("requests", id=served, count=1)["requests"]
    bridge.stop()
    assert waiting.result(30)["error"]
    until(lambda: not far.hub.graph.servers("/do"), "the server is gone from the hub", 30)


def test_error_texts_are_bridged_in_both_directions(side: Side, bridge: Bridge, far: HubSide) -> None:
    if not side.tells_errors:
        pytest.skip("its services cannot report errors")
    _skip_without_errors(far)
    peer = side.peer()
    peer.ask("serve", service="/in", type=SET, error="the arm is stuck")
    assert "the arm is stuck" in far.call("/in", SET).result()["error"]
    far.serve("/out", SET, error="no map yet")
    far.until_route("/out", "out", 60)

    def reported() -> bool:
        ended = result(peer, peer.ask("call", service="/out", type=SET)["id"])
        assert ended["reply"] is None
        return "no map yet" in ended["error"]

    until(reported, "the client receives the error's text", 60)


def test_rules_deny_and_rename_services(side: Side, far: HubSide, config) -> None:
    side.bridge(
        config(
            rules=[
                {"kind": "service", "topic": "/secret", "deny": True},
                {"kind": "topic", "topic": "/do", "deny": True},
                {"kind": "service", "topic": "/local/*", "rename": "/robot/*"},
            ]
        )
    )
    peer = side.peer()
    for name in ("/secret", "/do", "/local/go"):
        peer.ask("serve", service=name, type=SET, reply=YES)
    assert far.call("/robot/go", SET).result()["reply"] == YES
    assert far.call("/do", SET).result()["reply"] == YES
    until(lambda: [line["decision"] for line in far.explain("/secret")] == ["denied"], "explain reports the denial", 20)
    assert not far.hub.graph.servers("/secret")


def test_a_service_with_servers_on_both_sides_is_not_bridged(side: Side, bridge: Bridge, far: HubSide) -> None:
    """A call must reach only one server, so calls stay local; explain names the fix."""
    far.serve("/do", SET, reply=YES)
    far.until_route("/do", "out", 60)
    peer = side.peer()
    local = peer.ask("serve", service="/do", type=SET, reply={"success": False, "message": "own"})["id"]

    def refused() -> bool:
        lines = far.explain("/do")
        return sorted((line["direction"], line["decision"]) for line in lines) == [
            ("in", "refused"),
            ("out", "refused"),
        ]

    until(refused, "both directions are refused", 30, every=0.2)
    assert all("rename" in line["cure"] for line in far.explain("/do"))
    assert far.route("/do", "out") is None
    far.servers["/do"].close()
    until(lambda: [s for s in far.hub.graph.servers("/do") if not s.own], "the side's own service is offered", 30)
    assert far.call("/do", SET).result()["reply"]["message"] == "own"
    assert peer.ask("requests", id=local, count=1)["requests"]
