"""Parameters shared between a real roscore's parameter server and nodes on the hub."""

from __future__ import annotations

import threading
import xmlrpc.client
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.adapters.ros1.parameters.follower import ParameterSharing
from bridge.adapters.ros1.parameters.store import ParameterServer, codecs
from bridge.adapters.ros1.parameters.values import (
    NOT_SET,
    ParameterNames,
    ParameterType,
    ParameterValue,
    UnsayableError,
    flatten,
    to_ros1,
    to_ros2,
)
from bridge.config.sections.routing import ParameterRule, RoutingSection
from bridge.hub.endpoints.calls import CallError
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader
from bridge.routing.rules import RuleSet
from tests.support.hub import HubNetwork
from tests.support.ros1 import RosMaster, needs_ros1
from tests.support.wait import until

REGISTRY = Registry()
CODECS = codecs(REGISTRY)
PERIOD = 0.1
NOBODY = "http://127.0.0.1:1/"
"""Where no master can tell that something changed: what the next look finds then must do."""

VALUES = [
    (True, ParameterValue(ParameterType.BOOL, True)),
    (-7, ParameterValue(ParameterType.INTEGER, -7)),
    (2.5, ParameterValue(ParameterType.DOUBLE, 2.5)),
    (float("nan"), ParameterValue(ParameterType.DOUBLE, float("nan"))),
    ("base <&> link é😀\n", ParameterValue(ParameterType.STRING, "base <&> link é😀\n")),
    (xmlrpc.client.Binary(b"\0\xff"), ParameterValue(ParameterType.BYTE_ARRAY, b"\0\xff")),
    ([True, False], ParameterValue(ParameterType.BOOL_ARRAY, [True, False])),
    ([1, 2], ParameterValue(ParameterType.INTEGER_ARRAY, [1, 2])),
    ([1.5, 2.0], ParameterValue(ParameterType.DOUBLE_ARRAY, [1.5, 2.0])),
    (["a", ""], ParameterValue(ParameterType.STRING_ARRAY, ["a", ""])),
]


@pytest.mark.parametrize(("ros1", "ros2"), VALUES)
def test_values_go_there_and_back(ros1: Any, ros2: ParameterValue):
    assert to_ros2(ros1) == ros2
    assert repr(to_ros1(ros2)) == repr(ros1) or to_ros1(ros2) == ros1
    codec = CODECS["get_parameters"]
    sent = codec.response({"values": [ros2.message()]})
    assert ParameterValue.read(codec.response_value(sent)["values"][0]) == ros2
    assert ros2 != NOT_SET


@pytest.mark.parametrize(
    ("ros1", "like", "ros2"),
    [
        (1, ParameterType.DOUBLE, ParameterValue(ParameterType.DOUBLE, 1.0)),
        (2.0, ParameterType.INTEGER, ParameterValue(ParameterType.INTEGER, 2)),
        (2.5, ParameterType.INTEGER, ParameterValue(ParameterType.DOUBLE, 2.5)),
        (True, ParameterType.INTEGER, ParameterValue(ParameterType.BOOL, True)),
        ([1, 2], ParameterType.DOUBLE_ARRAY, ParameterValue(ParameterType.DOUBLE_ARRAY, [1.0, 2.0])),
        ([1, 2.5], ParameterType.NOT_SET, ParameterValue(ParameterType.DOUBLE_ARRAY, [1.0, 2.5])),
        ([], ParameterType.BOOL_ARRAY, ParameterValue(ParameterType.BOOL_ARRAY, [])),
        ([], ParameterType.DOUBLE, ParameterValue(ParameterType.STRING_ARRAY, [])),
    ],
)
def test_numbers_take_the_kind_that_the_node_has(ros1: Any, like: ParameterType, ros2: ParameterValue):
    assert to_ros2(ros1, like) == ros2


def test_what_cannot_be_said_is_refused():
    for ros1 in ({"a": 1}, [[1], [2]], [1, "a"], [True, 1], None, xmlrpc.client.DateTime(), 2**63):
        with pytest.raises(UnsayableError):
            to_ros2(ros1)
    for ros2 in (
        ParameterValue(ParameterType.INTEGER, 2**31),
        ParameterValue(ParameterType.STRING, "a\0"),
        ParameterValue(ParameterType.STRING_ARRAY, ["\r"]),
        NOT_SET,
    ):
        with pytest.raises(UnsayableError):
            to_ros1(ros2)


