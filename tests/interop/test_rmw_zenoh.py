"""Real programs on rmw_zenoh_cpp, which join the hub by themselves, with programs of the other sides.

The wheels lack rmw_zenoh_cpp, so that these tests run only where it was built; see docs/sides/ros2.md.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.interfaces.folders import read_folders
from tests.contract.side import PEER_FOLDERS
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.actions import HubActions
from tests.peers.peer import Peer
from tests.peers.ros2 import kilted
from tests.peers.ros2.network import ros2_python
from tests.peers.ros2.rmw_zenoh import has_rmw_zenoh, rmw_zenoh_environment
from tests.support.wait import until

PROGRAM = Path(__file__).parents[1] / "peers" / "ros2" / "parameters.py"
NODE = "controller_server"
RELEASES = [release for release in ("jazzy", "kilted") if has_rmw_zenoh(release)]
TEXT, SERVICE, ACTION = "std_msgs/String", "std_srvs/SetBool", "nav2_msgs/NavigateToPose"
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 5.0}}}}
REPLY = {"success": True, "message": "lit"}
SIDES = ["ros1", "ros2"]

pytestmark = [
    pytest.mark.skipif(not RELEASES, reason="rmw_zenoh_cpp is not installed (docs/sides/ros2.md)"),
    pytest.mark.thorough,
]


class Place:
    """A daemon, and a program on each side; that on the hub exists before the daemon."""

    def __init__(self, deployment: Deployment, release: str) -> None:
        self.deployment, self.release = deployment, release
        deployment.master.start()
        deployment.configure(
            routing={"parameters": [{"ros1": "/copy", "node": f"/{NODE}", "owner": "ros2"}]},
        )
        self.node = self.program(NODE)
        self.node.ask("declare", parameters={"mode": "slow"})
        deployment.run()
        self.programs = {"ros1": deployment.ros1("ros1_program"), "ros2": deployment.ros2("ros2_program")}

    def program(self, name: str) -> Peer:
        """Start a program on the hub."""
        env = rmw_zenoh_environment(self.deployment.endpoint, 0, read_folders(PEER_FOLDERS), self.release)
        peer: Peer = self.deployment.keep(Peer(PROGRAM, ros2_python(), env, name))
        return peer


@pytest.fixture(scope="module", params=RELEASES)
def place(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """The programs that all tests share."""
    with Deployment(tmp_path_factory.mktemp("rmw_zenoh")) as deployment:
        yield Place(deployment, request.param)


def crossing(source: Peer, sink: Peer, topic: str) -> tuple[int, int]:
    """Create a publisher and a subscription; return both once messages cross."""
    publisher, subscription = source.advertise(topic, TEXT, depth=1000), sink.subscribe(topic, TEXT, depth=1000)

    def received() -> bool:
        source.publish(publisher, {"data": "probe"})
        return bool(sink.wait(subscription, 1, 0.2))

    until(received, f"{topic} crosses", 40)
    return publisher, subscription


@pytest.mark.parametrize("side", SIDES)
def test_a_burst_arrives_completely_and_in_order(place: Place, side: str) -> None:
    for source, sink, topic in (
        (place.node, place.programs[side], f"/burst_to_{side}"),
        (place.programs[side], place.node, f"/burst_from_{side}"),
    ):
        publisher, subscription = crossing(source, sink, topic)
        for number in range(100):
            source.publish(publisher, {"data": f"{number}"})
        texts = lambda sink=sink, s=subscription: [m["data"] for m in sink.wait(s, 0) if m["data"] != "probe"]  # noqa: E731
        until(lambda texts=texts: texts()[-1:] == ["99"], f"the last message on {topic} arrives", 30)
        assert texts() == [f"{number}" for number in range(100)], topic


@pytest.mark.parametrize("side", SIDES)
def test_latched_messages_are_received_by_late_subscribers(place: Place, side: str) -> None:
    for source, sink, topic in (
        (place.node, place.programs[side], f"/kept_to_{side}"),
        (place.programs[side], place.node, f"/kept_from_{side}"),
    ):
        source.publish(source.advertise(topic, TEXT, latched=True, depth=1), {"data": topic})
        for _ in range(2):
            late = sink.subscribe(topic, TEXT, latched=True)
            assert sink.wait(late, 1, 40) == [{"data": topic}]


@pytest.mark.parametrize("side", SIDES)
def test_images_cross(place: Place, side: str) -> None:
    size = 6_000_000
    image = {"height": 1, "width": size, "encoding": "mono8", "step": size, "data": [7] * size}
    for source, sink, topic in (
        (place.node, place.programs[side], f"/image_to_{side}"),
        (place.programs[side], place.node, f"/image_from_{side}"),
    ):
        publisher = source.advertise(topic, "sensor_msgs/Image", depth=1)
        subscription = sink.subscribe(topic, "sensor_msgs/Image", depth=1)

        def received(source: Peer = source, sink: Peer = sink, p: int = publisher, s: int = subscription) -> Any:
            source.publish(p, image)
            return sink.ask("wait", id=s, count=1, seconds=2)["messages"]

        (first, *_) = until(received, f"{topic} crosses", 60)
        assert (len(first["data"]), set(first["data"])) == (size, {7})
        source.drop(publisher)
        sink.drop(subscription)


@pytest.mark.parametrize("side", SIDES)
def test_services_are_called_in_both_directions(place: Place, side: str) -> None:
    for server, client, name in (
        (place.node, place.programs[side], f"/lamp_of_hub_for_{side}"),
        (place.programs[side], place.node, f"/lamp_of_{side}"),
    ):
        served = server.ask("serve", service=name, type=SERVICE, reply=REPLY)["id"]
        if client is place.programs["ros1"]:
            client.ask("await_service", service=name, seconds=20)
        calls = [client.ask("call", service=name, type=SERVICE, request={"data": True})["id"] for _ in range(20)]
        assert [client.ask("result", id=call, seconds=40)["reply"] for call in calls] == [REPLY] * 20
        assert server.ask("requests", id=served, count=20, seconds=20)["requests"] == [{"data": True}] * 20


@pytest.mark.parametrize("outcome", ["succeed", "abort", "cancel", "reject"])
def test_goals_are_executed_in_both_directions(place: Place, outcome: str) -> None:
    feedback, status = [{"distance_remaining": 2.5}], {"succeed": 4, "abort": 6, "cancel": 5, "reject": 0}[outcome]
    hub = HubActions(place.deployment.settings(f"module_{outcome}"))
    place.deployment.keep(hub)
    options = {"held": True} if outcome == "cancel" else {"outcome": outcome}
    for server, client, name in (
        (place.node, place.programs["ros2"], f"/go_{outcome}_on_hub"),
        (place.programs["ros2"], place.node, f"/go_{outcome}_on_ros2"),
        (place.node, hub, f"/go_{outcome}_for_module"),
        (hub, place.node, f"/go_{outcome}_of_module"),
    ):
        served = server.ask("act", action=name, type=ACTION, feedback=feedback, **options)["id"]
        goal = client.ask("send_goal", action=name, type=ACTION, goal=GOAL, seconds=40)["id"]
        if outcome == "cancel":
            client.ask("goal", id=goal, until={"accepted": True}, seconds=40)
            assert server.ask("goals", id=served, count=1, seconds=20)["goals"]
            client.ask("cancel", id=goal)
        end = {"accepted": False} if outcome == "reject" else {"status": status}
        state = client.ask("goal", id=goal, until=end, seconds=40)
        assert (state["accepted"], state["status"]) == (outcome != "reject", status), (name, state)


def test_parameters_of_the_node_are_in_ros1(place: Place) -> None:
    ros1 = place.programs["ros1"]
    value = lambda: ros1.ask("get_param", name="/copy/mode")["value"]  # noqa: E731
    until(lambda: value() == "slow", "the node's parameter is in ROS 1", 40, every=0.1)
    ros1.ask("set_param", name="/copy/mode", value="fast")
    until(lambda: place.node.ask("own", name="mode")["value"] == "fast", "the node has the new value", 40, every=0.1)


def test_the_node_sees_the_graph_of_the_other_sides(place: Place) -> None:
    for side, program in place.programs.items():
        program.advertise(f"/seen_of_{side}", TEXT)
        until(lambda side=side: f"/seen_of_{side}" in place.node.graph()["topics"], f"the topic of {side} is seen", 40)
        until(lambda side=side: place.node.graph()["publishers"][f"/seen_of_{side}"], "its publisher is seen", 40)


def test_a_killed_node_takes_its_routes_along(place: Place) -> None:
    mortal = place.program("mortal")
    mortal.advertise("/mortal", TEXT)
    ros1 = place.programs["ros1"]
    until(lambda: ros1.graph()["publishers"].get("/mortal"), "the topic is on ROS 1", 40)
    mortal.signal(signal.SIGKILL)
    until(lambda: not ros1.graph()["publishers"].get("/mortal"), "the topic has left ROS 1", 40)


def router_of(place: Place) -> int:
    """Return the router's process ID, 0 if it does not respond."""
    statuses = [status for status in place.deployment.status() if status.get("worker") == "router"]
    return int(statuses[0]["pid"]) if statuses else 0


