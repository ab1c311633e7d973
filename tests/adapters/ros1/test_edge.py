"""The ROS 1 adapter with real rospy programs."""

import base64
import contextlib
import os
import socket
import struct
import time
from typing import Any
from xmlrpc.client import ServerProxy

import pytest

from bridge.adapters.ros1.handshake import ORIGIN_FIELD, encode, read_header
from bridge.adapters.ros1_peers import DeadlineSocket
from tests.peers.ros1.adapter import edge_on, string, text
from tests.peers.ros1.network import needs_ros1
from tests.peers.ros1.servers import publisher, tcp_server, until_closed
from tests.support.wait import until

pytestmark = needs_ros1

STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
THING = """std_msgs/Header header
string name
uint8[] data
my_pkg/Inner[] inner
================================================================================
MSG: my_pkg/Inner
float64 x
time when
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""
A_THING: dict[str, Any] = {
    "header": {"seq": 7, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "map"},
    "name": "thing",
    "data": [0, 128, 255],
    "inner": [{"x": 1.5, "when": {"secs": 3, "nsecs": 4}}, {"x": -2.0, "when": {"secs": 5, "nsecs": 6}}],
}


def latest(messages):
    return [m["data"] for m in messages]


def test_the_graph_lists_publishers_and_subscribers(master, edge):
    with master.peer("graph_talker") as peer:
        peer.advertise("/graph/plain", "std_msgs/String")
        peer.advertise("/graph/latched", "sensor_msgs/LaserScan", latched=True)
        peer.subscribe("/graph/numbers", "std_msgs/Int32")
        plain = edge.endpoint(topic="/graph/plain", made_by="native")
        assert (plain["kind"], plain["type"], plain["latched"]) == ("publisher", "std_msgs/String", False)
        assert (plain["node"], plain["type_id"]) == ("/graph_talker", STRING_MD5)
        # rospy enables latching after the registration, so that an early probe finds it disabled
        latched = edge.endpoint(topic="/graph/latched", made_by="native", latched=True)
        assert latched["type"] == "sensor_msgs/LaserScan"
        assert "float32[] ranges" in latched["definition"]
        assert "MSG: std_msgs/Header" in latched["definition"]
        numbers = edge.endpoint(topic="/graph/numbers")
        assert (numbers["kind"], numbers["type"], numbers["made_by"]) == ("subscription", "std_msgs/Int32", "native")
        endpoints = edge.endpoints()
        assert len({e["id"] for e in endpoints}) == len(endpoints)
    until(lambda: not edge.endpoints(topic="/graph/plain"), "the endpoints disappear with their node")


def test_a_subscription_receives_only_messages_of_its_type(master, edge):
    with master.peer("two_a") as first, master.peer("two_b") as second:
        a = first.advertise("/two", "std_msgs/String", latched=True)
        b = second.advertise("/two", "std_msgs/Int32", latched=True)
        first.publish(a, {"data": "text"})
        second.publish(b, {"data": 5})
        # a message that arrives before rospy enables latching arrives again when the publisher is known to latch
        wanted = {"topic": "/two", "made_by": "native", "latched": True}
        assert edge.endpoint(node="/two_a", **wanted)["type"] == "std_msgs/String"
        assert edge.endpoint(node="/two_b", **wanted)["type"] == "std_msgs/Int32"
        strings, numbers = edge.open("/two", "std_msgs/String"), edge.open("/two", "std_msgs/Int32")
        assert [text(p) for p, _ in edge.received(strings, 1)] == ["text"]
        assert [base64.b64decode(p) for p, _ in edge.received(numbers, 1)] == [struct.pack("<i", 5)]
        first.publish(a, {"data": "more"})
        assert [text(p) for p, _ in edge.received(strings, 2)] == ["text", "more"]
        assert len(edge.received(numbers, 2, 0.2)) == 1, "messages of the other type are not delivered"


def test_messages_are_received_with_their_source(master, edge):
    with master.peer("in_a") as first, master.peer("in_b") as second:
        first_out = first.advertise("/in", "std_msgs/String", latched=True)
        first.publish(first_out, {"data": "latched before"})
        inbox = edge.open("/in", "std_msgs/String")
        second_out = second.advertise("/in", "std_msgs/String", latched=True)
        second.publish(second_out, {"data": "latched later"})
        ids = {
            node: edge.endpoint(topic="/in", kind="publisher", node=node, latched=True)["id"]
            for node in ("/in_a", "/in_b")
        }
        wanted = {("latched before", ids["/in_a"]), ("latched later", ids["/in_b"])}
        received = lambda: [(text(p), s) for p, s in edge.received(inbox, 2)]  # noqa: E731
        # a message that arrives before rospy enables latching arrives again when the publisher is known to latch
        until(lambda: wanted <= set(received()), "both retained messages have arrived")
        before = len(received())
        assert {message for message, _ in received()} == {"latched before", "latched later"}
        for n in range(50):
            first.publish(first_out, {"data": str(n)})
        assert [text(p) for p, _ in edge.received(inbox, before + 50)[before:]] == [str(n) for n in range(50)]
        edge.drop(inbox)
        until(
            lambda: "/midspan" not in master.state()["subscribers"].get("/in", []), "the subscription is unregistered"
        )
        until(lambda: first.ask("connections", id=first_out)["count"] == 0, "the publisher is disconnected")


def test_a_publisher_that_latches_just_after_its_registration_counts_as_latched(master, edge):
    """The message then counts as a latched publisher's, so it is retained for late joiners."""
    with master.peer("late_latch") as peer:

        def latches(number: int) -> bool:
            """Return whether the edge's second probe found it latched; a probe that came too early tests nothing."""
            topic = f"/late_latch{number}"
            peer.advertise(topic, "std_msgs/String")
            inbox = edge.open(topic, "std_msgs/String")
            assert not edge.endpoint(topic=topic, made_by="native")["latched"]
            peer.publish(peer.advertise(topic, "std_msgs/String", latched=True), {"data": "kept"})
            with contextlib.suppress(AssertionError):
                until(
                    lambda: edge.endpoints(topic=topic, made_by="native", latched=True),
                    "the publisher is known to latch",
                    5,
                )
                (latched,) = edge.endpoints(topic=topic, made_by="native", latched=True)
                until(
                    lambda: (string("kept"), latched["id"]) in edge.received(inbox, 1), "the retained message arrives"
                )
                return True
            return False

        assert any(latches(number) for number in range(5))


