"""Real rospy and roscpp nodes and ROS 1's command-line tools use the embedded master."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from bridge.adapters.ros1.master import api
from bridge.adapters.ros1.master.embedded import EmbeddedMaster
from tests.peers.peer import Peer
from tests.peers.ros1.network import ROS1_PEER, ROS1_PYTHON, ros1_environment
from tests.support.missing import ROS1, need
from tests.support.process import Process
from tests.support.wait import until

STRING = "std_msgs/String"
ROSCPP_NODE = "/usr/lib/rosout/rosout"


class Network:
    """An embedded master, and the environment of its nodes and tools."""

    def __init__(self, folder: Path, purge: float = 0.0) -> None:
        need(ROS1)
        self.master = EmbeddedMaster("127.0.0.1", 0, purge=purge)
        self.master.start()
        self.env = {
            **ros1_environment(self.master.uri), "ROS_HOME": str(folder), "ROS_LOG_DIR": str(folder),
            "PYTHONUNBUFFERED": "1",
        }  # fmt: skip

    def peer(self, name: str) -> Peer:
        return Peer(ROS1_PEER, ROS1_PYTHON, self.env, name)

    def tool(self, *command: str, stdin: str = "") -> str:
        """Run a command-line tool, and return its output."""
        result = subprocess.run(
            command, env=self.env, input=stdin, capture_output=True, text=True, timeout=120, check=False
        )
        assert result.returncode == 0, f"{command}: {result.stdout}{result.stderr}"
        return result.stdout

    def until_ping(self, node: str) -> None:
        """Ping a node until it answers; rosnode waits only three seconds."""
        until(lambda: "xmlrpc reply from" in self.tool("rosnode", "ping", "-c", "1", node), f"{node} answers")

    def info(self, node: str) -> str:
        """Describe a node once it answers; rosnode waits only five seconds."""

        def described() -> str:
            with contextlib.suppress(AssertionError):
                return self.tool("rosnode", "info", node)
            return ""

        return until(described, f"{node} answers")

    def close(self) -> None:
        self.master.close()


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Network]:
    network = Network(tmp_path_factory.mktemp("ros"))
    yield network
    network.close()


@pytest.fixture(scope="module")
def talker(network: Network) -> Iterator[Peer]:
    """A rospy node with a latched topic, a subscription, a service and a parameter."""
    peer = network.peer("talker")
    topic = peer.advertise("/chatter", STRING, latched=True)
    peer.publish(topic, {"data": "hello"})
    peer.subscribe("/words", STRING)
    peer.ask("serve", service="/toggle", type="std_srvs/SetBool", reply={"success": True, "message": "done"})
    peer.ask("set_param", name="/talker/rate", value=7)
    yield peer
    peer.stop()


def test_rosnode_lists_describes_and_pings_nodes(network: Network, talker: Peer):
    assert "/talker" in network.tool("rosnode", "list").split()
    info = network.info("/talker")
    for part in ("* /chatter [std_msgs/String]", "* /words", "* /toggle", "Pid:"):
        assert part in info
    network.until_ping("/talker")
    assert f"{network.master.nodes()['/talker']}" in network.tool("rosnode", "list", "-a").replace(" \t", "")


def test_rostopic_lists_echoes_and_publishes(network: Network, talker: Peer):
    assert "/chatter" in network.tool("rostopic", "list").split()
    assert network.tool("rostopic", "type", "/chatter").strip() == STRING
    assert "* /talker" in network.tool("rostopic", "info", "/chatter")
    assert "/chatter" in network.tool("rostopic", "find", STRING)
    assert "hello" in network.tool("rostopic", "echo", "-n", "1", "/chatter")
    network.tool("rostopic", "pub", "-1", "/words", STRING, "{data: from a tool}")


def test_rosservice_lists_and_calls_services(network: Network, talker: Peer):
    assert "/toggle" in network.tool("rosservice", "list").split()
    assert network.tool("rosservice", "node", "/toggle").strip() == "/talker"
    assert network.tool("rosservice", "type", "/toggle").strip() == "std_srvs/SetBool"
    assert "success: True" in network.tool("rosservice", "call", "/toggle", "true")


def test_rosparam_sets_and_gets_values(network: Network, tmp_path: Path):
    network.tool("rosparam", "set", "/robot/name", "r1")
    network.tool("rosparam", "set", "/robot/wheels", "[1, 2.5, true, {a: b}]")
    assert network.tool("rosparam", "get", "/robot/wheels").split() == [
        "-",
        "1",
        "-",
        "2.5",
        "-",
        "true",
        "-",
        "a:",
        "b",
    ]
    file = tmp_path / "robot.yaml"
    network.tool("rosparam", "dump", str(file), "/robot")
    network.tool("rosparam", "delete", "/robot")
    assert "/robot/name" not in network.tool("rosparam", "list").split()
    network.tool("rosparam", "load", str(file), "/copy")
    assert network.tool("rosparam", "get", "/copy/name").strip() == "r1"
    assert "/run_id" in network.tool("rosparam", "list").split()


def test_rospy_nodes_join_and_leave(network: Network, talker: Peer):
    writer = network.peer("writer")
    try:
        received = writer.subscribe("/chatter", STRING)
        assert writer.wait(received, 1) == [{"data": "hello"}]
        call = writer.ask("call", service="/toggle", type="std_srvs/SetBool", request={"data": True})["id"]
        assert writer.ask("result", id=call)["reply"] == {"success": True, "message": "done"}
        assert writer.ask("get_param", name="/talker/rate")
    finally:
        writer.stop()
    until(lambda: "/writer" not in network.master.nodes(), "the node has unregistered everything")


OVERTAKEN = """
import rospy
from rospy.impl.registration import RegManager
from std_msgs.msg import String

