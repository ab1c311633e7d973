"""Human-readable output of the workers' status documents: routes and YARP ports."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from bridge.cli.main import main
from bridge.display.documents import port_lines, routes_table, transport_text
from bridge.status import PortStatus, RouteStatus, read_status
from tests.adapters.yarp.conftest import Place
from tests.cli.conftest import Midspan
from tests.support.wait import until
from yarp_compat.wire.profile import Profile

ROW: dict[str, Any] = {
    "direction": "in",
    "state": "active",
    "latency_ms": {"p50": 0.5, "p99": 2.0},
    "messages": 7,
    "drops": {"queue": 2, "bad": 0},
}


def row_text(**row: Any) -> str:
    """Return the table's last line for one route of the ROS 1 worker."""
    console = Console(width=200, file=io.StringIO(), record=True)
    document = {"side": "ros1", "routes": [{**ROW, **row}]}
    console.print(routes_table([read_status(document, "d", "ros1")]))
    return " ".join(console.export_text().strip().splitlines()[-1].split())


def test_a_service_shows_the_results_of_its_calls() -> None:
    calls = {"calls": 7, "replies": 3, "errors": 2, "abandoned": 1, "pending": 1}
    names = {"kind": "service", "action": "", "topic": "/do", "hub_topic": "/do", "priority": "", "type": "a/srv/B"}
    text = "- - 0.50 2.00 7 pending 1, errors 2, abandoned 1, queue 2 - active"
    assert row_text(**names, **calls) == f"ROS 1 -> hub /do a/srv/B service {text}"
    part = {"topic": "/go/_action/send_goal", "hub_topic": "/go/_action/send_goal", "action": "/go"}
    assert " action " in row_text(**names | part, **calls)


def test_a_topic_shows_its_priority() -> None:
    names = {"kind": "topic", "topic": "/scan", "hub_topic": "/scan", "priority": "stream", "type": "a/msg/B"}
    assert row_text(**names, way="lane") == "ROS 1 -> hub /scan a/msg/B stream lane - 0.50 2.00 7 queue 2 - active"


@pytest.mark.parametrize(
    ("way", "why", "text"),
    [
        ("lane", "", "by the lane"),
        ("zenoh", "it is latched", "over zenoh, as it is latched"),
        (
            "both",
            "a subscription is not on the lane",
            "by the lane and over zenoh, as a subscription is not on the lane",
        ),
        ("", "", ""),
    ],
)
def test_the_transport_on_the_hub_is_described(way: str, why: str, text: str) -> None:
    assert transport_text(RouteStatus(way=way, why=why)) == text


TWIST, SCAN, STRING = "geometry_msgs/Twist", "sensor_msgs/LaserScan", "std_msgs/String"
RULES = [
    {"topic": "/cmd_vel", "fields": ["linear.x", "angular.z"]},
    {"topic": "/scan", "as": "natural", "profile": "yarp4"},
    {"topic": "/words", "port": "/old/writer", "direction": "in", "type": "std_msgs/msg/String", "profile": "yarp3"},
]
PEERS = {"release": "3.12", "peers": [{"port": "/old/*", "release": "3.9"}]}


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as place:
        yield place


@pytest.fixture
def midspan(place: Place, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Midspan:
    file = tmp_path / "midspan.yaml"
    file.write_text(json.dumps({"name": "here", "hub": {"listen": place.hubs.endpoint}}))
    return Midspan(file, capsys)


def port(midspan: Midspan, name: str, peers: int) -> Any:
    """Return what explain shows about a port once a number of peers is connected."""

    def connected() -> Any:
        output = midspan("explain", name, "--json")
        ports = [p for p in output.json()["ports"] if p["port"] == name] if output.code == 0 else []
        return next((p for p in ports if len(p["peers"]) == peers), None)

    return until(connected, f"{peers} peers are connected to {name}")


def test_layout_and_profile_are_reported_with_their_reasons(place: Place, midspan: Midspan) -> None:
    place.bridge(*RULES, yarp=PEERS)
    place.far.advertise("/cmd_vel", TWIST)
    place.far.advertise("/scan", SCAN)
    place.far.subscribe("/words", STRING)
    reader, modern = place.port("/reader"), place.port("/modern", Profile.YARP4)
    reader.listen_to("/midspan/cmd_vel:o")
    modern.listen_to("/midspan/cmd_vel:o")
    place.port("/old/writer")
    command = port(midspan, "/midspan/cmd_vel:o", 2)
    assert (command["topic"], command["type"]) == ("/cmd_vel", "geometry_msgs/msg/Twist")
    assert (command["carries"], command["profile"]) == ("fields linear.x angular.z", "yarp3")
    newer, older = command["peers"]
    assert (newer["port"], newer["profile"], newer["profile_why"]) == ("/modern", "yarp4", "announced by the peer")
    assert (older["port"], older["profile"]) == ("/reader", "yarp3")
    scan = port(midspan, "/midspan/scan:o", 0)
    assert (scan["carries"], scan["profile"]) == ("natural", "yarp4")
    (ruled,) = port(midspan, "/midspan/words/from/old/writer:i", 1)["peers"]
    assert (ruled["profile"], ruled["profile_why"]) == ("yarp3", "set by its rule")


def test_layout_and_profile_are_described_in_words(place: Place, midspan: Midspan) -> None:
    place.bridge(*RULES, yarp=PEERS)
    place.far.advertise("/cmd_vel", TWIST)
    place.far.advertise("/plain", STRING)
    reader = place.port("/reader")
    reader.listen_to("/midspan/cmd_vel:o")
    port(midspan, "/midspan/cmd_vel:o", 1)
    port(midspan, "/midspan/plain:o", 0)
    output = midspan("explain", "/cmd_vel").out
    start = (
        "YARP port /midspan/cmd_vel:o writes it: geometry_msgs/msg/Twist as a Bottle of the fields linear.x angular.z"
    )
    assert f"{start}, YARP 3's bytes; 1 port connected." in output
    assert "    /reader over tcp: YARP 3's bytes (announced by the peer)" in output
    assert "YARP port /midspan/cmd_vel:i reads it: " in output
    output = midspan("explain", "/plain").out
    assert "std_msgs/msg/String as nested lists, as YARP's own converter of ROS messages writes them" in output
    assert "YARP 3's bytes; no connection." in output
    status = midspan("status").out.replace("\n", " ")
    assert "/midspan/cmd_vel:o: geometry_msgs/msg/Twist as a Bottle" in status
    assert "-> /reader over tcp" in status
    assert "ports without a connection" in status
    assert main(["explain", "/no/such:o", "--config", str(midspan.config)]) == 1


def test_a_service_port_shows_the_layout_of_requests_and_replies() -> None:
    served = {"port": "/lamp/rpc", "direction": "rpc", "type": "std_srvs/srv/SetBool", "profile": "yarp3", "peers": []}
    (line,) = port_lines(PortStatus(**served, carries="fields 'set' data", replies="bottle"))
    assert line.startswith(
        "YARP port /lamp/rpc answers calls: std_srvs/srv/SetBool as a Bottle of the fields 'set' data,"
    )
    assert "answered by nested lists" in line