def test_messages_reach_and_leave_roscpp_programs(master, edge):
    # roscore's rosout is a roscpp program that republishes /rosout on /rosout_agg, as does the embedded master's
    with master.peer("logger") as peer:
        endpoint = edge.endpoint(topic="/rosout_agg", made_by="native")
        assert (endpoint["type"], endpoint["node"]) == ("rosgraph_msgs/Log", "/rosout")
        inbox = edge.open("/rosout_agg", "rosgraph_msgs/Log")

        def logged() -> bool:
            peer.ask("log", text="from rospy over roscpp")
            return any(b"from rospy over roscpp" in base64.b64decode(p) for p, _ in edge.received(inbox, 0, 0))

        until(logged, "a message of a roscpp publisher arrives", every=0.2)
        aggregated = peer.subscribe("/rosout_agg", "rosgraph_msgs/Log")

        def received(text: str) -> bool:
            return text in [m["msg"] for m in peer.wait(aggregated, 0, 0)]

        until(lambda: peer.ask("log", text="again") and received("again"), "the subscriber is connected", every=0.2)
        publisher = edge.ask("advertise", topic="/rosout", type="rosgraph_msgs/Log", latched=True, depth=1)["id"]
        fields = [w.encode() for w in ("/bridged", "over roscpp", "file", "function")]
        strings = [struct.pack("<I", len(w)) + w for w in fields]
        log = struct.pack("<IIII", 0, 1, 2, 0) + b"\x02" + b"".join(strings) + struct.pack("<II", 3, 0)
        edge.ask("send", id=publisher, payload=base64.b64encode(log).decode())
        until(lambda: received("over roscpp"), "a roscpp subscriber received the adapter's message")
        edge.drop(publisher)
        edge.drop(inbox)


