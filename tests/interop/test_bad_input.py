"""Invalid input from each network is refused with a reason and counted, while valid messages still cross."""

from __future__ import annotations

import contextlib
import json
import re
import socket
import struct
import urllib.error
import urllib.request
import xmlrpc.client
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from bridge.adapters.ros1.handshake import encode
from bridge.hub.wire.keys import pack_attachment, topic_key
from bridge.hub.zenoh_config import make_config, session_tree
from tests.peers.daemon.deployment import Deployment
from tests.peers.ros1.servers import publisher, until_closed
from tests.support.wait import until

pytestmark = pytest.mark.thorough

STRING = "std_msgs/String"
MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
MEGABYTE = 1 << 20
LIMIT = 16


class Siege:
    """A deployment, two topics whose messages must always cross, and hostile programs."""

    def __init__(self, deployment: Deployment, stack: contextlib.ExitStack) -> None:
        self.deployment, self.stack = deployment, stack
        self.ros1, self.ros2, self.zenoh = deployment.ros1(), deployment.ros2(), deployment.zenoh()
        self._out = {"ros1": self.ros1.advertise("/good1", STRING), "ros2": self.ros2.advertise("/good2", STRING)}
        self._in = {"ros1": self.ros2.subscribe("/good1", STRING), "ros2": self.ros1.subscribe("/good2", STRING)}
        self._number = 0
        self._names = 0
        self.check_flow()

    def check_flow(self) -> None:
        """Check that a message crosses in each direction between ROS 1 and ROS 2."""
        for side, sender, receiver in (("ros1", self.ros1, self.ros2), ("ros2", self.ros2, self.ros1)):
            self._number += 1
            message = {"data": f"good {self._number}"}

            def crosses(sender: Any = sender, sink: Any = receiver, side: str = side, message: Any = message) -> bool:
                sender.publish(self._out[side], message)
                return message in sink.wait(self._in[side], 100_000, 0.1)

            until(crosses, f"{message} crosses from {side}", 30)

    def name(self, word: str) -> str:
        """Return a unique topic name."""
        self._names += 1
        return f"/{word}{self._names}"

    def route(self, side: str, topic: str, direction: str, **drops: int) -> dict[str, Any]:
        """Return the route of a topic, once it has dropped at least these numbers of messages, by reason."""

        def counted() -> dict[str, Any] | None:
            route = self.deployment.route(side, topic, direction)
            return route if route and all(route["drops"][k] >= n for k, n in drops.items()) else None

        result = until(counted, f"{side} {direction} {topic} counts {drops}", 30, every=0.1)
        assert result is not None
        return result

    def refusal(self, topic: str) -> dict[str, Any]:
        """Return the decision that refuses a topic, once it is reported."""
        reported = lambda: [line for line in self.deployment.explain(topic) if line["decision"] == "refused"]  # noqa: E731
        return until(reported, f"{topic} is refused", 30, every=0.1)[0]

    def warning(self, topic: str) -> str:
        """Return the ros1 worker's warning about a topic."""
        reported = lambda: [w for w in self.deployment.worker("ros1").get("warnings", []) if w.startswith(f"{topic}:")]  # noqa: E731
        return str(until(reported, f"a warning about {topic}", 30, every=0.1)[0])

    def add_hostile_publisher(self, topic: str, serve: Callable[[socket.socket], None], type_: str = STRING) -> None:
        """Register a ROS 1 publisher of a topic with the real master; ``serve`` handles its connections."""
        uri = self.stack.enter_context(publisher(serve))
        self._names += 1
        node = f"/hostile{self._names}"
        with xmlrpc.client.ServerProxy(self.deployment.master.uri) as master:
            assert master.registerPublisher(node, topic, type_, uri)[0] == 1  # type: ignore[index]
            self.stack.callback(self._unregister, node, topic, uri)

    def _unregister(self, node: str, topic: str, uri: str) -> None:
        with xmlrpc.client.ServerProxy(self.deployment.master.uri) as master:
            master.unregisterPublisher(node, topic, uri)

    def session(self) -> zenoh.Session:
        """Open a plain zenoh session without Midspan."""
        tree = session_tree(f"tcp/127.0.0.1:{self.deployment.port}", shared_memory=False, max_payload=256 * MEGABYTE)
        session = zenoh.open(make_config(tree, None))
        self.stack.callback(session.close)
        return session


