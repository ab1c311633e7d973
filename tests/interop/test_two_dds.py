"""Whole workers on Cyclone DDS and on Fast DDS, with real rclpy programs on both.

They need rmw_cyclonedds_cpp, which is not published as a wheel (docs/sides/ros2.md).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.ros2.environment import worker_environment
from bridge.config.model import Config
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.rmwside import RmwSide
from tests.contract.side import WorkerProcess
from tests.interop.test_parameters import (
    PROGRAM,
    RULES,
    assert_node_parameters_appear_in_ros1,
    assert_ros1_parameters_appear_on_a_node,
)
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.actions import HubActions
from tests.peers.hub.quick import QuickHub
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, has_rmw_cyclonedds, ros2_domain, ros2_environment, ros2_python
from tests.support.wait import until

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(not has_rmw_cyclonedds(), reason="rmw_cyclonedds_cpp is not installed (docs/sides/ros2.md)"),
]

FAST, CYCLONE = "rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"
STRING, SET = "std_msgs/String", "std_srvs/SetBool"
YES = {"success": True, "message": "done"}
COUNT = 100
NAVIGATE = "nav2_msgs/NavigateToPose"
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 5.0}}}}
SUCCEEDED, CANCELED = 4, 5


class Site:
    """One domain, and on it any number of hubs, workers and programs."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._registry = Registry()
        self._open = contextlib.ExitStack()
        self.hubs: list[QuickHub] = []

    def hub(self) -> QuickHub:
        """Start a hub, and append it to ``hubs``."""
        network = self._open.enter_context(QuickHub())
        self.hubs.append(network)
        return network

    def far(self, hub: QuickHub) -> RmwSide:
        """Return a node of rmw_zenoh on a hub."""
        end = RmwSide(Hub.open(hub.settings("far")), self._registry, hub.endpoint)
        self._open.callback(end.close)
        return end

    def actions(self, hub: QuickHub) -> HubActions:
        """Return a program with actions on a hub."""
        program = HubActions(hub.settings("actor"))
        self._open.callback(program.stop)
        return program

    def worker(self, hub: QuickHub, rmw: str) -> WorkerProcess:
        """Start a worker of a daemon that has the name of the middleware; it is active, or on standby."""
        config = Config.model_validate(
            {
                "name": rmw,
                "state": str(self._folder / rmw),
                "hub": {"listen": hub.endpoint, "domain": hub.domain},
                "ros2": {"domain": ros2_domain(), "rmw": rmw},
            }
        )
        worker = WorkerProcess("ros2", config, worker_environment(config, os.environ), ("running", "standby"))
        self._open.callback(worker.stop)
        return worker

    def program(self, rmw: str, name: str) -> Peer:
        peer = Peer(ROS2_PEER, ros2_python(), ros2_environment(on_cyclone=rmw == CYCLONE), name)
        self._open.callback(peer.stop)
        return peer

    def close(self) -> None:
        """Stop all, the last one first."""
        self._open.close()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    created = Site(tmp_path)
    yield created
    created.close()


def data(messages: list[dict[str, Any]], prefix: str) -> list[str]:
    """Return the texts that begin with a prefix."""
    return [m["data"] for m in messages if m["data"].startswith(prefix)]


def call(peer: Peer, service: str, **request: Any) -> dict[str, Any]:
    """Return the result of a program's call."""
    number = peer.ask("call", service=service, type=SET, request=request)["id"]
    return peer.ask("result", id=number, seconds=30)


@pytest.mark.parametrize("first", [FAST, CYCLONE])
def test_the_second_of_two_daemons_on_one_hub_stands_by(site: Site, first: str) -> None:
    """The second daemon recognizes the network of the first, and stands by, so that nothing crosses twice."""
    hub = site.hub()
    far, native = site.far(hub), site.program(CYCLONE, "native")
    site.worker(hub, first)
    second = site.worker(hub, CYCLONE if first == FAST else FAST)
    until(lambda: second.beat()["state"] == "standby", "the second one stands by", 30)
    crosses_once(far, native)


def crosses_once(far: RmwSide, native: Peer) -> None:
    """Assert that topics and services cross once between a hub and a program, in both directions."""
    received, out = far.subscribe("/to_hub", STRING, depth=1000), native.advertise("/to_hub", STRING, depth=1000)
    far.publish_until(native, out, {"data": "first"}, lambda: far.wait(received, 1, 0.1))
    for number in range(COUNT):
        native.publish(out, {"data": f"n{number}"})
    until(lambda: f"n{COUNT - 1}" in data(far.wait(received, 0), "n"), "the last message arrives")
    subscription = native.subscribe("/to_ros", STRING, depth=1000)
    publisher = far.advertise("/to_ros", STRING, depth=1000)
    far.hub_publish_until(publisher, {"data": "first"}, lambda: native.wait(subscription, 1, 0.1))
    for number in range(COUNT):
        far.publish(publisher, {"data": f"h{number}"})
    until(lambda: f"h{COUNT - 1}" in data(native.wait(subscription, 0), "h"), "the last message of the hub arrives")

    server = native.ask("serve", service="/native", type=SET, reply=YES)["id"]
    assert [far.call("/native", SET, data=number == 1).result()["reply"] for number in range(3)] == [YES] * 3
    serving = far.serve("/far", SET, reply=YES)
    assert [call(native, "/far", data=number == 1)["reply"] for number in range(3)] == [YES] * 3
    requests = native.ask("requests", id=server, count=3)["requests"]
    assert [request["data"] for request in requests] == [False, True, False]
    assert [request["data"] for request in serving.requests(3)] == [False, True, False]
    assert data(far.wait(received, 0), "n") == [f"n{number}" for number in range(COUNT)]
    assert data(native.wait(subscription, 0), "h") == [f"h{number}" for number in range(COUNT)]


