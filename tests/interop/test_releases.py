"""Real programs on ROS 2 Kilted (Fast DDS 3), with Midspan on Jazzy and on Kilted."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.actions import HubActions
from tests.peers.peer import Peer
from tests.peers.ros2 import kilted
from tests.peers.ros2.network import ros2_python
from tests.support.wait import until

PROGRAM = Path(__file__).parents[1] / "peers" / "ros2" / "parameters.py"
TEXT, SERVICE, ACTION = "std_msgs/String", "std_srvs/SetBool", "nav2_msgs/NavigateToPose"
THROUGH, FULL = "nav2_msgs/NavigateThroughPoses", "nav2_msgs/action/NavigateThroughPoses"
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 5.0}}}}
RULES = [
    {"ros1": "/robot", "node": "/robot_parameters", "owner": "ros1"},
    {"ros1": "/controller", "node": "/controller_server", "owner": "ros2"},
]


class ReleasePrograms:
    """A daemon with its ROS 2 side on a release, a program on Kilted, and programs on ROS 1 and the hub."""

    def __init__(self, deployment: Deployment, side: str) -> None:
        self.deployment, self.side = deployment, side
        if side == "kilted":
            deployment.env = kilted.source(os.environ)
        deployment.master.start()
        deployment.configure(routing={"parameters": RULES})
        self.ros1 = deployment.ros1()
        self.ros1.ask("set_param", name="/robot", value={"speed": 1.5})
        env = kilted.program_environment()
        self.ros2 = deployment.keep(Peer(PROGRAM, ros2_python(), env, "controller_server"))
        self.ros2.ask("declare", parameters={"mode": "slow"})
        deployment.run()
        self.hub = deployment.keep(HubActions(deployment.settings("module")))


@pytest.fixture(scope="module", params=["jazzy", pytest.param("kilted", marks=pytest.mark.thorough)])
def programs(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ReleasePrograms]:
    """The programs that all tests share; the parameter is the ROS 2 release of Midspan's side."""
    with Deployment(tmp_path_factory.mktemp("releases")) as deployment:
        yield ReleasePrograms(deployment, request.param)


def crossing(source: Peer, sink: Peer, topic: str) -> list[Any]:
    """Return the messages that cross on a volatile topic, and on a latched topic with a late subscriber."""
    publisher, subscription = source.advertise(topic, TEXT), sink.subscribe(topic, TEXT)

    def received() -> list[Any]:
        source.publish(publisher, {"data": "again"})
        return sink.wait(subscription, 1, 0.2)

    (volatile, *_) = until(received, f"{topic} crosses", 40)
    latched = source.advertise(f"{topic}_latched", TEXT, latched=True)
    source.publish(latched, {"data": "kept"})
    late = sink.subscribe(f"{topic}_latched", TEXT, latched=True)
    return [volatile, *sink.wait(late, 1)]


def test_topics_and_latched_data_are_bridged_between_releases(programs: ReleasePrograms) -> None:
    both = [{"data": "again"}, {"data": "kept"}]
    assert crossing(programs.ros2, programs.ros1, "/to_ros1") == both
    assert crossing(programs.ros1, programs.ros2, "/to_ros2") == both
    if programs.side == "kilted":
        jazzy = programs.deployment.ros2()
        assert crossing(jazzy, programs.ros1, "/from_jazzy") == both
        assert crossing(programs.ros1, jazzy, "/to_jazzy") == both


@pytest.mark.parametrize("native", ["server", "client"])
def test_services_cross_to_nodes_of_other_releases(programs: ReleasePrograms, native: str) -> None:
    server, client = (programs.ros2, programs.ros1) if native == "server" else (programs.ros1, programs.ros2)
    name, reply = f"/lamp_{native}", {"success": True, "message": "lit"}
    served = server.ask("serve", service=name, type=SERVICE, reply=reply)["id"]
    if native == "server":
        programs.deployment.until_route("ros1", name, "out", state="active")
        client.ask("await_service", service=name, seconds=20)
    if native == "server":
        users = lambda: [user for d in programs.deployment.explain(name) for user in d["users"]]  # noqa: E731
        served_by = ["served by /controller_server on Fast DDS 3.2.2 (Kilted)"]
        until(lambda: users() == served_by, "explain names the server's node", 20, every=0.1)
    call = client.ask("call", service=name, type=SERVICE, request={"data": True})["id"]
    assert client.ask("result", id=call, seconds=40)["reply"] == reply
    assert server.ask("requests", id=served, count=1, seconds=20)["requests"] == [{"data": True}]


