"""A side announces on the hub which velocities its own nodes subscribe to; rules convert velocities."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.clock import RunClock
from bridge.config.sections.routing import RoutingSection
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.routing import hub_to_side
from bridge.routing.decision import RouteDecision, RouteKey
from bridge.routing.edge import Kind, MadeBy
from bridge.routing.engine import Engine
from bridge.routing.hub_to_side import HubToSideRoute
from bridge.routing.velocities import unstamped, with_stamp
from tests.peers.fake import FakeEdge, FakeNetwork, Reader
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

CMD_VEL = "/cmd_vel"
TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


REGISTRY = Registry()


class Edge(FakeEdge):
    """An in-memory network with the name of a side, which rules can refer to."""

    side = "ros1"
    one_queue = True


class Side:
    """A side on a hub, and another program on the hub."""

    def __init__(self, hubs: HubNetwork) -> None:
        self.network = FakeNetwork()
        self.hub, self.far = Hub.open(hubs.settings("side")), Hub.open(hubs.settings("far"))
        self.engine = Engine(Edge(self.network, REGISTRY), self.hub, RoutingSection(), "side", pytest.fail)

    def rules(self, *rules: dict[str, Any]) -> None:
        self.engine.reload(RoutingSection.model_validate({"rules": rules}))

    def base(self, topic: str, type_name: str, made_by: MadeBy = MadeBy.NATIVE) -> Reader:
        self.received = list[bytes]()
        receive = lambda payload, *_: self.received.append(payload)  # noqa: E731
        return self.network.read_from(topic, type_name, Qos(), made_by, "/base", receive)

    def program(self, type_name: str, topic: str = CMD_VEL) -> HubPublisher:
        """Advertise velocities on the hub."""
        return self.far.publisher(topic, type_name, REGISTRY.ros2(type_name).type_id, Qos(depth=1))

    def refused(self) -> list[RouteDecision]:
        """Return what the last check refused; a check creates its routes before it stores its decisions."""
        return [decision for decision in self.engine.decisions() if decision.refused]

    def announced(self, *velocities: tuple[str, str]) -> Callable[[], bool]:
        """Return a function that returns whether exactly these are announced."""
        expected = sorted((self.hub.zid, *velocity) for velocity in velocities)
        return lambda: self.far.graph.velocities() == expected

    def close(self) -> None:
        self.engine.stop()
        self.hub.close()
        self.far.close()


@pytest.fixture
def side() -> Iterator[Side]:
    with HubNetwork() as hubs:
        side_ = Side(hubs)
        side_.engine.start()
        yield side_
        side_.close()


def test_velocities_that_the_nodes_of_a_side_subscribe_to_are_announced(side: Side) -> None:
    side.base("/foreign/cmd_vel", TWIST, MadeBy.MIDSPAN)
    side.base("/odom", "nav_msgs/msg/Odometry")
    stamped = side.base("/cmd_vel", STAMPED)
    until(side.announced(("/cmd_vel", STAMPED)), "the subscription is announced")
    plain = side.base("/cmd_vel", TWIST)
    until(side.announced(("/cmd_vel", STAMPED), ("/cmd_vel", TWIST)), "both types are announced")
    side.network.remove(stamped)
    until(side.announced(("/cmd_vel", TWIST)), "one type is announced")
    side.network.remove(plain)
    until(side.announced(), "nothing is announced")


def test_announced_velocities_follow_the_rules(side: Side) -> None:
    side.base("/base/cmd_vel", STAMPED)
    until(side.announced(("/base/cmd_vel", STAMPED)), "the topic is announced")
    side.rules({"topic": "/cmd_vel", "rename": "/base/cmd_vel"})
    until(side.announced(("/base/cmd_vel", STAMPED), ("/cmd_vel", STAMPED)), "the renamed topic is announced too")
    side.rules({"topic": "/base/cmd_vel", "deny": True})
    until(side.announced(), "a denied topic is not announced")
    side.rules({"topic": "/base/cmd_vel", "type": TWIST, "deny": True})
    until(side.announced(("/base/cmd_vel", STAMPED)), "only the other type is denied")


def test_announced_velocities_follow_rules_with_wildcards(side: Side) -> None:
    side.base("/cmd_vel", STAMPED)
    side.rules({"topic": "/robot/**", "rename": "/**"})
    until(side.announced(("/cmd_vel", STAMPED), ("/robot/cmd_vel", STAMPED)), "the renamed topic is announced too")
    side.rules({"topic": "/*/cmd_vel", "rename": "/cmd_vel"})
    until(side.announced(("/cmd_vel", STAMPED)), "a name that no longer follows from the rule is not announced")
    assert side.hub.graph.refused == 0
    assert side.hub.graph.velocities() == side.far.graph.velocities()


def test_announced_velocities_end_with_the_network_of_the_side(side: Side) -> None:
    side.base("/cmd_vel", STAMPED)
    until(side.announced(("/cmd_vel", STAMPED)), "the subscription is announced")
    side.network.restart(None)
    until(side.announced(), "nothing is announced without a network")
    side.network.restart("fake-2")
    side.base("/cmd_vel", TWIST)
    until(side.announced(("/cmd_vel", TWIST)), "the new network's subscription is announced")


MOTION = {"linear": {"x": 0.25, "y": -0.5, "z": 0.0}, "angular": {"x": 0.0, "y": 0.125, "z": 1.5}}
WITHOUT_STAMP = from_json(REGISTRY, TWIST, MOTION)
WITH_STAMP = from_json(REGISTRY, STAMPED, {"header": {"stamp": {"sec": 7}, "frame_id": "base"}, "twist": MOTION})
MESSAGES = {TWIST: WITHOUT_STAMP, STAMPED: WITH_STAMP}


def decoded(type_name: str, cdr: bytes) -> Any:
    """Return the velocity in a message; assert that its header, if any, has a stamp and a frame."""
    message = to_json(REGISTRY, type_name, cdr)
    if type_name == TWIST:
        return message
    assert message["header"]["stamp"]["sec"]
    assert message["header"]["frame_id"]
    return message["twist"]


def arrived(side: Side, program: HubPublisher, type_name: str, form: str) -> bool:
    """Publish a velocity; return whether the last one on the side has a form. The first ones may precede the rule."""
    program.put(MESSAGES[type_name])
    return bool(side.received) and (len(side.received[-1]) > len(WITHOUT_STAMP)) == (form == STAMPED)


FORMS = pytest.mark.parametrize(("stamped", "form"), [(True, STAMPED), (False, TWIST)])
SENT = pytest.mark.parametrize("type_name", [TWIST, STAMPED])


@SENT
@FORMS
def test_a_rule_converts_velocities_to_a_side(side: Side, stamped: bool, form: str, type_name: str) -> None:
    side.rules({"topic": CMD_VEL, "to": "ros1", "stamped": stamped})
    side.base(CMD_VEL, form)
    program = side.program(type_name)
    until(lambda: arrived(side, program, type_name, form), "the velocity arrives on the side in the rule's form")
    assert decoded(form, side.received[-1]) == MOTION
    other = side.program({TWIST: STAMPED, STAMPED: TWIST}[type_name])
    until(lambda: len(side.engine.routes()) == 2, "programs with both types can drive")
    assert {e.type for e in side.network.endpoints() if e.topic == CMD_VEL} == {form}, "the side has only one type"
    until(lambda: not side.refused(), "the check that created the second route refuses nothing")
    other.close()
    until(side.announced((CMD_VEL, form)), "programs on the hub follow the base")


@SENT
@FORMS
def test_a_rule_converts_velocities_to_the_hub(side: Side, stamped: bool, form: str, type_name: str) -> None:
    side.rules({"topic": CMD_VEL, "from": "ros1", "stamped": stamped})
    received: list[bytes] = []
    type_id = REGISTRY.ros2(form).type_id
    side.far.subscription(CMD_VEL, form, type_id, Qos(), lambda sample: received.append(sample.data()))
    writer = side.network.write_on(CMD_VEL, type_name, Qos(), MadeBy.NATIVE, "/joystick")
    until(lambda: (side.network.write(writer, MESSAGES[type_name]), received)[1], "the velocity arrives on the hub")
    assert decoded(form, received[-1]) == MOTION
    publishers = until(lambda: side.far.graph.publishers(CMD_VEL), "the publisher is seen")
    assert {publisher.type_name for publisher in publishers} == {form}


def test_a_base_whose_velocities_a_rule_converts_is_not_announced(side: Side) -> None:
    side.base(CMD_VEL, STAMPED)
    until(side.announced((CMD_VEL, STAMPED)), "the base is announced")
    side.rules({"topic": CMD_VEL, "to": "ros1", "stamped": False})
    until(side.announced(), "no velocity reaches the base, so none is announced")


def test_a_side_gets_the_velocity_type_that_its_nodes_subscribe_to(side: Side) -> None:
    """A side has one type per topic; with the wrong type, velocities that stop the base would not arrive."""
    program = side.program(TWIST)
    until(lambda: [route.hub_type for route in side.engine.routes()] == [TWIST], "the first type has a route")
    base = side.base(CMD_VEL, STAMPED)
    stamped = side.program(STAMPED)
    until(lambda: [route.hub_type for route in side.engine.routes()] == [STAMPED], "the base's type replaces it")
    until(lambda: (stamped.put(WITH_STAMP), side.received)[1], "the stamped velocity arrives")
    (refused,) = until(side.refused, "the check that created the route has ended")
    assert (refused.type, refused.cure) == (TWIST, "convert it with a rule: 'to: ros1', 'stamped: true'")
    assert f"nodes on the side subscribe to {CMD_VEL} as {STAMPED}" in refused.reason
    stamped.close()
    until(lambda: not side.engine.routes(), "no program publishes the base's type")
    side.network.remove(base)
    until(
        lambda: [route.hub_type for route in side.engine.routes()] == [TWIST],
        "without a base, the first type has the topic again",
    )
    program.close()
    until(lambda: not side.engine.routes(), "the route ends after its publisher has left")


def test_a_velocity_type_without_a_subscriber_on_the_side_has_no_route(side: Side) -> None:
    """On ROS 1, this form would become the topic's type, and the base's type would no longer be known."""
    side.base(CMD_VEL, STAMPED)
    side.program(TWIST)
    until(side.refused, "the program's type is refused")
    assert side.engine.routes() == []
    side.program(STAMPED)
    until(lambda: [route.hub_type for route in side.engine.routes()] == [STAMPED], "the base's type has a route")


def test_a_malformed_velocity_is_not_converted() -> None:
    clock = RunClock()
    for size in range(len(WITHOUT_STAMP)):
        with pytest.raises(ConversionError):
            with_stamp(WITHOUT_STAMP[:size], clock)
    for size in range(len(WITH_STAMP)):
        with pytest.raises(ConversionError):
            unstamped(WITH_STAMP[:size])
    big_endian = b"\0\0" + WITHOUT_STAMP[2:]
    with pytest.raises(ConversionError, match="little-endian"):
        with_stamp(big_endian, clock)
    frame_too_long = WITH_STAMP[:12] + b"\xff" * 4 + WITH_STAMP[16:]
    with pytest.raises(ConversionError, match="not a velocity"):
        unstamped(frame_too_long)


@pytest.mark.parametrize("more", [{"deny": True}, {"kind": "service"}, {"kind": "action"}])
def test_only_topics_that_cross_are_converted(more: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="stamped is for topics that are bridged"):
        RoutingSection.model_validate({"rules": [{"topic": CMD_VEL, "stamped": True, **more}]})


TRANSIENT = {"topic": CMD_VEL, "qos": {"durability": "transient_local"}}


def midspans(side: Side, kind: Kind) -> list[Qos]:
    """Return the QoS of Midspan's endpoints on the side."""
    return [e.qos for e in side.network.endpoints() if (e.kind, e.topic, e.made_by) == (kind, CMD_VEL, MadeBy.MIDSPAN)]


