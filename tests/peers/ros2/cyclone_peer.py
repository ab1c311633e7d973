"""A Cyclone DDS program that a test drives with JSON lines, as in `tests.peers.peer`; it uses the `cyclonedds` wheel.

Payloads are CDR in hex, with their encapsulation header, so the program needs no message packages. Like
rmw_cyclonedds_cpp, its readers accept payloads of any size, and requests and replies carry 16 bytes after the
encapsulation header: the client's id and the number of the request (rmw_cyclonedds_cpp, serdata.hpp).

Commands: ``advertise`` topic, type, type_hash ("": none), latched -> id; ``advertise_raw`` the same with names as in
DDS; ``subscribe`` topic, type -> id; ``publish`` id, payload; ``matched`` id -> count of a publisher's readers;
``wait`` id, count, seconds -> payloads; ``serve`` service, type, reply -> id; ``requests`` id -> payloads of all
requests as received; ``call`` service, type, request -> id, once a server has matched; ``result`` id, seconds -> reply
("" without one); ``act`` action, type, result -> id: three services and two topics; each goal is accepted, ``result``
is the reply to requests for its result, and a request to cancel is rejected; ``gid`` id -> gid of a writer. The
program's argument is the participant's user data.
Types are spelled ``package/Name`` for topics and services alike, ``package/action/Name_Feedback`` for parts of actions.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import os
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cyclonedds.core import Listener
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import uint8
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.commands import Commands, Record, only_answers, serve
from tests.support.wait import until

HEADER = slice(4, 20)
ACCEPTED = b"\0\1\0\0" + b"\1\0\0\0" + bytes(8)
"""Reply to ``send_goal``: accepted, and a time of zero."""

REJECTED = b"\0\1\0\0" + b"\1\0\0\0" + bytes(4)
"""Reply to ``cancel_goal``: its return code ERROR_REJECTED, and no goal."""
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100))
LATCHED = Qos(Policy.Durability.TransientLocal, base=RELIABLE)


class Bytes(bytes):
    """A payload, to which the wheel can add ``sample_info``."""


def raw_type(name: str) -> Any:
    """Return a type with this DDS name, whose samples are bytes."""

    @dataclass
    class Raw(IdlStruct, typename=name):
        byte: uint8

    def serialize(self: Any, *_args: Any, **_options: Any) -> bytes:
        payload: bytes = self.byte
        return payload

    Raw.serialize = serialize  # type: ignore[method-assign]
    Raw.deserialize = staticmethod(lambda data, *_args, **_options: Bytes(data))  # type: ignore[method-assign,assignment]
    return Raw


def dds_type(name: str, kind: str) -> str:
    """Return ``package::KIND::dds_::Name_`` for a type's name; the kind is ``kind`` unless the name has one."""
    package, *middle, short = name.split("/")
    return f"{package}::{middle[0] if middle else kind}::dds_::{short}_"


class Reader(Listener):  # type: ignore[misc]
    """A reader that stores all payloads, and passes each to ``received``."""

    def __init__(self, peer: Peer, topic: str, type_: str, qos: Qos, received: Callable[[bytes], None] = len) -> None:
        super().__init__()
        self.record = Record()
        self._received = received
        self.end = DataReader(peer.participant, peer.topic(topic, type_), qos=qos, listener=self)

    def on_data_available(self, reader: Any) -> None:
        """Store the samples that have arrived; runs on a thread of Cyclone DDS."""
        for payload in reader.take(N=1000):
            if isinstance(payload, Bytes):
                self.record.add(bytes(payload))
                self._received(bytes(payload))


class Writer:
    """A writer of payloads."""

    def __init__(self, peer: Peer, topic: str, type_: str, qos: Qos) -> None:
        described = peer.topic(topic, type_)
        self._make = described.data_type
        self.end = DataWriter(peer.participant, described, qos=qos)

    def write(self, payload: bytes) -> None:
        """Publish one payload."""
        self.end.write(self._make(byte=payload))

    def matched(self) -> int:
        """Return the number of matched readers."""
        return len(self.end.get_matched_subscriptions())

    def drop(self) -> None:
        """Close the writer; the participant stays."""
        del self.end


class Server:
    """A service that sends the same reply to each request, with the request's header; b"" sends no reply."""

    def __init__(self, peer: Peer, service: str, type_: str, reply: bytes) -> None:
        self._reply = reply
        self._writer = Writer(peer, f"rr{service}Reply", dds_type(f"{type_}_Response", "srv"), RELIABLE)
        self.reader = Reader(peer, f"rq{service}Request", dds_type(f"{type_}_Request", "srv"), RELIABLE, self._answer)

    def _answer(self, request: bytes) -> None:
        if self._reply and len(request) >= HEADER.stop:
            self._writer.write(self._reply[:4] + request[HEADER] + self._reply[4:])


