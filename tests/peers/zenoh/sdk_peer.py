"""A zenoh-ros2-sdk program that a test controls, as an independent participant of the hub; see `tests.peers.peer`.

Arguments: router port, ROS domain. Types are those of rosbags' Jazzy store; their definitions and hashes are passed
explicitly, otherwise the SDK would fetch them from the network. ``topic_info`` topic -> the SDK's view of a topic.
Services are those of ``SERVICES``, with the SDK's own hashes; ``serve`` -> id and hash.
"""

from __future__ import annotations

import json
import sys
import threading
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

STORE = get_typestore(Stores.ROS2_JAZZY)
SERVICES = {"std_srvs/SetBool": ("bool data", "bool success\nstring message")}


def full_name(name: str) -> str:
    """Return ``package/msg/Name`` for ``package/Name``."""
    package, _, short = name.rpartition("/")
    return name if package.endswith("/msg") else f"{package}/msg/{short}"


def fields_of(name: str, values: dict[str, Any], store: Any) -> dict[str, Any]:
    """Return the values of all fields of a message for its class; missing fields are zero."""
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


class Serving:
    """A server with one answer to all requests."""

    def __init__(self, params: dict[str, Any], options: dict[str, Any]) -> None:
        self._reply, self._error = params.get("reply") or {}, params.get("error", "")
        self._requests: list[Any] = []
        self._came = threading.Condition()
        self.released = threading.Event()
        if not params.get("held"):
            self.released.set()
        self.endpoint = ROS2ServiceServer(params["service"], callback=self._asked, **options)

    def _asked(self, request: Any) -> Any:
        with self._came:
            self._requests.append(plain(request))
            self._came.notify_all()
        self.released.wait()
        if self._error:
            raise RuntimeError(self._error)
        return self.endpoint.response_msg_class(**self._reply)

    def requests(self, count: int, seconds: float) -> list[Any]:
        with self._came:
            self._came.wait_for(lambda: len(self._requests) >= count, seconds)
            return list(self._requests)

    def close(self) -> None:
        self.released.set()
        self.endpoint.close()


class Calling:
    """A service call on a thread."""

    def __init__(self, client: ROS2ServiceClient, request: dict[str, Any]) -> None:
        self._client, self._request = client, request
        self._reply: Any = None
        self._error = ""
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            reply = self._client.call(**self._request)
            if reply is None:
                self._error = "no reply by the SDK"  # it writes the reason to its log
            else:
                self._reply = plain(reply)
        except Exception as err:
            self._error = f"{type(err).__name__}: {err}"

    def result(self, seconds: float) -> dict[str, Any]:
        self._thread.join(seconds)
        return {"done": not self._thread.is_alive(), "reply": self._reply, "error": self._error}

    def close(self) -> None:
        self._client.close()


