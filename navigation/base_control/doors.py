"""By which ports and topics commands come to a base."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import Any

from bridge.config.sections.base_control import BaseControlSection, BaseInput, JoySection
from bridge.hub.qos import Qos
from bridge.modules.host import Host
from bridge.routing.age import Pulse
from navigation.base_control.answers import Commands
from navigation.base_control.base import Base
from navigation.base_control.inputs import Input
from navigation.base_control.velocity import CommandError, FullControl, Velocity, of_bottle, of_degrees
from yarp_compat.dev.odometry import MobileBaseVelocity
from yarp_compat.pythonic import Received
from yarp_compat.wire.errors import WireError

TWIST, STAMPED, JOY = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "sensor_msgs/msg/Joy"
NEWEST = Qos(depth=1)


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
        def twist(message: Mapping[str, Any]) -> None:
            linear, angular = message["linear"], message["angular"]
            self.take(target, Velocity(linear["x"], linear["y"], angular["z"]))

        for topic in one.twist:
            host.node.subscription(topic, TWIST, twist, NEWEST)
            host.node.subscription(topic, STAMPED, lambda message: twist(message["twist"]), NEWEST)
        for topic in one.joy:
            host.node.subscription(topic, JOY, lambda message: self._stick(target, message, joy), NEWEST)

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

    def _stick(self, target: Input, message: Mapping[str, Any], joy: JoySection) -> None:
        velocity = of_joy(message, joy, self._base.full)
        if velocity is not None:
            self.take(target, velocity)

    def take(self, target: Input, velocity: Velocity, timeout: float | None = None) -> bool:
        """Give a command to its input; whether it is obeyed. Called from any thread."""
        if self._pulse.stood_still(target.timeout):
            with self._lock:
                self.stale += 1
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

    def last(self, target: Input) -> Velocity:
        """The last command of an input while it holds; still where none does."""
        found = target.last
        return found[0] if found is not None and self._now() <= found[2] else Velocity()


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
