"""Checks of the configuration, the daemon, the router's port and the types."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bridge.config.model import Config
from bridge.doctor import daemon_state
from bridge.doctor.check import Result
from bridge.doctor.checks import bridges, router, types
from bridge.doctor.checks import daemon as daemon_checks
from bridge.doctor.context import HubSnapshot
from bridge.doctor.hub_problems import conflicts, separated
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import UNKNOWN_HASH, EndpointKind, Origin
from bridge.hub.router import port_holder
from bridge.hub.wire.keys import NO_HASH
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from navigation.lifecycle import trouble
from tests.doctor.parts import around, every, hub, only, results
from tests.peers.hub.network import HubNetwork
from tests.support.ports import free_port
from tests.support.zenoh_router import open_router


def endpoint(
    node: str, type_name: str, digit: str, kind: EndpointKind = EndpointKind.PUBLISHER, topic: str = "/topic"
) -> HubEndpoint:
    """Return an endpoint whose type hash consists of one repeated digit; ``0`` is an unknown hash, "" none."""
    type_hash = {"0": UNKNOWN_HASH, "": NO_HASH}.get(digit, f"RIHS01_{digit * 64}")
    return HubEndpoint(
        "ab", node, "/", kind, topic, type_name, type_hash, Qos(), bytes(16), origin=None, pending=False, own=False
    )


@pytest.mark.parametrize(
    ("section", "count"),
    [
        ({}, 1),
        ({"open": {"listen": ["tls/0.0.0.0:7448"]}}, 1),
        ({"open": {"listen": ["tcp/0.0.0.0:7448"], "insecure": True}}, 2),
    ],
)
def test_open_hub_causes_a_warning(section: dict[str, Any], count: int) -> None:
    assert results(daemon_checks.check_config(around({"hub": section}))) == [Result.OK, Result.WARN][:count]


def test_each_problem_of_a_configuration_is_a_finding() -> None:
    place = around(config_text="a.yaml:1:1: x: bad\na.yaml:2:1: y: bad", config_good=False)
    assert results(daemon_checks.check_config(place)) == [Result.FAIL, Result.FAIL]


def test_nodes_of_the_planner_that_are_not_active_are_named_with_the_cure() -> None:
    states = {"/bt_navigator": "unconfigured"}
    warning = f"{trouble(states)}; start them"
    gateway = {"worker": "gateway", "module": True, "state": "waiting", "inactive_nodes": states, "warnings": [warning]}
    finding = only(daemon_checks.check_workers(around(hub=hub(gateway))))
    assert (finding.result, finding.cure) == (Result.WARN, "midspan nav startup")


def test_workers_are_judged_by_their_state() -> None:
    view = hub(
        {"worker": "router", "state": "running"},
        {"worker": "ros1", "state": "waiting"},
        {"worker": "ros2", "state": "running", "warnings": ["a QoS mismatch"]},
        {"worker": "other", "error": "no answer"},
        # as the daemon reports them in `midspan status`
        {"worker": "sim", "state": "starting", "text": "importing dartpy (4 s)"},
        {"worker": "modules", "state": "cannot work", "text": "no module is there"},
    )
    finding = every(daemon_checks.check_workers(around(hub=view)))
    assert results(finding) == [Result.OK, Result.WARN, Result.WARN, Result.FAIL, Result.WARN, Result.FAIL]
    assert finding[-2].seen == "robot1/sim is starting: importing dartpy (4 s)"
    assert finding[-1].seen == "robot1/modules cannot work: no module is there"
    for nobody in (HubSnapshot("nothing answers"), HubSnapshot()):
        assert only(daemon_checks.check_workers(around(hub=nobody))).result is Result.WARN


def test_reason_of_the_last_restart_is_named() -> None:
    """For example a new address, which the ROS 2 side's process before the restart did not use."""
    restarts = {"restarts": 1, "ended": "this machine has a new address: restarting"}
    worker = {"worker": "ros2", "state": "running", **restarts}
    finding = only(daemon_checks.check_workers(around(hub=hub(worker))))
    again = "robot1/ros2 is running (restarted once; last end: this machine has a new address: restarting)"
    assert (finding.result, finding.seen) == (Result.OK, again)
    finding = only(daemon_checks.check_workers(around(hub=hub({**worker, "warnings": ["a QoS mismatch"]}))))
    assert (finding.result, finding.seen) == (Result.WARN, f"{again}, and warns: a QoS mismatch")