def rule(owner: str, ros1: str, node: str, **more: Any) -> ParameterRule:
    return ParameterRule.model_validate({"owner": owner, "ros1": ros1, "node": node, **more})


def test_names_follow_the_rule():
    names = ParameterNames(rule("ros2", "/move_base/dwa", "/controller", prefix="FollowPath", names=["*", "deep/**"]))
    for rest, ros1, ros2 in (
        ("x", "/move_base/dwa/x", "FollowPath.x"),
        ("deep/a/b", "/move_base/dwa/deep/a/b", "FollowPath.deep.a.b"),
    ):
        assert (names.ros1(rest), names.ros2(rest), names.rest(ros2)) == (ros1, ros2, rest)
    assert [names.rest(other) for other in ("FollowPathX.x", "x", "FollowPath.a.b", "FollowPath.q/.x")] == [None] * 4
    one = ParameterNames(rule("ros2", "/speed", "/base", prefix="limits.speed"))
    assert (one.ros1(""), one.ros2(""), one.rest("limits.speed")) == ("/speed", "limits.speed", "")
    assert dict(flatten({"a": {"b": 1, "c": {}}, "d": [2]})) == {"a/b": 1, "d": [2]}
    assert dict(flatten(3)) == {"": 3}


@pytest.mark.parametrize(
    ("rules", "reason"),
    [
        ([{"ros1": "move_base"}], "write it as /move_base"),
        ([{"node": "controller"}], "write it as /controller_server"),
        ([{"prefix": "a/b"}], "write it as FollowPath"),
        ([{"owner": "yarp"}], "'ros1' or 'ros2'"),
        ([{}, {"ros1": "/b", "owner": "ros1"}], "give /n two owners"),
        ([{}, {"ros1": "/a/b", "node": "/m"}], "both take what is in /a/b"),
    ],
)
def test_a_wrong_rule_is_told(rules: list[dict[str, Any]], reason: str):
    whole = [{"ros1": "/a", "node": "/n", "owner": "ros2", **one} for one in rules]
    with pytest.raises(ValueError, match=reason):
        RoutingSection.model_validate({"parameters": whole})


def test_a_nodes_parameter_services_cross_where_a_rule_names_it():
    section = RoutingSection.model_validate({"parameters": [{"ros1": "/a", "node": "/ns/n", "owner": "ros2"}]})
    rules, kind = RuleSet(section), "rcl_interfaces/srv/GetParameters"
    assert rules.enter("ros2", "/ns/n/get_parameters", kind, "service").allowed
    assert not rules.enter("ros2", "/ns/other/get_parameters", kind, "service").allowed
    assert not rules.enter("ros2", "/ns/n/change_state", "lifecycle_msgs/srv/ChangeState", "service").allowed
    assert not rules.leave("ros2", "ros1", "/ns/n/get_parameters", kind, "service").allowed
    assert rules.leave("ros1", "ros2", "/ns/n/get_parameters", kind, "service").allowed
    event = "rcl_interfaces/msg/ParameterEvent"
    assert [rules.leave("ros1", side, "/parameter_events", event).allowed for side in ("ros2", "yarp")] == [True, False]
    denied = section.model_copy(update={"rules": (section.__class__.model_validate(
        {"rules": [{"topic": "/ns/**", "deny": True}]}
    ).rules)})  # fmt: skip
    assert not RuleSet(denied).enter("ros2", "/ns/n/get_parameters", kind, "service").allowed


# -- on a real parameter server ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def network() -> Iterator[HubNetwork]:
    with HubNetwork() as network:
        yield network


@pytest.fixture
def hubs(network: HubNetwork) -> Iterator[tuple[Hub, Hub]]:
    """The worker's session and that of others."""
    with Hub.open(network.settings("midspan_ros1")) as ours, Hub.open(network.settings("others")) as others:
        yield ours, others


Share = Callable[..., ParameterSharing]