@pytest.mark.parametrize("native", ["server", "client"])
def test_actions_cross_to_nodes_of_other_releases(programs: ReleasePrograms, native: str) -> None:
    server, client = (programs.ros2, programs.hub) if native == "server" else (programs.hub, programs.ros2)
    name, feedback = f"/go_{native}", [{"distance_remaining": 2.5}]
    served = server.ask("act", action=name, type=ACTION, feedback=feedback, outcome="succeed")["id"]
    goal = client.ask("send_goal", action=name, type=ACTION, goal=GOAL, seconds=40)["id"]
    state = client.ask("goal", id=goal, until={"accepted": True, "status": 4}, seconds=40)
    assert (state["accepted"], state["status"]) == (True, 4), state
    (received,) = server.ask("goals", id=served, count=1, seconds=20)["goals"]
    assert received["pose"]["pose"]["position"]["x"] == 5.0


@pytest.mark.parametrize("native", ["server", "client"])
def test_goals_are_converted_for_actions_whose_fields_differ(programs: ReleasePrograms, native: str) -> None:
    """Kilted's ``NavigateThroughPoses`` has its poses in a ``Goals``, and more fields in result and feedback."""
    server, client = (programs.ros2, programs.hub) if native == "server" else (programs.hub, programs.ros2)
    name, poses = f"/through_{native}", [GOAL["pose"], GOAL["pose"]]
    values = {"distance_remaining": 2.5, "number_of_poses_remaining": 2}
    served = server.ask("act", action=name, type=THROUGH, feedback=[values], outcome="succeed")["id"]
    sent = {"poses": poses if native == "server" else {"goals": poses}}

    def driven() -> list[Any]:
        goal = client.ask("send_goal", action=name, type=THROUGH, goal=sent, seconds=40)["id"]
        state = client.ask("goal", id=goal, until={"accepted": True, "status": 4}, seconds=40)
        assert (state["accepted"], state["status"]) == (True, 4), state
        return client.ask("goal", id=goal, until={"feedback": 1}, seconds=1)["feedback"]

    (feedback,) = until(driven, "feedback arrives; it is lost until its publisher is discovered", 40)
    assert (feedback["distance_remaining"], feedback["number_of_poses_remaining"]) == (2.5, 2)
    received, *_ = server.ask("goals", id=served, count=1, seconds=20)["goals"]
    goals = received["poses"]["goals"] if native == "server" else received["poses"]
    assert [pose["pose"]["position"]["x"] for pose in goals] == [5.0, 5.0]

    def explained() -> bool:
        reasons = [decision["why"] for decision in programs.deployment.explain(name)]
        return any(f"has kilted's version of {FULL}_" in reason for reason in reasons)

    until(explained, "explain names what is left out", 20, every=0.1)


def test_parameters_are_shared_with_nodes_of_other_releases(programs: ReleasePrograms) -> None:
    """ROS 1 has a copy of one node's parameters, and another node has ROS 1's; each copy can be set."""
    ros1, ros2 = programs.ros1, programs.ros2

    def in_ros1(name: str) -> Any:
        return ros1.ask("get_param", name=name)["value"]

    until(lambda: in_ros1("/controller/mode") == "slow", "the node's parameter is in ROS 1", 40, every=0.1)
    ros1.ask("set_param", name="/controller/mode", value="fast")
    until(lambda: ros2.ask("own", name="mode")["value"] == "fast", "the node has the new value", 40, every=0.1)
    node = "/robot_parameters"
    assert ros2.ask("get_of", node=node, names=["speed"])["values"] == [1.5]
    assert ros2.ask("set_of", node=node, parameters={"speed": 2.5})["reasons"] == [""]
    assert in_ros1("/robot/speed") == 2.5


def test_status_reports_that_shared_memory_is_not_used(programs: ReleasePrograms) -> None:
    """Fast DDS 2 and 3 share no memory segments. The side keeps shared memory for programs on its own version."""
    if programs.side == "kilted":
        programs.deployment.ros2()

    def reported() -> list[str]:
        warnings = programs.deployment.worker("ros2").get("warnings", [])
        return [text for text in warnings if "another major version of Fast DDS" in text]

    (text,) = until(reported, "the warning is reported", 20, every=0.1)
    assert f"({programs.side})" in text, "the worker runs on this release"
    assert text.endswith("their messages use UDP, not shared memory")
