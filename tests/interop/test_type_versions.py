"""Real programs with two versions of a package at once: ROS 1 and ROS 2 Jazzy have the older one, Kilted the newer one.

Fields were renamed and retyped between the versions; rules of the configuration map them (`tests.messages.fleet`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.wire.qos import Durability, Qos
from bridge.interfaces.builder import build
from bridge.interfaces.cache import environment
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from tests.messages.fleet import NEW, OLD, RULES, WHEEL, write_versions
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.actions import HubActions
from tests.peers.peer import Peer
from tests.peers.ros2 import kilted
from tests.peers.ros2.network import ROS2_PEER, ros2_environment, ros2_python
from tests.peers.zenoh.releases import (
    JAZZY,
    KILTED,
    ReleaseNode,
    ReleasePublisher,
    ReleaseSubscription,
    Topic,
)
from tests.support.wait import until

TOPIC_TYPE, SERVICE, ACTION = "fleet_msgs/Wheel", "fleet_msgs/Calibrate", "fleet_msgs/Turn"
MESSAGES = 5


class FleetPrograms:
    """A daemon, programs on ROS 1, Jazzy and Kilted, and hub nodes with each version."""

    def __init__(self, deployment: Deployment, folder: Path) -> None:
        write_versions(folder)
        rules = folder / "rules.yaml"
        rules.write_text(json.dumps(RULES))
        folders = [folder / "old", folder / "new"]
        self.folder = folder
        self.deployment, self.registry = deployment, Registry(folders, [rules])
        deployment.start(types={"folders": [str(path) for path in folders], "mapping_rules": [str(rules)]})
        env = {**ros2_environment(), **environment([build({"fleet_msgs": OLD})])}
        self.jazzy: Peer = deployment.keep(Peer(ROS2_PEER, ros2_python(), env, "jazzy"))
        env = kilted.program_environment({"fleet_msgs": NEW})
        self.kilted: Peer = deployment.keep(Peer(ROS2_PEER, ros2_python(), env, "kilted"))
        self.ros1 = deployment.ros1("ros1")
        self.ros1.ask("define", type=TOPIC_TYPE, definition=self.registry.ros1(TOPIC_TYPE).definition)
        service = self.registry.service_hub_to_ros1("fleet_msgs/srv/Calibrate").side.definition
        self.ros1.ask("define", type=SERVICE, definition=service)
        self.hub = deployment.keep(HubActions(deployment.settings("module"), self.registry))
        self.hashes = dict(zip(("old", "new"), self.registry.releases.hashes(WHEEL), strict=True))

    def hub_node(self, version: str) -> ReleaseNode:
        """Return a rmw_zenoh node with this version of the package."""
        release, domain = {"old": JAZZY, "new": KILTED}[version], self.deployment.settings("peer").domain
        node = ReleaseNode(self.deployment.endpoint, domain, f"hub_{version}", release)
        self.deployment.keep(_Closing(node))
        return node

    def topic(self, name: str, version: str) -> Topic:
        """Return a hub topic with this version of the type."""
        return Topic(name, WHEEL, self.hashes[version], Qos(depth=100))

    def encode(self, version: str, message: dict[str, Any]) -> bytes:
        return MessageWriter(self.registry.schema(WHEEL, self.hashes[version])).message(message)

    def loads(self, version: str, subscription: ReleaseSubscription) -> list[tuple[int, float]]:
        """Return the number and speed of each message with a name that a hub subscription has received."""
        schema = self.registry.schema(WHEEL, self.hashes[version])
        read = [MessageReader(schema, sample.payload).message() for sample in subscription.samples]
        return [(m["load"], m["rpm" if version == "old" else "speed"]) for m in read if m["name"]]

    def explained(self, name: str) -> str:
        return "\n".join(decision["why"] for decision in self.deployment.explain(name))


class _Closing:
    def __init__(self, node: ReleaseNode) -> None:
        self.stop = node.close


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FleetPrograms]:
    folder = tmp_path_factory.mktemp("versions")
    with Deployment(folder) as deployment:
        yield FleetPrograms(deployment, folder)


def numbered(messages: list[dict[str, Any]]) -> list[tuple[int, float]]:
    """Return the number and speed of each message with a name; those without a name only show that endpoints match."""
    return [(m["load"], m["rpm"] if "rpm" in m else m["speed"]) for m in messages if m["name"]]


def test_messages_of_publishers_of_two_versions_are_converted(programs: FleetPrograms) -> None:
    name, old, new = "/wheels", programs.hub_node("old"), programs.hub_node("new")
    ros1 = programs.ros1.subscribe(name, TOPIC_TYPE)
    hub = {
        "old": ReleaseSubscription(old, programs.topic(name, "old")),
        "new": ReleaseSubscription(new, programs.topic(name, "new")),
    }
    peers = {"rpm": programs.jazzy, "speed": programs.kilted}
    code: dict[str, Any] = {"rpm": "7", "speed": 7}
    ends = {field: peer.advertise(name, TOPIC_TYPE) for field, peer in peers.items()}

    def matched(field: str, load: int) -> bool:
        peers[field].publish(ends[field], {"load": load, "code": code[field]})
        everybody = programs.ros1.wait(ros1, 1, 0.1)
        return any(m["load"] == load for m in everybody) and all(
            any(load == m.get("load") for m in decoded(programs, version, end)) for version, end in hub.items()
        )

    until(lambda: matched("rpm", 101), "all subscriptions receive from Jazzy's publisher", 60)
    until(lambda: matched("speed", 102), "all subscriptions receive from Kilted's publisher", 60)
    for number in range(MESSAGES):
        for at, field in enumerate(peers):
            peers[field].publish(
                ends[field], {"name": "n", "load": 2 * number + at, "code": code[field], field: number + 0.5}
            )
    expected = [(n, n // 2 + 0.5) for n in range(2 * MESSAGES)]
    until(
        lambda: len(numbered(programs.ros1.wait(ros1, 1, 0.1))) >= len(expected), "ROS 1 has received all messages", 40
    )
    for version, end in hub.items():
        until(
            lambda v=version, e=end: len(programs.loads(v, e)) >= len(expected),
            f"the hub's {version} subscription has received all messages",
            40,
        )
        assert sorted(programs.loads(version, end)) == expected
    assert sorted(numbered(programs.ros1.wait(ros1, 1, 0.1))) == expected
    lost = f"{WHEEL}.kind is left out; {WHEEL}.speed is rounded to float32"
    about = lambda: [line for line in programs.explained(name).splitlines() if "/kilted" in line]  # noqa: E731
    until(lambda: any(lost in line for line in about()), "explain names what Kilted's messages lose", 20, every=0.1)


def decoded(programs: FleetPrograms, version: str, end: ReleaseSubscription) -> list[dict[str, Any]]:
    schema = programs.registry.schema(WHEEL, programs.hashes[version])
    return [MessageReader(schema, sample.payload).message() for sample in end.samples]


def test_subscriptions_of_two_versions_receive_their_own_version(programs: FleetPrograms) -> None:
    """Each subscription receives the messages in its version, on DDS and on the hub, and no others."""
    name, old, new = "/commands", programs.hub_node("old"), programs.hub_node("new")
    hub = {
        "old": ReleaseSubscription(old, programs.topic(name, "old")),
        "new": ReleaseSubscription(new, programs.topic(name, "new")),
    }
    ros1 = programs.ros1.advertise(name, TOPIC_TYPE)
    dds = {peer: peer.subscribe(name, TOPIC_TYPE) for peer in (programs.jazzy, programs.kilted)}

    def publish(**message: Any) -> None:
        programs.ros1.publish(ros1, {"code": "7", **message})

    def matched() -> bool:
        publish(load=101)
        return all(peer.wait(end, 1, 0.1) for peer, end in dds.items()) and all(end.samples for end in hub.values())

    until(matched, "all endpoints are matched", 60)
    for number in range(MESSAGES):
        publish(name="n", load=number, rpm=number + 0.5)
    expected = [(number, number + 0.5) for number in range(MESSAGES)]
    for peer, end in dds.items():
        until(
            lambda p=peer, e=end: len(numbered(p.wait(e, 1, 0.1))) >= MESSAGES, f"{peer} has received all messages", 40
        )
        messages = peer.wait(end, 1, 0.1)
        assert numbered(messages) == expected
        assert {m["load"] for m in messages if not m["name"]} == {101}
    for version, end in hub.items():
        until(
            lambda v=version, e=end: len(programs.loads(v, e)) >= MESSAGES, f"the hub's {version} has received all", 40
        )
        assert programs.loads(version, end) == expected
    assert "decodes it wrongly" not in programs.explained(name)
    before = len(programs.kilted.wait(dds[programs.kilted], 0, 0.0))
    programs.jazzy.drop(dds[programs.jazzy])
    publish(name="n", load=9, rpm=2.5)
    until(lambda: len(programs.kilted.wait(dds[programs.kilted], 1, 0.1)) > before, "Kilted still receives", 60)
    assert numbered(programs.kilted.wait(dds[programs.kilted], 1, 0.1))[-1] == (9, 2.5)


def test_late_subscriptions_of_two_versions_receive_latched_messages(programs: FleetPrograms) -> None:
    """They also receive a message in a version that no subscription had when it was sent."""
    name, end = "/latched_wheels", programs.ros1.advertise("/latched_wheels", TOPIC_TYPE, latched=True)
    programs.ros1.publish(end, {"name": "n", "load": 1, "code": "7", "rpm": 1.5})
    programs.deployment.until_route("ros2", name, "out", state="active")
    for _ in range(2):
        ends = {peer: peer.subscribe(name, TOPIC_TYPE, latched=True) for peer in (programs.kilted, programs.jazzy)}
        for peer, subscription in ends.items():
            assert numbered(peer.wait(subscription, 1, 40)) == [(1, 1.5)], peer
        for peer, subscription in ends.items():
            peer.drop(subscription)


def test_late_joiners_receive_latched_messages_of_two_versions_in_their_own(programs: FleetPrograms) -> None:
    """Late subscriptions on ROS 1 and the hub receive the last message of each publisher, in their own version."""
    name, values = (
        "/latched_sources",
        {programs.jazzy: {"rpm": 1.5, "code": "7"}, programs.kilted: {"speed": 2.5, "code": 7}},
    )
    for load, (peer, fields) in enumerate(values.items(), 1):
        end = peer.advertise(name, TOPIC_TYPE, latched=True, depth=1)
        peer.publish(end, {"name": "n", "load": load, **fields})
    programs.deployment.until_route("ros1", name, "out", state="active")
    late, expected = programs.ros1.subscribe(name, TOPIC_TYPE), [(1, 1.5), (2, 2.5)]
    until(
        lambda: sorted(numbered(programs.ros1.wait(late, 2, 0.1))) == expected, "ROS 1 has received both messages", 40
    )
    for version in ("old", "new"):
        topic = replace(programs.topic(name, version), qos=Qos(durability=Durability.TRANSIENT_LOCAL, depth=10))
        hub = ReleaseSubscription(programs.hub_node(version), topic)
        until(
            lambda v=version, e=hub: sorted(programs.loads(v, e)) == expected,
            f"the hub's {version} subscription has both messages",
            40,
        )


def test_a_service_of_the_newer_version_is_called_with_converted_fields(programs: FleetPrograms) -> None:
    """A client on ROS 1 calls Kilted's server; explain names the field that is rounded."""
    served = programs.kilted.ask("serve", service="/of_kilted", type=SERVICE, reply={"offset": 0.5})["id"]
    programs.deployment.until_route("ros1", "/of_kilted", "out", state="active")
    programs.ros1.ask("await_service", service="/of_kilted", seconds=30)
    call = programs.ros1.ask("call", service="/of_kilted", type=SERVICE, request={"target": 1.5})["id"]
    assert programs.ros1.ask("result", id=call, seconds=40)["reply"] == {"offset": 0.5}
    assert programs.kilted.ask("requests", id=served, count=1, seconds=20)["requests"] == [{"goal": 1.5}]
    rounded = "fleet_msgs/srv/Calibrate_Response.offset is rounded to float32"
    until(lambda: rounded in programs.explained("/of_kilted"), "explain names the rounded field", 20, every=0.1)


