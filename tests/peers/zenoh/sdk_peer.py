"""A zenoh-ros2-sdk program that a test controls, as an independent participant of the hub; see `tests.peers.peer`.

Arguments: router port, ROS domain. Types are those of rosbags' Jazzy store; their definitions and hashes are passed
explicitly, because the SDK would otherwise fetch them from the network. ``topic_info`` topic -> the SDK's view of a
topic.
Services are those of ``SERVICES``, with the SDK's own hashes; ``serve`` -> id and hash.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import (
    ROS2Publisher,
    ROS2ServiceClient,
    ROS2ServiceServer,
    ROS2Subscriber,
    ZenohSession,
    get_topic_info,
    get_topic_names_and_types,
)
from zenoh_ros2_sdk.qos import QosDurability, QosProfile, QosReliability

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.commands import Calling, Commands, Record, only_answers, serve

STORE = get_typestore(Stores.ROS2_JAZZY)
SERVICES = {"std_srvs/SetBool": ("bool data", "bool success\nstring message")}


def full_name(name: str) -> str:
    """Return ``package/msg/Name`` for ``package/Name``."""
    package, _, short = name.rpartition("/")
    return name if package.endswith("/msg") else f"{package}/msg/{short}"


def fields_of(name: str, values: dict[str, Any], store: Any) -> dict[str, Any]:
    """Return the values of all fields of a message, for its class; missing fields are zero."""
    _, fields = STORE.fielddefs[name]
    return {field: value_of(kind, values.get(field), store) for field, kind in fields}


def value_of(kind: Any, value: Any, store: Any) -> Any:
    """Return a field's value from JSON."""
    node, detail = kind
    if node.name == "BASE":
        return value if value is not None else {"string": "", "bool": False}.get(detail[0], 0)
    if node.name == "NAME":
        return store.types[detail](**fields_of(detail, value or {}, store))
    element, size = detail
    items = value if value is not None else [None] * (size if node.name == "ARRAY" else 0)
    listed = [value_of(element, item, store) for item in items]
    if element[0].name == "BASE" and element[1][0] not in ("string", "bool"):
        return np.array(listed, np.dtype({"octet": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])))
    return listed


def plain(value: Any) -> Any:
    """Return a message as JSON values."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name != "__msgtype__"}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


class Publisher:
    """A publisher of messages given by their fields."""

    def __init__(self, topic: str, options: dict[str, Any]) -> None:
        self._endpoint = ROS2Publisher(topic, node_name="sdk_talker", **options)

    def publish(self, message: dict[str, Any]) -> None:
        self._endpoint.publish(**fields_of(self._endpoint.msg_type, message, self._endpoint.session_mgr.store))

    def drop(self) -> None:
        self._endpoint.close()


class Subscription(Record):
    """A subscription that stores all messages."""

    def __init__(self, topic: str, options: dict[str, Any]) -> None:
        super().__init__()
        self._endpoint = ROS2Subscriber(
            topic, callback=lambda message: self.add(plain(message)), node_name="sdk_listener", **options
        )

    def drop(self) -> None:
        self._endpoint.close()


class Serving(Record):
    """A server with one answer to all requests."""

    def __init__(self, service: str, reply: dict[str, Any], error: str, held: bool, options: dict[str, Any]) -> None:
        super().__init__()
        self._reply, self._error = reply, error
        self._released = threading.Event()
        if not held:
            self._released.set()
        self.endpoint = ROS2ServiceServer(service, callback=self._on_request, node_name="sdk_server", **options)

    def _on_request(self, request: Any) -> Any:
        self.add(plain(request))
        self._released.wait()
        if self._error:
            raise RuntimeError(self._error)
        return self.endpoint.response_msg_class(**self._reply)

    def release(self) -> None:
        self._released.set()

    def drop(self) -> None:
        self._released.set()
        self.endpoint.close()


class ClientCall(Calling):
    """A call made by a separate client."""

    def __init__(self, client: ROS2ServiceClient, request: dict[str, Any]) -> None:
        self._client, self._request = client, request
        super().__init__(self._reply_fields)

    def _reply_fields(self) -> Any:
        reply = self._client.call(**self._request)
        assert reply is not None, "the SDK got no reply"  # the SDK writes the reason to its log
        return plain(reply)

    def drop(self) -> None:
        self._client.close()


class ZenohPeer(Commands):
    """Executes the commands."""

    def __init__(self, port: int, domain: int) -> None:
        super().__init__()
        self._where: dict[str, Any] = {"router_port": port, "domain_id": domain}

    def _options(
        self, type: str, best_effort: bool = False, latched: bool = False, depth: int = 10, hash: str = "", **_: Any
    ) -> dict[str, Any]:
        name = full_name(type)
        qos = QosProfile(
            reliability=QosReliability.BEST_EFFORT if best_effort else QosReliability.RELIABLE,
            durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
            history_depth=depth,
        )
        definition = STORE.generate_msgdef(name, ros_version=2)[0]
        type_hash = hash or STORE.hash_rihs01(name)
        return {"msg_type": name, "msg_definition": definition, "type_hash": type_hash, "qos": qos, **self._where}

    def advertise(self, topic: str, **options: Any) -> dict[str, Any]:
        return self.add(Publisher(topic, self._options(**options)))

    def publish(self, id: int, message: dict[str, Any], times: int = 1) -> dict[str, Any]:
        for _ in range(times):
            self.parts[id].publish(message)
        return {}

    def subscribe(self, topic: str, **options: Any) -> dict[str, Any]:
        return self.add(Subscription(topic, self._options(**options)))

    def _service(self, type: str) -> dict[str, Any]:
        request, response = SERVICES[type]
        definitions = {"request_definition": request, "response_definition": response}
        return {"srv_type": type.replace("/", "/srv/"), **definitions, **self._where}

    def serve(
        self,
        service: str,
        type: str,
        reply: dict[str, Any] | None = None,
        error: str = "",
        held: bool = False,
        **_: Any,
    ) -> dict[str, Any]:
        serving = Serving(service, reply or {}, error, held, self._service(type))
        return {**self.add(serving), "hash": serving.endpoint.type_hash}

    def call(
        self, service: str, type: str, request: dict[str, Any] | None = None, timeout: float = 20.0, **_: Any
    ) -> dict[str, Any]:
        client = ROS2ServiceClient(service, node_name="sdk_client", timeout=timeout, **self._service(type))
        return self.add(ClientCall(client, request or {}))

    def topic_info(self, topic: str) -> dict[str, Any]:
        info = get_topic_info(topic, verbose=True, **self._where)
        return {"info": None if info is None else json.loads(json.dumps(info, default=vars))}

    def graph(self) -> dict[str, Any]:
        topics = dict(get_topic_names_and_types(**self._where))
        infos = {topic: get_topic_info(topic, verbose=True, **self._where) for topic in topics}
        return {
            "topics": topics,
            "publishers": {t: [e.node_name for e in info.publishers] for t, info in infos.items() if info},
            "subscriptions": {t: [e.node_name for e in info.subscribers] for t, info in infos.items() if info},
        }

    def close(self) -> None:
        for number in list(self.parts):
            self.drop(number)
        ZenohSession.get_instance(router_port=self._where["router_port"]).close()


def main() -> None:
    """Execute the commands from standard input until it ends."""
    answers = only_answers()
    peer = ZenohPeer(int(sys.argv[1]), int(sys.argv[2]))
    try:
        serve(peer, answers)
    finally:
        peer.close()


if __name__ == "__main__":
    main()
