"""YARP programs for tests: ports like ``/topic+@/node_1``, whose messages `yarp_compat.rosmsg` encodes and decodes.

`yarp_compat.rosmsg` implements the layout independently of the bridge's converters.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bridge.messages.registry import Registry
from tests.peers.commands import Record
from tests.support.ports import free_port
from yarp_compat.naming import connections
from yarp_compat.naming.client import KEEPER, NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.os.ports.nested import LATCHED, PUBLISHER, SUBSCRIBER, NestedName
from yarp_compat.ports.connections import ConnectionEvent
from yarp_compat.ports.message import PortMessage as PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.rosmsg.library import MessageLibrary
from yarp_compat.rosmsg.message import Message, TickTime

PATIENT = 40.0
"""Seconds for the answer to a command of a test's client: the process may stall meanwhile."""


class Names:
    """A name server on a free port, with a client."""

    def __init__(self) -> None:
        self.address = Address("127.0.0.1", free_port(room=20))
        self.client = NameClient(self.address, timeout=PATIENT)
        self._server: NameServer | None = None
        self.start()

    @property
    def endpoint(self) -> str:
        """Return the address as ``host:port``, as in the configuration."""
        return f"{self.address.host}:{self.address.port}"

    def start(self) -> None:
        self._server = NameServer(self.address.host, self.address.port, gc_seconds=0).open()

    def stop(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.close()


class Definitions(MessageLibrary):
    """Message definitions from the bridge's registry."""

    def __init__(self, folders: tuple[Path, ...]) -> None:
        super().__init__({})
        registry = Registry(folders=folders)
        self.ask = lambda name: registry.ros1(name).definition


class YarpProgram:
    """A program that publishes and subscribes to topics, with one port per endpoint."""

    def __init__(self, naming: NameClient, node: str, definitions: Definitions) -> None:
        self._naming, self._node, self._definitions = naming, node, definitions
        self._ports: dict[int, PortCore] = {}
        self._types: dict[int, type[Message]] = {}
        self._received: dict[int, Record] = {}
        self._last: dict[int, list[Any]] = {}
        self._joined: dict[int, Counter[str]] = {}  # connections whose readers have received the last latched message
        self._lock = threading.Lock()
        self._ids = itertools.count(1)

    def advertise(self, topic: str, type_: str, *, latched: bool = False, **_: Any) -> int:
        number = next(self._ids)
        if latched:
            self._last[number] = []
        core = self._open(number, topic, PUBLISHER, type_)
        if latched:
            self._naming.set_property(core.name, LATCHED, "true")
        return number

    def subscribe(self, topic: str, type_: str, *, port: str = "", **_: Any) -> int:
        """Receive a topic; ``port``: a name that does not tell the topic."""
        number = next(self._ids)
        self._received[number] = Record()
        self._open(number, topic, SUBSCRIBER, type_, port)
        return number

    def _open(self, number: int, topic: str, role: str, type_: str, port: str = "") -> PortCore:
        self._types[number] = self._definitions.get(type_)
        core = self._ports[number] = PortCore(
            port or NestedName(topic, f"{self._node}_{number}", role).port,
            naming=self._naming,
            on_message=lambda message: self._on_message(number, message),
            on_event=lambda event: self._on_connection(number, event),
            type_name=type_,
            is_input=role == SUBSCRIBER,
            is_output=role == PUBLISHER,
        )
        if number in self._last:
            core.properties[LATCHED] = 1
        core.open()
        self._naming.set_property(core.name, "type", type_)
        self._connect(NestedName.parse(core.name))
        return core

    def _connect(self, own: NestedName) -> None:
        """Connect to the topic's other YARP publishers or subscribers, as `yarp_compat.os.ports.node` does."""
        for contact in self._naming.list():
            other = NestedName.parse(contact.name)
            if other.topic == own.topic and other.role != own.role:
                source, target = (own, other) if own.role == PUBLISHER else (other, own)
                with contextlib.suppress(OSError):
                    connections.connect(self._naming, source.port, target.port)

    def _on_connection(self, number: int, event: ConnectionEvent) -> None:
        if event.incoming or number not in self._last:
            return
        target = event.route.target
        with self._lock:
            joined = self._joined.setdefault(number, Counter())
            joined[target] += 1 if event.up else -1
            for message in self._last[number] if event.up else ():
                self._ports[number].write(message.to_wire, strict=True, chosen=lambda o: o.route.target == target)

    def _on_message(self, number: int, message: PortMessage) -> None:
        decoded = self._types[number].from_bytes(bytes(message.payload))
        self._received[number].add(as_fields(decoded))

    def publish(self, endpoint: int, message: dict[str, Any], times: int = 1) -> None:
        yarp_message = self._types[endpoint]()
        fill(yarp_message, message)
        with self._lock:
            joined, chosen = self._joined.setdefault(endpoint, Counter()), None
            if endpoint in self._last:  # `_on_connection` sends the message on a connection that is just coming up
                self._last[endpoint], chosen = [yarp_message], lambda output: joined[output.route.target] > 0
            for _ in range(times):
                self._ports[endpoint].write(yarp_message.to_wire, strict=True, chosen=chosen)

    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]:
        return self._received[endpoint].wait(count, seconds)

    def drop(self, endpoint: int) -> None:
        self._ports.pop(endpoint).close()

    def graph(self) -> dict[str, Any]:
        """Return the publishers and subscribers of each topic, as listed by the name server."""
        graph: dict[str, dict[str, list[str]]] = {"publishers": {}, "subscriptions": {}}
        for contact in self._naming.list():
            nested = NestedName.parse(contact.name)
            kind = "publishers" if nested.role == PUBLISHER or contact.name.endswith(":o") else "subscriptions"
            topic = nested.topic or contact.name.removeprefix("/midspan")[:-2]
            if nested.is_topic or contact.name.endswith((":i", ":o")):
                graph[kind].setdefault(topic, []).append(contact.name)
        return graph

    def stop(self, seconds: float = 6.0) -> int:
        for endpoint in list(self._ports):
            if seconds:
                self.drop(endpoint)
            else:  # as if the process had been killed, so the ports stay registered
                core = self._ports.pop(endpoint)
                core.naming = Forgetful(self._naming)
                core.close()
        return 0


