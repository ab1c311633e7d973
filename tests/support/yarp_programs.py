"""YARP programs for tests: ports opened as ``/topic@/node``, whose messages are made by `yarp_compat.rosmsg`.

That is the other implementation of the layout that the bridge's own converters write.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bridge.messages.registry import Registry
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


class Names:
    """A name server of a test's own."""

    def __init__(self) -> None:
        self.address = Address("127.0.0.1", free_port(room=20))
        self.client = NameClient(self.address)
        self._server: NameServer | None = None
        self.start()

    @property
    def endpoint(self) -> str:
        """Its address, as the configuration has it."""
        return f"{self.address.host}:{self.address.port}"

    def start(self) -> None:
        self._server = NameServer(self.address.host, self.address.port, gc_seconds=0).open()

    def stop(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.close()


class Definitions(MessageLibrary):
    """Finds definitions where the bridge's tests have them."""

    def __init__(self, folders: tuple[Path, ...]) -> None:
        super().__init__({})
        registry = Registry(folders=folders)
        self.ask = lambda name: registry.ros1(name).definition


class YarpProgram:
    """One program with ports of topics."""

    def __init__(self, names: Names, node: str, definitions: Definitions) -> None:
        self._naming, self._node, self._definitions = names.client, node, definitions
        self._ports: dict[int, PortCore] = {}
        self._types: dict[int, type[Message]] = {}
        self._heard: dict[int, list[dict[str, Any]]] = {}
        self._last: dict[int, list[Any]] = {}
        self._ids = itertools.count(1)
        self._changed = threading.Condition()

    def advertise(self, topic: str, type_: str, *, latched: bool = False, **_: Any) -> int:
        number = next(self._ids)
        if latched:
            self._last[number] = []
        core = self._open(number, topic, PUBLISHER, type_)
        if latched:
            self._naming.set_property(core.name, LATCHED, "true")
        return number

    def subscribe(self, topic: str, type_: str, **_: Any) -> int:
        number = next(self._ids)
        self._heard[number] = []
        self._open(number, topic, SUBSCRIBER, type_)
        return number

    def _open(self, number: int, topic: str, role: str, type_: str) -> PortCore:
        self._types[number] = self._definitions.get(type_)
        core = self._ports[number] = PortCore(
            NestedName(topic, f"{self._node}_{number}", role).port,
            naming=self._naming,
            on_message=lambda message: self._hear(number, message),
            on_event=lambda event: self._linked(number, event),
            type_name=type_,
            is_input=role == SUBSCRIBER,
            is_output=role == PUBLISHER,
        )
        if number in self._last:
            core.properties[LATCHED] = 1
        core.open()
        self._naming.set_property(core.name, "type", type_)
        self._join(NestedName.parse(core.name))
        return core

    def _join(self, own: NestedName) -> None:
        """Connect with the other YARP ends of a topic, as `yarp_compat.os.ports.node` does."""
        for contact in self._naming.list():
            other = NestedName.parse(contact.name)
            if other.topic == own.topic and other.role != own.role:
                source, target = (own, other) if own.role == PUBLISHER else (other, own)
                with contextlib.suppress(OSError):
                    connections.connect(self._naming, source.port, target.port)

    def _linked(self, number: int, event: ConnectionEvent) -> None:
        if event.up and not event.incoming:
            target = event.route.target
            for message in self._last.get(number, []):
                self._ports[number].write(message.to_wire, strict=True, chosen=lambda o: o.route.target == target)

    def _hear(self, number: int, message: PortMessage) -> None:
        found = self._types[number].from_bytes(bytes(message.payload))
        with self._changed:
            self._heard[number].append(as_fields(found))
            self._changed.notify_all()

    def publish(self, endpoint: int, message: dict[str, Any], times: int = 1) -> None:
        made = self._types[endpoint]()
        fill(made, message)
        if endpoint in self._last:
            self._last[endpoint] = [made]
        for _ in range(times):
            self._ports[endpoint].write(made.to_wire, strict=True)

    def wait(self, endpoint: int, count: int, seconds: float = 10.0) -> list[dict[str, Any]]:
        with self._changed:
            self._changed.wait_for(lambda: len(self._heard[endpoint]) >= count, seconds)
            return list(self._heard[endpoint])

    def drop(self, endpoint: int) -> None:
        self._ports.pop(endpoint).close()

    def graph(self) -> dict[str, Any]:
        """Publishers and subscribers by topic, as the name server lists them."""
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
            else:  # as if it was killed: nobody unregisters
                core = self._ports.pop(endpoint)
                core.naming = Forgetful(self._naming)
                core.close()
        return 0


class Forgetful:
    """A name server's client that does not unregister."""

    def __init__(self, naming: NameClient) -> None:
        self._naming = naming

    def __getattr__(self, name: str) -> Any:
        return getattr(self._naming, name)

    def unregister(self, name: str) -> None:
        """Keep it at the name server."""
        KEEPER.forget(self._naming, name)


def fill(message: Message, fields: Mapping[str, Any]) -> None:
    """Set a message's fields."""
    for name, value in fields.items():
        kind = next(field for field in message._definition.fields if field.name == name)
        setattr(message, name, _value(message, kind.type, value, array=kind.is_array))


def _value(message: Message, kind: str, value: Any, *, array: bool) -> Any:
    if array:
        return [_value(message, kind, one, array=False) for one in value]
    if isinstance(value, Mapping) and kind in message._nested:
        made = message._nested[kind]()
        fill(made, value)
        return made
    if isinstance(value, Mapping):
        return TickTime(value.get("sec", 0), value.get("nanosec", 0))
    return value


def as_fields(value: Any) -> Any:
    """A message as a dict of plain values, with ROS 2's names; ROS 1's ``seq`` is left out."""
    if isinstance(value, Message):
        return {
            field.name: as_fields(getattr(value, field.name))
            for field in value._definition.fields
            if (value.TYPE, field.name) != ("std_msgs/Header", "seq")
        }
    if isinstance(value, TickTime):
        return {"sec": value.sec, "nanosec": value.nsec}
    return [as_fields(one) for one in value] if isinstance(value, list) else value