def test_clients_of_two_versions_call_one_server(programs: FleetPrograms) -> None:
    served = programs.ros1.ask("serve", service="/of_ros1", type=SERVICE, reply={"offset": 0.25})["id"]
    for peer, request in ((programs.kilted, {"goal": 1.5}), (programs.jazzy, {"target": 2.5})):
        call = peer.ask("call", service="/of_ros1", type=SERVICE, request=request)["id"]
        assert peer.ask("result", id=call, seconds=60)["reply"] == {"offset": 0.25}
    assert programs.ros1.ask("requests", id=served, count=2)["requests"] == [{"target": 1.5}, {"target": 2.5}]


@pytest.mark.parametrize("native", ["server", "client"])
def test_goals_and_feedback_of_an_action_are_converted_between_versions(programs: FleetPrograms, native: str) -> None:
    server, client = (programs.kilted, programs.hub) if native == "server" else (programs.hub, programs.kilted)
    sent, received = ("angle", "radians") if native == "server" else ("radians", "angle")
    name = f"/turn_{native}"
    served = server.ask("act", action=name, type=ACTION, feedback=[{"at": 0.25}], held=True)["id"]
    goal = client.ask("send_goal", action=name, type=ACTION, goal={sent: 1.5}, seconds=60)["id"]
    assert client.ask("goal", id=goal, until={"accepted": True}, seconds=40)["accepted"]
    server.ask("release", id=served)
    state = client.ask("goal", id=goal, until={"status": 4}, seconds=40)
    assert state["status"] == 4, state
    assert server.ask("goals", id=served, count=1, seconds=20)["goals"] == [{received: 1.5}]


