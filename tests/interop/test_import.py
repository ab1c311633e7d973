"""Imported configurations in use: real programs, and the examples of the bridges' own documentation."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.interop.test_topics import cross
from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, new_domain, ros2_environment, ros2_python
from tests.support.forks import DAEMON_AND_WORKERS
from tests.support.ports import free_port
from tests.support.process import DAEMON_SECONDS, Process
from tests.support.wait import until

pytestmark = pytest.mark.thorough

STRING = "std_msgs/String"
TF = "tf2_msgs/TFMessage"

# the example in the README of ros1_bridge, its advice for /tf_static, and more services
PARAMETERS = """\
topics:
  -
    topic: /chatter  # Topic name on both ROS 1 and ROS 2
    type: std_msgs/msg/String  # Type of topic to bridge
    queue_size: 1  # Queue size
  -
    topic: /tf_static
    type: tf2_msgs/msg/TFMessage
    queue_size: 1
    qos:
      history: keep_all
      durability: transient_local
services_2_to_1:
  -
    service: /add_two_ints  # ROS 1 service name
    type: roscpp_tutorials/TwoInts  # The ROS 1 service type name
  - {service: /lamp, type: std_srvs/SetBool}
services_1_to_2:
  - {service: /door, type: std_srvs/srv/SetBool}
  - {service: /gate, type: std_srvs/srv/SetBool}
"""

DOMAINS = """\
name: my_bridge
from_domain: {first}
to_domain: {second}
topics:
  chatter:
    type: std_msgs/msg/String
    remap: chitter
  both:
    type: std_msgs/msg/String
    bidirectional: True
  latched:
    type: std_msgs/msg/String
    reversed: True
services:
  lamp:
    type: std_srvs/srv/SetBool
    remap: first/lamp
actions:
  go:
    type: nav2_msgs/action/NavigateToPose
    reversed: True
