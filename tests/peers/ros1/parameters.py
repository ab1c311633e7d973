"""A hub node with parameters, a client of its services, and rules and a server that share the parameters with ROS 1."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from typing_extensions import override

from bridge.adapters.ros1.parameters.follower import ParameterSharing
from bridge.adapters.ros1.parameters.store import ParameterServer, codecs, copies_parameter
from bridge.adapters.ros1.parameters.values import NOT_SET, ParameterType, ParameterValue
from bridge.config.sections.routing import ParameterRule
from bridge.hub.endpoints.calls import CallError
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.support.wait import until

REGISTRY = Registry()
CODECS = codecs(REGISTRY)
PERIOD = 0.1
OWNER = "1d3f"
COPIES = copies_parameter(OWNER)
NOBODY = "http://127.0.0.1:1/"
"""An address to which no master can report changes, so only the periodic comparison detects them."""


class RecordingServer(ParameterServer):
    """A master's parameter server that counts written parameters."""

    def __init__(self, uri: str, owner: str = OWNER) -> None:
        super().__init__(uri, lambda: "/midspan_test", NOBODY, owner)
        self.written = 0

    @override
    def write(self, values: Mapping[str, Any]) -> list[str]:
        self.written += len(values)
        return super().write(values)


class Share(Protocol):
    """Starts sharing parameters by rules."""

    def __call__(
        self, *rules: ParameterRule, active: Callable[[], bool] = ..., store: ParameterServer | None = ...
    ) -> ParameterSharing: ...


def rule(owner: str, ros1: str, node: str, **more: Any) -> ParameterRule:
    return ParameterRule.model_validate({"owner": owner, "ros1": ros1, "node": node, **more})


def double(value: float) -> ParameterValue:
    return ParameterValue(ParameterType.DOUBLE, value)


def integer(value: int) -> ParameterValue:
    return ParameterValue(ParameterType.INTEGER, value)


class ParameterClient:
    """Calls the parameter services of one hub node."""

    def __init__(self, hub: Hub, node: str) -> None:
        self._clients = {
            name: hub.client(f"{node}/{name}", codec.type.name, codec.type.type_id) for name, codec in CODECS.items()
        }
        until(lambda: all(client.ready for client in self._clients.values()), f"{node} is on the hub")

    def call(self, word: str, **request: Any) -> Any:
        done, results = threading.Event(), []

        def answered(result: bytes | CallError) -> None:
            results.append(result)
            done.set()

        self._clients[word].call(CODECS[word].request(request), answered)
        assert done.wait(20)
        if isinstance(results[0], CallError):
            raise results[0]
        return CODECS[word].response_value(results[0])

    def get(self, *names: str) -> list[Any]:
        return [
            ParameterValue.read(value).content for value in self.call("get_parameters", names=list(names))["values"]
        ]

    def set(self, word: str = "set_parameters", **values: ParameterValue) -> Any:
        wanted = [{"name": name.replace("__", "."), "value": value.message()} for name, value in values.items()]
        return self.call(word, parameters=wanted)


class ParameterNode:
    """A ROS 2 node on the hub with parameters, which rejects some changes.

    Attributes:
        values: the declared parameters; the type of a parameter without a value is in ``types``, DOUBLE by default.
        asked: number of requests for the names of the parameters.
        hangs: whether it keeps requests without a reply, until `resume`.
    """

    def __init__(self, hub: Hub, node: str, **values: ParameterValue) -> None:
        self.values = {name.replace("__", "."): value for name, value in values.items()}
        self.types: dict[str, ParameterType] = {}
        self.refuses: set[str] = set()
        self.set: list[tuple[str, Any]] = []
        self.asked = 0
        self.hangs = False
        self._kept: list[Callable[[], None]] = []
        self._servers = [
            hub.server(f"{node}/{key}", codec.type.name, codec.type.type_id, self._answer(key))
            for key, codec in CODECS.items()
        ]

    def _answer(self, word: str) -> Any:
        def call(request: bytes, done: Any) -> Any:
            def reply() -> None:
                done(CODECS[word].response(getattr(self, f"_{word}")(CODECS[word].request_value(request))))

            if self.hangs:
                self._kept.append(reply)
            else:
                reply()
            return lambda: None

        return call

    @property
    def kept(self) -> int:
        """Number of requests without a reply."""
        return len(self._kept)

    def resume(self, *, lost: bool = False) -> None:
        """Reply to all requests that were kept; ``lost``: without these replies."""
        self.hangs = False
        kept, self._kept = self._kept, []
        for reply in () if lost else kept:
            reply()

    def _list_parameters(self, request: Any) -> Any:
        self.asked += 1
        names = list(self.values)  # the test may change them meanwhile
        wanted = [n for n in names if not request["prefixes"] or n.startswith(request["prefixes"][0])]
        return {"result": {"names": wanted}}

    def _describe_parameters(self, request: Any) -> Any:
        return {"descriptors": [{"name": name, "type": int(self._type(name))} for name in request["names"]]}

    def _type(self, name: str) -> ParameterType:
        kind = self.values.get(name, NOT_SET).kind
        return self.types.get(name, ParameterType.DOUBLE) if kind is ParameterType.NOT_SET else kind

    def _get_parameter_types(self, request: Any) -> Any:
        return {"types": [int(self.values.get(name, NOT_SET).kind) for name in request["names"]]}

    def _get_parameters(self, request: Any) -> Any:
        values = [self.values.get(name, NOT_SET) for name in request["names"]]
        return {"values": [] if NOT_SET in values else [value.message() for value in values]}  # like rclcpp

    def _set_parameters(self, request: Any) -> Any:
        return {
            "results": [self._set(item["name"], ParameterValue.read(item["value"])) for item in request["parameters"]]
        }

    def _set(self, name: str, value: ParameterValue) -> Any:
        self.set.append((name, value.content))
        if name in self.refuses or value.kind is not self._type(name):
            return {"successful": False, "reason": "not now"}
        self.values[name] = value
        return {"successful": True}

    def close(self) -> None:
        for service in self._servers:
            service.close()