def test_of_two_servers_the_one_with_this_machines_version_is_called_first(programs: FleetPrograms) -> None:
    """The server with this machine's version is called until it leaves, and then the other one, in its own version."""
    newer = programs.kilted.ask("serve", service="/twice", type=SERVICE, reply={"offset": 0.5})["id"]
    programs.deployment.until_route("ros1", "/twice", "out", state="active")
    older = programs.jazzy.ask("serve", service="/twice", type=SERVICE, reply={"offset": 0.25})["id"]

    def decided() -> dict[str, str] | None:
        decisions = [d for d in programs.deployment.explain("/twice") if d["direction"] == "in"]
        reasons = {d["decision"]: d["why"] for d in decisions}
        named = all("calls go to /jazzy" in why for why in reasons.values())  # the node's name arrives after its server
        return reasons if set(reasons) == {"bridged", "refused"} and named else None

    reasons = until(decided, "one of the servers is bridged", 40, every=0.1)
    for why in reasons.values():  # type: ignore[union-attr]
        assert "/twice is served with different versions of fleet_msgs/srv/Calibrate" in why

    def reply(target: float) -> float | None:
        call = programs.ros1.ask("call", service="/twice", type=SERVICE, request={"target": target})["id"]
        received = programs.ros1.ask("result", id=call, seconds=20).get("reply")
        return received["offset"] if received else None

    until(lambda: reply(1.0) == 0.25, "the older server is called", 20, every=0.1)
    assert programs.kilted.ask("requests", id=newer)["requests"] == []
    programs.jazzy.drop(older)
    until(lambda: reply(2.0) == 0.5, "the newer server is called", 20, every=0.1)
    assert programs.kilted.ask("requests", id=newer)["requests"][-1] == {"goal": 2.0}