def test_a_rule_latches_no_velocity_on_a_side(side: Side, caplog: pytest.LogCaptureFixture) -> None:
    """A base that subscribes late would move at the last velocity."""
    side.rules(TRANSIENT)
    side.base(CMD_VEL, TWIST)
    program = side.program(TWIST)
    until(lambda: arrived(side, program, TWIST, TWIST), "the velocity arrives on the side")
    program.put(from_json(REGISTRY, TWIST, {}))  # zero, which is never too old, no matter how slow the machine is
    until(lambda: side.received[-1].endswith(bytes(8)), "the last velocity arrives, so that none arrives later")
    assert [qos.latched for qos in midspans(side, Kind.PUBLISHER)] == [False]
    assert side.network.retained() == []
    late = list[bytes]()
    side.network.read_from(CMD_VEL, TWIST, LATCHED, MadeBy.NATIVE, "/late", lambda payload, *_: late.append(payload))
    assert late == []
    assert f"{CMD_VEL}: the rule's durability transient_local has no effect" in caplog.text


def test_a_rule_requests_no_latched_velocity_from_a_side(side: Side) -> None:
    side.rules(TRANSIENT)
    writer = side.network.write_on(CMD_VEL, TWIST, LATCHED, MadeBy.NATIVE, "/joystick")
    side.network.write(writer, WITHOUT_STAMP)
    subscriptions = until(lambda: midspans(side, Kind.SUBSCRIPTION), "the side's publisher has a route")
    assert [qos.latched for qos in subscriptions] == [False]
    publishers = until(lambda: side.far.graph.publishers(CMD_VEL), "the publisher is seen")
    assert [publisher.qos.latched for publisher in publishers] == [False]
    assert [route.counters.messages for route in side.engine.routes()] == [0], "the last velocity does not cross"


