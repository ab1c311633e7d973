"""``midspan explain`` on a real hub, with canned responses and with a real engine."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.daemons import DaemonIdentity
from bridge.hub.graph.tokens import Origin
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from tests.cli.conftest import Midspan
from tests.peers.daemon.workers import EngineWorker, FakeWorker, config_file, route, status
from tests.peers.hub.network import HubNetwork
from tests.peers.zenoh.releases import (
    HUMBLE,
    JAZZY,
    ReleaseNode,
    ReleasePublisher,
    ReleaseSubscription,
    Topic,
)
from tests.support.wait import until

STRING = "std_msgs/msg/String"
RULES = [{"topic": "/secret", "deny": True}, {"topic": "/old", "rename": "/new"}]


def engine(network: HubNetwork, registry: Registry, closing: list[Any]) -> EngineWorker:
    """An engine with one topic for each kind of decision."""
    worker = EngineWorker(network, registry, rules=RULES)
    closing.append(worker)
    for topic in ("/secret", "/old", "/rosout", "/fine"):
        worker.advertise(topic, STRING)
    worker.advertise("/odd", "odd_msgs/msg/Odd")
    until(
        lambda: len(worker.engine.decisions()) == 5 and len(worker.engine.routes()) == 2,
        "the engine has decided on all topics",
    )
    return worker


def test_each_decision_is_explained_with_its_cure(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    engine(network, registry, closing)
    decisions = {
        "/fine": ("bridged", "ROS 1 -> hub: /fine (std_msgs/msg/String) is bridged: everything is bridged by default"),
        "/old": ("bridged", "/old (std_msgs/msg/String) is bridged as /new: rule 2 allows it"),
        "/new": ("bridged", "/old (std_msgs/msg/String) is bridged as /new: rule 2 allows it"),
        "/secret": ("denied", "is not bridged: rule 1 denies it"),
        "/rosout": ("private", "private to its side: ROS 1's own log"),
        "/odd": ("refused", "/odd (odd_msgs/msg/Odd) cannot be bridged: "),
    }
    for topic, (decision, explanation) in decisions.items():
        done = midspan("explain", topic)
        assert (done.code, explanation in done.out) == (0, True), done
        document = midspan("explain", topic, "--json").json()
        assert [d["decision"] for d in document["decisions"]] == [decision], topic
        assert bool(document["decisions"][0]["cure"]) == (decision != "bridged"), topic
        assert len(document["hub"]) == (1 if decision == "bridged" else 0), topic


def test_the_cure_of_a_denied_topic_is_not_another_rule(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    """A rule that denies a topic overrides all rules that allow it, whatever their order."""
    worker = EngineWorker(network, registry, rules=[{"topic": "/secret"}, {"topic": "/s*", "deny": True}])
    closing.append(worker)
    worker.advertise("/secret", STRING)
    until(lambda: len(worker.engine.decisions()) == 1, "the engine has decided on the topic")
    done = midspan("explain", "/secret")
    assert "is not bridged: rule 2 denies it." in done.out
    assert "    cure: remove or narrow rule 2; a rule that denies overrides all rules that allow" in done.out
    assert "add one that allows it" not in done.out


def test_connections_of_ros1_are_listed(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    engine(network, registry, closing)
    reader = {
        "topic": "/fine", "node": "/talker", "host": "10.0.0.5:41234", "direction": "in", "transport": "TCPROS",
        "bytes": 4100, "messages": 12, "dropped": 0,
    }  # fmt: skip
    writer = {**reader, "node": "/viewer\x1b", "direction": "out", "messages": 1, "dropped": 3}
    invalid = {"topic": "/fine", "node": 5, "messages": "many"}
    other = {**reader, "topic": "/fine/goal"}
    connections = [reader, writer, invalid, other, None]
    closing.append(FakeWorker(network, "ros1", explain=[], status={"side": "ros1"}, connections=connections))
    lines = midspan("explain", "/fine").out.splitlines()
    assert "Connection of ROS 1 from /talker at 10.0.0.5:41234 (TCPROS, /fine): 12 messages, 4.1 kB." in lines
    assert any(line.endswith(" (TCPROS, /fine): 1 message, 4.1 kB, 3 dropped.") for line in lines)
    assert "\x1b" not in "".join(lines)
    document = midspan("explain", "/fine", "--json").json()
    assert document["connections"][0] == {"daemon": "robot1", "worker": "ros1", **reader}
    assert [connection["topic"] for connection in document["connections"]] == ["/fine"] * 3
    assert midspan("explain", "/old", "--json").json()["connections"] == []


def test_explain_omits_workers_without_a_decision(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    """The console, metrics, the recorder and the Foxglove server have no daemon in their status documents."""
    engine(network, registry, closing)
    for name, state in (("web", "running"), ("metrics", "running"), ("record", "waiting"), ("foxglove", "running")):
        closing.append(FakeWorker(network, name, status={"side": name, "state": state, "text": "x"}))
    closing.append(FakeWorker(network, "store", status=status("store", side=None)))
    closing.append(FakeWorker(network, "yarp", explain=[], status={"side": "yarp", "state": "running"}))
    out = midspan("explain", "/fine").out
    assert "None" not in out
    notes = [line for line in out.splitlines() if line.startswith("Note:") and "did not answer" not in line]
    assert notes == [
        "Note: YARP (daemon robot1) has no decision on it, as the name is neither published there nor sent there."
    ]


def test_a_topic_of_another_name_on_the_hub_is_followed_there(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    engine(network, registry, closing)
    bridged = {
        "decision": "bridged",
        "direction": "out",
        "topic": "/new",
        "hub_topic": "/new",
        "type": STRING,
        "why": "x",
    }
    closing.append(FakeWorker(network, "ros2", explain=[bridged], status=status("ros2")))
    decisions = midspan("explain", "/old", "--json").json()["decisions"]
    assert [(d["direction"], d["hub_topic"]) for d in decisions] == [("in", "/new"), ("out", "/new")]


def test_the_error_for_an_unknown_topic_names_similar_ones(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    engine(network, registry, closing)
    done = midspan("explain", "secert")
    assert done.code == 1
    assert "no topic /secert" in done.err
    assert "/secret" in done.err


def test_an_unused_name_is_explained_by_the_rules(
    network: HubNetwork, closing: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rules = [
        {"topic": "**", "rate": 5},  # matches every topic, so it does not name this one
        {"topic": "/camera/**", "to": "yarp", "deny": True},
        {"kind": "topic", "topic": "/old", "from": "ros1", "rename": "/new"},
        {"regex": "/lidar/[0-9]", "type": "sensor_msgs/msg/*"},
    ]
    modules = {"base_control": {"enabled": True, "wheel_command": "/wheels"}}
    sections = {"navigation": {"planner": "move_base"}, "routing": {"rules": rules}, "modules": modules}
    midspan = Midspan(config_file(tmp_path, network, **sections), capsys)
    closing.append(FakeWorker(network, "ros1", status=status("ros1"), explain=[]))
    for name, reason in {
        "/move_base": "the section navigation (planner move_base): an action of ROS 1 with this name is bridged as"
        " /planner/move_base/navigate_to_pose.",
        "/planner/move_base/navigate_to_pose": "an action of ROS 1 /move_base gets this name",
        "/camera/left": "rule 2: a topic, service or action with this name is not bridged to YARP.",
        "/old": "rule 3: a topic of ROS 1 with this name is bridged as /new.",
        "/new": "rule 3: a topic of ROS 1 /old gets this name.",
        "/wheels": "the section modules.base_control: a topic (sensor_msgs/msg/JointState) with this name carries"
        " commands, which move the robot.",
        "/lidar/3": "rule 4: a topic, service or action (sensor_msgs/msg/*) with this name is bridged.",
    }.items():
        done = midspan("explain", name)
        assert (done.code, f"no endpoint has the name {name} now" in done.out, reason in done.out) == (0, True, True), (
            done
        )
        planner = "the planner move_base is not available: no node serves its action /move_base on ROS 1" in done.out
        assert planner == ("move_base" in name), done
    assert midspan("explain", "/nobody").code == 1


def test_an_unused_name_that_one_rule_allows_and_another_denies_is_reported_as_denied(
    network: HubNetwork, closing: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rules = [{"topic": "/old", "rename": "/new"}, {"topic": "/o*", "deny": True}]
    midspan = Midspan(config_file(tmp_path, network, routing={"rules": rules}), capsys)
    closing.append(FakeWorker(network, "ros1", status=status("ros1"), explain=[]))
    out = midspan("explain", "/old").out
    assert "rule 1: a topic, service or action with this name is not bridged, because rule 2 denies it." in out
    assert "rule 2: a topic, service or action with this name is not bridged." in out


def test_the_traffic_of_a_route_is_shown(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    decision = {
        "direction": "out",
        "topic": "/scan",
        "hub_topic": "/scan",
        "type": "sensor_msgs/msg/LaserScan",
        "decision": "bridged",
        "why": "w",
    }
    odd = "/scan: /viewer does not receive it: volatile is offered, transient local is requested"
    document = status("ros2", routes=[route("/scan", "out", error="too short")], warnings=[odd, "/other: x"])
    closing.append(FakeWorker(network, "ros2", status=document, explain=[decision]))
    closing.append(FakeWorker(network, "ros1", status=status("ros1", state="waiting", network=None), explain=[]))
    explanation = midspan("explain", "/scan").out
    assert "hub -> ROS 2: /scan (sensor_msgs/msg/LaserScan) is bridged: w." in explanation
    for text in (
        "100 messages, 9.8 msg/s",
        "last error: too short",
        "ROS 1 (daemon robot1) is unavailable",
        f"Note: ROS 2: {odd}",
    ):
        assert text in explanation
    assert "/other" not in explanation


def test_a_mismatch_on_the_hub_is_shown(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    del closing
    with Hub.open(network.settings("a")) as a, Hub.open(network.settings("b")) as b:
        latched = Qos(durability=Durability.TRANSIENT_LOCAL)
        publisher = a.publisher("/map", "nav_msgs/msg/OccupancyGrid", "RIHS01_" + "1" * 64, Qos())
        subscriber = b.subscription(
            "/map", "nav_msgs/msg/OccupancyGrid", "RIHS01_" + "2" * 64, latched, lambda _s: None
        )
        done = midspan("explain", "/map")
        publisher.close()
        subscriber.close()
    assert done.code == 0
    for text in ("1 publisher, 1 subscription", "definitions of nav_msgs/msg/OccupancyGrid differ", "transient local"):
        assert text in done.out
    assert "no worker answers" in done.out


def test_nodes_of_two_releases_are_separated_unless_a_worker_relays(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    topic = Topic("/chatter", STRING, registry.releases.here_hash(STRING))
    nodes = [ReleaseNode(network.endpoint, network.domain, r.name, r) for r in (HUMBLE, JAZZY)]
    closing += nodes
    ends = ReleasePublisher(nodes[0], topic), ReleaseSubscription(nodes[1], topic)
    assert ends
    separated = "/jazzy do not receive the messages of /humble on the hub"
    until(lambda: separated in midspan("explain", "/chatter").out, "the nodes are named")
    row = {"topic": "/chatter", "type": STRING, "others": [topic.type_hash], "senders": ["/humble"], "messages": 3}
    worker = {"side": "ros2", "relay": {"zid": "f", "names": [{**row, "receivers": ["/jazzy"]}]}}
    closing.append(FakeWorker(network, "ros2", explain=[], status=worker))
    until(lambda: separated not in midspan("explain", "/chatter").out, "the relay is taken into account")
    text = "Note: /chatter: ros2 (daemon robot1) relays messages from /humble to /jazzy, which have other versions of"
    assert f"{text} {STRING}; 3 so far." in midspan("explain", "/chatter").out


def test_all_workers_are_queried_in_parallel(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    """Each query waits for the slowest worker, so a user would wait too long for sequential queries."""
    name, queried = "/navigation2D_nws_yarp/rpc", threading.Event()
    decision = {"decision": "denied", "direction": "in", "topic": name, "hub_topic": name, "type": STRING, "why": "w"}
    module = status("gateway", side=None, module=True, ports=[{"port": name, "peers": []}])

    def status_of_module(_params: dict[str, Any]) -> dict[str, Any]:
        queried.set()
        return module

    closing.append(FakeWorker(network, "yarp", explain=lambda _params: [decision] if queried.wait(10) else []))
    closing.append(FakeWorker(network, "gateway", status=status_of_module))
    queried.clear()
    done = midspan("explain", name)
    assert f"YARP port {name} answers calls: no connection." in done.out
    assert f"{name} ({STRING}) is not bridged: w." in done.out
    assert done.code == 0


def test_a_worker_that_hangs_is_named(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    resume = threading.Event()
    guess = {"port": "/nav/rpc", "carrier": "tcp", "generation": "3.12", "generation_why": "a guess"}
    port = {"port": "/navigation2D_nws_yarp/rpc", "peers": [{**guess, "generation_cure": "set its release"}]}
    module = status("gateway", side=None, module=True, ports=[port])
    closing.append(FakeWorker(network, "gateway", status=module))
    closing.append(hanging := FakeWorker(network, "yarp", status=lambda _params: resume.wait(30)))
    hanging.hub.set_origin(Origin("yarp", "net", "robot1"))
    try:
        done = midspan("explain", "/navigation2D_nws_yarp/rpc")
        assert done.code == 0
        assert "    /nav/rpc over tcp: its calls are answered as YARP 3.12 does (a guess)" in done.out
        assert "        cure: set its release" in done.out
        assert "On the hub" not in done.out, "the name is that of a port"
        assert "YARP (daemon robot1) did not answer within 2 s, so its decisions are missing" in done.out
        done = midspan("explain", "/nowhere")
        assert done.code == 1
        assert "YARP (daemon robot1) did not answer within 2 s" in done.err
    finally:
        resume.set()


def test_daemons_with_the_same_name_are_distinguished(
    midspan: Midspan, network: HubNetwork, closing: list[Any]
) -> None:
    for folder, verdict, messages in (("/a", "bridged", 7), ("/b", "denied", 9)):
        identity = DaemonIdentity(folder, "pc", folder)
        decision = {"direction": "in", "topic": "/scan", "hub_topic": "/scan", "type": STRING, "decision": verdict}
        routes = [route("/scan", type=STRING, messages=messages)]
        closing.append(
            FakeWorker(
                network,
                "ros1",
                identity=identity,
                explain=[{**decision, "why": "w"}],
                status=status("ros1", routes=routes),
            )
        )
    done = midspan("explain", "/scan")
    lines = done.out.splitlines()
    assert f"ROS 1 -> hub (daemon robot1 (state folder /a on pc)): /scan ({STRING}) is bridged: w." in lines
    assert f"ROS 1 -> hub (daemon robot1 (state folder /b on pc)): /scan ({STRING}) is not bridged: w." in lines
    assert "7 messages" in done.out
    assert "9 messages" not in done.out, "the route belongs to the other daemon"
    assert "Note: 2 daemons on this hub are named 'robot1': state folder /a on pc; state folder /b on pc." in lines
    assert "    cure: set another 'name' in the configuration of one of them" in lines
