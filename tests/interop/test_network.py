"""A robot and an operator's computer, each a network namespace with a real daemon, joined by TLS over a real link.

They run ``configs/robot.yaml`` and ``configs/operator.yaml``, with certificates from ``midspan keys``.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.peer import Peer, on_machine
from tests.peers.ros1.network import ROS1_PEER, ROS1_PYTHON, ros1_environment
from tests.peers.ros2.network import ROS2_PEER, ros2_domain, ros2_environment, ros2_python
from tests.support.missing import ROS1, ROS2, needs
from tests.support.netns import Cable, Machine, need_namespaces
from tests.support.process import DAEMON_SECONDS, Process
from tests.support.wait import until

pytestmark = [needs(ROS1), needs(ROS2)]

ROOT = Path(__file__).parents[2]
STRING, TWIST = "std_msgs/String", "geometry_msgs/Twist"
GUEST = ROOT / "tests" / "peers" / "hub" / "guest.py"
STALE = 0.6
"""Age in seconds from which a command is stale: twice the configured timeout, to allow for a busy machine."""


class Pair:
    """The two machines with their daemons and programs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.robot, self.operator = Machine("robot"), Machine("operator")
        self.cable = Cable(self.robot, self.operator)
        local = {socket.gethostname(): "127.0.0.1"}
        for machine in (self.robot, self.operator):
            machine.hosts(robot1=self.cable.addresses[0], **local)
        self.files = {"robot": folder / "robot.yaml", "operator": folder / "operator.yaml"}
        self.ros1_env = {
            **ros1_environment("http://127.0.0.1:11311"),
            "ROS_HOME": str(folder / "ros"),
            "ROS_LOG_DIR": str(folder / "ros" / "log"),
        }
        self.processes: list[Process] = []
        self.daemons: dict[str, Process] = {}

    def start(self) -> None:
        for name in ("robot1", "operator1", "visitor"):
            self.operator.run(*MIDSPAN, "keys", "make", name, "--folder", self.folder / "keys")
        self.configure("robot", ros1={"poll": 0.1, "master": "http://127.0.0.1:11311"})
        self.configure("operator", ros2={"domain": ros2_domain()})
        self.processes.append(self.robot.start(ROS1_PYTHON, "/usr/bin/roscore", env=self.ros1_env))
        for name, machine in (("robot", self.robot), ("operator", self.operator)):
            daemon = machine.start(*MIDSPAN, "run", "--config", self.files[name], env=dict(os.environ))
            self.daemons[name] = daemon
            self.processes.append(daemon)
        self.ros1 = self.peer(self.robot, ROS1_PYTHON, ROS1_PEER, self.ros1_env, "robot_program")
        self.ros2 = self.peer(self.operator, ros2_python(), ROS2_PEER, ros2_environment(), "operator_program")

    def configure(self, name: str, **over: dict[str, Any]) -> None:
        """Write a machine's configuration: the shipped one with the test's folders and networks."""
        config = yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text())
        config["state"] = str(self.folder / name)
        config["hub"]["open"]["keys"] = str(self.folder / "keys")
        for section, values in over.items():
            config[section] = {**config.get(section, {}), **values}
        self.files[name].write_text(yaml.safe_dump(config))

    def trust(self, *names: str) -> None:
        """Reload the robot's daemon with these machines as the only trusted ones."""
        config = yaml.safe_load(self.files["robot"].read_text())
        config["hub"]["open"]["trusted"] = list(names)
        self.files["robot"].write_text(yaml.safe_dump(config))
        os.kill(self.daemons["robot"].pid, 1)
        expected = [("operator1", "operator1" in names)]
        until(lambda: self.machines() == expected, f"the robot trusts {names}", 40, every=0.3)

    def machines(self) -> list[tuple[str, bool]]:
        """Return the machines that are connected to the robot, each with whether it is trusted."""
        status = json.loads(self.robot.run(*MIDSPAN, "status", "--json", "--config", self.files["robot"]))
        machines = [
            (machine["name"], machine["trusted"])
            for worker in status
            if worker.get("daemon") == "robot1"
            for machine in worker.get("machines", [])
        ]
        return sorted(machines)

    def peer(self, machine: Machine, python: Path, program: Path, env: dict[str, str], name: str) -> Peer:
        program_peer = on_machine(machine, env, python, program, name)
        self.processes.append(program_peer)
        return program_peer

    def close(self) -> None:
        for process in reversed(self.processes):
            process.stop(DAEMON_SECONDS)
        for machine in (self.robot, self.operator):
            machine.close()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    need_namespaces()
    with contextlib.closing(Pair(tmp_path_factory.mktemp("network"))) as pair:
        pair.start()
        yield pair