@pytest.fixture(scope="module")
def besieged(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Siege]:
    with Deployment(tmp_path_factory.mktemp("siege")) as deployment, contextlib.ExitStack() as stack:
        deployment.start(limits={"message": LIMIT})
        yield Siege(deployment, stack)


@pytest.fixture
def siege(besieged: Siege) -> Iterator[Siege]:
    """The deployment; after each test, messages of the two valid topics must still cross."""
    yield besieged
    besieged.check_flow()


def header(**fields: str) -> bytes:
    reported = {"callerid": "/hostile", "type": STRING, "md5sum": MD5, "message_definition": "string data\n"}
    return encode({**reported, **fields})


def sends(*parts: bytes) -> Callable[[socket.socket], None]:
    """Return a ``serve`` for `Siege.add_hostile_publisher`: it sends these bytes to each subscriber, then nothing."""

    def serve(sock: socket.socket) -> None:
        sock.recv(65536)
        for part in parts:
            sock.sendall(part)
        until_closed(sock)

    return serve


def frame(payload: bytes) -> bytes:
    return struct.pack("<I", len(payload)) + payload


def text(data: str) -> bytes:
    return frame(data.encode())


# -- ROS 1 -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("payload", "why"),
    [
        (b"\xff\xff\xff\xff", "announces 4294967295 bytes"),
        (struct.pack("<I", 8) + struct.pack("<I", 1000) + b"type", "truncated"),
        (struct.pack("<I", 9) + struct.pack("<I", 5) + b"hello", "no '='"),
        (encode({"callerid": "/hostile"}), "has no type"),
        (encode({"error": "go away"}), "go away"),
    ],
    ids=["huge", "field too long", "no equals", "no type", "error"],
)
def test_invalid_ros1_headers_are_reported_with_the_reason(siege: Siege, payload: bytes, why: str) -> None:
    topic = siege.name("header")
    siege.add_hostile_publisher(topic, sends(payload))
    # a connection may fail for another reason first, as this process serves it
    until(lambda: why in siege.warning(topic), f"the warning contains {why!r}", 30, every=0.1)


def test_invalid_ros1_messages_are_dropped_and_valid_ones_bridged(siege: Siege) -> None:
    """The messages end before their string does, are empty, or have trailing bytes."""
    topic = siege.name("lying")
    good = frame(text("good"))
    siege.add_hostile_publisher(
        topic, sends(header(latching="1"), frame(b"\xff\xff\xff\x7fabc"), frame(b""), frame(text("x") + b"!"), good)
    )
    route = siege.route("ros1", topic, "in", bad=3)
    assert "std_msgs/String" in route["error"]
    until(lambda: siege.route("ros1", topic, "in")["messages"] == 1, "the valid message after them crosses")


def test_an_impossible_ros1_length_is_reported(siege: Siege) -> None:
    topic = siege.name("endless")
    siege.add_hostile_publisher(topic, sends(header(), struct.pack("<I", 0xFFFFFFF0) + b"x"))
    assert "4294967280 bytes" in siege.route("ros1", topic, "in", bad=1)["error"]


def test_ros1_messages_above_the_limit_are_dropped_and_small_ones_bridged(siege: Siege) -> None:
    topic = siege.name("huge")
    siege.add_hostile_publisher(topic, sends(header(), frame(bytes(64 * MEGABYTE)), frame(text("small"))))
    route = siege.route("ros1", topic, "in", large=1)
    assert f"{64 * MEGABYTE} bytes, limits.message allows {LIMIT * MEGABYTE}" in route["error"]
    until(lambda: siege.route("ros1", topic, "in")["messages"] == 1, "the small message after it crosses")


