"""A real rclpy program with parameters, which also reads and sets other nodes' parameters; see `tests.peers.peer`.

Commands in addition to those of `peer.py`: ``declare`` parameters (name to value) and ``unset`` ones (name to type);
``refuse`` names; ``own`` name -> value; ``change`` name, value; ``get_of`` node, names -> values; ``set_of`` node,
parameters -> reasons ("" if it was set); ``list_of`` node -> names; ``nodes`` -> names.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.ros2.peer import Peer, main


class ParameterPeer(Peer):
    """The program's commands."""

    def __init__(self, node: Any) -> None:
        super().__init__(node)
        self._refused: set[str] = set()
        self._parameter_clients: dict[str, Any] = {}
        node.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: Any) -> Any:
        wrong = [parameter.name for parameter in parameters if parameter.name in self._refused]
        return SetParametersResult(
            successful=not wrong, reason=f"{', '.join(wrong)} cannot be changed" if wrong else ""
        )

    def declare(self, parameters: dict[str, Any], unset: dict[str, str] | None = None) -> dict[str, Any]:
        for name, value in parameters.items():
            self.node.declare_parameter(name, value)
        for name, kind in (unset or {}).items():
            self.node.declare_parameter(name, Parameter.Type[kind])
        return {}

    def refuse(self, names: list[str]) -> dict[str, Any]:
        self._refused = set(names)
        return {}

    def own(self, name: str) -> dict[str, Any]:
        value = self.node.get_parameter_or(name).value
        return {"value": list(value) if hasattr(value, "typecode") else value}

    def change(self, name: str, value: Any) -> dict[str, Any]:
        (result,) = self.node.set_parameters([Parameter(name, value=value)])
        return {"successful": result.successful}

    def get_of(self, node: str, names: list[str]) -> dict[str, Any]:
        got = self._wait(self._client(node).get_parameters(names))
        values = [parameter_value_to_python(value) for value in got.values]
        return {"values": [list(entry) if hasattr(entry, "typecode") else entry for entry in values]}

    def set_of(self, node: str, parameters: dict[str, Any]) -> dict[str, Any]:
        wanted = [Parameter(name, value=value) for name, value in parameters.items()]
        done = self._wait(self._client(node).set_parameters(wanted))
        return {"reasons": ["" if result.successful else result.reason or "refused" for result in done.results]}

    def list_of(self, node: str) -> dict[str, Any]:
        return {"names": list(self._wait(self._client(node).list_parameters()).result.names)}

    def nodes(self) -> dict[str, Any]:
        return {"names": [f"{space.rstrip('/')}/{name}" for name, space in self.node.get_node_names_and_namespaces()]}

    def _client(self, node: str) -> Any:
        if node not in self._parameter_clients:
            self._parameter_clients[node] = AsyncParameterClient(self.node, node)
        assert self._parameter_clients[node].wait_for_services(30.0), f"{node} has no parameter services"
        return self._parameter_clients[node]

    def _wait(self, future: Any) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(30.0), "no response"
        return future.result()


if __name__ == "__main__":
    main(ParameterPeer)
