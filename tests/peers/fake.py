"""An edge on an in-memory network, for tests of the engine alone. Payloads are CDR, and names are ROS 2's."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.routing.edge import Deliver, Edge, EdgeListener, Endpoint, Kind, MadeBy, Sighting


@dataclass(eq=False)
class Writer:
    """A publisher on the fake network. While it exists, late joiners receive its retained messages."""

    endpoint: Endpoint
    retained: dict[str, bytes] = field(default_factory=dict)


@dataclass(eq=False)
class Reader:
    """A subscription on the fake network.

    ``delivering`` is held during each delivery, so that a message cannot overtake the retained ones, which are older.
    """

    endpoint: Endpoint
    deliver: Deliver
    delivering: threading.RLock = field(default_factory=threading.RLock)


@dataclass(eq=False)
class Server:
    """A server on the fake network."""

    endpoint: Endpoint
    call: Call


class FakeNetwork:
    """An in-memory network that connects writers and readers of the same topic.

    Latched writers retain one message per source. A call goes to the last server of the service's name.
    """

    def __init__(self) -> None:
        self.identity: str | None = "fake-1"
        self._ids = itertools.count(1)
        self._writers: list[Writer] = []
        self._readers: list[Reader] = []
        self._servers: list[Server] = []
        self._watchers: list[Callable[[], None]] = []
        self._lock = threading.RLock()
        self.announced: dict[int, Sighting] = {}

    def watch(self, changed: Callable[[], None]) -> None:
        self._watchers.append(changed)

    def restart(self, identity: str | None) -> None:
        """Remove the network (None), or restart it with another identity; its native endpoints are gone either way."""
        with self._lock:
            self.identity = identity
            self._writers = [w for w in self._writers if w.endpoint.made_by is MadeBy.MIDSPAN]
            self._readers = [r for r in self._readers if r.endpoint.made_by is MadeBy.MIDSPAN]
            self._servers = [s for s in self._servers if s.endpoint.made_by is MadeBy.MIDSPAN]
        self._changed()

    def retained(self) -> list[bytes]:
        """Return the messages that latched writers retain for late readers."""
        with self._lock:
            return [payload for writer in self._writers for payload in writer.retained.values()]

    def endpoints(self) -> list[Endpoint]:
        with self._lock:
            things: list[Writer | Reader | Server] = [*self._writers, *self._readers, *self._servers]
            return [thing.endpoint for thing in things]

    def write_on(self, topic: str, type_: str, qos: Qos, made_by: MadeBy, node: str) -> Writer:
        endpoint = Endpoint(f"w{next(self._ids)}", Kind.PUBLISHER, topic, type_, qos, made_by, node)
        writer = Writer(endpoint)
        with self._lock:
            self._writers.append(writer)
        self._changed()
        return writer

    def read_from(self, topic: str, type_: str, qos: Qos, made_by: MadeBy, node: str, deliver: Deliver) -> Reader:
        reader = Reader(Endpoint(f"r{next(self._ids)}", Kind.SUBSCRIPTION, topic, type_, qos, made_by, node), deliver)
        with reader.delivering:
            with self._lock:
                self._readers.append(reader)
                past = [
                    (payload, w.endpoint.id)
                    for w in self._writers
                    if w.endpoint.topic == topic and w.endpoint.qos.latched and qos.latched
                    for payload in w.retained.values()
                ]
            for payload, source in past:
                deliver(payload, source, None)
        self._changed()
        return reader

    def write(self, writer: Writer, payload: bytes, source: str = "") -> None:
        with self._lock:
            if writer.endpoint.qos.latched:
                writer.retained[source] = payload
            readers = [r for r in self._readers if r.endpoint.topic == writer.endpoint.topic]
        for reader in readers:
            with reader.delivering:
                reader.deliver(payload, writer.endpoint.id, None)

    def drop_source(self, writer: Writer, source: str) -> None:
        """Drop the message that a writer retains for a source."""
        with self._lock:
            writer.retained.pop(source, None)

    def has_subscribers(self, topic: str) -> bool:
        with self._lock:
            return any(r.endpoint.topic == topic and r.endpoint.made_by is MadeBy.NATIVE for r in self._readers)

    def serve(self, name: str, type_: str, made_by: MadeBy, node: str, call: Call) -> Server:
        endpoint = Endpoint(f"s{next(self._ids)}", Kind.SERVER, name, type_, Qos(), made_by, node)
        server = Server(endpoint, call)
        with self._lock:
            self._servers.append(server)
        self._changed()
        return server

    def call(self, name: str, request: bytes, done: Done, *, native: bool = False) -> Abandon:
        with self._lock:
            servers = [
                s
                for s in self._servers
                if s.endpoint.topic == name and (not native or s.endpoint.made_by is MadeBy.NATIVE)
            ]
        if servers:
            return servers[-1].call(request, done)
        done(CallError(f"{name} has no server"))
        return lambda: None

    def remove(self, thing: Writer | Reader | Server) -> None:
        with self._lock:
            self._writers = [w for w in self._writers if w is not thing]
            self._readers = [r for r in self._readers if r is not thing]
            self._servers = [s for s in self._servers if s is not thing]
        self._changed()

    def _changed(self) -> None:
        for changed in list(self._watchers):
            changed()


@dataclass
class _Subscription:
    network: FakeNetwork
    reader: Reader
    lost: int = 0

    def close(self) -> None:
        self.network.remove(self.reader)


@dataclass
class _Publisher:
    network: FakeNetwork
    writer: Writer

    @property
    def dropped(self) -> int:
        return 0

    @property
    def has_subscribers(self) -> bool:
        return self.network.has_subscribers(self.writer.endpoint.topic)

    def send(self, payload: bytes, source: str) -> None:
        self.network.write(self.writer, payload, source)

    def drop_source(self, source: str) -> None:
        self.network.drop_source(self.writer, source)

    def close(self) -> None:
        self.network.remove(self.writer)


@dataclass
class _Server:
    network: FakeNetwork
    server: Server

    def close(self) -> None:
        self.network.remove(self.server)


@dataclass
class _Caller:
    network: FakeNetwork
    name: str

    def call(self, request: bytes, done: Done) -> Abandon:
        return self.network.call(self.name, request, done, native=True)

    def close(self) -> None:
        """Do nothing: the route ends the calls."""


class FakeEdge(Edge):
    """Joins a `FakeNetwork`."""

    side = "fake"
    services = True

    def __init__(self, network: FakeNetwork, registry: Registry) -> None:
        self._network, self._registry = network, registry
        self._made: list[_Subscription | _Publisher | _Server | _Caller] = []

    def start(self, listener: EdgeListener) -> None:
        self._network.watch(listener.graph_changed)
        listener.graph_changed()

    def stop(self) -> None:
        for endpoint in self._made:
            endpoint.close()
        self._made = []

    def network(self) -> str | None:
        return self._network.identity

    def announce(self, record: bytes) -> None:
        self._network.announced[id(self)] = Sighting(str(id(self)), record, time.monotonic())

    def sightings(self) -> list[Sighting]:
        return [s for key, s in list(self._network.announced.items()) if key != id(self)]

    def is_own_network(self, origin: Origin) -> bool:
        return origin.side == self.side and origin.network == self._network.identity

    def endpoints(self) -> list[Endpoint]:
        return [e for e in self._network.endpoints() if e.made_by is not MadeBy.MIDSPAN]

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        return self._identity(endpoint.type, "")

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        return replace(self._identity(type_name, type_hash), convert=self._registry.hub_check(type_name))

    def _identity(self, type_name: str, type_hash: str) -> Conversion:
        known = self._registry.ros2(type_name)
        if type_hash and type_hash != known.type_id:
            raise MessageTypeError(f"{type_name}: hash {type_hash} is not {known.type_id}", "install the same version")
        return Conversion(known, known, None)

    def learn(self, type_name: str, definition: str) -> None:
        self._registry.learn_ros2(type_name, definition)

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> _Subscription:
        native: Deliver = lambda payload, source, time_ns: self._if_native(payload, source, time_ns, deliver)  # noqa: E731
        reader = self._network.read_from(topic, side_type.name, qos, MadeBy.MIDSPAN, "/midspan", native)
        self._made.append(subscription := _Subscription(self._network, reader))
        return subscription

    def _if_native(self, payload: bytes, source: str, time_ns: int | None, deliver: Deliver) -> None:
        if any(e.id == source and e.made_by is MadeBy.NATIVE for e in self._network.endpoints()):
            deliver(payload, source, time_ns)

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> _Publisher:
        writer = self._network.write_on(topic, side_type.name, qos, MadeBy.MIDSPAN, "/midspan")
        self._made.append(publisher := _Publisher(self._network, writer))
        return publisher

    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        return self._same_service(endpoint.type, "")

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        return self._same_service(type_name, type_hash)

    def _same_service(self, type_name: str, type_hash: str) -> ServiceConversion:
        known = self._registry.service_ros2(type_name, type_hash)
        request, reply = self._registry.hub_service_check(type_name, type_hash)
        return ServiceConversion(known, known, request, request, reply, reply)

    def caller(self, name: str, side_type: SideType) -> _Caller:
        del side_type
        self._made.append(caller := _Caller(self._network, name))
        return caller

    def serve(self, name: str, side_type: SideType, call: Call) -> _Server:
        server = self._network.serve(name, side_type.name, MadeBy.MIDSPAN, "/midspan", call)
        self._made.append(served := _Server(self._network, server))
        return served
