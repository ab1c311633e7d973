"""A ROS 1 network only on IPv6: a real roscore or Midspan's master, and rospy, with ``ROS_IPV6=on``."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest

from bridge.adapters.ros1_peers import XmlRpcClient, bracketed
from tests.peers.ros1.adapter import EdgeUnderTest, string, text
from tests.peers.ros1.network import RosMaster, needs_ros1


class Master(RosMaster):
    """A master at an IPv6 address; roscore runs without rosout, because roscpp's cannot use such a master."""

    def __init__(self, *, embedded: bool) -> None:
        super().__init__(embedded=embedded, address="::1")
        self.env["ROS_IPV6"] = "on"

    def _ready(self) -> bool:
        try:
            return bool(self.call("getParam", "/run_id"))
        except OSError:
            return False


@needs_ros1
@pytest.mark.parametrize("embedded", [False, True], ids=["roscore", "embedded"])
def test_topics_and_a_service_work_over_ipv6(tmp_path: Path, embedded: bool) -> None:
    """A rospy node registers ``http://::1:port/``, without brackets, and cannot call services at such addresses."""
    master = Master(embedded=embedded)
    variables = {"ROS_IPV6": "on", "ROS_IP": "::1"}
    with master, EdgeUnderTest(master.uri, tmp_path, variables=variables) as edge, master.peer("six") as peer:
        edge.ask("start")
        edge.joined()
        out = peer.advertise("/six/in", "std_msgs/String", latched=True)
        peer.publish(out, {"data": "to the hub"})
        # a message that arrives before rospy enables latching arrives again when the publisher is known to latch
        edge.endpoint(topic="/six/in", made_by="native", latched=True)
        assert [text(p) for p, _ in edge.received(edge.open("/six/in", "std_msgs/String"), 1)] == ["to the hub"]
        publisher = edge.ask("advertise", topic="/six/out", type="std_msgs/String")["id"]
        inbox = peer.subscribe("/six/out", "std_msgs/String")
        edge.until_connected(publisher)
        assert master.call("lookupNode", "/midspan").startswith("http://[::1]:")
        edge.ask("send", id=publisher, payload=string("to ROS 1"))
        assert [m["data"] for m in peer.wait(inbox, 1)] == ["to ROS 1"]
        peer.ask("serve", service="/six/serve", type="std_srvs/SetBool", reply={"success": True, "message": "six"})
        edge.endpoint(topic="/six/serve", made_by="native")
        caller = edge.ask("caller", service="/six/serve", type="std_srvs/SetBool")["id"]
        edge.ask("begin", id=caller, request=base64.b64encode(b"\1").decode())
        (result,) = edge.ask("results", id=caller)["results"]["0"]
        assert base64.b64decode(result) == b"\1\3\0\0\0six"


@pytest.mark.parametrize(
    ("uri", "expected"),
    [
        ("http://::1:1234/", "http://[::1]:1234/"),
        ("rosrpc://2001:db8::5:1234", "rosrpc://[2001:db8::5]:1234"),
        ("http://[::1]:1234/", "http://[::1]:1234/"),
        ("http://robot:1234/a:b", "http://robot:1234/a:b"),
        ("", ""),
    ],
)
def test_ipv6_addresses_without_brackets_get_them(uri: str, expected: str) -> None:
    assert bracketed(uri) == expected


def test_a_client_accepts_ipv6_addresses_without_brackets() -> None:
    client = XmlRpcClient("http://::1:1234/", 1.0)
    assert (client._http.host, client._http.port) == ("::1", 1234)