def test_no_route_is_created_for_messages_that_commands_exclude(side: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    side.rules({"topic": "/recorded", "rename": CMD_VEL, "priority": "stream"})
    side.program(TWIST)
    until(side.engine.routes, "the commands have a route")
    created = list[str]()

    class Recorded(HubToSideRoute):
        def __init__(self, key: RouteKey, *rest: Any) -> None:
            created.append(key.topic)
            super().__init__(key, *rest)

    monkeypatch.setattr(hub_to_side, "HubToSideRoute", Recorded)
    side.program(TWIST, "/recorded")
    until(side.refused, "the other messages are refused")
    assert created == []


@pytest.mark.parametrize("first", ["commands", "others"])
def test_commands_exclude_other_messages_from_a_topic_with_one_queue(side: Side, first: str) -> None:
    """The order does not matter: commands must not wait in a queue, and one of them may be a stop."""
    side.rules({"topic": "/recorded", "rename": CMD_VEL, "priority": "stream"})
    side.base(CMD_VEL, TWIST)
    topics = [CMD_VEL, "/recorded"] if first == "commands" else ["/recorded", CMD_VEL]
    programs = {}
    for count, topic in enumerate(topics, 1):
        programs[topic] = side.program(TWIST, topic)
        until(lambda n=count: len(side.engine.routes()) + len(side.refused()) == n, f"{topic} has been decided")
    until(lambda: [d.hub_topic for d in side.refused()] == ["/recorded"], "the other messages are refused")
    assert [route.hub_topic for route in side.engine.routes()] == [CMD_VEL]
    (refused,) = side.refused()
    assert refused.reason == f"{CMD_VEL} has commands, which are not queued, so it cannot have other messages, too"
    assert refused.cure == "set `priority: command` in the rules of both topics, or rename one of the two"
    until(lambda: arrived(side, programs[CMD_VEL], TWIST, TWIST), "the command arrives on the side")
    programs[CMD_VEL].close()
    until(lambda: [r.hub_topic for r in side.engine.routes()] == ["/recorded"], "without commands, the others pass")
    until(lambda: not side.refused(), "the check that created the route refuses nothing")