"""
SERVICE = "std_srvs/SetBool"
ACTION = "nav2_msgs/NavigateToPose"


def imported(peer: str, file: Path, folder: Path) -> list[Path]:
    """Import a file with the command, and return the written files."""
    output = folder / "imported.yaml" if peer == "ros1_bridge" else folder
    done = subprocess.run(
        [*MIDSPAN, "import", peer, str(file), "-o", str(output)],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert done.returncode in {0, 3}, done.stderr
    return [Path(line) for line in done.stdout.splitlines()]


def placed(file: Path, **sections: dict) -> None:
    """Set keys of an imported file, such as its ports and folders, to values of the test."""
    config = yaml.safe_load(file.read_text(encoding="utf-8"))
    for name, keys in sections.items():
        config[name] = {**config.get(name, {}), **keys} if isinstance(keys, dict) else keys
    file.write_text(yaml.safe_dump(config), encoding="utf-8")


def test_the_imported_example_of_ros1_bridge_bridges_only_what_it_lists(deployment: Deployment, tmp_path: Path) -> None:
    source = tmp_path / "bridge.yaml"
    source.write_text(PARAMETERS)
    (created,) = imported("ros1_bridge", source, tmp_path)
    deployment.start(routing=yaml.safe_load(created.read_text())["routing"])
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    for sender, hearer in ((ros1, ros2), (ros2, ros1)):
        subscription = hearer.subscribe("/chatter", STRING)
        out = sender.advertise("/chatter", STRING)
        assert cross(sender, out, hearer, subscription, {"data": "hello"}) == {"data": "hello"}
    frames = {"transforms": [{"header": {"frame_id": "base"}, "child_frame_id": "laser"}]}
    ros1.publish(ros1.advertise("/tf_static", TF, latched=True), frames)
    late = ros2.subscribe("/tf_static", TF, latched=True)
    assert ros2.wait(late, 1)[0]["transforms"][0]["child_frame_id"] == "laser"
    for server, client, service in ((ros1, ros2, "/lamp"), (ros2, ros1, "/door")):
        served(server, client, service, service)
    # a service crosses in one direction only
    for server, service in ((ros1, "/gate"), (ros2, "/add_two_ints")):
        server.ask("serve", service=service, type=SERVICE)
        until(lambda name=service: "no rule allows it" in str(deployment.explain(name)), f"{service} is refused", 20)
    # unlisted topics do not cross
    ros1.advertise("/other", STRING)
    until(lambda: "no rule allows it" in str(deployment.explain("/other")), "/other is refused", 20)
    assert deployment.route("ros1", "/other", "in") is None


def served(server: Peer, client: Peer, name: str, called: str) -> None:
    """Check that a server replies to a client that calls the service by another name."""
    reply = {"success": True, "message": name}
    server.ask("serve", service=name, type=SERVICE, reply=reply)

    def answered() -> bool:
        try:
            call = client.ask("call", service=called, type=SERVICE, request={"data": True}, seconds=5.0)["id"]
            return bool(client.ask("result", id=call, seconds=5.0)["reply"] == reply)
        except AssertionError:  # the service is not offered yet
            return False

    until(answered, f"{called} is answered", 40, every=0.1)


class TwoDomains:
    """The daemons of an imported domain bridge, and programs in both domains."""

    def __init__(self, folder: Path) -> None:
        self.domains = (new_domain(), new_domain())
        self.open: list[Process] = []
        source = folder / "domains.yaml"
        source.write_text(DOMAINS.format(first=self.domains[0], second=self.domains[1]))
        listen = f"tcp/127.0.0.1:{free_port()}"
        self.daemons = []
        for file in imported("domain_bridge", source, folder / "made"):
            placed(file, hub={"listen": listen}, state=str(folder / "state"))  # type: ignore[arg-type]
            self.daemons.append(Process([*MIDSPAN, "run", "--config", file], imports=DAEMON_AND_WORKERS))
        self.open += self.daemons
        for daemon in self.daemons:
            until(lambda d=daemon: "ready: " in d.output(), "the daemon is ready", 40)

    def program(self, index: int) -> Peer:
        """Start a real rclpy program in one of the domains."""
        env = ros2_environment(ROS_DOMAIN_ID=str(self.domains[index]))
        peer = Peer(ROS2_PEER, ros2_python(), env, f"program_{index}")
        self.open.append(peer)
        return peer


@pytest.fixture
def two_domains(tmp_path: Path) -> Iterator[TwoDomains]:
    """An imported domain bridge, running."""
    two_domains = TwoDomains(tmp_path)
    yield two_domains
    for process in reversed(two_domains.open):
        process.stop(DAEMON_SECONDS)


def test_an_imported_domain_bridge_bridges_topics_services_and_actions(two_domains: TwoDomains) -> None:
    first, second = two_domains.program(0), two_domains.program(1)
    subscription = second.subscribe("/chitter", STRING)
    unnamed = second.subscribe("/unnamed", STRING)
    kept = second.subscribe("/chatter", STRING)
    stays = first.advertise("/unnamed", STRING)
    out = first.advertise("/chatter", STRING)
    assert cross(first, out, second, subscription, {"data": "renamed"}) == {"data": "renamed"}
    for sender, hearer in ((first, second), (second, first)):
        subscription = hearer.subscribe("/both", STRING)
        out = sender.advertise("/both", STRING)
        assert cross(sender, out, hearer, subscription, {"data": "both directions"}) == {"data": "both directions"}
    second.publish(second.advertise("/latched", STRING, latched=True), {"data": "kept"})
    subscription = first.subscribe("/latched", STRING, latched=True)
    assert first.wait(subscription, 1) == [{"data": "kept"}]
    first.publish(stays, {"data": "stays"})
    assert second.wait(unnamed, 1, 0.3) == []
    assert second.wait(kept, 1, 0.1) == []
    served(first, second, "/lamp", "/first/lamp")
    second.ask("act", action="/go", type=ACTION)
    goal = first.ask("send_goal", action="/go", type=ACTION, goal={"behavior_tree": "x"}, seconds=40.0)["id"]
    assert first.ask("goal", id=goal, until={"status": 4}, seconds=40.0)["accepted"]
    # one copy of each topic, although the daemons discover each other
    topics = second.graph()["topics"]
    assert [name for name in topics if "domain" in name] == []
