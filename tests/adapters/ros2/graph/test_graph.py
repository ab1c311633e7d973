"""The edge's view of a real ROS 2 graph."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

from bridge.adapters.ros2.graph.graph import is_hidden
from bridge.adapters.ros2.graph.origins import new_prefix
from bridge.adapters.ros2.profile import FastDdsProfile
from bridge.adapters.ros2.rcl import host_prefix
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.routing.edge import Kind, MadeBy
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.peer import Peer
from tests.peers.ros2.network import SHORT_LEASE
from tests.support.wait import until


def marked_profile(folder: Path) -> tuple[Path, bytes]:
    """Write a profile that turns any ROS 2 program into a Midspan participant; return its path and prefix."""
    prefix = new_prefix(host_prefix())
    path = folder / "marked.xml"
    path.write_text(FastDdsProfile(prefix, 0, localhost_only=True).xml())
    return path, prefix


def test_publishers_and_subscriptions_have_their_qos_type_and_node(
    edge: RunningEdge, peer: Callable[..., Peer]
) -> None:
    native = peer("camera_driver")
    native.advertise("/g/scan", "sensor_msgs/LaserScan", best_effort=True)
    native.advertise("/g/map", "nav_msgs/OccupancyGrid", latched=True)
    native.subscribe("/g/cmd", "geometry_msgs/Twist")

    (scan,) = edge.until_seen("/g/scan", Kind.PUBLISHER)
    assert scan.type == "sensor_msgs/msg/LaserScan"
    assert scan.type_id == edge.type("sensor_msgs/msg/LaserScan").type_id
    assert scan.node == "/camera_driver"
    assert scan.made_by is MadeBy.NATIVE
    assert scan.qos == Qos(Reliability.BEST_EFFORT, depth=10)
    (map_,) = edge.until_seen("/g/map", Kind.PUBLISHER)
    assert map_.qos == Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=1)
    (cmd,) = edge.until_seen("/g/cmd", Kind.SUBSCRIPTION)
    assert cmd.type == "geometry_msgs/msg/Twist"


def test_own_endpoints_are_not_listed(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    edge.edge.advertise("/g/own", edge.type("std_msgs/msg/String"), Qos())
    edge.subscribe("/g/own", "std_msgs/msg/String")
    native = peer()
    native.subscribe("/g/own", "std_msgs/String")
    edge.until_seen("/g/own", Kind.SUBSCRIPTION)
    assert not [e for e in edge.edge.endpoints() if e.topic == "/g/own" and e.kind is Kind.PUBLISHER]
    until(lambda: native.graph()["publishers"]["/g/own"] == ["midspan"], "the edge's publisher is listed")


def test_closed_endpoint_leaves_the_graph(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    native = peer()
    publisher = native.advertise("/g/gone", "std_msgs/String")
    edge.until_seen("/g/gone", Kind.PUBLISHER)
    before = edge.changes
    native.drop(publisher)
    edge.until_gone("/g/gone", Kind.PUBLISHER)
    until(lambda: edge.changes > before, "the change is reported, after the edge lists it")


def test_killed_program_leaves_the_graph_after_its_lease(edge: RunningEdge, peer: Callable[..., Peer]) -> None:
    native = peer(**SHORT_LEASE)
    native.advertise("/g/killed", "std_msgs/String")
    edge.until_seen("/g/killed", Kind.PUBLISHER)
    native.signal(signal.SIGKILL)
    edge.until_gone("/g/killed", Kind.PUBLISHER)


def test_other_midspan_is_recognized_by_its_mark(edge: RunningEdge, peer: Callable[..., Peer], tmp_path: Path) -> None:
    profile, prefix = marked_profile(tmp_path)
    other = peer("midspan", FASTRTPS_DEFAULT_PROFILES_FILE=str(profile))
    other.advertise("/g/bridged", "std_msgs/String")
    (endpoint,) = edge.until_seen("/g/bridged", Kind.PUBLISHER)
    assert endpoint.made_by is MadeBy.MIDSPAN
    assert edge.edge.is_own_network(Origin("ros2", prefix.hex(), "other"))


def test_network_is_the_marked_prefix(edge: RunningEdge) -> None:
    network = edge.edge.network()
    assert network is not None
    assert len(bytes.fromhex(network)) == 12
    assert edge.edge.is_own_network(Origin("ros2", network, "me"))
    assert not edge.edge.is_own_network(Origin("ros1", network, "me"))
    elsewhere = Origin("ros2", new_prefix(b"\x01\x0f\x00\x00").hex(), "elsewhere")
    until(lambda: not edge.edge.is_own_network(elsewhere), "the undiscovered participant counts as foreign")
    assert not edge.edge.is_own_network(Origin("ros2", "no hex", "elsewhere"))


def test_names_with_a_leading_underscore_are_hidden() -> None:
    assert is_hidden("/_private")
    assert is_hidden("/_private/_action/feedback")
    assert is_hidden("/fibonacci/_action/other")
    assert not is_hidden("/fibonacci/_action/feedback")
    assert not is_hidden("/a_b/c_")