class ZenohPeer:
    """Executes the commands."""

    def __init__(self, port: int, domain: int) -> None:
        self._where: dict[str, Any] = {"router_port": port, "domain_id": domain}
        self._endpoints: dict[int, Any] = {}
        self._messages: dict[int, list[Any]] = {}
        self._came = threading.Condition()

    def _options(self, params: dict[str, Any]) -> dict[str, Any]:
        name = full_name(params["type"])
        qos = QosProfile(
            reliability=QosReliability.BEST_EFFORT if params.get("best_effort") else QosReliability.RELIABLE,
            durability=QosDurability.TRANSIENT_LOCAL if params.get("latched") else QosDurability.VOLATILE,
            history_depth=params.get("depth", 10),
        )
        definition = STORE.generate_msgdef(name, ros_version=2)[0]
        type_hash = params.get("hash") or STORE.hash_rihs01(name)
        return {"msg_type": name, "msg_definition": definition, "type_hash": type_hash, "qos": qos, **self._where}

    def advertise(self, params: dict[str, Any]) -> dict[str, Any]:
        number = len(self._messages)
        self._messages[number] = []
        self._endpoints[number] = ROS2Publisher(params["topic"], node_name="sdk_talker", **self._options(params))
        return {"id": number}

    def publish(self, params: dict[str, Any]) -> dict[str, Any]:
        publisher = self._endpoints[params["id"]]
        publisher.publish(**fields_of(publisher.msg_type, params["message"], publisher.session_mgr.store))
        return {}

    def subscribe(self, params: dict[str, Any]) -> dict[str, Any]:
        number = len(self._messages)
        self._messages[number] = []

        def on_message(message: Any) -> None:
            with self._came:
                self._messages[number].append(plain(message))
                self._came.notify_all()

        subscriber = ROS2Subscriber(
            params["topic"], callback=on_message, node_name="sdk_listener", **self._options(params)
        )
        self._endpoints[number] = subscriber
        return {"id": number}

    def wait(self, params: dict[str, Any]) -> dict[str, Any]:
        messages = self._messages[params["id"]]
        with self._came:
            self._came.wait_for(lambda: len(messages) >= params["count"], params["seconds"])
            return {"messages": list(messages[params["since"] :])}

    def drop(self, params: dict[str, Any]) -> dict[str, Any]:
        self._endpoints.pop(params["id"]).close()
        return {}

    def _service(self, params: dict[str, Any]) -> dict[str, Any]:
        package, _, name = params["type"].partition("/")
        request, response = SERVICES[params["type"]]
        return {
            "srv_type": f"{package}/srv/{name}",
            "request_definition": request,
            "response_definition": response,
            **self._where,
        }

    def _add(self, endpoint: Any) -> int:
        number = len(self._messages)
        self._messages[number] = []
        self._endpoints[number] = endpoint
        return number

    def serve(self, params: dict[str, Any]) -> dict[str, Any]:
        serving = Serving(params, {"node_name": "sdk_server", **self._service(params)})
        return {"id": self._add(serving), "hash": serving.endpoint.type_hash}

    def requests(self, params: dict[str, Any]) -> dict[str, Any]:
        return {"requests": self._endpoints[params["id"]].requests(params.get("count", 1), params.get("seconds", 40.0))}

    def release(self, params: dict[str, Any]) -> dict[str, Any]:
        self._endpoints[params["id"]].released.set()
        return {}

    def call(self, params: dict[str, Any]) -> dict[str, Any]:
        client = ROS2ServiceClient(
            params["service"], node_name="sdk_client", timeout=params.get("timeout", 20.0), **self._service(params)
        )
        return {"id": self._add(Calling(client, params.get("request") or {}))}

    def result(self, params: dict[str, Any]) -> dict[str, Any]:
        result: dict[str, Any] = self._endpoints[params["id"]].result(params.get("seconds", 40.0))
        return result

    def topic_info(self, params: dict[str, Any]) -> dict[str, Any]:
        info = get_topic_info(params["topic"], verbose=True, **self._where)
        return {"info": None if info is None else json.loads(json.dumps(info, default=vars))}

    def graph(self, _params: dict[str, Any]) -> dict[str, Any]:
        topics = dict(get_topic_names_and_types(**self._where))
        infos = {topic: get_topic_info(topic, verbose=True, **self._where) for topic in topics}
        return {
            "topics": topics,
            "publishers": {t: [e.node_name for e in info.publishers] for t, info in infos.items() if info},
            "subscriptions": {t: [e.node_name for e in info.subscribers] for t, info in infos.items() if info},
        }

    def close(self) -> None:
        for endpoint in self._endpoints.values():
            endpoint.close()
        ZenohSession.get_instance(router_port=self._where["router_port"]).close()


def main() -> None:
    """Read commands until the input ends or ``exit``."""
    peer = ZenohPeer(int(sys.argv[1]), int(sys.argv[2]))
    try:
        for line in sys.stdin:
            command = json.loads(line)
            name = command.pop("do")
            if name == "exit":
                break
            try:
                answer = {"ok": True, **getattr(peer, name)(command)}
            except Exception as err:
                answer = {"ok": False, "error": f"{type(err).__name__}: {err}"}
            print(json.dumps(answer), flush=True)
    finally:
        peer.close()
    print(json.dumps({"ok": True}), flush=True)


if __name__ == "__main__":
    main()
