"""Programs on a plain zenoh network, in the test's process: JSON programs, and bridges like zenoh's plugins.

Written from the plugins' sources (zenoh-plugin-ros2dds of August 2026: ``liveliness_mgt.rs``, ``route_publisher.rs``,
``route_subscriber.rs``; zenoh-plugin-ros1 of May 2025: ``topic_utilities.rs``, ``discovery.rs``,
``aloha_declaration.rs``), without any of Midspan's code, not even its messages. A peer is a bridge together with its
ROS nodes, which receive each other's messages. See `tests.peers.peer` for the commands.
"""

from __future__ import annotations

import itertools
import json
import random
import secrets
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh import ext

from tests.peers.commands import Record
from tests.peers.zenoh.services import MD5, TYPES, Calling, Serving, Wire
from tests.support.ports import free_port
from tests.support.rosbags_messages import Messages
from tests.support.wait import until
from tests.support.zenoh_router import open_router


def service_texts() -> dict[str, str]:
    """Return the definitions of the services' requests and responses, by name."""
    halves = ("Request", "Response")
    return {f"{name}_{half}": text for name, texts in TYPES.items() for half, text in zip(halves, texts, strict=True)}


def open_session(endpoint: str, mode: str = "peer", **more: Any) -> zenoh.Session:
    """Open a session to the router at an endpoint, with timestamps like the plugins' bridges."""
    tree = {
        "mode": mode,
        "scouting": {"delay": 0, "multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
        "listen": {"endpoints": ["tcp/127.0.0.1:0"]} if mode == "peer" else {},
        "connect": {"endpoints": [endpoint]},
        **more,
    }
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(tree)))
    until(session.info.routers_zid, "the session is linked to the router")
    return session