def test_a_custom_type_is_bridged_in_both_directions(master, edge):
    with master.peer("custom") as peer:
        md5 = peer.ask("define", type="my_pkg/Thing", definition=THING)["md5"]
        out = peer.advertise("/thing/in", "my_pkg/Thing", latched=True)
        peer.publish(out, A_THING)
        # a message that arrives before rospy enables latching arrives again when the publisher is known to latch
        endpoint = edge.endpoint(topic="/thing/in", made_by="native", latched=True)
        assert (endpoint["type"], endpoint["type_id"]) == ("my_pkg/Thing", md5)
        assert "my_pkg/Inner[] inner" in endpoint["definition"]
        assert "MSG: my_pkg/Inner" in endpoint["definition"]
        definition = {"md5": md5, "definition": THING}
        ((payload, _),) = edge.received(edge.open("/thing/in", "my_pkg/Thing", **definition), 1)
        inbox = peer.subscribe("/thing/out", "my_pkg/Thing")
        publisher = edge.ask("advertise", topic="/thing/out", type="my_pkg/Thing", **definition)["id"]
        edge.until_connected(publisher)
        edge.ask("send", id=publisher, payload=payload)
        (thing,) = peer.wait(inbox, 1)
        thing["header"]["seq"] = A_THING["header"]["seq"]  # rospy counts the sender's messages there
        assert thing == A_THING


def test_late_joiners_receive_the_latched_messages_of_each_source(master, edge):
    publisher = edge.ask("advertise", topic="/late", type="std_msgs/String", latched=True, depth=1)["id"]
    for source in "abc":
        edge.send(publisher, f"old {source}", source)
        edge.send(publisher, f"last {source}", source)
    with master.peer("late") as peer:
        inbox = peer.subscribe("/late", "std_msgs/String")
        assert latest(peer.wait(inbox, 3)) == ["last a", "last b", "last c"]
        header = peer.ask("header", id=inbox)["headers"]["/midspan"]
        assert header["latching"] == "1"
        assert header["midspan_origin"] == "robot"
        edge.send(publisher, "live", "b")
        assert latest(peer.wait(inbox, 4))[3:] == ["live"]
        edge.ask("forget", id=publisher, source="a")
        with master.peer("later") as later:
            inbox = later.subscribe("/late", "std_msgs/String")
            later.wait(inbox, 2)
            edge.send(publisher, "end", "c")
            assert latest(later.wait(inbox, 3)) == ["live", "last c", "end"]


def test_a_warning_names_a_subscriber_with_another_definition(master, edge):
    publisher = edge.ask("advertise", topic="/version", type="std_msgs/String")["id"]
    warnings = lambda: [w for w in edge.ask("status")["warnings"] if w.startswith("/version: ")]  # noqa: E731
    with master.peer("old_version") as peer:
        md5 = peer.ask("define", type="std_msgs/String", definition="string data\nint32 extra\n")["md5"]
        peer.subscribe("/version", "std_msgs/String")
        (warning,) = until(warnings, "the warning is reported")
        assert "/old_version does not receive it" in warning
        assert md5 in warning
        assert STRING_MD5 in warning
    until(lambda: not warnings(), "the warning has ended")
    edge.ask("drop", id=publisher)


def test_a_latched_depth_applies_per_source(master, edge):
    publisher = edge.ask("advertise", topic="/deep", type="std_msgs/String", latched=True, depth=3)["id"]
    for n in range(5):
        edge.send(publisher, str(n), "a")
    with master.peer("deep") as peer:
        assert latest(peer.wait(peer.subscribe("/deep", "std_msgs/String"), 3)) == ["2", "3", "4"]


