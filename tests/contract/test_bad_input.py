"""Invalid input is refused with a reason and does not affect other routes."""

from __future__ import annotations

from bridge.hub.wire.qos import Qos
from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, Side
from tests.support.wait import until

STRING = "std_msgs/String"


def test_junk_on_the_hub_is_counted_and_the_route_continues(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    subscription = peer.subscribe("/maybe_junk", STRING)
    out = far.advertise("/maybe_junk", STRING)
    far.hub_publish_until(out, {"data": "probe"}, lambda: peer.wait(subscription, 1, 0.2))
    for junk in (
        b"",
        b"\x00",
        b"\x00\x01\x00\x00",
        b"\x00\x01\x00\x00\xff\xff\xff\xff",
        b"\x00\x01\x00\x00\x05\x00\x00\x00ab",
    ):
        far.publish_raw(out, junk)
    far.publish(out, {"data": "good"})
    got = until(lambda: [m for m in peer.wait(subscription, 1, 0.2) if m["data"] != "probe"], "it arrives", 10)
    assert got == [{"data": "good"}]
    route = far.route("/maybe_junk", "out")
    assert route["drops"]["bad"] == 5
    assert route["error"]


def test_an_unknown_type_is_reported_and_other_types_are_bridged(side: Side, bridge: Bridge, far: HubSide) -> None:
    strange = far.hub.publisher("/strange", "nowhere_msgs/msg/Nothing", "RIHS01_" + "ab" * 32, Qos())
    far.advertise("/normal", STRING)
    far.until_route("/normal", "out")
    # the check that created the route of /normal may not have stored its decisions yet
    line = until(
        lambda: [x for x in far.explain("/strange") if x["decision"] == "refused"], "it is refused", 15, every=0.1
    )[0]
    assert line["direction"] == "out"
    assert "nowhere_msgs" in line["why"]
    assert line["cure"]
    assert any(r["topic"] == "/strange" for r in far.status()["refused"])
    strange.close()


def test_a_hash_that_differs_is_reported(side: Side, bridge: Bridge, far: HubSide) -> None:
    other = far.hub.publisher("/other_string", "std_msgs/msg/String", "RIHS01_" + "cd" * 32, Qos())
    line = until(
        lambda: [x for x in far.explain("/other_string") if x["decision"] == "refused"],
        "the topic is refused",
        15,
        every=0.1,
    )[0]
    assert "RIHS01_" in line["why"] or "hash" in line["why"]
    other.close()