@pytest.fixture
def share(master: RosMaster, hubs: tuple[Hub, Hub]) -> Iterator[Share]:
    started: list[ParameterSharing] = []

    def start(*rules: ParameterRule, active: Callable[[], bool] = lambda: True) -> ParameterSharing:
        store = ParameterServer(master.uri, lambda: "/midspan_test", NOBODY)
        started.append(ParameterSharing(rules, hubs[0], REGISTRY, store, active, PERIOD))
        return started[-1]

    yield start
    for parameters in started:
        parameters.stop()


class Client:
    """Calls the parameter services of one node on the hub."""

    def __init__(self, hub: Hub, node: str) -> None:
        self._clients = {
            word: hub.client(f"{node}/{word}", codec.type.name, codec.type.type_id) for word, codec in CODECS.items()
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


@needs_ros1
def test_ros1s_parameters_are_those_of_a_node(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    master.call(
        "setParam", "/own", {"speed": 1.5, "frames": {"base": "base_link"}, "odd": [[1], [2]], "deep": {"x": 1}}
    )
    parameters = share(
        rule("ros1", "/own", "/ns/own_node"), rule("ros1", "/own_one", "/ns/own_node", prefix="one", write=False)
    )
    master.call("setParam", "/own_one", 3)
    client = Client(hubs[1], "/ns/own_node")
    until(
        lambda: ("own_node", "/ns") in {(n.node, n.namespace) for n in hubs[1].graph.nodes()}, "the node is there", 20
    )
    assert client.get("speed", "frames.base", "one", "nothing") == [1.5, "base_link", 3, None]
    listed = client.call("list_parameters", prefixes=[], depth=0)["result"]
    assert (listed["names"], listed["prefixes"]) == (["deep.x", "frames.base", "one", "speed"], ["deep", "frames"])
    assert client.call("list_parameters", prefixes=["frames"], depth=1)["result"]["names"] == ["frames.base"]
    assert client.call("list_parameters", prefixes=[], depth=1)["result"]["names"] == ["one", "speed"]
    assert client.call("get_parameter_types", names=["speed", "one", "x"])["types"].tolist() == [3, 2, 0]
    about = client.call("describe_parameters", names=["speed", "one"])["descriptors"]
    assert [(one["type"], one["read_only"], one["description"]) for one in about] == [
        (3, False, "ROS 1 parameter /own/speed"),
        (2, True, "ROS 1 parameter /own_one"),
    ]
    until(lambda: any("/own/odd" in warning for warning in parameters.warnings()), "the odd list is told")
    assert parameters.details()[0] == {"ros1": "/own", "node": "/ns/own_node", "owner": "ros1", "shared": 4}


@needs_ros1
def test_a_node_of_ros2_sets_ros1s_parameters(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    master.call("setParam", "/set", {"speed": 1.5, "below": {"x": 1}, "fixed": 7})
    share(rule("ros1", "/set", "/set_node", names=["speed", "below/**", "new"]))
    client = Client(hubs[1], "/set_node")
    results = client.set(
        speed=ParameterValue(ParameterType.DOUBLE, 2.5),
        fixed=ParameterValue(ParameterType.INTEGER, 8),
        below=ParameterValue(ParameterType.INTEGER, 1),
        new=ParameterValue(ParameterType.STRING, "there"), below__x=ParameterValue(ParameterType.INTEGER, 2**40),
    )["results"]  # fmt: skip
    assert [one["successful"] for one in results] == [True, False, False, True, False]
    assert [one["reason"] for one in results if one["reason"]] == [
        "no rule of routing.parameters shares fixed",
        "/set/below is a namespace in ROS 1",
        "below.x: ROS 1 has no integer as large as 1099511627776",
    ]
    assert master.call("getParam", "/set") == {"speed": 2.5, "below": {"x": 1}, "fixed": 7, "new": "there"}
    both = {"speed": ParameterValue(ParameterType.DOUBLE, 9.0), "nobody": ParameterValue(ParameterType.DOUBLE, 9.0)}
    assert not client.set("set_parameters_atomically", **both)["result"]["successful"]
    assert master.call("getParam", "/set/speed") == 2.5
    assert client.set("set_parameters_atomically", new=NOT_SET)["result"]["successful"]
    assert master.call("getParam", "/set/new") is None


@needs_ros1
def test_changes_of_ros1s_parameters_are_events(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    kind = REGISTRY.ros2("rcl_interfaces/msg/ParameterEvent")
    heard: list[dict[str, Any]] = []

    def take(sample: Any) -> None:
        heard.append(MessageReader(REGISTRY.schema(kind.name), sample.payload.to_bytes()).message())

    hubs[1].subscription("/parameter_events", kind.name, kind.type_id, Qos(depth=100), take)
    master.call("setParam", "/told", {"stays": 1, "changes": 2, "goes": 3})
    share(rule("ros1", "/told", "/told_node"))
    Client(hubs[1], "/told_node")

    def changed() -> bool:
        master.call("setParam", "/told/changes", master.call("getParam", "/told/changes") + 1)
        return any(one["name"] == "changes" for event in heard for one in event["changed_parameters"])

    until(changed, "the change is told", every=0.5)
    master.call("deleteParam", "/told/goes")
    master.call("setParam", "/told/comes", "new")
    until(lambda: [n["name"] for e in heard for n in e["deleted_parameters"]] == ["goes"], "the end is told")
    until(lambda: [n["value"]["string_value"] for e in heard for n in e["new_parameters"]] == ["new"], "the new")
    assert {event["node"] for event in heard} == {"/told_node"}


class Node:
    """A ROS 2 node on the hub that has parameters, some of which it refuses to change."""

    def __init__(self, hub: Hub, node: str, **values: ParameterValue) -> None:
        self.values = {name.replace("__", "."): value for name, value in values.items()}
        self.refuses: set[str] = set()
        self.set: list[tuple[str, Any]] = []
        self.whole = True
        self._servers = [
            hub.server(f"{node}/{word}", codec.type.name, codec.type.type_id, self._answer(word))
            for word, codec in CODECS.items()
        ]

    def _answer(self, word: str) -> Any:
        def call(request: bytes, done: Any) -> Any:
            done(CODECS[word].response(getattr(self, f"_{word}")(CODECS[word].request_value(request))))
            return lambda: None

        return call

    def _list_parameters(self, request: Any) -> Any:
        wanted = [n for n in self.values if not request["prefixes"] or n.startswith(request["prefixes"][0])]
        return {"result": {"names": wanted}}

    def _get_parameter_types(self, request: Any) -> Any:
        return {"types": [int(self.values[name].kind) for name in request["names"]]}

    def _get_parameters(self, request: Any) -> Any:
        values = [self.values[name] for name in request["names"]]
        return {"values": [] if NOT_SET in values else [value.message() for value in values]}  # as rclcpp does

    def _set_parameters(self, request: Any) -> Any:
        return {"results": [self._set(one["name"], ParameterValue.read(one["value"])) for one in request["parameters"]]}

    def _set(self, name: str, value: ParameterValue) -> Any:
        self.set.append((name, value.content))
        if name in self.refuses or value.kind is not self.values[name].kind:
            return {"successful": False, "reason": "not now"}
        self.values[name] = value
        return {"successful": True}

    def close(self) -> None:
        for server in self._servers:
            server.close()


@needs_ros1
def test_a_nodes_parameters_are_kept_in_ros1(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = Node(
        hubs[1], "/kept_node",
        FollowPath__speed=ParameterValue(ParameterType.DOUBLE, 1.5),
        FollowPath__inner__frame=ParameterValue(ParameterType.STRING, "odom"),
        FollowPath__huge=ParameterValue(ParameterType.INTEGER, 2**40),
        FollowPath__unset=NOT_SET,
        other=ParameterValue(ParameterType.INTEGER, 1),
    )  # fmt: skip
    master.call("setParam", "/kept", {"mine": 1, "speed": 99.0})
    parameters = share(rule("ros2", "/kept", "/kept_node", prefix="FollowPath"))
    want = {"mine": 1, "speed": 1.5, "inner": {"frame": "odom"}}
    until(lambda: master.call("getParam", "/kept") == want, "the node's values are in ROS 1")
    assert any("/kept/huge: ROS 1 has no integer" in warning for warning in parameters.warnings())
    node.values["FollowPath.speed"] = ParameterValue(ParameterType.DOUBLE, 2.5)
    until(lambda: master.call("getParam", "/kept/speed") == 2.5, "the node's change is in ROS 1")
    del node.values["FollowPath.inner.frame"]
    until(lambda: master.call("getParam", "/kept/inner/frame") is None, "what it no longer has is gone")
    assert node.set == []
    parameters.stop()
    assert master.call("getParam", "/kept").keys() <= {"mine", "inner"}


@needs_ros1
def test_ros1_sets_a_nodes_parameters(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = Node(
        hubs[1],
        "/asked_node",
        speed=ParameterValue(ParameterType.DOUBLE, 1.5),
        mode=ParameterValue(ParameterType.STRING, "slow"),
    )
    parameters = share(rule("ros2", "/asked", "/asked_node"))
    until(lambda: master.call("getParam", "/asked") == {"speed": 1.5, "mode": "slow"}, "both are in ROS 1")
    master.call("setParam", "/asked/speed", 3)
    parameters.changed()
    until(lambda: node.values["speed"] == ParameterValue(ParameterType.DOUBLE, 3.0), "the node has ROS 1's value")
    node.refuses = {"mode"}
    master.call("setParam", "/asked/mode", "fast")
    until(lambda: master.call("getParam", "/asked/mode") == "slow", "what it refused is put back")
    assert ("mode", "fast") in node.set
    until(lambda: any("refused 'fast': not now" in one for one in parameters.warnings()), "it is told")
    assert parameters.details() == [{"ros1": "/asked", "node": "/asked_node", "owner": "ros2", "shared": 2}]


@needs_ros1
def test_what_is_not_to_be_written_is_put_back(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = Node(hubs[1], "/read_node", speed=ParameterValue(ParameterType.DOUBLE, 1.5))
    share(rule("ros2", "/read_only", "/read_node", write=False))
    until(lambda: master.call("getParam", "/read_only/speed") == 1.5, "it is in ROS 1")
    master.call("setParam", "/read_only/speed", 3.0)
    until(lambda: master.call("getParam", "/read_only/speed") == 1.5, "it is put back")
    assert node.set == []


@needs_ros1
def test_nothing_is_kept_for_a_node_that_is_away(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = Node(hubs[1], "/away_node", speed=ParameterValue(ParameterType.DOUBLE, 1.5))
    parameters = share(rule("ros2", "/away", "/away_node"))
    until(lambda: master.call("getParam", "/away/speed") == 1.5, "it is in ROS 1")
    node.close()
    until(lambda: parameters.details()[0]["shared"] == 0, "the node is gone")
    master.call("setParam", "/away/speed", 9.0)
    again = Node(hubs[1], "/away_node", speed=ParameterValue(ParameterType.DOUBLE, 2.0))
    until(lambda: master.call("getParam", "/away/speed") == 2.0, "the node's value counts")
    assert again.set == []


@pytest.mark.thorough
@needs_ros1
def test_a_master_that_goes_takes_the_node_with_it(hubs: tuple[Hub, Hub]):
    with RosMaster() as master:
        master.call("setParam", "/gone/speed", 1.0)
        store = ParameterServer(master.uri, lambda: "/midspan_test", NOBODY)
        parameters = ParameterSharing(
            [rule("ros1", "/gone", "/gone_node")], hubs[0], REGISTRY, store, lambda: True, PERIOD
        )
        try:
            assert Client(hubs[1], "/gone_node").get("speed") == [1.0]
            master.stop()
            until(lambda: not hubs[1].graph.servers("/gone_node/get_parameters"), "the node is gone")
            assert any("cannot be asked" in warning for warning in parameters.warnings())
            master.start()
            master.call("setParam", "/gone/speed", 2.0)
            assert Client(hubs[1], "/gone_node").get("speed") == [2.0]
            until(lambda: parameters.warnings() == [], "all is well again")
        finally:
            parameters.stop()


@needs_ros1
def test_who_stands_by_shares_nothing(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    active = threading.Event()
    master.call("setParam", "/standing/speed", 1.0)
    share(rule("ros1", "/standing", "/standing_node"), active=active.is_set)
    share(rule("ros1", "/standing", "/active_node"))
    Client(hubs[1], "/active_node")
    assert not hubs[1].graph.servers("/standing_node/get_parameters")
    active.set()
    assert Client(hubs[1], "/standing_node").get("speed") == [1.0]
    active.clear()
    until(lambda: not hubs[1].graph.servers("/standing_node/get_parameters"), "it is gone again")