@pytest.fixture
def pair(running: Pair) -> Iterator[Pair]:
    with running.cable:
        yield running


class BridgedTopic:
    """A topic from a program on one machine to a program on the other."""

    def __init__(self, sender: Peer, receiver: Peer, topic: str, type_: str = STRING, **qos: Any) -> None:
        self.sender, self.receiver = sender, receiver
        self.subscriber = receiver.subscribe(topic, type_, **qos)
        self.out = sender.advertise(topic, type_, **qos)

    def send(self, value: float) -> None:
        self.sender.publish(self.out, {"linear": {"x": value}})

    def received(self) -> list[float]:
        return [message["linear"]["x"] for message in self.receiver.wait(self.subscriber, 0, 0)]

    def until_crosses(self, seconds: float) -> None:
        """Send commands until one arrives, however late."""
        before = len(self.received())

        def once() -> bool:
            self.send(time.monotonic())
            return len(self.receiver.wait(self.subscriber, before + 1, 0.2)) > before

        until(once, "commands cross", seconds)


def publish_until_received(
    sender: Peer, publisher: int, receiver: Peer, subscriber: int, text: str, seconds: float = 60
) -> None:
    """Publish a text until the receiver gets it."""

    def once() -> bool:
        sender.publish(publisher, {"data": text})
        return {"data": text} in receiver.wait(subscriber, 10_000, 0.2)

    until(once, f"{text} crosses", seconds)


@pytest.mark.thorough
def test_topics_cross_in_both_directions_including_latched_ones(pair: Pair) -> None:
    for sender, receiver, name in ((pair.ros1, pair.ros2, "to_operator"), (pair.ros2, pair.ros1, "to_robot")):
        out, subscriber = sender.advertise(f"/{name}", STRING), receiver.subscribe(f"/{name}", STRING)
        kept = sender.advertise(f"/{name}_kept", STRING, latched=True)
        sender.publish(kept, {"data": "kept"})
        publish_until_received(sender, out, receiver, subscriber, name)
        late = receiver.subscribe(f"/{name}_kept", STRING, latched=True)
        assert receiver.wait(late, 1, 30) == [{"data": "kept"}]


