"""Checks of the configuration, the daemon, the router's port and the types."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from bridge.doctor.around import HubView
from bridge.doctor.checks import bridges, daemon, router, types
from bridge.doctor.finding import Result
from bridge.doctor.hubtypes import conflicts
from bridge.hub.graph import HubEndpoint
from bridge.hub.liveliness import UNKNOWN_HASH, EndpointKind
from bridge.hub.qos import Qos
from tests.doctor.parts import around, hub, only, results
from tests.support.hub import HubNetwork
from tests.support.ports import free_port


def endpoint(node: str, type_name: str, digit: str, kind: EndpointKind = EndpointKind.PUBLISHER) -> HubEndpoint:
    """An endpoint of /topic whose type's hash is made of one digit."""
    type_hash = UNKNOWN_HASH if digit == "0" else f"RIHS01_{digit * 64}"
    return HubEndpoint(
        "ab", node, "/", kind, "/topic", type_name, type_hash, Qos(), bytes(16), origin=None, pending=False, own=False
    )


@pytest.mark.parametrize(
    ("section", "count"),
    [
        ({}, 1),
        ({"open": {"listen": ["tls/0.0.0.0:7448"]}}, 1),
        ({"open": {"listen": ["tcp/0.0.0.0:7448"], "insecure": True}}, 2),
    ],
)
def test_an_open_hub_is_warned_of(section: dict[str, Any], count: int) -> None:
    assert results(daemon.look_at_config(around({"hub": section}))) == [Result.OK, Result.WARN][:count]


def test_every_problem_of_a_configuration() -> None:
    place = around(config_text="a.yaml:1:1: x: bad\na.yaml:2:1: y: bad", config_good=False)
    assert results(daemon.look_at_config(place)) == [Result.FAIL, Result.FAIL]


def test_workers() -> None:
    view = hub(
        {"worker": "router", "state": "running"},
        {"worker": "ros1", "state": "waiting"},
        {"worker": "ros2", "state": "running", "warnings": ["a QoS mismatch"]},
        {"worker": "other", "error": "no answer"},
    )
    found = daemon.look_at_workers(around(hub=view))
    assert results(found) == [Result.OK, Result.WARN, Result.WARN, Result.FAIL]
    for nobody in (HubView("nothing answers"), HubView()):
        assert only(daemon.look_at_workers(around(hub=nobody))).result is Result.WARN


def test_a_free_port() -> None:
    assert only(router.look(around({"hub": {"listen": f"tcp/127.0.0.1:{free_port()}"}}))).result is Result.OK


def test_our_own_router() -> None:
    with HubNetwork() as network:
        finding = only(router.look(around({"hub": {"listen": network.endpoint}})))
    assert (finding.result, "Midspan daemon test" in finding.seen) == (Result.OK, True), finding


@pytest.fixture
def strangers_port() -> Iterator[int]:
    """A port held by a program that takes connections and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        stop = threading.Event()
        taken: list[socket.socket] = []

        def accept() -> None:
            while not stop.is_set():
                try:
                    taken.append(server.accept()[0])
                except TimeoutError:
                    continue

        thread = threading.Thread(target=accept)
        thread.start()
        yield server.getsockname()[1]
        stop.set()
        thread.join()
        for connection in taken:
            connection.close()


def test_a_program_that_speaks_no_zenoh(strangers_port: int) -> None:
    finding = only(router.look(around({"hub": {"listen": f"tcp/127.0.0.1:{strangers_port}"}})))
    assert finding.result is Result.FAIL
    assert "does not speak zenoh" in finding.seen
    assert "hub.listen" in finding.cure


@pytest.mark.parametrize(
    ("mode", "wanted", "result"),
    [("router", "auto", Result.WARN), ("router", True, Result.FAIL), ("peer", "auto", Result.FAIL)],
)
def test_another_router(mode: str, wanted: Any, result: Result) -> None:
    listen = f"tcp/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    for key, value in (("mode", mode), ("listen/endpoints", [listen]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        finding = only(router.look(around({"hub": {"listen": listen, "router": wanted}})))
    assert (finding.result, listen in finding.seen) == (result, True), finding


def test_refused_types_and_differing_definitions() -> None:
    unknown = {"direction": "in", "topic": "/a", "type": "x/A", "reason": "no definition of x/A is known", "cure": "c"}
    differs = {
        "direction": "out",
        "topic": "/b",
        "type": "x/B",
        "reason": "x/B has the md5 1 there but 2 here: the differ",
    }
    place = around(hub=hub({"worker": "ros1", "side": "ros1", "refused": [unknown, differs]}))
    refused, hashes = only(types.look_at_refused(place)), only(types.look_at_hashes(place))
    assert (refused.result, refused.cure) == (Result.FAIL, "c")
    assert "/a (x/A, ros1 -> hub)" in refused.seen
    assert (hashes.result, "/b" in hashes.seen) == (Result.FAIL, True)
    deaf = "/c: /old does not hear us: it asks for x/C with md5 1, we publish x/C with md5 2"
    warned = only(types.look_at_hashes(around(hub=hub({"worker": "ros1", "warnings": [deaf, "/d: other"]}))))
    assert (warned.result, warned.seen) == (Result.WARN, deaf)
    many = hub({"worker": "ros1", "refused": [unknown] * 30})
    assert "and 10 more" in types.look_at_refused(around(hub=many))[-1].seen
    nothing = around(hub=hub({"worker": "ros1"}))
    assert only(types.look_at_refused(nothing)).result is Result.OK
    assert only(types.look_at_hashes(nothing)).result is Result.OK


def test_conflicts_on_the_hub() -> None:
    any_hash = endpoint("any", "a/msg/A", "0", EndpointKind.SUBSCRIPTION)
    assert conflicts([endpoint("one", "a/msg/A", "1"), any_hash]) == []
    (hashes,) = conflicts([endpoint("one", "a/msg/A", "1"), endpoint("two", "a/msg/A", "2", EndpointKind.SUBSCRIPTION)])
    assert "/one RIHS01_1" in hashes.text
    assert "/two RIHS01_2" in hashes.text
    (kinds,) = conflicts([endpoint("one", "a/msg/A", "1"), endpoint("two", "a/msg/B", "2")])
    assert "a/msg/A, a/msg/B" in kinds.text
    assert conflicts([endpoint("one", "a/srv/A", "1", EndpointKind.SERVER)]) == []
    view = HubView(endpoints=[endpoint("one", "a/msg/A", "1"), endpoint("two", "a/msg/A", "2")])
    assert only(types.look_at_hashes(around(hub=view))).result is Result.FAIL


def test_a_compiler_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    finding = only(types.look_at_compiler(around()))
    if finding.result is not Result.SKIP:  # where there is no rclpy nothing is built
        assert (finding.result, "no-such-compiler" in finding.seen) == (Result.WARN, True)
    assert only(types.look_at_compiler(around({"ros2": {"enabled": False}}))).result is Result.SKIP


def test_two_daemons_on_one_network() -> None:
    off = {"ros1": {"enabled": False}, "ros2": {"enabled": False}}
    documents = [
        {"daemon": name, "worker": "ros1", "side": "ros1", "network": network, "state": state}
        for name, network, state in (("a", "n1", "running"), ("b", "n1", "standby"), ("c", "n2", "running"))
    ]
    assert Result.FAIL not in results(bridges.look(around(off, hub=hub(*documents))))
    documents[1]["state"] = "running"
    finding = next(f for f in bridges.look(around(off, hub=hub(*documents))) if f.result is Result.FAIL)
    assert "a and b are both active on the ros1 network n1" in finding.seen
