"""Parameter services and events at both gates, for every owner, origin and destination."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from bridge.config.sections.routing import RoutingSection
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import EndpointKind, Origin
from bridge.hub.wire.qos import Qos
from bridge.routing.gates import ExitGate
from bridge.routing.rules import RoutePolicy, RuleSet
from bridge.sides import all_networks

SERVICES = {
    "get_parameters": "GetParameters",
    "get_parameter_types": "GetParameterTypes",
    "list_parameters": "ListParameters",
    "describe_parameters": "DescribeParameters",
    "set_parameters": "SetParameters",
    "set_parameters_atomically": "SetParametersAtomically",
}
LOGGERS = {"get_logger_levels": "GetLoggerLevels", "set_logger_levels": "SetLoggerLevels"}
EVENT = "rcl_interfaces/msg/ParameterEvent"
SHARED = {"ros1": "/shared", "node": "/ns/shared"}
WITH_PARAMETERS = {"ros2", "zenoh_ros2dds"}
OTHERS = sorted(set(all_networks()) - WITH_PARAMETERS - {"zenoh"})
NATIVE = "zenoh"


def rules(owner: str = "", **section: object) -> RuleSet:
    """Rules that share the parameters of ``/ns/shared``, if an owner is given."""
    parameters = [{**SHARED, "owner": owner}] if owner else []
    return RuleSet(RoutingSection.model_validate({"parameters": parameters, **section}))


def leaving(
    compiled: RuleSet, origin: str, side: str, node: str = "/ns/shared", services: Iterable[tuple[str, str]] = (),
    *, elsewhere: bool = False,
) -> dict[str, RoutePolicy]:  # fmt: skip
    """Return the decisions on a node's services, by default its six parameter services."""
    return {
        name: compiled.leave(
            origin, side, f"{node}/{name}", f"rcl_interfaces/srv/{type_}", "service", elsewhere=elsewhere
        )
        for name, type_ in services or SERVICES.items()
    }


def allowed(policies: dict[str, RoutePolicy]) -> set[bool]:
    return {policy.allowed for policy in policies.values()}


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize("side", OTHERS)
@pytest.mark.parametrize("owner", ["ros1", "ros2"])
@pytest.mark.parametrize("origin", [NATIVE, "ros1", "ros2", "zenoh_ros2dds"])
def test_shared_parameters_do_not_leave_as_services_to_a_side_without_parameters(
    origin: str, owner: str, side: str, *, elsewhere: bool
) -> None:
    policies = leaving(rules(owner), origin, side, elsewhere=elsewhere)
    assert allowed(policies) == {False}
    assert all(policy.private for policy in policies.values())


@pytest.mark.parametrize("default", ["allow", "deny"])
@pytest.mark.parametrize("side", sorted(WITH_PARAMETERS))
@pytest.mark.parametrize(
    ("origin", "owner", "expected"),
    [
        (NATIVE, "ros2", True),
        ("ros2", "ros2", True),
        ("zenoh_ros2dds", "ros2", True),
        ("ros1", "ros1", True),
        (NATIVE, "ros1", False),  # the rule shares the ROS 1 node's parameters, not those of the native node
    ],
)
def test_shared_parameters_leave_to_a_side_with_parameters(
    origin: str, owner: str, side: str, default: str, *, expected: bool
) -> None:
    for elsewhere in (False, True) if origin != NATIVE else (False,):
        policies = leaving(rules(owner, default=default), origin, side, elsewhere=elsewhere)
        assert allowed(policies) == {expected}, elsewhere


@pytest.mark.parametrize("side", [*OTHERS, *sorted(WITH_PARAMETERS)])
@pytest.mark.parametrize("owner", ["", "ros1", "ros2"])
def test_other_nodes_of_the_hub_keep_their_parameters(owner: str, side: str) -> None:
    assert allowed(leaving(rules(owner), NATIVE, side, "/ns/other")) == {False}
    assert allowed(leaving(rules(owner), NATIVE, side, services=LOGGERS.items())) == {False}