def test_latched_and_volatile_publishers_share_a_topic(master, edge):
    latched = edge.ask("advertise", topic="/shared", type="std_msgs/String", latched=True, depth=1)["id"]
    volatile = edge.ask("advertise", topic="/shared", type="std_msgs/String")["id"]
    edge.send(latched, "kept")
    edge.send(volatile, "gone", "b")
    with master.peer("shared") as peer:
        inbox = peer.subscribe("/shared", "std_msgs/String")
        assert latest(peer.wait(inbox, 1)) == ["kept"]
        edge.drop(latched)
        edge.send(volatile, "still there", "b")
        assert latest(peer.wait(inbox, 2)) == ["kept", "still there"]
        with pytest.raises(AssertionError, match="already published on ROS 1 as std_msgs/String"):
            edge.ask("advertise", topic="/shared", type="std_msgs/Int32")
        edge.drop(volatile)
        until(lambda: "/shared" not in master.state()["publishers"], "the topic is unregistered")
    with master.peer("shared") as peer:
        numbers = edge.ask("advertise", topic="/shared", type="std_msgs/Int32")["id"]
        inbox = peer.subscribe("/shared", "std_msgs/Int32")
        edge.until_connected(numbers)
        edge.ask("send", id=numbers, payload=base64.b64encode(struct.pack("<i", 9)).decode())
        assert latest(peer.wait(inbox, 1)) == [9]


@pytest.mark.thorough
def test_messages_published_by_a_midspan_are_not_bridged_back(master, edge, tmp_path):
    with edge_on(master, tmp_path / "second", "other") as second, master.peer("loop") as peer:
        publisher = edge.ask("advertise", topic="/loop", type="std_msgs/String", latched=True)["id"]
        edge.send(publisher, "from the first")
        endpoint = second.endpoint(topic="/loop", made_by="midspan")
        assert endpoint["type"] == "std_msgs/String"
        native = peer.advertise("/loop", "std_msgs/String", latched=True)
        peer.publish(native, {"data": "native"})
        for e in (edge, second):  # a message that arrives before rospy enables latching arrives again afterwards
            e.endpoint(topic="/loop", made_by="native", latched=True)
        inboxes = [(e, e.open("/loop", "std_msgs/String")) for e in (edge, second)]
        for e, inbox in inboxes:
            assert [text(p) for p, _ in e.received(inbox, 1)] == ["native"]
        edge.send(publisher, "again from the first")
        peer.publish(native, {"data": "native again"})
        for e, inbox in inboxes:
            assert [text(p) for p, _ in e.received(inbox, 2)] == ["native", "native again"]
        assert not edge.endpoints(node="/midspan"), "the graph excludes the adapter's own endpoints"
        subscription = second.endpoint(topic="/loop", node="/midspan", kind="subscription")
        assert subscription["made_by"] == "midspan"


def test_a_topic_advertised_again_at_once_is_received_again(master, edge):
    with master.peer("again_listener") as peer:
        inbox = peer.subscribe("/again", "std_msgs/String")
        for number in range(8):
            out = edge.ask("advertise", topic="/again", type="std_msgs/String")["id"]

            def received(out=out, number=number) -> bool:
                edge.ask("send", id=out, payload=string(str(number)))
                return str(number) in latest(peer.wait(inbox, 10_000, 0.05))

            until(received, f"the subscriber receives publication {number}")
            edge.ask("drop", id=out)