def test_a_free_port_passes_the_check() -> None:
    assert only(router.check_port(around({"hub": {"listen": f"tcp/127.0.0.1:{free_port()}"}}))).result is Result.OK


def test_a_port_with_midspans_own_router_passes_the_check() -> None:
    with HubNetwork() as network:
        finding = only(router.check_port(around({"hub": {"listen": network.endpoint}})))
    assert (finding.result, "Midspan daemon test" in finding.seen) == (Result.OK, True), finding


FEW = {"transport": {"unicast": {"max_sessions": 1}}}
DENY = {"enabled": True, "rules": [], "subjects": [], "policies": []}


@pytest.mark.parametrize(
    ("section", "settings", "seen", "key"),
    [
        ("router_zenoh", FEW, "accepts no connection", "transport.unicast.max_sessions"),
        ("router_zenoh", {"access_control": DENY}, "does not identify itself", "access_control"),
        ("zenoh", {"transport": {"link": {"protocols": ["udp"]}}}, "accepts no connection", "transport.link.protocols"),
    ],
)  # fmt: skip
def test_settings_that_keep_programs_from_the_router_are_named(
    section: str, settings: dict[str, Any], seen: str, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with HubNetwork(router_zenoh=settings if section == "router_zenoh" else None) as network, ExitStack() as stack:
        if key.endswith("max_sessions"):
            stack.enter_context(network.program())
        holder = port_holder(network.endpoint)
        assert holder is not None
        # the router of this test runs without the lock of a daemon's worker
        monkeypatch.setattr(daemon_state, "_router_process", lambda _config: holder.pid)
        place = around({"name": "robot", "hub": {"listen": network.endpoint, section: settings}})
        finding = only(router.check_port(place))
    assert finding.result is Result.FAIL
    assert finding.seen.startswith(
        f"the router of robot (process {holder.pid}) listens at {network.endpoint}, but {seen}"
    )
    assert finding.cure.startswith(f"leave out hub.{section}.{key}, and restart the daemon")


def test_a_file_of_settings_is_named_by_its_key(tmp_path: Path) -> None:
    config = Config.model_validate({"hub": {"zenoh": tmp_path / "a.json5", "router_zenoh": {"mode": "router"}}})
    assert daemon_state.zenoh_settings(config) == "hub.zenoh and hub.router_zenoh.mode"
    assert daemon_state.zenoh_settings(Config()) == ""


@pytest.fixture
def strangers_port() -> Iterator[int]:
    """A port held by a program that accepts connections and sends nothing."""
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


def test_a_port_that_another_program_uses_fails_the_check(strangers_port: int) -> None:
    finding = only(router.check_port(around({"hub": {"listen": f"tcp/127.0.0.1:{strangers_port}"}})))
    assert finding.result is Result.FAIL
    assert "that is not zenoh" in finding.seen
    assert "hub.listen" in finding.cure


@pytest.mark.parametrize(
    ("mode", "wanted", "result"),
    [("router", "auto", Result.WARN), ("router", True, Result.FAIL), ("peer", "auto", Result.FAIL)],
)
def test_another_router_at_the_address_is_reported(mode: str, wanted: Any, result: Result) -> None:
    listen = f"tcp/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    for key, value in (("mode", mode), ("listen/endpoints", [listen]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    with open_router(config):
        finding = only(router.check_port(around({"hub": {"listen": listen, "router": wanted}})))
    assert (finding.result, listen in finding.seen) == (result, True), finding


def test_refused_types_and_differing_definitions_are_reported() -> None:
    unknown = {"direction": "in", "topic": "/a", "type": "x/A", "reason": "no definition of x/A is known", "cure": "c"}
    differs = {
        "direction": "out",
        "topic": "/b",
        "type": "x/B",
        "reason": "x/B has the md5 1 there but 2 here: the differ",
    }
    place = around(hub=hub({"worker": "ros1", "side": "ros1", "refused": [unknown, differs]}))
    refused, hashes = only(types.check_refused(place)), only(types.check_hashes(place))
    assert (refused.result, refused.cure) == (Result.FAIL, "c")
    assert "/a (x/A, ros1 -> hub)" in refused.seen
    assert (hashes.result, "/b" in hashes.seen) == (Result.FAIL, True)
    deaf = "/c: /old gets no messages: it asks for x/C with md5 1, we publish x/C with md5 2"
    warned = only(types.check_hashes(around(hub=hub({"worker": "ros1", "warnings": [deaf, "/d: other"]}))))
    assert (warned.result, warned.seen) == (Result.WARN, deaf)
    many = hub({"worker": "ros1", "refused": [{**unknown, "type": f"x/A{number}"} for number in range(30)]})
    assert "and 10 more" in every(types.check_refused(around(hub=many)))[-1].seen
    nothing = around(hub=hub({"worker": "ros1"}))
    assert only(types.check_refused(nothing)).result is Result.OK
    assert only(types.check_hashes(nothing)).result is Result.OK


def test_conflicting_types_and_hashes_on_the_hub_are_reported() -> None:
    any_hash = endpoint("any", "a/msg/A", "0", EndpointKind.SUBSCRIPTION)
    assert conflicts([endpoint("one", "a/msg/A", "1"), any_hash]) == []
    humble = endpoint("humble", "a/msg/A", "", EndpointKind.SUBSCRIPTION)
    assert conflicts([endpoint("one", "a/msg/A", "1"), humble]) == []
    (hashes,) = conflicts([endpoint("one", "a/msg/A", "1"), endpoint("two", "a/msg/A", "2", EndpointKind.SUBSCRIPTION)])
    assert "/one RIHS01_1" in hashes.text
    assert "/two RIHS01_2" in hashes.text
    (kinds,) = conflicts([endpoint("one", "a/msg/A", "1"), endpoint("two", "a/msg/B", "2")])
    assert "a/msg/A, a/msg/B" in kinds.text
    assert conflicts([endpoint("one", "a/srv/A", "1", EndpointKind.SERVER)]) == []
    view = HubSnapshot(endpoints=[endpoint("one", "a/msg/A", "1"), endpoint("two", "a/msg/A", "2")])
    assert only(types.check_hashes(around(hub=view))).result is Result.FAIL


def test_versions_that_a_worker_converts_are_no_conflict() -> None:
    registry, name = Registry(), "nav2_msgs/action/NavigateToPose_FeedbackMessage"
    jazzy, lyrical = registry.releases.hashes(name)
    nav2 = replace(endpoint("nav2", name, "1"), type_hash=lyrical, zid="5")
    client = replace(endpoint("client", name, "1", EndpointKind.SUBSCRIPTION), type_hash=jazzy)
    bridged = replace(client, origin=Origin("ros1", "0" * 24, "robot1"))
    assert conflicts([nav2, bridged], (), lambda: registry.releases) == []
    assert conflicts([nav2, client], {client.zid}, lambda: registry.releases) == []
    other = replace(nav2, type_hash="RIHS01_" + "1" * 64)
    assert len(conflicts([other, bridged], (), lambda: registry.releases)) == 1
    (note,) = conflicts([nav2, client, bridged], (), lambda: registry.releases)
    assert "/client" in note.text


def test_native_clients_and_servers_of_two_releases_are_reported_as_separated() -> None:
    """The client waits for ever, while rmw_zenoh reports the server as available."""
    server = endpoint("lyrical", "a/srv/A", "1", EndpointKind.SERVER)
    client = replace(endpoint("jazzy", "a/srv/A", "2", EndpointKind.CLIENT), zid="5")
    (note,) = separated([server, client])
    assert "/jazzy never get a reply from /lyrical on the hub: they have different versions of a/srv/A" in note.text
    view = HubSnapshot(endpoints=[server, client])
    finding = only(types.check_hashes(around(hub=view)))
    assert (finding.result, finding.seen) == (Result.WARN, note.text)
    assert "run one of them on DDS" in finding.cure
    humble = replace(server, hashless=True, type_hash=client.type_hash)
    assert len(separated([humble, client])) == 1
    same = replace(server, type_hash=client.type_hash)
    bridged = replace(server, origin=Origin("ros1", "0" * 24, "robot1"))
    for answered in ([server, same, client], [server, bridged, client], [client], [server]):
        assert separated(answered) == []
    assert separated([server, client], {client.zid}) == []


@pytest.mark.parametrize(
    ("publisher", "subscription", "reason"),
    [
        ({"hashless": True}, {}, "one of them has no type hashes"),
        ({}, {"hashless": True}, "one of them has no type hashes"),
        ({"buffers": True}, {}, "only nodes of Lyrical receive its buffers"),
        ({"buffers": True}, {"buffers": True}, ""),
        ({}, {"buffers": True}, ""),
        ({"buffers": True}, {"type_hash": UNKNOWN_HASH}, ""),
        ({"hashless": True}, {"zid": "5"}, ""),
    ],
)
def test_native_publishers_and_subscriptions_of_two_releases_are_reported_as_separated(
    publisher: dict[str, Any], subscription: dict[str, Any], reason: str
) -> None:
    ends = [
        replace(endpoint("from", "a/msg/A", "1"), **publisher),
        replace(endpoint("to", "a/msg/A", "1", EndpointKind.SUBSCRIPTION), **subscription),
    ]
    texts = [note.text for note in separated(ends, {"5"})]
    assert [text.rpartition(": ")[2] for text in texts] == [reason] * bool(reason)


def test_what_a_worker_relays_is_no_problem_and_is_named() -> None:
    registry, name = Registry(), "nav2_msgs/action/NavigateToPose_FeedbackMessage"
    jazzy, lyrical = registry.releases.hashes(name)
    ends = [
        replace(endpoint("nav2", name, "1"), type_hash=lyrical),
        replace(endpoint("gui", name, "1", EndpointKind.SUBSCRIPTION), type_hash=jazzy),
        replace(endpoint("talker", "a/msg/A", "1", topic="/chatter"), hashless=True),
        endpoint("listener", "a/msg/A", "1", EndpointKind.SUBSCRIPTION, topic="/chatter"),
        endpoint("server", "a/srv/A", "1", EndpointKind.SERVER, topic="/do"),
        endpoint("client", "a/srv/A", "2", EndpointKind.CLIENT, topic="/do"),
        replace(endpoint("midspan_relay", name, "1", EndpointKind.SUBSCRIPTION), type_hash=lyrical, zid="f"),
    ]
    rows = [
        {"topic": "/topic", "type": name, "hash": lyrical, "others": [jazzy], "senders": ["/nav2"]},
        {"topic": "/chatter", "type": "a/msg/A", "hash": "", "others": [ends[3].type_hash], "messages": 7},
        {
            "topic": "/do",
            "type": "a/srv/A",
            "hash": ends[5].type_hash,
            "others": [ends[4].type_hash],
            "kind": "service",
        },
    ]
    document = {"worker": "ros1", "daemon": "robot", "relay": {"zid": "f", "names": rows}}
    view = replace(hub(document), endpoints=ends)
    findings = every(types.check_hashes(around(hub=view)))
    assert [finding.result for finding in findings] == [Result.OK] * 3
    assert "/topic: ros1 (daemon robot) relays messages from /nav2" in findings[0].seen
    assert "other versions of a/msg/A; 7 so far" in findings[1].seen
    for without in (1, 2, 3):
        some = {**document, "relay": {"zid": "f", "names": rows[: without - 1] + rows[without:]}}
        findings = every(types.check_hashes(around(hub=replace(hub(some), endpoints=ends))))
        assert [f.result for f in findings].count(Result.OK) == 2
        assert len(findings) == 3


def test_bridged_endpoints_are_named_by_their_side() -> None:
    bridged = replace(endpoint("midspan_ros2", "a/msg/A", "2"), origin=Origin("ros2", "0" * 24, "robot1"))
    (note,) = conflicts([endpoint("one", "a/msg/A", "1"), bridged])
    assert "/one RIHS01_1" in note.text
    assert "a node on ROS 2 RIHS01_2" in note.text
    assert "midspan_ros2" not in note.text


def test_node_that_subscribes_to_several_types_has_no_conflict() -> None:
    # for example BaseControl, which subscribes to /cmd_vel with Twist and with TwistStamped
    first, second = endpoint("one", "a/msg/A", "1"), endpoint("two", "a/msg/B", "2")
    both = [endpoint("base", e.type_name, e.type_hash[7], EndpointKind.SUBSCRIPTION) for e in (first, second)]
    assert conflicts(both) == conflicts([*both, first]) == conflicts([*both, first, second]) == []
    deaf = endpoint("deaf", "a/msg/A", "1", EndpointKind.SUBSCRIPTION)
    assert conflicts([*both, first, deaf]) == []
    assert len(conflicts([*both, second, deaf])) == 1


def test_services_that_a_ros_map_server_serves_already_are_no_failure() -> None:
    # refused by the ros1 worker if a real map_server runs (navigation 1.17.3), which serves both
    def refused(service: str, *, reason: str = "") -> list[dict[str, Any]]:
        entry = {"kind": "service", "topic": service, "hub_topic": service, "type": "nav_msgs/srv/GetMap"}
        refusal = reason or f"/map_server serves {service} there already"
        ours = reason or f"map2d_server serves {service} on the hub already"
        return [{**entry, "direction": "out", "reason": refusal}, {**entry, "direction": "in", "reason": ours}]

    def check_refused(taken: dict[str, int], entries: list[dict[str, Any]]) -> list[Any]:
        server = {"worker": "map2d_server", "module": True, "zid": "ab", "taken": taken}
        services = ("/static_map", "/change_map")
        ends = [endpoint("map2d_server", "nav_msgs/srv/GetMap", "1", EndpointKind.SERVER, s) for s in services]
        view = hub(server, {"worker": "ros1", "side": "ros1", "refused": entries}, endpoints=ends)
        return list(types.check_refused(around(hub=view)))

    both = [*refused("/static_map"), *refused("/change_map")]
    finding = check_refused({"/map": 1}, both)
    assert results(finding) == [Result.OK, Result.OK]
    assert finding[1].seen.startswith("/change_map, /static_map: the map server there answers on ros1")
    assert set(results(check_refused({}, both))) == {Result.FAIL}  # the module serves other maps than the map_server
    assert set(results(check_refused({"/map": 1}, refused("/static_map", reason="no definition")))) == {Result.FAIL}
    assert set(results(check_refused({"/map": 1}, refused("/other")))) == {Result.FAIL}


def test_a_missing_compiler_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    finding = only(types.check_compiler(around()))
    if finding.result is not Result.SKIP:  # without rclpy, no package is built
        assert (finding.result, "no-such-compiler" in finding.seen) == (Result.WARN, True)
    assert only(types.check_compiler(around({"ros2": {"enabled": False}}))).result is Result.SKIP


def test_two_active_daemons_on_one_network_fail_the_check() -> None:
    off = {"ros1": {"enabled": False}, "ros2": {"enabled": False}}
    documents = [
        {"daemon": name, "worker": "ros1", "side": "ros1", "network": network, "state": state}
        for name, network, state in (("a", "n1", "running"), ("b", "n1", "standby"), ("c", "n2", "running"))
    ]
    assert Result.FAIL not in results(bridges.check(around(off, hub=hub(*documents))))
    documents[1]["state"] = "running"
    finding = next(f for f in bridges.check(around(off, hub=hub(*documents))) if f.result is Result.FAIL)
    assert "a and b are both active on the ros1 network n1" in finding.seen