def test_messages_of_hub_publishers_of_two_versions_are_received_once(programs: FleetPrograms) -> None:
    """ROS 1 and Jazzy receive the messages of both publishers once, in the older version."""
    name, nodes = "/hub_wheels", {version: programs.hub_node(version) for version in ("old", "new")}
    publishers = {version: ReleasePublisher(node, programs.topic(name, version)) for version, node in nodes.items()}
    peers = {"ROS 1": programs.ros1, "Jazzy": programs.jazzy}
    ends = {peer: peers[peer].subscribe(name, TOPIC_TYPE) for peer in peers}
    field = {"old": "rpm", "new": "speed"}

    def put(version: str, **message: Any) -> None:
        publishers[version].put(programs.encode(version, {"code": "7" if version == "old" else 7, **message}))

    def matched(version: str, load: int) -> bool:
        put(version, load=load)
        return all(any(m["load"] == load for m in peers[peer].wait(end, 1, 0.1)) for peer, end in ends.items())

    until(lambda: matched("old", 101), "the older publisher is received", 60)
    until(lambda: matched("new", 102), "the newer publisher is received", 60)
    for number in range(MESSAGES):
        for at, version in enumerate(publishers):
            put(version, name="n", load=2 * number + at, **{field[version]: number + 0.5})
    expected = [(n, n // 2 + 0.5) for n in range(2 * MESSAGES)]
    for peer, end in ends.items():
        until(lambda p=peer, e=end: len(numbered(peers[p].wait(e, 1, 0.1))) >= len(expected), f"{peer} has all", 40)
        assert sorted(numbered(peers[peer].wait(end, 1, 0.1))) == expected
