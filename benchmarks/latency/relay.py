"""A bare relay: one half of a bridge between ROS 1 and ROS 2 with nothing of Midspan's on the way of a message.

It obeys JSON lines as the ends do (`benchmarks.latency.end`). The half of ROS 1 reads all its connections on one thread
and writes from zenoh's; that of ROS 2 takes by `benchmarks.latency.taker`. Between the two is a direct link of zenoh
sessions that are configured as the daemon's own. Strings alone cross, converted by hand; no type is looked up, nothing
is checked, numbered, counted, queued or kept.

Usage: ``python -m benchmarks.latency.relay ros1|ros2 ENDPOINT MASTER``; the one of ROS 1 listens on the zenoh endpoint.
"""

from __future__ import annotations

import json
import select
import socket
import struct
import sys
import threading
import xmlrpc.client
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import zenoh

from benchmarks.latency.end import tell
from bridge.adapters.ros1.deadline import DeadlineSocket
from bridge.adapters.ros1.handshake import connect, encode, read_header
from bridge.hub.attachment import SIZE
from bridge.hub.settings import MAX_PAYLOAD, make_config, session_tree

Heard = Callable[[bytes], None]

NODE = "/bare_relay"
TYPE = {"type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1", "message_definition": "string data\n"}
"""Of every topic; the md5 is that of std_msgs/String."""

_CDR = bytes([0, 1, 0, 0])
_LENGTH = struct.Struct("<I")
_CHUNK = 65536
_SECONDS = 10.0


class Link:
    """The zenoh session of one half."""

    def __init__(self, endpoint: str, *, listens: bool) -> None:
        tree = session_tree(None if listens else endpoint, shared_memory=True, max_payload=MAX_PAYLOAD)
        if listens:
            tree["listen"] = {"endpoints": [endpoint]}
        self._session = zenoh.open(make_config(tree, None))
        self._kept: list[Any] = []

    def sender(self, topic: str) -> Heard:
        """What sends a message to the other half."""
        publisher = self._session.declare_publisher(
            topic.strip("/"), congestion_control=zenoh.CongestionControl.DROP, express=False
        )
        self._kept.append(publisher)
        attached = bytes(SIZE)
        return lambda payload: publisher.put(payload, attachment=attached)

    def listen(self, topic: str, heard: Heard) -> None:
        """Call ``heard`` on zenoh's thread with each message of the other half."""
        handler: Any = zenoh.handlers.Callback(lambda sample: heard(sample.payload.to_bytes()), indirect=False)
        self._kept.append(self._session.declare_subscriber(topic.strip("/"), handler))

    def close(self) -> None:
        """End the session."""
        self._session.close()  # type: ignore[no-untyped-call]


class Ros1Half:
    """A ROS 1 node of bare sockets."""

    def __init__(self, link: Link, master: str) -> None:
        self._link = link
        self._master = xmlrpc.client.ServerProxy(master)
        self._poll = select.epoll()
        self._incoming: dict[int, tuple[DeadlineSocket, Heard]] = {}
        self._senders: dict[str, Heard] = {}
        self._outgoing: dict[str, list[socket.socket]] = defaultdict(list)
        self._tcp = socket.create_server(("127.0.0.1", 0), backlog=1024)
        self._api = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        methods: dict[str, Any] = {"publisherUpdate": self._publishers, "requestTopic": self._port}
        for name, method in methods.items():
            self._api.register_function(method, name)
        for run in (self._accept, self._read, self._api.serve_forever):
            threading.Thread(target=run, daemon=True).start()

    def relay(self, inward: Sequence[str], outward: Sequence[str]) -> None:
        """Carry topics from ROS 1, and to it."""
        address = f"http://127.0.0.1:{self._api.server_address[1]}/"
        for topic in inward:
            self._senders[topic] = self._link.sender(topic)
            self._master.registerSubscriber(NODE, topic, TYPE["type"], address)
        for topic in outward:
            self._link.listen(topic, self._writer(self._outgoing[topic]))
            self._master.registerPublisher(NODE, topic, TYPE["type"], address)

    def _publishers(self, _caller: str, topic: str, uris: list[str]) -> list[Any]:
        threading.Thread(target=self._connect, args=(topic, uris), daemon=True).start()
        return [1, "", 0]

    def _port(self, _caller: str, _topic: str, _protocols: Any) -> list[Any]:
        return [1, "", ["TCPROS", "127.0.0.1", self._tcp.getsockname()[1]]]

    def _connect(self, topic: str, uris: list[str]) -> None:
        for uri in uris:
            sock, _ = connect(NODE, uri, topic, _SECONDS)
            sock.deadline = float("inf")
            self._incoming[sock.fileno()] = sock, self._senders[topic]
            self._poll.register(sock.fileno(), select.EPOLLIN)

    def _accept(self) -> None:
        while True:
            plain, _ = self._tcp.accept()
            sock = DeadlineSocket(fileno=plain.detach())
            header = read_header(sock)
            sock.sendall(encode({"callerid": NODE, "topic": header["topic"], "latching": "0", **TYPE}))
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._outgoing[header["topic"]].append(socket.socket(fileno=sock.detach()))

    def _read(self) -> None:
        while True:
            for number, _ in self._poll.poll(maxevents=64):
                sock, send = self._incoming[number]
                data = socket.socket.recv(sock, _CHUNK, socket.MSG_DONTWAIT)
                if not data:
                    self._poll.unregister(number)
                at = 0
                while at < len(data):
                    (size,) = _LENGTH.unpack_from(data, at)
                    send(_CDR + _LENGTH.pack(size - 3) + data[at + 8 : at + 4 + size] + b"\0")
                    at += 4 + size

    @staticmethod
    def _writer(socks: list[socket.socket]) -> Heard:
        def write(cdr: bytes) -> None:
            (size,) = _LENGTH.unpack_from(cdr, 4)
            message = _LENGTH.pack(size + 3) + _LENGTH.pack(size - 1) + cdr[8 : 7 + size]
            for sock in socks:
                sock.sendall(message)

        return write


class Ros2Half:
    """A ROS 2 node without an executor."""

    def __init__(self, link: Link) -> None:
        import rclpy

        from benchmarks.latency.taker import Taker

        rclpy.init()
        self._link, self._taker = link, Taker()
        self._node = rclpy.create_node("bare_relay", enable_rosout=False, start_parameter_services=False)

    def relay(self, inward: Sequence[str], outward: Sequence[str]) -> None:
        """Carry topics from ROS 2, and to it."""
        from rclpy.qos import QoSProfile

        from benchmarks.latency.ros2_end import DEPTH
        from benchmarks.latency.taker import message_class

        type_, qos = "std_msgs/msg/String", QoSProfile(depth=DEPTH)  # type: ignore[no-untyped-call]
        for topic in outward:
            self._link.listen(topic, self._node.create_publisher(message_class(type_), topic, qos).publish)
        for topic in inward:
            self._taker.listen(self._node, topic, type_, qos, self._link.sender(topic))


def main() -> None:
    """Obey until the input ends."""
    kind, endpoint, master = sys.argv[1:]
    link = Link(endpoint, listens=kind == "ros1")
    half = Ros1Half(link, master) if kind == "ros1" else Ros2Half(link)
    tell("ready")
    for line in sys.stdin:
        command = json.loads(line)
        half.relay(command["inward"], command["outward"])
        tell("relaying")
    link.close()


if __name__ == "__main__":
    main()
