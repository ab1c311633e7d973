"""A real rclpy program with parameters, which also reads and sets those of other nodes; see `tests.peers.peer`.

Commands in addition to those of `peer.py`: ``declare`` parameters (name to value) and ``unset`` ones (name to type);
``refuse`` names; ``own`` name -> value; ``change`` name, value; ``get_of`` node, names -> values; ``set_of`` node,
parameters -> reasons ("" if it was set); ``list_of`` node -> names; ``nodes`` -> names.
"""

from __future__ import annotations

import threading
from typing import Any

from peer import Peer, main
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient


class ParameterPeer(Peer):
    """The program's commands."""

    def __init__(self, node: Any) -> None:
        super().__init__(node)
        self._node = node
        self._refused: set[str] = set()
        self._clients: dict[str, Any] = {}
        node.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: Any) -> Any:
        wrong = [parameter.name for parameter in parameters if parameter.name in self._refused]
        return SetParametersResult(
            successful=not wrong, reason=f"{', '.join(wrong)} cannot be changed" if wrong else ""
        )

    def declare(self, params: dict[str, Any]) -> dict[str, Any]:
        for name, value in params["parameters"].items():
            self._node.declare_parameter(name, value)
        for name, kind in params.get("unset", {}).items():
            self._node.declare_parameter(name, Parameter.Type[kind])
        return {}

    def refuse(self, params: dict[str, Any]) -> dict[str, Any]:
        self._refused = set(params["names"])
        return {}

    def own(self, params: dict[str, Any]) -> dict[str, Any]:
        value = self._node.get_parameter_or(params["name"]).value
        return {"value": list(value) if hasattr(value, "typecode") else value}

    def change(self, params: dict[str, Any]) -> dict[str, Any]:
        (result,) = self._node.set_parameters([Parameter(params["name"], value=params["value"])])
        return {"successful": result.successful}

    def get_of(self, params: dict[str, Any]) -> dict[str, Any]:
        got = self._wait(self._client(params["node"]).get_parameters(params["names"]))
        values = [parameter_value_to_python(value) for value in got.values]
        return {"values": [list(entry) if hasattr(entry, "typecode") else entry for entry in values]}

    def set_of(self, params: dict[str, Any]) -> dict[str, Any]:
        wanted = [Parameter(name, value=value) for name, value in params["parameters"].items()]
        done = self._wait(self._client(params["node"]).set_parameters(wanted))
        return {"reasons": ["" if result.successful else result.reason or "refused" for result in done.results]}

    def list_of(self, params: dict[str, Any]) -> dict[str, Any]:
        return {"names": list(self._wait(self._client(params["node"]).list_parameters()).result.names)}

    def nodes(self, _params: dict[str, Any]) -> dict[str, Any]:
        return {"names": [f"{space.rstrip('/')}/{name}" for name, space in self._node.get_node_names_and_namespaces()]}

    def _client(self, node: str) -> Any:
        if node not in self._clients:
            self._clients[node] = AsyncParameterClient(self._node, node)
        assert self._clients[node].wait_for_services(30.0), f"{node} has no parameter services"
        return self._clients[node]

    def _wait(self, future: Any) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(30.0), "no response"
        return future.result()


if __name__ == "__main__":
    main(ParameterPeer)
