"""A native hub node with parameters, in the test's process: the six services that each rmw_zenoh node declares."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from bridge.hub.endpoints.calls import Abandon, Done
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.messages.services import ServiceCodec

_KINDS: dict[type, tuple[int, str]] = {
    bool: (1, "bool_value"), int: (2, "integer_value"), float: (3, "double_value"), str: (4, "string_value"),
}  # fmt: skip
"""Value of rcl_interfaces/msg/ParameterType and field of ParameterValue, by Python type."""


class HubParameters:
    """The parameters of one hub node, whose full name is ``node``; `stop` also closes the node.

    Attributes:
        values: the current values by name.
        services: the names of the six services.
    """

    def __init__(self, hub: Hub, node: str, registry: Registry, values: Mapping[str, Any]) -> None:
        self.hub, self.values = hub, dict(values)
        self._lock = threading.Lock()
        self.services = [self._serve(f"{node}/{method}", registry, method, kind) for method, kind in _SERVICES]

    def stop(self) -> None:
        """Leave the hub."""
        self.hub.close()

    def _serve(self, name: str, registry: Registry, method: str, kind: str) -> str:
        codec = ServiceCodec(registry, f"rcl_interfaces/srv/{kind}")

        def call(request: bytes, done: Done) -> Abandon:
            with self._lock:
                reply = getattr(self, f"_{method}")(codec.request_value(request))
            done(codec.response(reply))
            return lambda: None

        self.hub.server(name, codec.type.name, codec.type.type_id, call)
        return name

    def _get_parameters(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return {"values": [self._value(name) for name in request["names"]]}

    def _get_parameter_types(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return {"types": [self._value(name)["type"] for name in request["names"]]}

    def _list_parameters(self, _request: Mapping[str, Any]) -> dict[str, Any]:
        return {"result": {"names": list(self.values)}}

    def _describe_parameters(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return {"descriptors": [{"name": name, "type": self._value(name)["type"]} for name in request["names"]]}

    def _set_parameters(self, request: Mapping[str, Any]) -> dict[str, Any]:
        for parameter in request["parameters"]:
            field = dict(_KINDS.values())[parameter["value"]["type"]]
            self.values[parameter["name"]] = parameter["value"][field]
        return {"results": [{"successful": True} for _ in request["parameters"]]}

    def _set_parameters_atomically(self, request: Mapping[str, Any]) -> dict[str, Any]:
        self._set_parameters(request)
        return {"result": {"successful": True}}

    def _value(self, name: str) -> dict[str, Any]:
        if name not in self.values:
            return {"type": 0}
        number, field = _KINDS[type(self.values[name])]
        return {"type": number, field: self.values[name]}


_SERVICES = (
    ("get_parameters", "GetParameters"),
    ("get_parameter_types", "GetParameterTypes"),
    ("list_parameters", "ListParameters"),
    ("describe_parameters", "DescribeParameters"),
    ("set_parameters", "SetParameters"),
    ("set_parameters_atomically", "SetParametersAtomically"),
)
