"""Checks of ROS 1, against a real roscore."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest

from bridge.doctor.check import Result
from bridge.doctor.checks import bridges, ros1
from bridge.doctor.context import CheckContext
from tests.doctor.parts import around, hub, only, results
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.support.ports import free_port

NOWHERE = "no-such-host.invalid"
REMOTE = "http://192.0.2.1:11311"
WORKER = {"worker": "ros1", "side": "ros1"}


@pytest.fixture(scope="module")
def roscore() -> Iterator[RosMaster]:
    with RosMaster() as master:
        yield master


@pytest.fixture
def master(roscore: RosMaster) -> Iterator[RosMaster]:
    """A roscore without registrations from earlier tests."""
    yield roscore
    for kind, name in (("Publisher", "publishers"), ("Subscriber", "subscribers")):
        for topic, nodes in roscore.state()[name].items():
            for node in nodes:
                if node != "/rosout":
                    uri = roscore.call("lookupNode", node)
                    call_as_node(roscore, node, f"unregister{kind}", topic, uri)
    roscore.call("deleteParam", "/midspan/nodes")


def call_as_node(master: RosMaster, node: str, method: str, *params: Any) -> None:
    from xmlrpc.client import ServerProxy

    with ServerProxy(master.uri) as proxy:
        getattr(proxy, method)(node, *params)


def register(master: RosMaster, node: str, uri: str) -> None:
    call_as_node(master, node, "registerPublisher", f"{node}/topic", "std_msgs/String", uri)


@needs_ros1
def test_a_reachable_master_and_its_nodes_are_ok(master: RosMaster) -> None:
    place = around({"ros1": {"master": master.uri}}, hub=hub(WORKER))
    finding = only(ros1.check_master(place))
    assert (finding.result, "1 nodes" in finding.seen) == (Result.OK, True), finding
    assert only(ros1.check_nodes(place)).result is Result.OK


@pytest.mark.parametrize(
    ("master", "words", "result"),
    [
        (f"http://{NOWHERE}:11311", f"'{NOWHERE}' does not resolve", Result.FAIL),
        ("http://127.0.0.1:{free}", "does not answer", Result.FAIL),
    ],
)
def test_an_unreachable_master_fails_with_a_cure(master: str, words: str, result: Result) -> None:
    uri = master.replace("{free}", str(free_port()))
    place = around({"ros1": {"master": uri}}, hub=hub(WORKER))
    finding = only(ros1.check_master(place))
    assert (finding.result, words in finding.seen) == (result, True), finding
    assert finding.cure
    assert only(ros1.check_nodes(place)).result is Result.SKIP


def test_checks_are_skipped_without_ros1() -> None:
    off = around({"ros1": {"enabled": False}})
    for check in (ros1.check_master, ros1.check_environment, ros1.check_address, ros1.check_nodes):
        assert results(check(off)) == [Result.SKIP]
    assert results(ros1.check_packages(off)) == [Result.SKIP]


def test_missing_packages_fail_only_if_ros1_is_enabled(tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    for enabled, result in ((True, Result.FAIL), ("auto", Result.WARN)):
        place = around({"ros1": {"enabled": enabled, "packages": missing}})
        finding = only(ros1.check_packages(place))
        assert (finding.result, str(missing) in finding.seen) == (result, True), finding
    assert only(ros1.check_master(around({"ros1": {"packages": missing}}))).result is Result.SKIP


def test_on_a_machine_without_ros1_the_master_check_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.adapters.ros1.environment.DEFAULT_MASTER", f"http://127.0.0.1:{free_port()}")
    place = around({})
    assert only(ros1.check_packages(place)).result is Result.OK
    finding = only(ros1.check_master(place))
    assert (finding.result, "waits for a master" in finding.seen) == (Result.SKIP, True), finding


@needs_ros1
def test_unreachable_nodes_are_reported_by_cause(master: RosMaster) -> None:
    dead = free_port()
    register(master, "/lost", f"http://{NOWHERE}:4711/")
    register(master, "/lost_too", f"http://{NOWHERE}:4712/")
    register(master, "/dead", f"http://127.0.0.1:{dead}/")
    register(master, "/strange", f"http://{'x' * 70}.y:1/")
    finding = ros1.check_nodes(around({"ros1": {"master": master.uri}}, hub=hub(WORKER)))
    lost = next(f for f in finding if NOWHERE in f.seen)
    assert lost.result is Result.FAIL
    assert "/lost, /lost_too: " in lost.seen
    assert "/etc/hosts" in lost.cure
    unreachable = next(f for f in finding if f.result is Result.WARN)
    assert unreachable.seen.startswith("/dead: ")
    assert any(f.seen.startswith("/strange: ") for f in finding)
    assert len(finding) == 3


@pytest.mark.parametrize(
    ("environ", "config", "result"),
    [
        ({}, {}, Result.OK),
        ({"ROS_IP": "127.0.0.1"}, {}, Result.OK),
        ({"ROS_HOSTNAME": "localhost"}, {}, Result.OK),
        ({"ROS_IP": "203.0.113.7"}, {}, Result.FAIL),
        ({"ROS_HOSTNAME": NOWHERE}, {}, Result.FAIL),
        ({"ROS_IP": "203.0.113.7"}, {"ip": "127.0.0.1"}, Result.OK),
        ({}, {"hostname": NOWHERE}, Result.FAIL),
        ({"ROS_IP": "127.0.0.1", "ROS_MASTER_URI": REMOTE}, {}, Result.FAIL),
        ({"ROS_HOSTNAME": "localhost", "ROS_MASTER_URI": REMOTE}, {}, Result.FAIL),
    ],
)
def test_an_address_that_peers_cannot_reach_fails_the_check(
    environ: dict[str, str], config: dict[str, str], result: Result
) -> None:
    finding = only(ros1.check_address(around({"ros1": config}, environ, hub=hub(WORKER))))
    assert (finding.result, bool(finding.cure)) == (result, result is Result.FAIL), finding


@needs_ros1
def test_a_shell_with_another_master_than_the_daemons_is_reported(master: RosMaster) -> None:
    shell = {"ROS_MASTER_URI": master.uri}
    run_id = master.call("getParam", "/run_id")
    for network, result in ((run_id, Result.OK), ("another run id", Result.FAIL)):
        place = around(environ=shell, hub=hub({**WORKER, "network": network}))
        assert only(ros1.check_environment(place)).result is result
    place = around({"ros1": {"master": "http://other:11311"}}, shell, hub=hub(WORKER))
    finding = only(ros1.check_environment(place))
    assert (finding.result, "http://other:11311" in finding.seen) == (Result.WARN, True)
    same = around(
        {"ros1": {"master": master.uri.rstrip("/").replace("127.0.0.1", "localhost")}}, shell, hub=hub(WORKER)
    )
    assert only(ros1.check_environment(same)).result is Result.OK


class _Http(SimpleXMLRPCRequestHandler):
    def log_message(self, *_args: Any) -> None:
        pass


@pytest.fixture
def live_node() -> Iterator[str]:
    """A node that answers getPid with 4711, as Midspan on another machine would."""
    server = SimpleXMLRPCServer(("127.0.0.1", 0), _Http)
    server.register_function(lambda _caller: (1, "", 4711), "getPid")
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}/"
    server.shutdown()
    thread.join()
    server.server_close()


@needs_ros1
def test_other_bridges_on_the_master_are_reported(master: RosMaster, live_node: str, tmp_path: Path) -> None:
    config = {"ros1": {"master": master.uri}, "ros2": {"enabled": False}, "state": tmp_path}

    def place() -> CheckContext:
        return around(config, hub=hub({**WORKER, "pid": 99}))

    assert Result.WARN not in results(bridges.check(place()))

    entry = {"owner": "x", "daemon": "robot2", "node": "/midspan", "uri": live_node, "pid": 4711}
    dead = {**entry, "node": "/midspan_dead", "uri": f"http://127.0.0.1:{free_port()}/"}
    own_entry = {**entry, "node": "/midspan_own", "daemon": "robot1", "pid": 99}
    for name, value in (("other", entry), ("dead", dead), ("own", own_entry)):
        master.call("setParam", f"/midspan/nodes/{name}", value)
    register(master, "/ros_bridge", live_node)
    finding = bridges.check(place())
    texts = {f.seen: f.result for f in finding if f.result is not Result.SKIP}
    assert sorted(texts.values()) == [Result.FAIL, Result.WARN, Result.WARN], texts
    assert any("/ros_bridge looks like another bridge" in seen for seen in texts)
    assert any("daemon robot2 is on this master too (/midspan at" in seen for seen in texts)
    assert any("/midspan_dead of Midspan daemon robot2 is dead" in seen for seen in texts)
