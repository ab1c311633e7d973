"""A client for the tests that implements ``foxglove.sdk.v1``, over a plain WebSocket.

Source: https://github.com/foxglove/foxglove-sdk, ``rust/foxglove/src/protocol``: JSON texts, and binary frames of an
opcode and little-endian numbers.
"""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable
from typing import Any, Self, TypeVar

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tests.peers.browser.page import TlsSocket
from tests.support.wait import until

T = TypeVar("T")

PROTOCOL = Subprotocol("foxglove.sdk.v1")
MESSAGE, CALL = 1, 2
"""Opcodes of a client's message and call; a server's message and reply are 1 and 3."""


class App:
    """One client of the server.

    Attributes:
        channels: the announced channels, by topic.
        services: the announced services, by name.
        messages: received messages, by topic: time in nanoseconds and bytes.
        texts: all other received texts.
    """

    def __init__(self, port: int, *, host: str = "127.0.0.1", query: str = "", **options: Any) -> None:
        self._stack = contextlib.ExitStack()
        tls = "s" if "ssl" in options else ""
        address = f"ws{tls}://{host}:{port}/{query}"
        options.setdefault("max_queue", None)
        join: Any = TlsSocket if tls else connect
        options |= {"subprotocols": [PROTOCOL], "max_size": None, "compression": None}
        self.socket: ClientConnection = self._stack.enter_context(join(address, **options))
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}
        self.texts: list[dict[str, Any]] = []
        self.replies: dict[int, bytes] = {}
        self._subscriptions: dict[int, str] = {}
        self._numbers = 0

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def read(self, seconds: float = 0.05) -> bool:
        """Read one frame, and return whether there was one."""
        try:
            frame = self.socket.recv(timeout=seconds)
        except TimeoutError:
            return False
        if isinstance(frame, str):
            self._text(json.loads(frame))
        elif frame[0] == MESSAGE:
            number, at = struct.unpack_from("<IQ", frame, 1)
            topic = self._subscriptions.get(number)
            if topic is not None:
                self.messages[topic].append((at, frame[13:]))
        elif frame[0] == 3:
            _, call, length = struct.unpack_from("<III", frame, 1)
            self.replies[call] = frame[13 + length :]
        return True

    def _text(self, texts: dict[str, Any]) -> None:
        if texts["op"] == "advertise":
            self.channels.update({entry["topic"]: entry for entry in texts["channels"]})
        elif texts["op"] == "unadvertise":
            removed = set(texts["channelIds"])
            self.channels = {topic: entry for topic, entry in self.channels.items() if entry["id"] not in removed}
        elif texts["op"] == "advertiseServices":
            self.services.update({entry["name"]: entry for entry in texts["services"]})
        elif texts["op"] == "unadvertiseServices":
            removed = set(texts["serviceIds"])
            self.services = {name: entry for name, entry in self.services.items() if entry["id"] not in removed}
        elif texts.get("message", "").startswith("Unknown channel ID"):
            # the SDK announces a channel before it accepts subscriptions to it, so a fast client repeats them
            for number, topic in self._subscriptions.items():
                self._ask(number, topic)
        else:
            self.texts.append(texts)

    def until(self, done: Callable[[], T | None], what: str, seconds: float = 15.0) -> T:
        """Read until ``done`` returns something true; waits are as long as in `tests.support.wait.until`."""

        def read() -> T | None:
            if not (value := done()):
                self.read()
            return value

        try:
            return until(read, what, seconds, every=0.0)
        except AssertionError as err:
            err.add_note(f"received: {self.texts[-5:]}")
            raise

    def channel(self, topic: str) -> dict[str, Any]:
        """Wait for the announcement of a topic."""
        return self.until(lambda: self.channels.get(topic), f"the channel {topic}")

    def subscribe(self, topic: str) -> int:
        """Subscribe to a topic; return the subscription's number."""
        self.channel(topic)
        self._numbers += 1
        self._subscriptions[self._numbers] = topic
        self.messages.setdefault(topic, [])
        self._ask(self._numbers, topic)
        return self._numbers

    def _ask(self, number: int, topic: str) -> None:
        if topic in self.channels:
            self.send(op="subscribe", subscriptions=[{"id": number, "channelId": self.channels[topic]["id"]}])

    def unsubscribe(self, number: int) -> None:
        self.send(op="unsubscribe", subscriptionIds=[number])

    def advertise(self, topic: str, type_name: str, encoding: str) -> int:
        """Start publishing, and return the channel's number."""
        self._numbers += 1
        channel = {"id": self._numbers, "topic": topic, "encoding": encoding, "schemaName": type_name}
        self.send(op="advertise", channels=[channel])
        return self._numbers

    def unadvertise(self, number: int) -> None:
        self.send(op="unadvertise", channelIds=[number])

    def publish(self, number: int, data: bytes) -> None:
        self.socket.send(struct.pack("<BI", MESSAGE, number) + data)

    def call(self, service: str, request: bytes, encoding: str = "cdr") -> int:
        """Call a service; return the call's number."""
        number = self.until(lambda: self.services.get(service), f"the service {service}")["id"]
        self._numbers += 1
        head = struct.pack("<BIII", CALL, number, self._numbers, len(encoding))
        self.socket.send(head + encoding.encode() + request)
        return self._numbers

    def sync(self) -> None:
        """Wait until the server has handled all requests so far; it replies in order."""
        self._numbers += 1
        request_id = f"sync {self._numbers}"
        self.send(op="getParameters", parameterNames=["nothing"], id=request_id)
        self.until(lambda: any(texts.get("id") == request_id for texts in self.texts), "the answer to the last request")

    def received(self, topic: str, count: int = 1) -> list[tuple[int, bytes]]:
        """Wait for ``count`` messages of a topic."""
        return self.until(
            lambda: self.messages[topic] if len(self.messages[topic]) >= count else None, f"{count} of {topic}"
        )

    def decoded(self, topic: str, number: int = -1) -> Any:
        """Return a message, decoded by mcap-ros2-support with the channel's own schema."""
        channel = self.channel(topic)
        schema = Schema(1, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
        decode = DecoderFactory().decoder_for(channel["encoding"], schema)
        assert decode is not None
        return decode(self.messages[topic][number][1])

    def read_until_cut(self) -> None:
        """Read until the server closes the connection, which raises `websockets.ConnectionClosed`."""
        self.until(lambda: False, "the end")

    def close(self) -> None:
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