def stream(topic: BridgedTopic, seconds: float, stop: Callable[[], bool] = lambda: False) -> None:
    """Send the time as a command, 20 times per second."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and not stop():
        topic.send(time.monotonic())
        time.sleep(0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("seconds", [1.5, 4.0], ids=["shorter than the lease", "longer"])
def test_a_restored_link_carries_new_messages_and_no_stale_commands(pair: Pair, seconds: float) -> None:
    ros1, ros2 = pair.ros1, pair.ros2
    name = f"/cut_{int(seconds)}"
    drive = BridgedTopic(ros2, ros1, "/cmd_vel", TWIST)
    drive.until_crosses(60)
    numbers, counted = ros1.advertise(f"{name}/numbers", STRING), ros2.subscribe(f"{name}/numbers", STRING)
    publish_until_received(ros1, numbers, ros2, counted, "0")
    state = {peer: peer.advertise(f"{name}/state_{i}", STRING, latched=True) for i, peer in enumerate((ros1, ros2))}
    seen = {ros1: ros1.subscribe(f"{name}/state_1", STRING, latched=True)}
    seen[ros2] = ros2.subscribe(f"{name}/state_0", STRING, latched=True)
    for peer, publisher in state.items():
        peer.publish(publisher, {"data": "before"})
    for peer, subscriber in seen.items():
        assert {"data": "before"} in peer.wait(subscriber, 1, 30)
    ros1.ask("count", id=numbers, first=1, count=100_000, rate=50)
    stream(drive, 0.5)

    pair.cable.cut()
    stream(drive, seconds)
    for peer, publisher in state.items():
        peer.publish(publisher, {"data": "changed"})
    before = len(drive.received())
    cut_off = ros2.ask("tally", id=counted)["received"]
    restored = time.monotonic()
    pair.cable.mend()
    stream(drive, 40, lambda: len(drive.received()) > before)
    commands_back = time.monotonic() - restored
    until(lambda: ros2.ask("tally", id=counted)["received"] > cut_off + 20, "numbers arrive again", 40)
    numbers_back = ros2.ask("tally", id=counted)["last"] - restored
    stream(drive, 1.0)
    print(f"link cut for {seconds:g} s: commands resumed after {commands_back:.1f} s, data after {numbers_back:.1f} s")
    later = drive.received()[before:]
    assert later
    assert min(later) > restored - STALE, (
        f"a command {restored - min(later):.1f} s old arrived after the link was restored"
    )
    for peer, subscriber in seen.items():
        until(lambda p=peer, s=subscriber: {"data": "changed"} in p.wait(s, 10_000, 0.2), "the last state arrives", 40)
        assert peer.wait(subscriber, 10_000, 0.1)[-1] == {"data": "changed"}
    ros1.ask("counted", id=numbers, now=True)
    for peer, publisher in state.items():
        peer.drop(publisher)


@pytest.mark.thorough
def test_commands_from_an_untrusted_machine_are_refused(pair: Pair) -> None:
    ros1, ros2 = pair.ros1, pair.ros2
    drive = BridgedTopic(ros2, ros1, "/cmd_vel", TWIST)
    drive.until_crosses(60)
    pair.trust("another_machine")
    try:
        out, subscriber = ros2.advertise("/other_data", STRING), ros1.subscribe("/other_data", STRING)
        publish_until_received(ros2, out, ros1, subscriber, "first")
        before = len(drive.received())
        stream(drive, 1.0)
        publish_until_received(ros2, out, ros1, subscriber, "second")
        assert len(drive.received()) == before
        # a busy worker may not respond to a command in time
        status = lambda: pair.robot.run(*MIDSPAN, "status", "--config", pair.files["robot"])  # noqa: E731
        until(lambda: "operator1 may not command" in status(), "midspan status reports it", 40)
        refused = r"robot1 refuses the commands of operator1 on /cmd_vel .*; [1-9]\d* messages so far"
        for name, machine in (("robot", pair.robot), ("operator", pair.operator)):

            def explained(name: str = name, machine: Machine = machine) -> bool:
                text = machine.run(*MIDSPAN, "explain", "/cmd_vel", "--config", pair.files[name])
                return re.search(refused, text) is not None

            until(explained, f"midspan explain reports it on the {name}", 40)
    finally:
        pair.trust("operator1")
    drive.until_crosses(40)
    assert "refuses" not in pair.robot.run(*MIDSPAN, "explain", "/cmd_vel", "--config", pair.files["robot"])


@pytest.mark.thorough
def test_a_guest_reaches_only_the_external_listener(pair: Pair) -> None:
    """A peer with a certificate, whose address zenoh's gossip could spread, is linked only through the TLS listener."""
    commands = pair.ros1.subscribe("/cmd_vel", TWIST)
    args = [pair.folder / "keys", "tls/robot1:7448", f"tcp/{pair.cable.addresses[1]}:0"]
    report = json.loads(pair.operator.run(sys.executable, GUEST, *args, env={**os.environ, "PYTHONPATH": str(ROOT)}))
    assert [link.partition("/")[0] for link in report["links"]] == ["tls"]
    assert report["topics"], "the guest discovers the robot's graph"
    assert 66.0 not in [message["linear"]["x"] for message in pair.ros1.wait(commands, 10_000, 0.5)]