LOOP = "=" * 80 + "\nMSG: loop_msgs/Loop\nloop_msgs/Loop again\n"


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"md5sum": "0" * 32}, "0" * 32),
        ({"type": "nowhere_msgs/Nothing", "md5sum": "1" * 32, "message_definition": ""}, "nowhere_msgs/Nothing"),
        ({"type": "loop_msgs/Loop", "md5sum": "*", "message_definition": "loop_msgs/Loop again\n"}, "contains itself"),
        ({"type": "loop_msgs/In", "md5sum": "*", "message_definition": f"loop_msgs/Loop a\n{LOOP}"}, "contains itself"),
        ({"type": "a_msgs/A", "md5sum": "2" * 32, "message_definition": "int8[] ]["}, "cannot read"),
        ({"type": "no type", "md5sum": "3" * 32, "message_definition": "int8 a"}, "no type"),
        ({"type": f"a_msgs/{'A' * 300}", "md5sum": "*", "message_definition": "int8 a"}, "AAAA"),
    ],
    ids=[
        "md5 differs",
        "nobody defines",
        "nests itself",
        "nests one that does",
        "no grammar",
        "no name",
        "endless name",
    ],
)
def test_topics_with_invalid_ros1_types_are_refused_with_the_reason(
    siege: Siege, fields: dict[str, str], why: str
) -> None:
    topic = siege.name("type")
    siege.add_hostile_publisher(topic, sends(header(**fields)))
    until(lambda: why in siege.refusal(topic)["why"], f"the refusal contains {why!r}", 30, every=0.1)
    explained = lambda: siege.deployment.command("explain", topic).stdout.replace("\n", " ")  # noqa: E731
    until(lambda: why in explained(), f"explain contains {why!r}", 30, every=0.1)


def test_ros1_names_with_illegal_characters_get_legal_hub_names(siege: Siege) -> None:
    topic = siege.name("1-a/*/é%?")
    siege.add_hostile_publisher(topic, sends(header(), frame(text("x"))))
    route = siege.route("ros1", topic, "in")
    assert re.fullmatch(r"/n1_a/_/___\d+", route["hub_topic"])


def test_hostile_ros1_subscribers_do_not_affect_others(siege: Siege) -> None:
    """Raw connections to the node: invalid headers, another md5, and a subscriber that is admitted and never reads."""
    topic = siege.name("outward")
    subscription = siege.ros1.subscribe(topic, STRING)
    out = siege.ros2.advertise(topic, STRING)
    siege.deployment.until_route("ros2", topic, "in")

    def crosses() -> bool:
        siege.ros2.publish(out, {"data": "x" * 100_000})
        return bool(siege.ros1.wait(subscription, 1, 0.2))

    until(crosses, "the node publishes", 30)
    with xmlrpc.client.ServerProxy(siege.deployment.master.uri) as master:
        uri = str(master.lookupNode("/test", "/midspan")[2])  # type: ignore[index]
    with xmlrpc.client.ServerProxy(uri) as node:
        _, host, port = node.requestTopic("/raw", topic, [["TCPROS"]])[2]  # type: ignore[index,misc]
    ask = {"callerid": "/raw", "topic": topic, "type": STRING, "md5sum": MD5}
    for text in (
        b"\xff\xff\xff\xff",
        struct.pack("<I", 5) + b"\1\2\3\4\5",
        encode({}),
        encode({**ask, "md5sum": "0" * 32}),
    ):
        with socket.create_connection((host, int(str(port))), timeout=20) as sock:
            sock.sendall(text)
            until(lambda sock=sock: sock.recv(65536) == b"", "the node disconnects", 20)  # type: ignore[misc]
    with socket.create_connection((host, int(str(port)))) as deaf:
        deaf.sendall(encode(ask) + b"\xff" * 1000)
        for number in range(40):
            siege.ros2.publish(out, {"data": f"{number}" + "x" * 400_000})
        seen = lambda: any(m["data"].startswith("39x") for m in siege.ros1.wait(subscription, 100_000, 0.2))  # noqa: E731
        until(seen, "the other subscriber keeps receiving messages", 30)


def test_hostile_requests_to_the_ros1_node_are_rejected(siege: Siege) -> None:
    with xmlrpc.client.ServerProxy(siege.deployment.master.uri) as master:
        uri = str(master.lookupNode("/test", "/midspan")[2])  # type: ignore[index]
    bomb = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10 if n else "lol"}">' for n in range(10))
    junk = "<value><array><data>" * 5000
    call = (
        "<?xml version='1.0'?>{}<methodCall><methodName>publisherUpdate</methodName>"
        "<params><param>{}</param></params></methodCall>"
    )
    bodies = (call.format(f"<!DOCTYPE x [{bomb}]>", "<value>&a9;</value>"), call.format("", junk), "\0\1", "<a>", "")
    for body in bodies:
        request = urllib.request.Request(uri, body.encode())
        with contextlib.suppress(urllib.error.URLError), urllib.request.urlopen(request, timeout=20) as answer:
            assert b"fault" in answer.read()
    # a request that announces 100 GB is rejected at once, before its body is read
    host, port = uri.removeprefix("http://").rstrip("/").split(":")
    with socket.create_connection((host, int(port)), timeout=20) as sock:
        sock.sendall(b"POST / HTTP/1.1\r\nContent-Length: 100000000000\r\n\r\n<a>")
        assert b" 413 " in sock.recv(65536).split(b"\r\n")[0]


