"""By which ports and topics commands come to a base."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import Any

from bridge.config.sections.base_control import BaseControlSection, BaseInput, JoySection
from bridge.hub.qos import Qos
from bridge.modules.host import Host
from bridge.routing.age import AgeGate, Pulse
from navigation.base_control.answers import Commands
from navigation.base_control.base import Base
from navigation.base_control.inputs import Input
from navigation.base_control.velocity import CommandError, FullControl, Velocity, of_bottle, of_degrees
from yarp_compat.dev.odometry import MobileBaseVelocity
from yarp_compat.pythonic import Received
from yarp_compat.wire.errors import WireError

TWIST, STAMPED, JOY = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Joy"
NEWEST = Qos(depth=1)
_MAX_SENDERS = 64


class Doors:
    """Opens what the inputs of a base name, and gives each command to its input.

    Args:
        host: gives the ports and topics.
        section: names them.
        base: is commanded.
        now: the time of commands, seconds.
        pulse: notices that this process stood still: what waited meanwhile is not obeyed.
    """

    def __init__(
        self, host: Host, section: BaseControlSection, base: Base, now: Callable[[], float], pulse: Pulse
    ) -> None:
        self._base, self._now, self._pulse = base, now, pulse
        self._log = host.log
        self._lock = threading.Lock()
        self.stale = 0
        self.trouble: dict[str, str] = {}
        for one in base.settings.inputs:
            target = base.input_of(one)
            for port in one.ports:
                self._open(host, port if port.startswith("/") else f"{section.prefix}/{port}", target)
            self._hear(host, one, target, section.joy)

    def _open(self, host: Host, name: str, target: Input) -> None:
        if name.endswith("aux_control:i"):
            host.yarp.input(name, self._velocity(target))
        elif name.endswith(":i"):
            host.yarp.input(name, self._bottle(target))
        else:
            host.yarp.serve(f"{name}/rpc:i", Commands(self, target))
            host.yarp.input(f"{name}/data:i", self._velocity(target))

    def _hear(self, host: Host, one: BaseInput, target: Input, joy: JoySection) -> None:
        for topic in one.twist:
            self._subscribe(host, topic, TWIST, target, of_twist)
            self._subscribe(host, topic, STAMPED, target, lambda message: of_twist(message["twist"]))
        for topic in one.joy:
            self._subscribe(host, topic, JOY, target, lambda message: of_joy(message, joy, self._base.full))

    def _subscribe(
        self, host: Host, topic: str, kind: str, target: Input, read: Callable[[Mapping[str, Any]], Velocity | None]
    ) -> None:
        """Hear a topic; what waited on its way for longer than the input's time-out is dropped."""
        ages: dict[bytes, AgeGate] = {}

        def hear(message: Mapping[str, Any]) -> None:
            if len(ages) >= _MAX_SENDERS and subscription.sender not in ages:
                del ages[next(iter(ages))]
            age = ages.setdefault(subscription.sender, AgeGate()).age(subscription.sent_ns)
            velocity = read(message)
            if age > target.timeout:
                self._drop()
            elif velocity is not None:
                self.take(target, velocity)

        subscription = host.node.subscription(topic, kind, hear, NEWEST)

    def _velocity(self, target: Input) -> Callable[[Received], None]:
        def take(received: Received) -> None:
            given = received.to(MobileBaseVelocity)
            self.take(target, of_degrees(given.vel_x, given.vel_y, given.vel_theta))

        return take

    def _bottle(self, target: Input) -> Callable[[Received], None]:
        def take(received: Received) -> None:
            try:
                velocity = of_bottle(received.values, self._base.full)
            except CommandError as err:
                target.refused += 1
                raise WireError(str(err)) from None  # the port counts it and tells of it now and then
            self.take(target, velocity)

        return take

    def take(self, target: Input, velocity: Velocity, timeout: float | None = None) -> bool:
        """Give a command to its input; whether it is obeyed. Called from any thread."""
        if self._pulse.stood_still(target.timeout):
            self._drop()
            return False
        try:
            target.command(velocity, self._now(), timeout)
        except CommandError as err:
            if self.trouble.get(target.name) != str(err):
                self._log.warning("%s", err)
            self.trouble[target.name] = str(err)
            return False
        self.trouble.pop(target.name, None)
        return True

    def _drop(self) -> None:
        with self._lock:
            self.stale += 1

    def last(self, target: Input) -> Velocity | None:
        """The last command of an input while it holds; None where none does."""
        found = target.last
        return found[0] if found is not None and self._now() <= found[2] else None


def of_twist(message: Mapping[str, Any]) -> Velocity:
    """The velocity of a `geometry_msgs/Twist`: m/s, rad/s."""
    return Velocity(message["linear"]["x"], message["linear"]["y"], message["angular"]["z"])


def of_joy(message: Mapping[str, Any], joy: JoySection, full: FullControl) -> Velocity | None:
    """The velocity of a gamepad's axes (`sensor_msgs/Joy`); None while its button is not held.

    An axis or a button that the gamepad does not have counts as not moved, or not held.
    """
    axes, buttons = message["axes"], message["buttons"]

    def axis(number: int | None) -> float:
        value = float(axes[number]) if number is not None and number < len(axes) else 0.0
        return max(-1.0, min(1.0, value)) if math.isfinite(value) else 0.0

    if joy.enable_button is not None and not (joy.enable_button < len(buttons) and buttons[joy.enable_button]):
        return None
    turn = math.radians(full.angular) * axis(joy.angular_axis)
    return Velocity(full.linear * axis(joy.linear_axis), full.linear * axis(joy.side_axis), turn)
