"""A bare relay: one half of a bridge between ROS 1 and ROS 2, without Midspan in the path of a message.

It is controlled by JSON lines like the ends (`benchmarks.latency.end`). The ROS 1 half reads all connections on one
thread, and sends on zenoh's thread; the ROS 2 half is an end (`benchmarks.latency.ros2_end`). Both are connected by a
direct link of zenoh sessions that are configured like the daemon's. It relays only strings, converted by hand, without
type lookups, checks, numbers, counters, queues or caches.

Usage: ``python -m benchmarks.latency.relay ros1|ros2 ENDPOINT MASTER``; the ROS 1 half listens on the zenoh endpoint.
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

from benchmarks.latency.end import reply
from benchmarks.latency.zenoh_end import ZenohEnd
from bridge.adapters.ros1.handshake import connect, encode, read_header
from bridge.adapters.ros1_peers import DeadlineSocket

OnMessage = Callable[[bytes], None]

NODE = "/bare_relay"
TYPE = {"type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1", "message_definition": "string data\n"}
"""Connection header of every topic, with the md5 of std_msgs/String."""

_CDR = bytes([0, 1, 0, 0])
_LENGTH = struct.Struct("<I")
_CHUNK = 65536
_SECONDS = 10.0


class Ros1Half:
    """A ROS 1 node on plain sockets."""

    def __init__(self, link: ZenohEnd, master: str) -> None:
        self._link = link
        self._master = xmlrpc.client.ServerProxy(master)
        self._poll = select.epoll()
        self._incoming: dict[int, tuple[socket.socket, OnMessage]] = {}
        self._senders: dict[str, OnMessage] = {}
        self._outgoing: dict[str, list[socket.socket]] = defaultdict(list)
        self._tcp = socket.create_server(("127.0.0.1", 0), backlog=1024)
        self._api = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        methods: dict[str, Any] = {"publisherUpdate": self._publishers, "requestTopic": self._port}
        for name, method in methods.items():
            self._api.register_function(method, name)
        for run in (self._accept, self._read, self._api.serve_forever):
            threading.Thread(target=run, daemon=True).start()

    def relay(self, inward: Sequence[str], outward: Sequence[str]) -> None:
        """Relay the topics ``inward`` from ROS 1 and ``outward`` to ROS 1."""
        address = f"http://127.0.0.1:{self._api.server_address[1]}/"
        for topic in inward:
            self._senders[topic] = self._link.publisher(topic, TYPE["type"])[0]
            self._master.registerSubscriber(NODE, topic, TYPE["type"], address)
        for topic in outward:
            self._link.listen(topic, TYPE["type"], self._writer(self._outgoing[topic]))
            self._master.registerPublisher(NODE, topic, TYPE["type"], address)

    def _publishers(self, _caller: str, topic: str, uris: list[str]) -> list[Any]:
        threading.Thread(target=self._connect, args=(topic, uris), daemon=True).start()
        return [1, "", 0]

    def _port(self, _caller: str, _topic: str, _protocols: Any) -> list[Any]:
        return [1, "", ["TCPROS", "127.0.0.1", self._tcp.getsockname()[1]]]

    def _connect(self, topic: str, uris: list[str]) -> None:
        for uri in uris:
            sock = _plain(connect(NODE, uri, topic, _SECONDS)[0])
            self._incoming[sock.fileno()] = sock, self._senders[topic]
            self._poll.register(sock.fileno(), select.EPOLLIN)

    def _accept(self) -> None:
        while True:
            plain, _ = self._tcp.accept()
            sock = DeadlineSocket(fileno=plain.detach())
            header = read_header(sock)
            sock.sendall(encode({"callerid": NODE, "topic": header["topic"], "latching": "0", **TYPE}))
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._outgoing[header["topic"]].append(_plain(sock))

    def _read(self) -> None:
        while True:
            for number, _ in self._poll.poll(maxevents=64):
                sock, send = self._incoming[number]
                data = sock.recv(_CHUNK)  # these are whole messages, because small messages are sent in one piece
                if not data:
                    self._poll.unregister(number)
                at = 0
                while at < len(data):
                    (size,) = _LENGTH.unpack_from(data, at)
                    send(_CDR + _LENGTH.pack(size - 3) + data[at + 8 : at + 4 + size] + b"\0")
                    at += 4 + size

    @staticmethod
    def _writer(socks: list[socket.socket]) -> OnMessage:
        def write(cdr: bytes) -> None:
            (size,) = _LENGTH.unpack_from(cdr, 4)
            message = _LENGTH.pack(size + 3) + _LENGTH.pack(size - 1) + cdr[8 : 7 + size]
            for sock in socks:
                sock.sendall(message)

        return write


def _plain(sock: DeadlineSocket) -> socket.socket:
    """Return a connection's socket without a deadline."""
    plain = socket.socket(fileno=sock.detach())
    plain.settimeout(None)
    return plain


def _ros2_half(link: ZenohEnd) -> Callable[[Sequence[str], Sequence[str]], None]:
    """Return a function that relays topics ``outward`` from ROS 2 and ``inward`` to ROS 2."""
    from benchmarks.latency.ros2_end import Ros2End  # needs rclpy

    end, type_ = Ros2End(), "std_msgs/msg/String"

    def relay(inward: Sequence[str], outward: Sequence[str]) -> None:
        for topic in outward:
            link.listen(topic, type_, end.publisher(topic, type_)[0])
        for topic in inward:
            end.listen(topic, type_, link.publisher(topic, type_)[0])

    return relay


def main() -> None:
    kind, endpoint, master = sys.argv[1:]
    listens = kind == "ros1"
    link = ZenohEnd(
        None if listens else endpoint, shared_memory=True, listen=endpoint if listens else "", express=False
    )
    relay = Ros1Half(link, master).relay if kind == "ros1" else _ros2_half(link)
    reply("ready")
    for line in sys.stdin:
        command = json.loads(line)
        relay(command["inward"], command["outward"])
        reply("relaying")
    link.close()


if __name__ == "__main__":
    main()