# -- ROS 2 -------------------------------------------------------------------------------------------------------------


def test_invalid_cdr_on_ros2_is_dropped_and_valid_messages_bridged(siege: Siege) -> None:
    """CDR that is truncated, big-endian, followed by other bytes or has an invalid length, and bytes that are not CDR.

    Each is published by a real rclpy publisher of raw bytes.
    """
    topic = siege.name("raw")
    out = siege.ros2.advertise(topic, STRING)
    subscription = siege.zenoh.subscribe(topic, STRING)
    siege.deployment.until_route("ros2", topic, "in")
    good = b"\0\1\0\0" + struct.pack("<I", 5) + b"good\0"
    bad = {
        "truncated": good[:-3],
        "big-endian": b"\0\0\0\0" + struct.pack(">I", 5) + b"good\0",
        "rubbish": good + b"rubbish behind the message",
        "an invalid length": b"\0\1\0\0\xff\xff\xff\xffgood\0",
        "no CDR": b'{"a": 1}',
    }  # fmt: skip
    for count, (label, payload) in enumerate(bad.items(), 1):
        siege.ros2.ask("publish_raw", id=out, hex=payload.hex())
        route = siege.route("ros2", topic, "in", bad=count)
        assert route["drops"]["bad"] == count, label
        assert "std_msgs/msg/String" in route["error"], label

    def crosses() -> list[dict[str, Any]]:  # the first one may precede the route to the subscription
        siege.ros2.ask("publish_raw", id=out, hex=good.hex())
        return siege.zenoh.wait(subscription, 1, 0.2)

    received = until(crosses, "the valid message after them crosses")
    assert all(message == {"data": "good"} for message in received), "only the valid message crosses"
    # a busy worker may not respond to the command in time
    until(lambda: "bad 5" in siege.deployment.command("explain", topic).stdout, "explain has the count")


def test_ros2_messages_above_the_limit_are_dropped_and_small_ones_bridged(siege: Siege) -> None:
    topic = siege.name("raw")
    out = siege.ros2.advertise(topic, STRING)
    siege.deployment.until_route("ros2", topic, "in")
    size = 64 * MEGABYTE
    siege.ros2.ask("publish_raw", id=out, hex=(b"\0\1\0\0" + struct.pack("<I", size)).hex(), zeros=size)
    route = siege.route("ros2", topic, "in", large=1)
    assert "limits.message" in route["error"]
    siege.ros2.publish(out, {"data": "small"})
    until(lambda: siege.route("ros2", topic, "in")["messages"] == 1, "a small message crosses")


# -- zenoh -------------------------------------------------------------------------------------------------------------


def test_invalid_samples_on_the_hub_are_dropped_and_valid_ones_bridged(siege: Siege) -> None:
    """Missing or invalid attachments, invalid CDR and too large samples are refused toward ROS 1 and ROS 2."""
    topic = siege.name("hub")
    subscription = siege.ros1.subscribe(topic, STRING)
    out = siege.zenoh.advertise(topic, STRING)
    siege.zenoh.hub_publish_until(out, {"data": "probe"}, lambda: siege.ros1.wait(subscription, 1, 0.2))
    key = topic_key(0, topic, "std_msgs/msg/String", siege.zenoh.registry.ros2("std_msgs/msg/String").type_id)
    # blocking, because each sample is counted, and zenoh would drop some on a busy machine
    raw = siege.session().declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    good = b"\0\1\0\0" + struct.pack("<I", 5) + b"good\0"
    sides = ("ros1", "ros2")

    def linked() -> bool:
        raw.put(good)
        return all(siege.route(side, topic, "out")["drops"]["bad"] for side in sides)

    until(linked, "the raw session reaches both workers", 20)

    def refused(put: Callable[[], None], reason: str, why: str) -> None:
        before = [siege.route(side, topic, "out")["drops"][reason] for side in sides]
        put()
        for side, count in zip(sides, before, strict=True):

            def counted(side: str = side, least: int = count + 1) -> bool:  # a sample from before may be counted first
                return why in siege.route(side, topic, "out", **{reason: least})["error"]

            until(counted, f"{side} reports {why!r}", 30, every=0.1)

    refused(lambda: raw.put(good), "bad", "without rmw_zenoh's attachment")
    refused(lambda: raw.put(good, attachment=b"nonsense"), "bad", "attachment of 8 bytes")
    refused(lambda: raw.put(good, attachment=b"\xff" * 33), "bad", "GID of 255 bytes")
    for junk in (b"", b"\0\1\0\0\xff\xff\xff\x7f", good[:-2], b"\0\0\0\0\0\0\0\5good\0", good + bytes(100)):
        refused(lambda junk=junk: siege.zenoh.publish_raw(out, junk), "bad", "std_msgs/msg/String")  # type: ignore[misc]
    huge = bytes(64 * MEGABYTE)
    attached = pack_attachment(1, 1, bytes(16))
    refused(lambda: raw.put(huge, attachment=attached), "large", f"{64 * MEGABYTE} bytes")
    siege.zenoh.publish(out, {"data": "good"})
    until(lambda: {"data": "good"} in siege.ros1.wait(subscription, 100_000, 0.2), "a valid sample crosses")