class Forgetful:
    """A name server client that does not unregister ports."""

    def __init__(self, naming: NameClient) -> None:
        self._naming = naming

    def __getattr__(self, name: str) -> Any:
        return getattr(self._naming, name)

    def unregister(self, name: str) -> None:
        """Leave the port registered."""
        KEEPER.remove(self._naming, name)


def fill(message: Message, fields: Mapping[str, Any]) -> None:
    """Set the fields of a message, including nested ones."""
    for name, value in fields.items():
        kind = next(field for field in message._definition.fields if field.name == name)
        setattr(message, name, _value(message, kind.type, value, array=kind.is_array))


def _value(message: Message, kind: str, value: Any, *, array: bool) -> Any:
    if array:
        return [_value(message, kind, item, array=False) for item in value]
    if isinstance(value, Mapping) and kind in message._nested:
        nested = message._nested[kind]()
        fill(nested, value)
        return nested
    if isinstance(value, Mapping):
        return TickTime(value.get("sec", 0), value.get("nanosec", 0))
    return value


def as_fields(value: Any) -> Any:
    """Return a message as a dict of plain values with ROS 2's field names, without ROS 1's ``seq``."""
    if isinstance(value, Message):
        return {
            field.name: as_fields(getattr(value, field.name))
            for field in value._definition.fields
            if (value.TYPE, field.name) != ("std_msgs/Header", "seq")
        }
    if isinstance(value, TickTime):
        return {"sec": value.sec, "nanosec": value.nsec}
    return [as_fields(item) for item in value] if isinstance(value, list) else value