def test_two_daemons_on_two_hubs_are_both_active_without_duplicates(site: Site) -> None:
    """Both are active on the domain: neither brings to its hub what the other one has published or serves."""
    hubs = [site.hub(), site.hub()]
    fars = [site.far(hub) for hub in hubs]
    for hub, rmw in zip(hubs, (FAST, CYCLONE), strict=True):
        worker = site.worker(hub, rmw)
        until(lambda worker=worker: worker.beat()["state"] == "running", "it is active", 30)
    native = site.program(CYCLONE, "native")

    received = [far.subscribe("/all", STRING, depth=1000) for far in fars]
    publishers = [far.advertise("/all", STRING, depth=1000) for far in fars]
    subscription, out = native.subscribe("/all", STRING, depth=1000), native.advertise("/all", STRING, depth=1000)
    for number, (far, publisher) in enumerate(zip(fars, publishers, strict=True)):
        far.hub_publish_until(
            publisher, {"data": f"hub{number}"}, lambda n=number: data(native.wait(subscription, 0), f"hub{n}")
        )
    for far, end in zip(fars, received, strict=True):
        far.publish_until(native, out, {"data": "first"}, lambda far=far, end=end: data(far.wait(end, 0), "first"))
    for number in range(COUNT):
        native.publish(out, {"data": f"n{number}"})
        for index, (far, publisher) in enumerate(zip(fars, publishers, strict=True)):
            far.publish(publisher, {"data": f"hub{index}-{number}"})
    expected = [f"n{number}" for number in range(COUNT)]
    for index, (far, end) in enumerate(zip(fars, received, strict=True)):
        until(lambda far=far, end=end: expected[-1] in data(far.wait(end, 0), "n"), "the last message arrives")
        assert data(far.wait(end, 0), "n") == expected
        assert not data(far.wait(end, 0), f"hub{1 - index}")
    for index in range(2):
        last = f"hub{index}-{COUNT - 1}"
        until(lambda last=last: last in data(native.wait(subscription, 0), "hub"), "the hub's last message arrives")
        assert data(native.wait(subscription, 0), f"hub{index}-") == [f"hub{index}-{number}" for number in range(COUNT)]

    server = native.ask("serve", service="/native", type=SET, reply=YES)["id"]
    for far in fars:
        assert [far.call("/native", SET, data=True).result()["reply"] for _ in range(3)] == [YES] * 3
    assert len(native.ask("requests", id=server, count=6)["requests"]) == 6
    servings = [far.serve(f"/far{number}", SET, reply=YES) for number, far in enumerate(fars)]
    for number in range(2):
        assert [call(native, f"/far{number}", data=True)["reply"] for _ in range(3)] == [YES] * 3
    assert [len(serving.requests(3)) for serving in servings] == [3, 3]
    for number, far in enumerate(fars):
        assert not far.hub.graph.servers(f"/far{1 - number}")
    assert len(native.ask("requests", id=server, count=6)["requests"]) == 6


@pytest.fixture
def on_cyclone(site: Site) -> tuple[RmwSide, WorkerProcess]:
    """A node on a hub, and the hub's running worker on Cyclone DDS."""
    hub = site.hub()
    far, worker = site.far(hub), site.worker(hub, CYCLONE)
    return far, worker


def test_the_call_of_a_client_that_leaves_is_abandoned(site: Site, on_cyclone: tuple[RmwSide, WorkerProcess]) -> None:
    far, _ = on_cyclone
    serving = far.serve("/far", SET, held=True)
    leaving = site.program(CYCLONE, "leaving")
    leaving.ask("call", service="/far", type=SET, request={"data": True})
    assert serving.requests(1) == [{"data": True}]
    leaving.stop()
    until(lambda: serving.abandoned == 1, "its call is abandoned", 30)