def publisher_update(self, topic, uris):
    with self.cond:
        self.updates.append((topic, uris))
        if topic == "/overtaken" and uris and not overtaken:
            overtaken.append(topic)
            self.updates.append((topic, []))  # the reply to the registration, of which the thread has run only now
        self.cond.notify_all()

overtaken = []
RegManager.publisher_update = publisher_update
rospy.init_node("overtaken")
rospy.Subscriber("/overtaken", String, lambda message: rospy.set_param("/received", message.data))
publisher = rospy.Publisher("/overtaken", String, latch=True, queue_size=1)
publisher.publish("hello")
rospy.spin()
"""


def test_a_rospy_subscriber_connects_though_an_update_overtook_the_reply_to_its_registration(
    network: Network, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(api, "NEW_SECONDS", 60.0)  # the publisher may register late after the subscriber
    with Process([ROS1_PYTHON, "-c", OVERTAKEN], network.env):
        until(lambda: network.master.api.parameters.has("/received"), "the message of the publisher arrives")


def test_a_node_of_the_same_name_replaces_the_first(network: Network):
    first = network.peer("twin")
    uri = until(lambda: network.master.nodes().get("/twin"), "the first node registers")
    second = network.peer("twin")
    try:
        until(lambda: network.master.nodes()["/twin"] != uri, "the second node registers")
        until(lambda: not _connects(uri), "the first node is shut down")
        assert _connects(network.master.nodes()["/twin"])
    finally:
        second.stop()
        first.stop()


def test_a_roscpp_node_registers_connects_and_unregisters(network: Network, talker: Peer, tmp_path: Path):
    env = {**network.env, "ROS_LOG_DIR": str(tmp_path)}
    with Process([ROSCPP_NODE, "__name:=cpp", "/rosout_agg:=/cpp_agg"], env) as process:
        until(lambda: "/cpp" in network.master.nodes(), "the node registers")
        listener = network.peer("agg_listener")
        try:
            logs = listener.subscribe("/cpp_agg", "rosgraph_msgs/Log")
            until(lambda: _relayed(talker, listener, logs), "the node has connected to the log of a rospy node")
        finally:
            listener.stop()
        assert "* /cpp_agg [rosgraph_msgs/Log]" in network.tool("rosnode", "info", "/cpp")
        process.signal(signal.SIGINT)
        until(lambda: "/cpp" not in network.master.nodes(), "the node has unregistered")


def _relayed(node: Peer, listener: Peer, logs: int, text: str = "to be relayed") -> bool:
    node.ask("log", text=text)
    return any(text in message["msg"] for message in listener.wait(logs, 1, seconds=1))


def test_logs_are_collected(network: Network, talker: Peer):
    assert "/rosout" in network.tool("rosnode", "list").split()
    network.until_ping("/rosout")
    listener = network.peer("collector")
    try:
        logs = listener.subscribe("/rosout_agg", "rosgraph_msgs/Log")
        until(lambda: _relayed(talker, listener, logs), "the log of a rospy node is published again")
        late = network.peer("late")
        until(lambda: _relayed(late, listener, logs, "from a late node"), "a later node's log is published, too")
        late.stop()
        info = network.info("/rosout")
        for part in ("* /rosout_agg [rosgraph_msgs/Log]", "* /rosout", "to: /collector", "to: /talker"):
            assert part in info
    finally:
        listener.stop()


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_native_rosout_replaces_midspans_until_it_ends(tmp_path: Path, end: signal.Signals):
    network = Network(tmp_path, purge=0.5)
    own = network.master.nodes()["/rosout"]
    with Process([ROSCPP_NODE, "__name:=rosout"], network.env) as process:
        until(lambda: network.master.nodes().get("/rosout", own) != own, "the native node registers")
        until(lambda: not _connects(own), "the own node has ended")
        native = network.master.nodes()["/rosout"]
        until(lambda: network.master.api.registrations.nodes["/rosout"].reachable, "the master has checked the node")
        process.signal(end)
        until(lambda: network.master.nodes().get("/rosout", native) != native, "the own node runs again")
    talker, listener = network.peer("again_talker"), network.peer("again_listener")
    try:
        logs = listener.subscribe("/rosout_agg", "rosgraph_msgs/Log")
        until(lambda: _relayed(talker, listener, logs), "the own node publishes the logs")
    finally:
        talker.stop()
        listener.stop()
        network.close()


def _connects(uri: str) -> bool:
    parts = urlsplit(uri)
    try:
        socket.create_connection((str(parts.hostname), int(parts.port or 0)), 5).close()
    except OSError:  # refused, or reset as the socket closes
        return False
    return True


def test_rosnode_cleanup_removes_a_killed_node(tmp_path: Path):
    """It also removes nodes that do not respond for three seconds, so those of other tests must not be there."""
    with contextlib.closing(Network(tmp_path)) as network:
        peer = network.peer("killed")
        until(lambda: "/killed" in network.master.nodes(), "the node registers")
        peer.signal(signal.SIGKILL)
        peer.stop()
        network.tool("rosnode", "cleanup", stdin="y\n")
        assert "/killed" not in network.master.nodes()


def test_roslaunch_sets_parameters_and_starts_nodes(network: Network, tmp_path: Path):
    file = tmp_path / "one.launch"
    file.write_text(
        '<launch><param name="/launched/x" value="5"/><rosparam param="/launched/list">[1, 2]</rosparam>'
        '<node pkg="rosout" type="rosout" name="launched"/></launch>'
    )
    with Process(["/usr/bin/roslaunch", str(file)], network.env) as process:
        until(lambda: "/launched" in network.master.nodes(), "the launched node registers")
        assert network.master.api.parameters.get("/launched") == {"x": 5, "list": [1, 2]}
        process.signal(signal.SIGINT)  # before the end of the block, which kills roslaunch after some seconds
        until(lambda: "/launched" not in network.master.nodes(), "the launched node has unregistered")


def test_a_killed_node_is_removed_and_its_subscribers_learn_of_it(tmp_path: Path):
    network = Network(tmp_path, purge=1.0)
    peer, listener = network.peer("killed"), network.peer("listener")
    try:
        peer.advertise("/t", STRING)
        listener.subscribe("/t", STRING)
        nodes = network.master.api.registrations.nodes
        until(lambda: nodes["/killed"].reachable, "the master has checked the node")
        peer.signal(signal.SIGKILL)
        until(lambda: "/killed" not in network.master.nodes(), "the killed node is removed")
        until(lambda: network.master.calls.waiting == 0, "the subscribers have been called")
        assert "/listener" in network.master.nodes()
    finally:
        listener.stop()
        peer.stop()
        network.close()
