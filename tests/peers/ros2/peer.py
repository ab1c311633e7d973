"""A real rclpy program that a test controls by JSON lines; see `tests.peers.peer`. It does not use Midspan."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import json
import os
import signal
import sys
import threading
import time
from array import array
from collections.abc import Callable
from typing import Any, TextIO

import rclpy
import rclpy.utilities
from calls import Calls  # from the same folder: this file runs as a script
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions


def message_class(name: str) -> Any:
    """Return the class of a type ``package/Name``."""
    package, _, short = name.rpartition("/")
    return getattr(importlib.import_module(f"{package.partition('/')[0]}.msg"), short)


def to_plain(value: Any) -> Any:
    """Return a message, or a part of one, as JSON values."""
    if hasattr(value, "get_fields_and_field_types"):
        return {field: to_plain(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, (list, tuple, array)) or getattr(value, "ndim", None):
        return [to_plain(item) for item in value]
    return value.item() if hasattr(value, "item") else value


def fill(message: Any, fields: dict[str, Any]) -> Any:
    """Set the fields of a message from JSON; those not named keep their defaults."""
    types = message.get_fields_and_field_types()
    for field, value in fields.items():
        setattr(message, field, converted(types[field], value))
    return message


def converted(kind: str, value: Any) -> Any:
    """Return a field's value of the ROS 2 type ``kind``, in the form of ``get_fields_and_field_types``."""
    if kind.startswith("sequence<"):
        return [converted(kind[9:-1].split(",")[0].strip(), item) for item in value]
    if kind.endswith("]"):
        return [converted(kind.rpartition("[")[0], item) for item in value]
    if kind == "octet":
        return bytes([value])
    return fill(message_class(kind)(), value) if "/" in kind else value


class Endpoint:
    """A publisher, or a subscription with what it received."""

    def __init__(self, handle: Any, type_: Any) -> None:
        self.handle, self.type = handle, type_
        self.messages: list[Any] = []
        self.times: list[float] = []
        self.arrived = threading.Condition()

    def receive(self, message: Any) -> None:
        with self.arrived:
            self.messages.append(message)
            self.times.append(time.monotonic())
            self.arrived.notify_all()


class Counting:
    """Publishes numbers, one per message, on a thread."""

    def __init__(self, endpoint: Endpoint, first: int, count: int, rate: float) -> None:
        self.endpoint, self.sent, self.stopping = endpoint, 0, False
        self.thread = threading.Thread(target=self.run, args=(first, count, rate), daemon=True)
        self.thread.start()

    def run(self, first: int, count: int, rate: float) -> None:
        due = time.monotonic()
        while self.sent < count and not self.stopping:
            self.endpoint.handle.publish(fill(self.endpoint.type(), {"data": str(first + self.sent)}))
            self.sent += 1
            due += 1.0 / rate
            time.sleep(max(0.0, due - time.monotonic()))


