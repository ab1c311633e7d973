"""The app reads parameters of ROS 2 nodes on request, and sets them if permitted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from bridge.adapters.ros1.parameters.values import ParameterType, ParameterValue, UnrepresentableError
from bridge.foxglove import parameters
from bridge.foxglove.parameters import value_of_kind
from bridge.hub.endpoints.calls import Abandon, Done, nothing
from bridge.messages.services import ServiceCodec
from tests.foxglove.conftest import Desk
from tests.foxglove.test_publishing import DRIVE, wait_for_status
from tests.peers.browser.foxglove_app import App
from tests.support.wait import until


class Node:
    """A node with parameters on the hub, with the three services that tools use."""

    def __init__(self, desk: Desk, name: str, values: Mapping[str, ParameterValue]) -> None:
        self.values = dict(values)
        self.read_parameters = 0
        self._desk = desk
        self._ends = [
            self._serve(f"{name}/list_parameters", "ListParameters", self._list),
            self._serve(f"{name}/get_parameters", "GetParameters", self._get),
            self._serve(f"{name}/set_parameters", "SetParameters", self._set),
        ]

    def _serve(self, name: str, kind: str, answer: Any) -> Any:
        codec = ServiceCodec(self._desk.far.registry, f"rcl_interfaces/srv/{kind}")

        def call(payload: bytes, done: Done) -> Abandon:
            done(codec.response(answer(codec.request_value(payload))))
            return nothing

        return self._desk.far.hub.server(name, codec.type.name, codec.type.type_id, call)

    def _list(self, _request: dict[str, Any]) -> dict[str, Any]:
        self.read_parameters += 1
        return {"result": {"names": list(self.values)}}

    def _get(self, request: dict[str, Any]) -> dict[str, Any]:
        return {"values": [self.values[name].message() for name in request["names"]]}

    def _set(self, request: dict[str, Any]) -> dict[str, Any]:
        results = []
        for parameter in request["parameters"]:
            value = ParameterValue.read(parameter["value"])
            refused = parameter["name"] == "fixed"
            results.append({"successful": not refused, "reason": "it is fixed" if refused else ""})
            if not refused:
                self.values[parameter["name"]] = value
        return {"results": results}

    def close(self) -> None:
        for end in self._ends:
            end.close()


VALUES = {
    "speed": ParameterValue(ParameterType.DOUBLE, 2.0),
    "count": ParameterValue(ParameterType.INTEGER, 3),
    "fixed": ParameterValue(ParameterType.STRING, "x"),
    "sizes": ParameterValue(ParameterType.DOUBLE_ARRAY, [1.0, 2.5]),
    "names": ParameterValue(ParameterType.STRING_ARRAY, ["a", "b"]),
    "raw": ParameterValue(ParameterType.BYTE_ARRAY, b"\0\1"),
    "limits.on": ParameterValue(ParameterType.BOOL, True),
    "unset": ParameterValue(ParameterType.NOT_SET),
}


def answers(app: App, request: str) -> dict[str, Any]:
    """Wait for an answer, and return its parameters by name."""

    def values() -> dict[str, Any] | None:
        parameters_ = [
            parameter
            for parameter in app.texts
            if parameter["op"] == "parameterValues" and parameter.get("id") == request
        ]
        return parameters_[-1] if parameters_ else None

    return {
        parameter["name"]: parameter for parameter in app.until(values, "the parameters have arrived")["parameters"]
    }


def read_parameters(app: App, *names: str) -> dict[str, Any]:
    app.texts.clear()
    app.send(op="getParameters", parameterNames=names, id="q")
    return answers(app, "q")


def test_parameters_of_all_nodes_are_returned_on_request(desk: Desk) -> None:
    node = Node(desk, "/ns/base", VALUES)
    with desk.app() as app:
        parameters_ = app.until(lambda: read_parameters(app), "the parameters are read")
        assert parameters_ == {
            "/ns/base.speed": {"name": "/ns/base.speed", "value": 2.0, "type": "float64"},
            "/ns/base.count": {"name": "/ns/base.count", "value": 3},
            "/ns/base.fixed": {"name": "/ns/base.fixed", "value": "x"},
            "/ns/base.sizes": {"name": "/ns/base.sizes", "value": [1.0, 2.5], "type": "float64_array"},
            "/ns/base.names": {"name": "/ns/base.names", "value": ["a", "b"]},
            "/ns/base.raw": {"name": "/ns/base.raw", "value": "AAE=", "type": "byte_array"},
            "/ns/base.limits.on": {"name": "/ns/base.limits.on", "value": True},
        }
        assert list(read_parameters(app, "/ns/base.count", "/ns/base.none")) == ["/ns/base.count"]
        node.values["count"] = ParameterValue(ParameterType.INTEGER, 4)

        def count() -> int | None:
            """Return the value; None while the node does not answer, which is skipped then."""
            value: int | None = read_parameters(app, "/ns/base.count").get("/ns/base.count", {}).get("value")
            return value

        until(lambda: count() == 4, "the change is read", 10)
        node.close()
        until(lambda: not read_parameters(app), "the node's parameters are removed", 10)


def test_nodes_are_queried_only_while_clients_request(desk: Desk) -> None:
    node = Node(desk, "/base", VALUES)
    with desk.app() as app:
        app.until(lambda: app.texts, "the client is accepted")
        desk.far.advertise("/said", "std_msgs/String")
        app.channel("/said")
        assert node.read_parameters == 0
        assert not desk.far.hub.graph.clients("/base/list_parameters")


def test_a_watching_client_may_not_set_parameters(desk: Desk) -> None:
    node = Node(desk, "/base", VALUES)
    with desk.app() as app:
        app.until(lambda: read_parameters(app), "the parameters are read")
        app.send(op="setParameters", parameters=[{"name": "/base.count", "value": 5}], id="w")
        wait_for_status(app, "you may read parameters, but not set them")
        assert answers(app, "w")["/base.count"]["value"] == node.values["count"].content == 3


def test_parameters_are_set_with_their_nodes_type(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameters, "WAIT_SECONDS", 20.0)  # a busy node may take longer than 0.5 s
    desk.open_with(**DRIVE)
    node = Node(desk, "/base", VALUES)
    with desk.app() as app, desk.app() as other:
        app.until(lambda: read_parameters(app), "the parameters are read")
        other.send(op="subscribeParameterUpdates", parameterNames=["/base.speed"])
        other.until(lambda: read_parameters(other), "the parameters are subscribed")
        other.texts.clear()
        new = {"/base.speed": 3, "/base.count": 7, "/base.raw": "AgM=", "/base.fixed": "y", "/base.no": 1}
        wanted = [{"name": name, "value": value} for name, value in new.items()]
        wanted[2]["type"] = "byte_array"
        app.send(op="setParameters", parameters=wanted, id="w")
        parameters_ = answers(app, "w")
        assert {name: parameter["value"] for name, parameter in parameters_.items()} == {
            "/base.speed": 3.0, "/base.count": 7, "/base.raw": "AgM=", "/base.fixed": "x",
        }  # fmt: skip
        assert (node.values["speed"], node.values["raw"].content) == (
            ParameterValue(ParameterType.DOUBLE, 3.0),
            b"\2\3",
        )
        wait_for_status(app, "/base refuses fixed: it is fixed")
        (update,) = other.until(
            lambda: [parameter for parameter in other.texts if parameter["op"] == "parameterValues"],
            "the other clients are notified",
        )
        assert update["parameters"] == [{"name": "/base.speed", "value": 3.0, "type": "float64"}]


def test_a_client_may_set_a_parameter_that_nobody_has_read(desk: Desk) -> None:
    desk.open_with(**DRIVE)
    node = Node(desk, "/base", VALUES)
    graph = desk.live.host.node.hub.graph
    until(lambda: graph.servers("/base/set_parameters"), "all services of the node are known, this one last")
    with desk.app() as app:
        app.send(op="setParameters", parameters=[{"name": "/base.count", "value": 5}], id="w")
        app.until(lambda: node.values["count"].content == 5, "the parameter is set")


@pytest.mark.parametrize(
    ("value", "kind", "wanted"),
    [(1, ParameterType.DOUBLE, 1.0), (1.0, ParameterType.INTEGER, 1), ([], ParameterType.BOOL_ARRAY, [])],
)
def test_values_are_converted_to_the_parameters_type(value: Any, kind: ParameterType, wanted: Any) -> None:
    assert value_of_kind(value, ParameterValue(kind, wanted)) == ParameterValue(kind, wanted)


@pytest.mark.parametrize("value", [{"a": 1}, [1, "x"], None, 1 << 70])
def test_values_without_a_ros_type_are_refused(value: Any) -> None:
    with pytest.raises(UnrepresentableError):
        value_of_kind(value, ParameterValue(ParameterType.INTEGER, 1))