def test_messages_cross_again_after_the_router_was_killed(place: Place) -> None:
    ends = [crossing(place.node, place.programs[side], f"/again_{side}") for side in SIDES]
    pid = router_of(place)
    assert pid
    os.kill(pid, signal.SIGKILL)
    until(lambda: router_of(place) not in (0, pid), "another router runs", 40, every=0.1)
    for side, (publisher, subscription) in zip(SIDES, ends, strict=True):
        before = len(place.programs[side].wait(subscription, 0))

        def received(side: str = side, p: int = publisher, s: int = subscription, before: int = before) -> bool:
            place.node.publish(p, {"data": "again"})
            return len(place.programs[side].wait(s, before + 1, 0.5)) > before

        until(received, f"messages cross to {side} again", 60)


THROUGH = "nav2_msgs/NavigateThroughPoses"


@pytest.mark.skipif(len(RELEASES) < 2, reason="rmw_zenoh_cpp is not installed for two releases (docs/sides/ros2.md)")
@pytest.mark.parametrize("server_release", ["jazzy", "kilted"])
def test_goals_are_relayed_between_nodes_of_two_releases(deployment: Deployment, server_release: str) -> None:
    """Kilted's version has its poses in a ``Goals``, so the nodes reach each other only by the relay."""
    deployment.start()
    programs = {}
    for release in ("jazzy", "kilted"):
        packages = kilted.nav2_actions() if release == "kilted" else {}
        env = rmw_zenoh_environment(deployment.endpoint, 0, packages, release)
        programs[release] = deployment.keep(Peer(PROGRAM, ros2_python(), env, f"node_{release}"))
    server = programs[server_release]
    client_release = "kilted" if server_release == "jazzy" else "jazzy"
    client, poses = programs[client_release], [GOAL["pose"], GOAL["pose"]]
    served = server.ask("act", action="/through", type=THROUGH, feedback=[{"distance_remaining": 2.5}])["id"]
    goal = {"poses": {"goals": poses} if client_release == "kilted" else poses}
    sent = client.ask("send_goal", action="/through", type=THROUGH, goal=goal, seconds=60)["id"]
    state = client.ask("goal", id=sent, until={"accepted": True, "status": 4}, seconds=40)
    assert (state["accepted"], state["status"]) == (True, 4), state
    (received,) = server.ask("goals", id=served, count=1, seconds=20)["goals"]
    goals = received["poses"]["goals"] if server_release == "kilted" else received["poses"]
    assert [pose["pose"]["position"]["x"] for pose in goals] == [5.0, 5.0]