class Peer:
    """The node, and the commands that use it."""

    def __init__(self, node: Any) -> None:
        self.node = node
        self.countings: dict[int, Counting] = {}
        self.endpoints: dict[int, Any] = {}
        self.calls = Calls(node, qos, fill, to_plain)

    def advertise(self, params: dict[str, Any]) -> dict[str, Any]:
        type_ = message_class(params["type"])
        return self._add(Endpoint(self.node.create_publisher(type_, params["topic"], qos(params)), type_))

    def subscribe(self, params: dict[str, Any]) -> dict[str, Any]:
        type_ = message_class(params["type"])
        endpoint = Endpoint(None, type_)
        endpoint.handle = self.node.create_subscription(type_, params["topic"], endpoint.receive, qos(params))
        return self._add(endpoint)

    def _add(self, endpoint: Any) -> dict[str, Any]:
        number = max(self.endpoints, default=0) + 1
        self.endpoints[number] = endpoint
        return {"id": number}

    def publish(self, params: dict[str, Any]) -> dict[str, Any]:
        endpoint = self.endpoints[params["id"]]
        message = fill(endpoint.type(), params["message"])
        for _ in range(params.get("times", 1)):
            endpoint.handle.publish(message)
        return {}

    def publish_raw(self, params: dict[str, Any]) -> dict[str, Any]:
        """Publish bytes instead of a message: ``hex``, then ``zeros`` zero bytes."""
        self.endpoints[params["id"]].handle.publish(bytes.fromhex(params["hex"]) + bytes(params.get("zeros", 0)))
        return {}

    def wait(self, params: dict[str, Any]) -> dict[str, Any]:
        endpoint = self.endpoints[params["id"]]
        with endpoint.arrived:
            endpoint.arrived.wait_for(lambda: len(endpoint.messages) >= params["count"], params["seconds"])
            return {"messages": [to_plain(m) for m in endpoint.messages[params["since"] :]]}

    def count(self, params: dict[str, Any]) -> dict[str, Any]:
        endpoint = self.endpoints[params["id"]]
        self.countings[params["id"]] = Counting(endpoint, params["first"], params["count"], params["rate"])
        return {}

    def counted(self, params: dict[str, Any]) -> dict[str, Any]:
        counting = self.countings.pop(params["id"])
        counting.stopping = params.get("now", False)
        counting.thread.join()
        return {"sent": counting.sent}

    def tally(self, params: dict[str, Any]) -> dict[str, Any]:
        endpoint = self.endpoints[params["id"]]
        with endpoint.arrived:
            numbers = [int(m.data) for m in endpoint.messages]
        return {"received": len(numbers), "distinct": len(set(numbers)), **self.silence(params)}

    def silence(self, params: dict[str, Any]) -> dict[str, Any]:
        endpoint, since = self.endpoints[params["id"]], params.get("since", 0.0)
        with endpoint.arrived:
            times = list(endpoint.times)
        later = [since, *(t for t in times if t >= since)]
        silence = max((after - before for before, after in itertools.pairwise(later)), default=0.0)
        return {"last": times[-1] if times else 0.0, "silence": silence}

    def serve(self, params: dict[str, Any]) -> dict[str, Any]:
        return self._add(self.calls.serve(params))

    def requests(self, params: dict[str, Any]) -> dict[str, Any]:
        return {"requests": self.endpoints[params["id"]].wait(params.get("count", 1), params.get("seconds", 40.0))}

    def release(self, params: dict[str, Any]) -> dict[str, Any]:
        self.endpoints[params["id"]].release()
        return {}

    def call(self, params: dict[str, Any]) -> dict[str, Any]:
        return self._add(self.calls.call(params))

    def result(self, params: dict[str, Any]) -> dict[str, Any]:
        outcome: dict[str, Any] = self.endpoints[params["id"]].result(params.get("seconds", 40.0))
        return outcome

    def act(self, params: dict[str, Any]) -> dict[str, Any]:
        return self._add(self.calls.act(params))

    def goals(self, params: dict[str, Any]) -> dict[str, Any]:
        return {"goals": self.endpoints[params["id"]].wait(params.get("count", 1), params.get("seconds", 40.0))}

    def send_goal(self, params: dict[str, Any]) -> dict[str, Any]:
        return self._add(self.calls.send_goal(params))

    def cancel(self, params: dict[str, Any]) -> dict[str, Any]:
        self.endpoints[params["id"]].cancel()
        return {}

    def ask_result(self, params: dict[str, Any]) -> dict[str, Any]:
        self.endpoints[params["id"]].ask()
        return {}

    def goal(self, params: dict[str, Any]) -> dict[str, Any]:
        return dict(self.endpoints[params["id"]].wait(params.get("until") or {}, params.get("seconds", 40.0)))

    def drop(self, params: dict[str, Any]) -> dict[str, Any]:
        endpoint = self.endpoints.pop(params["id"])
        if not isinstance(endpoint, Endpoint):
            endpoint.drop()
            return {}
        handle = endpoint.handle
        if isinstance(handle, rclpy.publisher.Publisher):
            self.node.destroy_publisher(handle)
        else:
            self.node.destroy_subscription(handle)
        return {}

    def graph(self, _params: dict[str, Any]) -> dict[str, Any]:
        topics = dict(self.node.get_topic_names_and_types())
        return {
            "topics": topics,
            "publishers": {t: [i.node_name for i in self.node.get_publishers_info_by_topic(t)] for t in topics},
            "subscriptions": {t: [i.node_name for i in self.node.get_subscriptions_info_by_topic(t)] for t in topics},
        }


def qos(params: dict[str, Any]) -> Any:
    """Return the profile for a command; by default deep enough for bursts that a busy program handles late."""
    profile: Any = QoSProfile(  # type: ignore[no-untyped-call]
        depth=params.get("depth") or (10 if params.get("latched") else 100),
        durability=DurabilityPolicy.TRANSIENT_LOCAL if params.get("latched") else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.BEST_EFFORT if params.get("best_effort") else ReliabilityPolicy.RELIABLE,
    )
    return profile


class EndedError(Exception):
    """Raised by SIGTERM, so that the shared memory is released."""


def end(_number: int, _frame: Any) -> None:
    """Handle SIGTERM."""
    raise EndedError


def execute(peer: Peer, answers: TextIO) -> None:
    """Execute commands until ``exit`` or the end of the input."""
    for line in sys.stdin:
        params = json.loads(line)
        if params["do"] == "exit":
            break
        try:
            answer = {"ok": True, **getattr(peer, params["do"])(params)}
        except EndedError:
            raise
        except Exception as err:
            answer = {"ok": False, "error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")


def main(make: Callable[[Any], Peer] = Peer) -> None:
    """Execute the commands from standard input until it ends."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # Fast DDS's own output, such as on port locks, must not mix with the answers
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node: Any = rclpy.create_node(sys.argv[1] if len(sys.argv) > 1 else "peer")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    spinner.start()
    with contextlib.suppress(EndedError):
        signal.signal(signal.SIGTERM, end)
        execute(make(node), answers)
    executor.shutdown(1.0)
    spinner.join(2)
    node.destroy_node()
    rclpy.utilities.try_shutdown()


if __name__ == "__main__":
    main()