def test_invalid_tokens_on_the_hub_are_ignored_and_reported(siege: Siege) -> None:
    session = siege.session()
    good = topic_token(siege, "/tokens", "std_msgs::msg::dds_::String_", "RIHS01_" + "ab" * 32)
    tokens = [
        session.liveliness().declare_token(key)
        for key in (
            "@ros2_lv/0/x",
            "@ros2_lv/0/1/2/3/XX/%/%/a/%t/a::msg::dds_::B_/RIHS01_00/::,1:,:,:,,",
            "@ros2_lv/0/1/2/3/MP/%/%/a/%t/no type/RIHS01_00/::,1:,:,:,,",
            "@ros2_lv/0/1/2/3/MP/%/%/a/%t/a::msg::dds_::B_/RIHS01_00/no:qos",
            "@ros2_lv/0/" + "/".join("x" * 500 for _ in range(11)),
            "@midspan/0/origin/x",
            good.replace("%tokens", "%a b%é"),
            good.replace("%tokens", "%%%"),
            good.replace("%tokens", "%hash").replace("ab" * 32, "nonsense"),
            topic_token(siege, "/undefined", "nowhere_msgs::msg::dds_::Nothing_", "RIHS01_" + "ab" * 32),
            good,
        )
    ]
    assert "RIHS01_abab" in siege.refusal("/tokens")["why"]
    assert "RIHS01_nonsense" in siege.refusal("/hash")["why"]
    assert "nowhere_msgs" in siege.refusal("/undefined")["why"]
    for side in ("ros1", "ros2"):

        def reported(side: str = side) -> bool:
            return "liveliness tokens on the hub were ignored" in str(siege.deployment.worker(side).get("warnings"))

        until(reported, f"{side} reports the tokens", 30, every=0.1)
    for token in tokens:
        token.undeclare()  # type: ignore[no-untyped-call]
    removed = lambda: not siege.deployment.explain("/undefined")  # noqa: E731
    until(removed, "withdrawn tokens are dropped", 20, every=0.1)


def topic_token(siege: Siege, topic: str, dds_type: str, type_hash: str) -> str:
    return f"@ros2_lv/0/{'7' * 32}/0/9/MP/%/%/raw/{topic.replace('/', '%')}/{dds_type}/{type_hash}/::,7:,:,:,,"


def test_invalid_control_queries_get_a_reply_and_the_control_plane_still_responds(siege: Siege) -> None:
    """The replies to any payload have a value or an error, and the control plane still responds afterwards."""
    session = siege.session()
    for payload in (
        b"",
        b"nonsense",
        b"[" * 5000,
        b"[]",
        b"\xff\xff",
        b'{"topic": ' + b"1" * 5000 + b"}",
        bytes(2 * MEGABYTE),
    ):
        for verb in ("status", "explain", "tap", "type"):
            replies = list(session.get(f"@midspan/0/*/*/{verb}", payload=payload, timeout=5.0))
            assert all(
                "value" in (text := json.loads(r.ok.payload.to_bytes())) or text["error"] for r in replies if r.ok
            )
    sides = lambda: {worker.get("side") for worker in siege.deployment.status()}  # noqa: E731
    until(lambda: sides() >= {"ros1", "ros2"}, "both workers respond", 30)