def test_goals_are_bridged_both_ways_on_cyclone_dds(site: Site, on_cyclone: tuple[RmwSide, WorkerProcess]) -> None:
    """Goals of the hub at a program, and of a program at the hub: feedback, result and cancel."""
    far, _ = on_cyclone
    native, hub = site.program(CYCLONE, "native"), site.actions(site.hubs[0])
    feedback = [{"distance_remaining": 2.0}]
    often = {"times": 100, "period": 0.1}  # the first may precede the match of the client's reader
    acting = native.ask("act", action="/native_go", type=NAVIGATE, held=True, feedback=feedback, **often)["id"]
    goal = hub.ask("send_goal", action="/native_go", type=NAVIGATE, goal=GOAL, seconds=60)["id"]
    state = hub.ask("goal", id=goal, until={"accepted": True, "feedback": 1}, seconds=30)
    assert (state["accepted"], state["feedback"][0]["distance_remaining"]) == (True, 2.0)
    assert native.ask("goals", id=acting)["goals"][0]["pose"]["pose"]["position"]["x"] == 5.0
    native.ask("release", id=acting)
    assert hub.ask("goal", id=goal, until={"status": SUCCEEDED}, seconds=30)["status"] == SUCCEEDED

    hub.ask("act", action="/hub_go", type=NAVIGATE, held=True)
    far.until_route("/hub_go/_action/send_goal", "out", 30)
    goal = native.ask("send_goal", action="/hub_go", type=NAVIGATE, goal=GOAL)["id"]
    assert native.ask("goal", id=goal, until={"accepted": True}, seconds=30)["accepted"]
    native.ask("cancel", id=goal)
    assert native.ask("goal", id=goal, until={"status": CANCELED}, seconds=30)["status"] == CANCELED


def test_parameters_are_shared_both_ways_on_cyclone_dds(deployment: Deployment) -> None:
    """ROS 1's parameters appear on a node of the bridge, and those of a node on Cyclone DDS in ROS 1."""
    deployment.master.start()
    ros2 = {"domain": ros2_domain(), "rmw": CYCLONE}
    deployment.configure(routing={"parameters": RULES}, ros2=ros2)
    ros1 = deployment.ros1()
    ros1.ask("set_param", name="/robot", value={"speed": 1.5, "name": "r1", "limits": {"turn": 2}, "ranges": [1, 2.5]})
    node = deployment.keep(Peer(PROGRAM, ros2_python(), ros2_environment(on_cyclone=True), "controller_server"))
    node.ask("declare", parameters={"FollowPath.speed": 0.5, "mode": "slow", "tries": 3, "weights": [1.0, 2.0]})
    deployment.run()
    assert_ros1_parameters_appear_on_a_node(ros1, node)
    assert_node_parameters_appear_in_ros1(ros1, node)
    shared = {item["ros1"]: item["shared"] for item in deployment.answer("ros1")["parameters"]}
    assert shared["/robot"] == 5
    assert shared["/nav/controller"] >= 4


def test_a_server_on_fast_dds_is_refused(site: Site, on_cyclone: tuple[RmwSide, WorkerProcess]) -> None:
    """A topic of the same program crosses; the server never executes a request."""
    far, _ = on_cyclone
    native = site.program(FAST, "lamp")
    server = native.ask("serve", service="/lamp", type=SET, reply=YES)["id"]
    known = {"nodes": [], "both": [], "mixed": [], "foreign": ["/lamp"], "uncallable": ["/lamp"]}
    until(lambda: far.status()["cyclone"] == known, "the server and its node are known", 30)
    lines = until(lambda: [line for line in far.explain("/lamp") if line["direction"] == "in"], "it is explained")
    (line,) = lines
    assert "/lamp is served on a DDS other than Cyclone DDS (/lamp)" in line["reason"]
    assert "remove ros2.rmw" in line["cure"]
    (warning,) = far.status()["warnings"]
    assert warning.startswith(
        "/lamp: served on a DDS other than Cyclone DDS, so they cannot be called; remove ros2.rmw"
    )
    received, out = far.subscribe("/text", STRING), native.advertise("/text", STRING)
    far.publish_until(native, out, {"data": "crosses"}, lambda: far.wait(received, 1, 0.1))
    assert native.ask("requests", id=server, count=0)["requests"] == []


def test_a_client_on_fast_dds_gets_no_reply(site: Site, on_cyclone: tuple[RmwSide, WorkerProcess]) -> None:
    """Its requests are not forwarded, which is logged at most once in 10 s; a client on Cyclone DDS is served."""
    far, worker = on_cyclone
    serving = far.serve("/far", SET, reply=YES)
    foreign, native = site.program(FAST, "asker"), site.program(CYCLONE, "native")
    calls = [foreign.ask("call", service="/far", type=SET, request={"data": True})["id"] for _ in range(3)]
    reason = "its client is not on Cyclone DDS"
    until(lambda: reason in worker.process.output(), "the reason is logged", 30)
    assert call(native, "/far", data=False)["reply"] == YES
    assert [request["data"] for request in serving.requests(1)] == [False]
    assert worker.process.output().count(reason) == 1
    assert not any(foreign.ask("result", id=number, seconds=0)["done"] for number in calls)

    def warned() -> bool:
        return any("/asker on a DDS other than Cyclone DDS may call them" in text for text in far.status()["warnings"])

    until(warned, "status warns of it", 30)