@pytest.mark.parametrize(
    ("side", "owner", "expected"),
    [
        ("ros2", "ros2", True),
        ("zenoh_ros2dds", "ros2", True),
        ("ros2", "ros1", False),
        ("zenoh_ros2dds", "ros1", False),
        ("ros2", "", False),
    ],
)
def test_parameters_enter_the_hub_if_a_ros_2_node_owns_them(side: str, owner: str, *, expected: bool) -> None:
    compiled = rules(owner)
    for name, type_ in SERVICES.items():
        policy = compiled.enter(side, f"/ns/shared/{name}", f"rcl_interfaces/srv/{type_}", "service")
        assert policy.allowed is expected
    for name, type_ in LOGGERS.items():
        assert not compiled.enter(side, f"/ns/shared/{name}", f"rcl_interfaces/srv/{type_}", "service").allowed


@pytest.mark.parametrize("topic", ["/parameter_events", "/renamed/events"])
@pytest.mark.parametrize("side", OTHERS)
@pytest.mark.parametrize("origin", [NATIVE, "ros1", "ros2"])
def test_parameter_events_stay_with_sides_that_have_parameters(origin: str, side: str, topic: str) -> None:
    policy = rules("ros1").leave(origin, side, topic, EVENT)
    assert (policy.allowed, policy.private) == (False, True)


def test_events_of_parameters_that_ros_1_owns_reach_ros_2() -> None:
    assert rules("ros1").leave("ros1", "ros2", "/parameter_events", EVENT).allowed
    assert not rules("ros1").leave(NATIVE, "ros2", "/parameter_events", EVENT).allowed


@pytest.mark.parametrize("origin", [NATIVE, "ros2"])
@pytest.mark.parametrize("side", ["ros1", "yarp"])
def test_a_rule_or_private_false_lets_parameter_services_leave(origin: str, side: str) -> None:
    named = {"kind": "service", "type": "rcl_interfaces/srv/*"}
    assert allowed(leaving(rules("ros2", rules=[named]), origin, side)) == {True}
    assert allowed(leaving(rules("ros2", rules=[{**named, "to": side}]), origin, side)) == {True}
    assert allowed(leaving(rules("ros2", private=False), origin, side)) == {True}
    assert allowed(leaving(rules("ros2", private=False, rules=[{**named, "deny": True}]), origin, side)) == {False}


@pytest.mark.parametrize("origin", [NATIVE, "ros2"])
@pytest.mark.parametrize("default", ["allow", "deny"])
def test_a_rule_for_one_side_lets_private_services_leave_to_that_side_only(origin: str, default: str) -> None:
    named = {"kind": "service", "type": "rcl_interfaces/srv/*", "to": "zenoh_ros2dds"}
    compiled = rules(rules=[named, {"topic": "/rosout", "to": "ros1"}], default=default)
    assert allowed(leaving(compiled, origin, "zenoh_ros2dds", "/ns/other")) == {True}
    assert allowed(leaving(compiled, origin, "ros1", "/ns/other")) == {False}
    assert compiled.leave(origin, "ros1", "/rosout", "rcl_interfaces/msg/Log").allowed
    assert not compiled.leave(origin, "yarp", "/rosout", "rcl_interfaces/msg/Log").allowed


def test_a_rule_for_the_hub_lets_private_services_leave_to_all_sides() -> None:
    compiled = rules(rules=[{"topic": "/rosout", "to": "zenoh"}])
    assert compiled.enter("ros2", "/rosout", "rcl_interfaces/msg/Log").allowed
    assert compiled.leave("ros2", "yarp", "/rosout", "rcl_interfaces/msg/Log").allowed


@pytest.mark.parametrize("origin", [None, Origin("ros2", "prefix", "here"), Origin("ros2", "prefix", "there")])
@pytest.mark.parametrize(("side", "expected"), [("ros1", False), ("yarp", False), ("zenoh_ros2dds", True)])
def test_the_exit_gate_decides_alike_for_native_and_bridged_servers(
    origin: Origin | None, side: str, *, expected: bool
) -> None:
    names = {f"/ns/shared/{name}": f"rcl_interfaces/srv/{type_}" for name, type_ in SERVICES.items()}
    servers = [
        HubEndpoint("z", "shared", "/ns", EndpointKind.SERVER, name, type_, "", Qos(), b"", origin, False, False)
        for name, type_ in names.items()
    ]
    gate = ExitGate(rules("ros2"), side, "here", servers)
    assert {gate.decide("service", origin, name, type_).allowed for name, type_ in names.items()} == {expected}