class Client:
    """One service call."""

    def __init__(self, peer: Peer, service: str, type_: str) -> None:
        self._header = os.urandom(8) + struct.pack("<q", 1)
        self._reader = Reader(peer, f"rr{service}Reply", dds_type(f"{type_}_Response", "srv"), RELIABLE)
        self.writer = Writer(peer, f"rq{service}Request", dds_type(f"{type_}_Request", "srv"), RELIABLE)

    def call(self, request: bytes) -> None:
        """Send the request once a server has matched."""
        until(self.writer.matched, "a server has matched", 30)
        self.writer.write(request[:4] + self._header + request[4:])

    def reply(self, seconds: float) -> bytes:
        """Return the reply without its header, or b"" if none arrives."""
        end = time.monotonic() + seconds
        count = 0
        while True:
            payloads = self._reader.record.wait(count + 1, max(0.0, end - time.monotonic()))
            matching = [payload for payload in payloads if payload[HEADER] == self._header]
            if matching or len(payloads) == count:
                return matching[0][:4] + matching[0][HEADER.stop :] if matching else b""
            count = len(payloads)


class Peer(Commands):
    """The participant, and the commands that use it."""

    def __init__(self, domain: int, user_data: str = "") -> None:
        super().__init__()
        self.participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(user_data.encode())))
        self._topics: dict[str, Topic] = {}

    def topic(self, name: str, type_: str) -> Topic:
        """Return the topic, which is created once."""
        if name not in self._topics:
            self._topics[name] = Topic(self.participant, name, raw_type(type_))
        return self._topics[name]

    def advertise(self, topic: str, type: str, type_hash: str = "", latched: bool = False) -> dict[str, Any]:
        qos = LATCHED if latched else RELIABLE
        hashed = Qos(Policy.Userdata(f"typehash={type_hash};".encode()), base=qos)
        return self.add(Writer(self, f"rt{topic}", dds_type(type, "msg"), hashed if type_hash else qos))

    def advertise_raw(self, topic: str, type: str, latched: bool = False) -> dict[str, Any]:
        return self.add(Writer(self, topic, type, LATCHED if latched else RELIABLE))

    def subscribe(self, topic: str, type: str) -> dict[str, Any]:
        return self.add(Reader(self, f"rt{topic}", dds_type(type, "msg"), RELIABLE))

    def publish(self, id: int, payload: str) -> dict[str, Any]:
        self.parts[id].write(bytes.fromhex(payload))
        return {}

    def gid(self, id: int) -> dict[str, Any]:
        return {"gid": self.parts[id].end.guid.hex}

    def matched(self, id: int) -> dict[str, Any]:
        return {"count": self.parts[id].matched()}

    def wait(self, id: int, count: int, seconds: float) -> dict[str, Any]:
        return {"payloads": [payload.hex() for payload in self.parts[id].record.wait(count, seconds)]}

    def serve(self, service: str, type: str, reply: str) -> dict[str, Any]:
        return self.add(Server(self, service, type, bytes.fromhex(reply)))

    def requests(self, id: int) -> dict[str, Any]:
        server = self.parts[id]
        servers = server if isinstance(server, list) else [server]
        return {"payloads": [request.hex() for served in servers for request in served.reader.record.wait(0, 0)]}

    def act(self, action: str, type: str, result: str) -> dict[str, Any]:
        services = {
            "send_goal": (f"{type}_SendGoal", ACCEPTED),
            "get_result": (f"{type}_GetResult", bytes.fromhex(result)),
            "cancel_goal": ("action_msgs/CancelGoal", REJECTED),
        }
        prefix = f"{action}/_action/"
        servers = [Server(self, prefix + name, part, reply) for name, (part, reply) in services.items()]
        self.add(Writer(self, f"rt{prefix}feedback", dds_type(f"{type}_FeedbackMessage", "msg"), RELIABLE))
        self.add(Writer(self, f"rt{prefix}status", dds_type("action_msgs/GoalStatusArray", "msg"), LATCHED))
        return self.add(servers)

    def call(self, service: str, type: str, request: str) -> dict[str, Any]:
        client = Client(self, service, type)
        client.call(bytes.fromhex(request))
        return self.add(client)

    def result(self, id: int, seconds: float) -> dict[str, Any]:
        return {"reply": self.parts[id].reply(seconds).hex()}


def main() -> None:
    """Execute the commands from standard input until it ends."""
    answers = only_answers()
    serve(Peer(int(os.environ["ROS_DOMAIN_ID"]), *sys.argv[1:]), answers)


if __name__ == "__main__":
    main()
