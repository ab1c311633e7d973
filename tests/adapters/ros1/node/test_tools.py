"""ROS 1's command-line tools treat the adapter's node like any other node."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.ros1.adapter import EdgeUnderTest, edge_on
from tests.peers.ros1.network import ROS1_PYTHON, RosMaster, needs_ros1
from tests.support.wait import until

pytestmark = needs_ros1

RUN = """
import socket, sys, rosnode, rostopic
socket.setdefaulttimeout = lambda _seconds: None  # rosnode's three seconds are too short on a busy machine
for line in sys.argv[1:]:
    print("$", line, flush=True)
    words = line.split()
    try:
        {"rosnode": rosnode.rosnodemain, "rostopic": rostopic.rostopicmain}[words[0]](words)
    except SystemExit:
        pass
    sys.stdout.flush()
"""


@pytest.fixture(scope="module")
def master() -> Iterator[RosMaster]:
    with RosMaster() as master:
        yield master


@pytest.fixture
def edge(master: RosMaster, tmp_path: Path) -> Iterator[EdgeUnderTest]:
    with edge_on(master, tmp_path) as edge:
        yield edge


def run(master: RosMaster, *lines: str) -> dict[str, str]:
    """Run command lines in one process, because each would otherwise import for a second; return their outputs."""
    done = subprocess.run(
        [ROS1_PYTHON, "-c", RUN, *lines], env=master.env, text=True, capture_output=True, check=True, timeout=60
    )
    parts = done.stdout.split("$ ")[1:]
    return {part.partition("\n")[0]: part.partition("\n")[2] for part in parts}


def test_rosnode_and_rostopic_work_with_midspans_node(master: RosMaster, edge: EdgeUnderTest) -> None:
    with master.peer("tool_peer") as peer:
        peer.advertise("/tool/in", "std_msgs/String")
        edge.endpoint(topic="/tool/in", made_by="native")
        edge.open("/tool/in", "std_msgs/String")
        out = edge.ask("advertise", topic="/tool/out", type="std_msgs/String", latched=True)["id"]
        edge.send(out, "hello")
        inbox = peer.subscribe("/tool/out", "std_msgs/String")
        assert len(peer.wait(inbox, 1)) == 1
        edge.until_connected(out)
        until(lambda: "/midspan" in master.state()["subscribers"].get("/tool/in", []), "the edge has subscribed")
        until(lambda: edge.ask("connections")["in"], "the edge is connected to the publisher")
        outputs = run(
            master, "rosnode info /midspan", "rosnode ping -c 1 /midspan", "rosnode list", "rostopic info /tool/out",
            "rostopic type /tool/out", "rostopic echo -n 1 /tool/out", "rosnode kill /midspan",
        )  # fmt: skip
        info = outputs["rosnode info /midspan"]
        assert " * /tool/out [std_msgs/String]" in info
        assert f"Pid: {edge.pid}" in info
        out_lines = info[info.index(" * topic: /tool/out") :].splitlines()
        assert out_lines[1].strip() == "* to: /tool_peer"
        assert "direction: outbound (" in out_lines[2]
        in_lines = info[info.index(" * topic: /tool/in") :].splitlines()
        assert in_lines[1].strip().startswith("* to: /tool_peer (http://")
        assert "direction: inbound (" in in_lines[2]
        assert "xmlrpc reply from" in outputs["rosnode ping -c 1 /midspan"]
        assert "/midspan" in outputs["rosnode list"].split()
        assert "/midspan (http://127.0.0.1:" in outputs["rostopic info /tool/out"]
        assert outputs["rostopic type /tool/out"].strip() == "std_msgs/String"
        assert 'data: "hello"' in outputs["rostopic echo -n 1 /tool/out"]
        failures = until(lambda: edge.ask("status")["failures"], "the node is requested to stop")
        assert "rosnode" in failures[0]
