"""A hub program drives a base on a side, with the message type that the base subscribes to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from bridge.client.velocity import VelocityForm, VelocityPublisher, subscribers
from bridge.clock import SYSTEM
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.json import from_json
from bridge.messages.registry import Registry
from bridge.messages.velocities import TWIST, TWIST_STAMPED
from tests.contract.hubside import HubSide
from tests.contract.side import PeerLike, Side
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

CMD_VEL = "/cmd_vel"
BASES = {TWIST: "geometry_msgs/Twist", TWIST_STAMPED: "geometry_msgs/TwistStamped"}
SPEED = 0.25


@pytest.fixture
def far(hubs: HubNetwork) -> Iterator[HubSide]:
    with Hub.open(hubs.settings("far")) as hub:
        yield HubSide(hub, Registry())


class Output:
    """A publisher of one type on the hub."""

    def __init__(self, far: HubSide, type_name: str) -> None:
        self._registry, self._type_name = far.registry, type_name
        type_id = far.registry.ros2(type_name).type_id
        self._end = far.hub.publisher(CMD_VEL, type_name, type_id, Qos(depth=1), priority="command")

    def publish(self, message: Mapping[str, Any]) -> None:
        self._end.put(from_json(self._registry, self._type_name, message))

    def close(self) -> None:
        self._end.close()


class Driver:
    """A hub program that publishes velocities in the type that the base subscribes to."""

    def __init__(self, far: HubSide) -> None:
        form = VelocityForm(CMD_VEL)
        self._publisher = VelocityPublisher(
            far.hub.graph, form, SYSTEM, lambda type_name: Output(far, type_name), pytest.fail
        )

    def drives(self, base: PeerLike, end: int) -> Callable[[], bool]:
        """Return a function that publishes a velocity and returns whether the base has received it."""

        def driven() -> bool:
            self._publisher.publish(SPEED)
            received = base.wait(end, 1, 0.05)
            return bool(received) and received[-1].get("twist", received[-1])["linear"]["x"] == SPEED

        return driven


@pytest.mark.parametrize("side", ["ros1", "ros2"], indirect=True)
def test_velocities_have_the_type_that_the_base_subscribes_to(
    side: Side, far: HubSide, config: Callable[..., Any]
) -> None:
    side.bridge(config())
    base = side.peer()
    stamped = base.subscribe(CMD_VEL, BASES[TWIST_STAMPED])
    until(
        lambda: subscribers(far.hub.graph, CMD_VEL) == {TWIST_STAMPED: [side.name]}, "the base's type is announced", 20
    )
    obstacle = Output(far, TWIST)  # another program's publisher, whose type must not decide
    driver = Driver(far)
    until(driver.drives(base, stamped), "the base receives stamped velocities", 20)
    if side.name == "ros1":  # the master stores one type per topic, which is now the one that Midspan publishes
        return
    obstacle.close()
    base.drop(stamped)
    base = side.peer()  # a new process: rclpy destroys subscriptions late, and DDS has one type per topic and process
    plain = base.subscribe(CMD_VEL, BASES[TWIST])
    until(driver.drives(base, plain), "the base receives velocities without a stamp", 20)


@pytest.mark.parametrize(
    ("side", "source", "form"), [("ros1", TWIST_STAMPED, TWIST), ("ros2", TWIST, TWIST_STAMPED)], indirect=["side"]
)
def test_a_rule_converts_the_velocities_of_another_program(
    side: Side, far: HubSide, config: Callable[..., Any], source: str, form: str
) -> None:
    """Nav2 of Kilted drives a base on ROS 1, and a planner that publishes ``Twist`` drives a base of Kilted."""
    side.bridge(config(rules=[{"topic": CMD_VEL, "to": side.name, "stamped": form == TWIST_STAMPED}]))
    base = side.peer()
    end = base.subscribe(CMD_VEL, BASES[form])
    twist = {"linear": {"x": SPEED, "y": -0.5}, "angular": {"z": 1.5}}
    message = {"header": {"frame_id": "map"}, "twist": twist} if source == TWIST_STAMPED else twist
    program = Output(far, source)
    until(lambda: (program.publish(message), base.wait(end, 1, 0.05))[1], "the base receives velocities", 20)
    (received, *_) = base.wait(end, 1)
    velocity = received.get("twist", received)
    assert (velocity["linear"]["x"], velocity["linear"]["y"], velocity["angular"]["z"]) == (SPEED, -0.5, 1.5)
    if form == TWIST_STAMPED:
        assert received["header"]["frame_id"] == "base_link"
        assert received["header"]["stamp"]["sec"]


@pytest.mark.parametrize("side", ["ros1"], indirect=True)
@pytest.mark.parametrize("first", [CMD_VEL, "/recorded"])
def test_a_ros_1_base_receives_commands_although_a_rule_renames_other_messages_to_its_topic(
    side: Side, far: HubSide, config: Callable[..., Any], first: str
) -> None:
    """The connections of a ROS 1 topic have one queue each, and commands are not queued."""
    side.bridge(config(rules=[{"topic": "/recorded", "rename": CMD_VEL, "priority": "stream"}]))
    base = side.peer()
    end = base.subscribe(CMD_VEL, BASES[TWIST])
    programs = {first: far.advertise(first, BASES[TWIST])}

    def arrives(topic: str, speed: float) -> Callable[[], bool]:
        """Return a function that publishes a velocity and returns whether the base has received it."""

        def arrived() -> bool:
            far.publish(programs[topic], {"linear": {"x": speed}})
            return speed in [message["linear"]["x"] for message in base.wait(end, 1, 0.05)]

        return arrived

    until(arrives(first, 0.25), "the base receives the first program's velocity", 20)
    (second,) = {CMD_VEL, "/recorded"} - {first}
    programs[second] = far.advertise(second, BASES[TWIST])
    until(
        lambda: [line["hub_topic"] for line in far.explain(CMD_VEL) if line["decision"] == "refused"] == ["/recorded"],
        "the other messages are refused",
        20,
    )
    far.publish(programs["/recorded"], {"linear": {"x": 0.5}})
    until(arrives(CMD_VEL, 0.75), "the base receives commands", 20)
    assert 0.5 not in [message["linear"]["x"] for message in base.wait(end, 1)]