def test_a_subscriber_that_connects_as_a_publication_ends_gets_its_header_and_is_disconnected(master, edge):
    """After an error header, rospy would never connect to this node for the topic again."""
    out = edge.ask("advertise", topic="/ends", type="std_msgs/String")["id"]
    with ServerProxy(until(lambda: master.call("lookupNode", "/midspan"), "the node is known")) as node:
        _, _, (_, _, port) = node.requestTopic("/late", "/ends", [["TCPROS"]])
    edge.ask("drop", id=out)
    request = {"callerid": "/late", "topic": "/ends", "type": "*", "md5sum": "*"}
    for md5 in ("*", STRING_MD5):
        sock, header = connect(port, request | {"md5sum": md5})
        with sock:
            assert (header["type"], header["md5sum"]) == ("std_msgs/String", STRING_MD5)
            assert ORIGIN_FIELD in header
            assert sock.recv(1) == b""
    for wrong in ({"md5sum": "0" * 32}, {"topic": "/never"}):
        sock, header = connect(port, request | wrong)
        with sock:
            assert "is not a publisher of" in header["error"]


def connect(port: int, header: dict) -> tuple[DeadlineSocket, dict]:
    """Connect to the adapter's TCPROS port as a subscriber; return the socket and the response header."""
    sock = DeadlineSocket.connected("127.0.0.1", port, time.monotonic() + 40)
    sock.sendall(encode(header))
    return sock, read_header(sock)


def test_names_that_ros2_forbids_are_mapped_to_legal_names(master, edge):
    with master.peer("digits") as peer:
        peer.subscribe("/camera/1/image", "std_msgs/String")
        edge.endpoint(topic="/camera/1/image")
        names = edge.ask("names", hub="/camera/n1/image", side="/camera/1/image")
        assert (names["side"], names["hub"]) == ("/camera/1/image", "/camera/n1/image")


def test_types_cross_to_the_hub_and_back(master, edge):
    with master.peer("types") as peer:
        peer.advertise("/types", "nav_msgs/Odometry")
        edge.endpoint(topic="/types", made_by="native")
        answer = edge.ask("convert", type="nav_msgs/Odometry")
        assert answer["hub"] == "nav_msgs/msg/Odometry"
        assert (answer["side"], answer["md5"]) == ("nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7")


def test_a_type_without_md5_is_refused(edge):
    with pytest.raises(AssertionError, match=r"MessageTypeError.*md5"):
        edge.ask("advertise", topic="/unknown", type="a/B", md5="*", definition="")


@contextlib.contextmanager
def registered(master, topic, node, uri):
    """Register a publisher of the topic with the master, with any URI."""
    with ServerProxy(master.uri) as proxy:
        proxy.registerPublisher(node, topic, "std_msgs/String", uri)
        try:
            yield
        finally:
            proxy.unregisterPublisher(node, topic, uri)


def test_dead_and_malformed_publishers_do_not_affect_a_good_one(master, edge):
    def garbage(sock) -> None:
        sock.sendall(b"\xff" * 1000)
        until_closed(sock)

    with contextlib.ExitStack() as stack:
        host, port = stack.enter_context(tcp_server(until_closed))
        malformed = stack.enter_context(publisher(garbage))
        for n in range(30):
            stack.enter_context(registered(master, f"/dead{n}", "/hung", f"http://{host}:{port}/"))
        stack.enter_context(registered(master, "/odd", "/odd", malformed))
        stack.enter_context(registered(master, "/dead0", "/killed", "http://127.0.0.1:9/"))
        peer = stack.enter_context(master.peer("alive"))
        inbox = edge.open("/dead0", "std_msgs/String")
        out = peer.advertise("/dead0", "std_msgs/String", latched=True)
        peer.publish(out, {"data": "alive"})
        assert [text(p) for p, _ in edge.received(inbox, 1)] == ["alive"]
        assert {e["made_by"] for e in edge.endpoints(node="/hung")} == {"unknown"}

        def warned() -> bool:
            warnings = edge.ask("status")["warnings"]
            return any("/odd" in warning and "connection header announces" in warning for warning in warnings)

        until(warned, "a warning about /odd names its connection header")