class Router:
    """A zenoh router on a free port of loopback."""

    def __init__(self) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._session: zenoh.Session | None = None
        self.start()

    def start(self) -> None:
        tree = {
            "mode": "router",
            "scouting": {"delay": 0, "multicast": {"enabled": False}},
            "listen": {"endpoints": [self.endpoint]},
        }
        self._session = open_router(zenoh.Config.from_json5(json.dumps(tree)))

    def stop(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()


class Program:
    """Base class of these programs: numbered endpoints and their received messages."""

    def __init__(self, endpoint: str) -> None:
        self.session = open_session(endpoint)
        self.zid = str(self.session.zid())
        self._ids = itertools.count(1)
        self._things: dict[int, tuple[str, str, list[Any]]] = {}
        self._puts: dict[int, Callable[[bytes], None]] = {}
        self.received: dict[int, Record] = {}
        self.servings: dict[int, Serving] = {}
        self._callings: dict[int, Calling] = {}
        self.watch: zenoh.Subscriber | None = None

    def encode(self, type_: str, message: dict[str, Any]) -> bytes:
        raise NotImplementedError

    def decode(self, type_: str, data: bytes) -> Any:
        raise NotImplementedError

    def add(self, topic: str, type_: str, parts: list[Any], put: Callable[[bytes], None] | None = None) -> int:
        number = next(self._ids)
        self._things[number] = (topic, type_, parts)
        if put is not None:
            self._puts[number] = put
        return number

    def on_message(self, number: int, type_: str, data: bytes) -> None:
        self.received[number].add(self.decode(type_, data))

    def listener(self, topic: str, type_: str) -> tuple[int, Callable[[zenoh.Sample], None]]:
        number = self.add(topic, type_, [])
        self.received[number] = Record()
        return number, lambda sample: self.on_message(number, type_, sample.payload.to_bytes())

    def publish(self, endpoint: int, message: dict[str, Any]) -> None:
        topic, type_, _ = self._things[endpoint]
        data = self.encode(type_, message)
        self._puts[endpoint](data)
        for number in [n for n in self.received if self._things.get(n, ("",))[0] == topic]:
            self.on_message(number, type_, data)

    def until_subscribed(self, endpoint: int) -> None:
        """Wait until a publisher has a subscription."""
        publisher = self._things[endpoint][2][-1]
        until(lambda: publisher.matching_status.matching, "a subscription exists")

    def wait(self, endpoint: int, count: int, seconds: float = 40.0) -> list[Any]:
        return self.received[endpoint].wait(count, seconds)

    def drop(self, endpoint: int) -> None:
        for part in self._things.pop(endpoint)[2]:
            part.undeclare()

    def serve(self, service: str, type_: str, params: dict[str, Any]) -> tuple[Serving, list[Any]]:
        """Start a server in the program's dialect; return it, and the entities to undeclare together with it."""
        raise NotImplementedError

    def call(self, service: str, type_: str, request: dict[str, Any] | bytes | None) -> Calling:
        """Call a server in the program's dialect."""
        raise NotImplementedError

    def ask(self, do: str, **params: Any) -> dict[str, Any]:
        """Execute a service command; see `tests.peers.peer`."""
        if do == "serve":
            serving, parts = self.serve(params["service"], params["type"], params)
            number = self.add(params["service"], params["type"], [*parts, serving])
            self.servings[number] = serving
            return {"id": number}
        if do == "call":
            number = next(self._ids)
            self._callings[number] = self.call(params["service"], params["type"], params.get("request") or {})
            return {"id": number}
        number = params.pop("id")
        if do == "result":
            return self._callings[number].result(**params)
        if do == "requests":
            return {"requests": self.servings[number].requests(**params)}
        self.servings[number].release()
        return {}

    def stop(self, seconds: float = 6.0) -> int:
        session, self.session = self.session, None
        if session is not None:
            # closing zenoh waits for callbacks, which wait for Python's lock
            for number in list(self._things):
                self.drop(number)
            for serving in self.servings.values():
                serving.drop_queries()
            for calling in self._callings.values():
                calling.token.cancel()
            if self.watch is not None:
                self.watch.undeclare()
            session.close()
        return int(seconds * 0)


class Ros2ddsBridge(Program):
    """A stand-in for zenoh-bridge-ros2dds."""

    def __init__(self, endpoint: str, messages: Messages, namespace: str = "") -> None:
        super().__init__(endpoint)
        self._messages, self._namespace = messages, namespace
        self._client, self._sequence = secrets.token_bytes(8), itertools.count(1)
        self.wire = Wire(self.encode, self.decode, lambda _text: None, _is_cdr, self._request_id)
        self._alive = self.session.liveliness().declare_token(f"@/{self.zid}/@ros2_lv")
        self._tokens: set[str] = set()
        self.watch = self.session.liveliness().declare_subscriber(
            "@/*/@ros2_lv/**", zenoh.handlers.Callback(self._on_token, indirect=False), history=True
        )

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.PUT:
            self._tokens.add(key)
        else:
            self._tokens.discard(key)

    def encode(self, type_: str, message: dict[str, Any]) -> bytes:
        return self._messages.encode(type_, message)

    def decode(self, type_: str, data: bytes) -> Any:
        return self._messages.decode(type_, data)

    def key(self, topic: str) -> str:
        return f"{self._namespace}/{topic[1:]}" if self._namespace else topic[1:]

    def token(self, letters: str, topic: str, type_: str, *, latched: bool, depth: int, best_effort: bool) -> str:
        """Return a topic's token, byte for byte."""
        type_name = self._messages.full(type_).replace("/", "§")
        qos = f":{int(not best_effort)}:{int(latched)}:0,{depth}:typehash={self._messages.type_id(type_)};"
        return f"@/{self.zid}/@ros2_lv/{letters}/{self.key(topic).replace('/', '§')}/{type_name}/{qos}"

    def advertise(
        self, topic: str, type_: str, *, latched: bool = False, depth: int = 10, best_effort: bool = False
    ) -> int:
        key = self.key(topic)
        cache = {"cache": ext.CacheConfig(depth * 10), "publisher_detection": True} if latched else {}
        publisher = ext.declare_advanced_publisher(
            self.session, key, allowed_destination=zenoh.Locality.REMOTE,
            congestion_control=zenoh.CongestionControl.BLOCK, **cache,
        )  # fmt: skip
        text = self.token("MP", topic, type_, latched=latched, depth=depth, best_effort=best_effort)
        token = self.session.liveliness().declare_token(text)
        return self.add(topic, type_, [token, publisher], publisher.put)

    def subscribe(
        self, topic: str, type_: str, *, latched: bool = False, depth: int = 10, best_effort: bool = False
    ) -> int:
        number, hear = self.listener(topic, type_)
        key = self.key(topic)
        if latched:
            subscriber = ext.declare_advanced_subscriber(
                self.session, key, hear, allowed_origin=zenoh.Locality.REMOTE,
                history=ext.HistoryConfig(detect_late_publishers=True, max_samples=depth),
            )  # fmt: skip
        else:
            subscriber = self.session.declare_subscriber(key, hear, allowed_origin=zenoh.Locality.REMOTE)
        text = self.token("MS", topic, type_, latched=latched, depth=depth, best_effort=best_effort)
        self._things[number][2].extend([self.session.liveliness().declare_token(text), subscriber])
        return number

    def _request_id(self) -> bytes:
        return b"rqh" + self._client + next(self._sequence).to_bytes(8, "little") + b"\1"

    def declare_token(self, letters: str, name: str, type_name: str) -> zenoh.LivelinessToken:
        """Declare a service's or an action's token, byte for byte."""
        key, type_name = self.key(name).replace("/", "§"), type_name.replace("/", "§")
        return self.session.liveliness().declare_token(f"@/{self.zid}/@ros2_lv/{letters}/{key}/{type_name}")

    def serve(self, service: str, type_: str, params: dict[str, Any]) -> tuple[Serving, list[Any]]:
        serving = Serving(self.session, self.key(service), self.wire, params)
        return serving, [self.declare_token("SS", service, type_.replace("/", "/srv/"))]

    def call(self, service: str, type_: str, request: dict[str, Any] | bytes | None) -> Calling:
        return Calling(self.session, self.key(service), self.wire, type_, request)

    def all_tokens(self) -> set[str]:
        """Return all current tokens of the dialect."""
        return set(self._tokens)

    def tokens(self, topic: str, letters: str = "MP") -> list[str]:
        """Return the tokens of other bridges for a topic."""
        part = f"/@ros2_lv/{letters}/{self.key(topic).replace('/', '§')}/"
        return sorted(t for t in self.all_tokens() if part in t and self.zid not in t)

    def graph(self) -> dict[str, Any]:
        graph: dict[str, Any] = {"publishers": {}, "subscriptions": {}}
        for token in sorted(self._tokens):
            parts = token.split("/")
            if len(parts) > 4 and parts[3] in ("MP", "MS"):
                kind = "publishers" if parts[3] == "MP" else "subscriptions"
                key = parts[4].replace("§", "/").removeprefix(f"{self._namespace}/" if self._namespace else "")
                graph[kind].setdefault(f"/{key}", []).append(parts[1])
        return graph


def _is_cdr(query: zenoh.Query) -> bool:
    payload = query.payload
    data = b"\0\1\0\0" if payload is None else payload.to_bytes()
    return len(data) >= 4 and data[1] <= 1


class Beacon:
    """A plugin's beacon on one key.

    Each period in which others send beacons there, it pauses with a probability of 1/2 (``aloha_declaration.rs``).
    """

    def __init__(self, session: zenoh.Session, key: str, period: float, *, sending: bool = True) -> None:
        self._period, self._sending = period, sending
        self._others = 0
        self._stopping = threading.Event()
        self._publisher = session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.BACKGROUND,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        self._subscriber = session.declare_subscriber(
            key, zenoh.handlers.Callback(self._on_beacon, indirect=False), allowed_origin=zenoh.Locality.REMOTE
        )
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _on_beacon(self, _sample: zenoh.Sample) -> None:
        self._others += 1

    def _run(self) -> None:
        while not self._stopping.is_set():
            if self._sending:
                self._publisher.put(b"")
            self._stopping.wait(self._period)
            others, self._others = self._others, 0
            if others and self._sending:
                self._sending = random.random() < 0.5
            elif not others and not self._sending:
                self._stopping.wait(random.random() * self._period)
                self._sending = not self._others

    def undeclare(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._subscriber.undeclare()


class Ros1Bridge(Program):
    """A stand-in for zenoh-bridge-ros1. The plugin does not announce whether its ROS 1 nodes latch."""

    def __init__(self, endpoint: str, messages: Messages, namespace: str = "*", period: float = 1.0) -> None:
        super().__init__(endpoint)
        self._messages, self.namespace, self._period = messages, namespace, period
        self.wire = Wire(
            self.encode, self.decode, lambda text: text.encode(), lambda q: q.payload is not None, lambda: None
        )
        self._beacons: dict[str, float] = {}
        self.watch = self.session.declare_subscriber(
            f"ros1_discovery_info/*/*/*/*/{namespace}/*/**", zenoh.handlers.Callback(self._on_beacon, indirect=False)
        )

    def ignore_beacons(self) -> None:
        """Stop recording beacons; each of the bridge's own beacons still reacts to others on its key."""
        self.watch.undeclare()
        self.watch = self.session.declare_subscriber("nothing", zenoh.handlers.Callback(self._on_beacon))

    def _on_beacon(self, sample: zenoh.Sample) -> None:
        self._beacons[str(sample.key_expr)] = time.monotonic()

    def encode(self, type_: str, message: dict[str, Any]) -> bytes:
        return self._messages.encode(type_, message)

    def decode(self, type_: str, data: bytes) -> Any:
        return self._messages.decode(type_, data)

    def key(self, topic: str, type_: str, md5: str = "") -> str:
        """Return the key of a topic's samples, byte for byte."""
        hex_type = type_.replace("/msg/", "/").encode().hex()
        return f"{hex_type}/{md5 or self._messages.type_id(type_)}/{self.namespace}/{topic.strip('/')}"

    def discovery(self, letters: str, topic: str, type_: str, md5: str = "") -> str:
        """Return the key of a topic's beacon, byte for byte."""
        return f"ros1_discovery_info/*/{letters}/{self.key(topic, type_, md5)}"

    def advertise(
        self,
        topic: str,
        type_: str,
        *,
        md5: str = "",
        **_: Any,
    ) -> int:
        publisher = self.session.declare_publisher(
            self.key(topic, type_, md5),
            reliability=zenoh.Reliability.RELIABLE,
            congestion_control=zenoh.CongestionControl.BLOCK,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        beacon = Beacon(self.session, self.discovery("pub", topic, type_, md5), self._period)
        return self.add(topic, type_, [beacon, publisher], publisher.put)

    def subscribe(
        self,
        topic: str,
        type_: str,
        *,
        md5: str = "",
        **_: Any,
    ) -> int:
        number, hear = self.listener(topic, type_)
        key = self.key(topic, type_, md5)
        subscriber = self.session.declare_subscriber(key, hear, allowed_origin=zenoh.Locality.REMOTE)
        beacon = Beacon(self.session, self.discovery("sub", topic, type_, md5), self._period)
        self._things[number][2].extend([beacon, subscriber])
        return number

    def serve(self, service: str, type_: str, params: dict[str, Any]) -> tuple[Serving, list[Any]]:
        serving = Serving(self.session, self.key(service, type_, MD5[type_]), self.wire, params)
        return serving, [Beacon(self.session, self.discovery("srv", service, type_, MD5[type_]), self._period)]

    def call(self, service: str, type_: str, request: dict[str, Any] | bytes | None) -> Calling:
        return Calling(self.session, self.key(service, type_, MD5[type_]), self.wire, type_, request)

    def beacons(self) -> list[str]:
        """Return the keys of all beacons received from other sessions in the last three periods."""
        now = time.monotonic()
        return sorted(key for key, received_at in self._beacons.copy().items() if now - received_at < 3 * self._period)

    def graph(self) -> dict[str, Any]:
        graph: dict[str, Any] = {"publishers": {}, "subscriptions": {}}
        for key in self.beacons():
            parts = key.split("/", 6)
            kind = {"pub": "publishers", "sub": "subscriptions"}.get(parts[2])
            if kind is None:
                continue
            graph[kind].setdefault(f"/{parts[6]}", ["a bridge"])
        return graph


class JsonProgram(Program):
    """A program without ROS that uses JSON; topics and services are keys."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(endpoint)
        self.wire = Wire(self.encode, self.decode, lambda _text: None, lambda q: q.payload is not None, lambda: None)

    def encode(self, _type: str, message: dict[str, Any]) -> bytes:
        return json.dumps(message).encode()

    def decode(self, _type: str, data: bytes) -> Any:
        return json.loads(data)

    def advertise(self, topic: str, type_: str = "", **_: Any) -> int:
        publisher = self.session.declare_publisher(topic.strip("/"), encoding=zenoh.Encoding.APPLICATION_JSON)
        return self.add(topic, type_, [publisher], publisher.put)

    def subscribe(self, topic: str, type_: str = "", **_: Any) -> int:
        number, hear = self.listener(topic, type_)
        self._things[number][2].append(
            ext.declare_advanced_subscriber(self.session, topic.strip("/"), hear, allowed_origin=zenoh.Locality.REMOTE)
        )
        return number

    def serve(self, service: str, _type: str, params: dict[str, Any]) -> tuple[Serving, list[Any]]:
        return Serving(self.session, service.strip("/"), self.wire, params), []

    def call(self, service: str, type_: str, request: dict[str, Any] | bytes | None) -> Calling:
        return Calling(self.session, service.strip("/"), self.wire, type_, request)

    def get(self, key: str) -> list[tuple[Any, str]]:
        """Query a key, and return each reply with its encoding."""
        replies = self.session.get(key, timeout=5.0)
        return [(json.loads(r.ok.payload.to_bytes()), str(r.ok.encoding)) for r in replies if r.ok is not None]
