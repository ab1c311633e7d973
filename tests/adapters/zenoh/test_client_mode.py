"""Dialects wait until zenoh can open their sessions: in client mode for the router, and for a listener's address."""

from __future__ import annotations

import socket
import threading

import pytest

from bridge.adapters.worker import NetworkBridge, make_edges
from bridge.adapters.zenoh import edge
from bridge.messages.registry import Registry
from tests.adapters.zenoh.conftest import Place, cross
from tests.contract.zenohside import ZenohBridge
from tests.support.wait import until

STRING = "std_msgs/String"
KEYS = [{"key": "json/both", "topic": "/both", "type": "std_msgs/msg/String"}]
DIALECTS = {"ros2dds": {"dialect": "ros2dds"}, "ros1": {"dialect": "ros1"}, "json": {"dialect": "json", "keys": KEYS}}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edge, "RETRY_SECONDS", 0.1)
    monkeypatch.setattr(edge, "_CLIENT_WAIT_MS", 300)
    monkeypatch.setattr(edge, "UNLINKED_SECONDS", 0.1)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_client_waits_for_its_router(
    place: Place, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, dialect: str
) -> None:
    place.router.stop()
    client = {"mode": "client", "connect": {"endpoints": [place.router.endpoint]}}
    config = place.config(zenoh={"zenoh": client, "dialects": [DIALECTS[dialect]]})
    monkeypatch.setattr(
        "tests.contract.zenohside.until", lambda *_: None
    )  # so that the fixture returns before the dialect has joined
    bridge = ZenohBridge(config)
    (joined,) = bridge.bridges
    try:
        until(lambda: "Unable to connect" in joined.health().text, "the state gives the reason")
        health = joined.health()
        assert health.state == "waiting"
        assert health.text.startswith(f"waiting for the zenoh router at {place.router.endpoint}: ")
        assert health.text in place.answer(joined.name)["warnings"]
        place.router.start()
        until(lambda: joined.health().state == "running", "the dialect joins")
        topic = "/json/both" if dialect == "json" else "/both"
        program = {"ros2dds": place.ros2dds, "ros1": place.ros1, "json": place.json}[dialect]()
        out, received = program.advertise(topic, STRING), place.far.subscribe("/both", STRING)
        assert cross(program, out, place.far, received, {"data": "hi"}) == {"data": "hi"}
        assert not [w for w in place.answer(joined.name)["warnings"] if "waiting" in w]
        assert sum("waiting for the zenoh router" in record.message for record in caplog.records) <= 1
        place.router.stop()
        lost = f"waiting for the zenoh router at {place.router.endpoint}: not connected; start it, or"
        until(lambda: joined.health().text.startswith(lost), "the state names the lost router")
        assert joined.health().state == "waiting"
        until(lambda: lost in caplog.text, "the log names it")
        assert any(warning.startswith(lost) for warning in place.answer(joined.name)["warnings"])
        place.router.start()
        until(lambda: joined.health().state == "running", "the dialect joins again")
        assert not [w for w in place.answer(joined.name)["warnings"] if "waiting" in w]
        assert sum(lost in record.message for record in caplog.records) == 1
    finally:
        bridge.stop()


def test_a_client_that_waits_stops_at_once(place: Place) -> None:
    place.router.stop()
    client = {"mode": "client", "connect": {"endpoints": [place.router.endpoint], "timeout_ms": -1}}
    config = place.config(zenoh={"zenoh": client, "dialects": [DIALECTS["ros2dds"]]})
    registry = Registry()
    (created,) = make_edges("zenoh", config, registry, place.folder).values()
    joined = NetworkBridge("zenoh_ros2dds", created, config, registry, pytest.fail, diagnostics=False)
    assert joined.health().state == "waiting"
    joined.stop()
    place.router.start()
    until(
        lambda: f"midspan-{created.side}-tick" not in {t.name for t in threading.enumerate()},
        "the dialect's attempt ends",
    )
    assert created.network() is None


def test_a_peer_waits_until_it_can_listen(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        listener = f"tcp/127.0.0.1:{holder.getsockname()[1]}"
        peer = {"connect": {"endpoints": [place.router.endpoint]}, "listen": {"endpoints": [listener]}}
        config = place.config(zenoh={"zenoh": peer, "dialects": [DIALECTS["ros1"]]})
        registry = Registry()
        (created,) = make_edges("zenoh", config, registry, place.folder).values()
        joined = NetworkBridge("zenoh_ros1", created, config, registry, pytest.fail, diagnostics=False)
        try:
            health = joined.health()
            assert (health.state, health.text[:32]) == ("waiting", "waiting until it can listen: Can")
            assert listener in health.text
            assert sum(health.text in record.message for record in caplog.records) == 1
            holder.close()
            until(lambda: joined.health().state == "running", "the dialect joins")
        finally:
            joined.stop()


def test_a_peer_without_a_link_names_the_address(place: Place) -> None:
    place.router.stop()
    registry = Registry()
    config = place.config(DIALECTS["ros2dds"])
    (created,) = make_edges("zenoh", config, registry, place.folder).values()
    joined = NetworkBridge("zenoh_ros2dds", created, config, registry, pytest.fail, diagnostics=False)
    try:
        reason = f"waiting for another zenoh session at {place.router.endpoint}: not connected; start it, or"
        until(lambda: joined.health().text.startswith(reason), "the state gives the reason")
        assert joined.health().state == "waiting"
        place.router.start()
        until(lambda: joined.health().state == "running", "the dialect joins")
        assert created.away == ""
    finally:
        joined.stop()


def test_dialects_that_are_linked_only_to_each_other_wait(place: Place) -> None:
    bridge = place.bridge(DIALECTS["ros2dds"], DIALECTS["json"])
    until(lambda: {joined.health().state for joined in bridge.bridges} == {"running"}, "both dialects join")
    place.router.stop()
    reason = f"waiting for another zenoh session at {place.router.endpoint}: not connected"
    until(
        lambda: all(joined.health().text.startswith(reason) for joined in bridge.bridges),
        "both dialects give the reason",
    )
    place.router.start()
    until(lambda: {joined.health().state for joined in bridge.bridges} == {"running"}, "both dialects join again")