def test_a_publisher_that_disconnects_after_its_header_is_connected_again(master, edge):
    """The publisher resets the connection right after sending its header, so the adapter may not have read it yet."""
    attempts = []

    def reset(sock) -> None:
        with DeadlineSocket(fileno=os.dup(sock.fileno())) as copy:
            read_header(copy)
        fields = {"callerid": "/reset", "type": "std_msgs/String", "md5sum": STRING_MD5, "message_definition": "x"}
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        sock.sendall(encode(fields))
        sock.close()
        attempts.append(fields)

    with publisher(reset) as uri, registered(master, "/reset", "/reset", uri):
        edge.open("/reset", "std_msgs/String")
        until(lambda: len(attempts) >= 6, "six connection attempts")


def test_a_killed_publisher_is_no_longer_native(master, edge):
    with master.peer("killed") as peer:
        peer.advertise("/killed", "std_msgs/String", latched=True)
        edge.endpoint(topic="/killed", made_by="native")
        inbox = edge.open("/killed", "std_msgs/String")
        until(lambda: "/midspan" in master.state()["subscribers"].get("/killed", []), "the adapter is subscribed")
        peer.signal(9)
        peer.popen.wait()
        assert "/killed" in master.state()["publishers"], "the master does not notice"
        edge.endpoint(topic="/killed", made_by="unknown")
    with master.peer("killed") as peer:
        out = peer.advertise("/killed", "std_msgs/String", latched=True)
        peer.publish(out, {"data": "back"})
        # a message that arrives before rospy enables latching arrives again when the publisher is known to latch
        assert {text(p) for p, _ in edge.received(inbox, 1)} == {"back"}
        edge.endpoint(topic="/killed", made_by="native")


def test_silent_clients_do_not_block_other_subscribers(master, edge):
    publisher = edge.ask("advertise", topic="/open", type="std_msgs/String", latched=True)["id"]
    edge.send(publisher, "open")
    state = until(lambda: master.call("lookupNode", "/midspan"), "the node is known")
    with ServerProxy(state) as node, contextlib.ExitStack() as stack:
        _, _, (_, host, port) = node.requestTopic("/silent", "/open", [["TCPROS"]])
        for start in (b"", b"\xff\xff\xff\xff", b"\x10\0\0\0half a header"):
            sock = stack.enter_context(socket.create_connection((host, port)))
            sock.sendall(start)
        with master.peer("open") as peer:
            assert latest(peer.wait(peer.subscribe("/open", "std_msgs/String"), 1)) == ["open"]


@pytest.mark.thorough
def test_a_stopped_subscriber_does_not_delay_others(master, edge):
    publisher = edge.ask("advertise", topic="/slow", type="std_msgs/String", depth=5)["id"]
    with master.peer("slow") as slow, master.peer("quick") as quick:
        slow.subscribe("/slow", "std_msgs/String")
        edge.until_connected(publisher)
        slow.signal(19)
        inbox = quick.subscribe("/slow", "std_msgs/String")
        edge.until_connected(publisher, 2)
        big = string("x" * 1_000_000)
        for n in range(1, 21):
            edge.ask("send", id=publisher, payload=big)
            assert len(quick.ask("wait", id=inbox, count=n, seconds=40)["messages"]) == n
        assert edge.ask("send", id=publisher, payload=big)["dropped"] > 0
        slow.signal(18)


def test_rosnode_can_read_the_adapters_connections(master, edge):
    with master.peer("info") as peer:
        peer.advertise("/info/in", "std_msgs/String")
        edge.endpoint(topic="/info/in", made_by="native")
        edge.open("/info/in", "std_msgs/String")
        edge.ask("advertise", topic="/info/out", type="std_msgs/String")
        peer.subscribe("/info/out", "std_msgs/String")
        uri = until(lambda: master.call("lookupNode", "/midspan"), "the node is known")

        def topics() -> bool:
            node: Any
            with ServerProxy(uri) as node:
                _, _, connections = node.getBusInfo("/test")
                assert node.getBusStats("/test")[0] == 1
            return {c[4] for c in connections} == {"/info/in", "/info/out"}

        until(topics, "the bus info lists both connections")
