"""The topics and ports of BaseControl, for commands and odometry."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import Any

from typing_extensions import override

from bridge.hub.wire.qos import Qos
from bridge.messages.velocities import TWIST, TWIST_STAMPED
from bridge.modules.host import Host
from bridge.routing.stall import AgeGate, StallDetector
from navigation.base_control.base import DrivenBase
from navigation.base_control.commands import (
    STILL,
    CommandError,
    CommandInput,
    FullControl,
    Velocity,
    of_bottle,
    of_degrees,
)
from navigation.base_control.kinematics import Traveled
from navigation.base_control.section import JOY, BaseControlSection, BaseInput, JoySection
from yarp_compat.dev.basecontrol import (
    INavigation2DVelocityActionsMsgs,
    IOdometry2DMsgs,
    MobileBaseVelocity,
    OdometryData,
)
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
from yarp_compat.os.data.stamp import Stamp
from yarp_compat.pythonic import Received
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.errors import WireError

_OK, _FAILED = ReturnValue(ReturnCode.OK), ReturnValue(ReturnCode.METHOD_FAILED)


class VelocityRpc(INavigation2DVelocityActionsMsgs):
    """Serves ``mobileBaseVelocityControl_nwc_yarp``."""

    def __init__(self, inputs: CommandInputs, target: CommandInput) -> None:
        super().__init__()
        self._inputs, self._target = inputs, target

    @override
    def applyVelocityCommandRPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue:
        """Command a velocity; fails for NaN, infinity or a value above `ABSURD`, and after a stall of this process."""
        accepted = self._inputs.apply(self._target, of_degrees(x_vel, y_vel, theta_vel), timeout)
        return _OK if accepted else _FAILED

    @override
    def getLastVelocityCommandRPC(self) -> tuple[ReturnValue, float, float, float]:
        """Return the input's last command; fails if it has timed out, as in ``velocityInputHandler``."""
        velocity = self._inputs.last(self._target)
        if velocity is None:
            return _FAILED, 0.0, 0.0, 0.0
        return _OK, velocity.x, velocity.y, math.degrees(velocity.turn)


class OdometryRpc(IOdometry2DMsgs):
    """Serves ``odometry2D_nwc_yarp``; ``reset`` sets the odometry to zero, on the thread of the client's connection."""

    def __init__(self, reset: Callable[[], None]) -> None:
        super().__init__()
        self._reset = reset

    @override
    def reset_odometry_RPC(self) -> ReturnValue:
        self._reset()
        return _OK


NEWEST = Qos(depth=1)
_MAX_SENDERS = 64


class CommandInputs:
    """Opens the ports and topics of a base's inputs, and passes each command to its input."""

    def __init__(
        self,
        host: Host,
        section: BaseControlSection,
        base: DrivenBase,
        now: Callable[[], float],  # the time of commands, seconds
        stall_detector: StallDetector,  # detects stalls of this process, after which only zero is accepted
    ) -> None:
        self._base, self._now, self._stall_detector = base, now, stall_detector
        self._log = host.log
        self._lock = threading.Lock()
        self.stale = 0
        self.trouble: dict[str, str] = {}
        for source in section.inputs:
            target = base.inputs[source.name]
            for port in source.ports:
                self._open(host, port if port.startswith("/") else f"{section.prefix}/{port}", target)
            self._open_topics(host, source, target, section.joy)

    def _open(self, host: Host, name: str, target: CommandInput) -> None:
        if name.endswith("aux_control:i"):
            host.yarp.input(name, self._velocity(target))
        elif name.endswith(":i"):
            host.yarp.input(name, self._bottle(target))
        else:
            host.yarp.serve(f"{name}/rpc:i", VelocityRpc(self, target))
            host.yarp.input(f"{name}/data:i", self._velocity(target))

    def _open_topics(self, host: Host, source: BaseInput, target: CommandInput, joy: JoySection) -> None:
        for topic in source.twist:
            self._subscribe(host, topic, TWIST, target, of_twist)
            self._subscribe(host, topic, TWIST_STAMPED, target, lambda message: of_twist(message["twist"]))
        for topic in source.joy:
            self._subscribe(host, topic, JOY, target, lambda message: of_joy(message, joy, self._base.full))

    def _subscribe(
        self,
        host: Host,
        topic: str,
        kind: str,
        target: CommandInput,
        read: Callable[[Mapping[str, Any]], Velocity | None],
    ) -> None:
        """Subscribe to a topic; messages that are older than the input's time-out are dropped, except zero.

        If a sender's command ends (``read`` returns None), the base stops at once, without waiting for the time-out.
        """
        ages: dict[bytes, AgeGate] = {}
        commanding: set[bytes] = set()

        def receive(message: Mapping[str, Any]) -> None:
            if len(ages) >= _MAX_SENDERS and subscription.sender not in ages:
                oldest = next(iter(ages))
                del ages[oldest]
                commanding.discard(oldest)
            age = ages.setdefault(subscription.sender, AgeGate()).age(subscription.sent_ns)
            velocity = read(message)
            if velocity is None and subscription.sender in commanding:
                commanding.remove(subscription.sender)
                self.apply(target, STILL)
            elif age > target.timeout and (velocity is None or any(velocity)):
                self._drop()
            elif velocity is not None:
                commanding.add(subscription.sender)
                self.apply(target, velocity)

        subscription = host.node.subscription(topic, kind, receive, NEWEST)

    def _velocity(self, target: CommandInput) -> Callable[[Received], None]:
        def receive(received: Received) -> None:
            given = received.to(MobileBaseVelocity)
            self.apply(target, of_degrees(given.vel_x, given.vel_y, given.vel_theta))

        return receive

    def _bottle(self, target: CommandInput) -> Callable[[Received], None]:
        def receive(received: Received) -> None:
            try:
                velocity = of_bottle(received.values, self._base.full)
            except CommandError as err:
                target.refused += 1
                raise WireError(str(err)) from None  # the port counts such errors, and logs them at intervals
            self.apply(target, velocity)

        return receive

    def apply(self, target: CommandInput, velocity: Velocity, timeout: float | None = None) -> bool:
        """Pass a command to its input; return whether it is accepted. May be called on any thread."""
        if self._stall_detector.stood_still(target.timeout) and any(velocity):
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

    def last(self, target: CommandInput) -> Velocity | None:
        """Return the last command of an input; None before the first one, or if it has timed out."""
        last = target.last
        return last[0] if last is not None and self._now() <= last[2] else None


def of_twist(message: Mapping[str, Any]) -> Velocity:
    """Convert a `geometry_msgs/Twist`: m/s, rad/s."""
    return Velocity(message["linear"]["x"], message["linear"]["y"], message["angular"]["z"])


def of_joy(message: Mapping[str, Any], joy: JoySection, full: FullControl) -> Velocity | None:
    """Convert a gamepad's axes (`sensor_msgs/Joy`) to a velocity; None while its enable button is not held.

    Missing axes and buttons count as not moved and not held.
    """
    axes, buttons = message["axes"], message["buttons"]

    def axis(number: int | None) -> float:
        value = float(axes[number]) if number is not None and number < len(axes) else 0.0
        return max(-1.0, min(1.0, value)) if math.isfinite(value) else 0.0

    if joy.enable_button is not None and not (joy.enable_button < len(buttons) and buttons[joy.enable_button]):
        return None
    turn = math.radians(full.angular) * axis(joy.angular_axis)
    return Velocity(full.linear * axis(joy.linear_axis), full.linear * axis(joy.side_axis), turn)


ODOMETRY, TF = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"

_POSE_VARIANCE = 1e-3
_UNKNOWN = 1e6  # the variance of height, roll and pitch, which encoders do not measure, as in ROS's planar drivers
_COVARIANCE = [
    (_POSE_VARIANCE if row in (0, 1, 5) else _UNKNOWN) if row == column else 0.0
    for row in range(6)
    for column in range(6)
]


class OdometryPublisher:
    """Publishes odometry as `nav_msgs/Odometry`, on ``/tf``, and on the ports of YARP's current and older servers."""

    def __init__(self, host: Host, section: BaseControlSection) -> None:
        frames = {"header": {"frame_id": section.odom_frame}, "child_frame_id": section.base_frame}
        sure = {"covariance": _COVARIANCE}
        self._odom = host.node.publisher(section.odom, ODOMETRY)
        self._odometry = self._odom.template(
            {**frames, "pose": sure, "twist": sure}, "header.stamp", "pose.pose", "twist.twist"
        )
        self._tf = host.node.publisher("/tf", TF) if section.publish_tf else None
        if self._tf is not None:
            frame = {"transforms": [frames]}
            self._moved = self._tf.template(frame, "transforms[0].header.stamp", "transforms[0].transform")
        names = dict.fromkeys((section.odometry, section.prefix))
        self._poses = [host.yarp.output(f"{name}/odometry:o") for name in names]
        self._odometers = [host.yarp.output(f"{name}/odometer:o") for name in names]
        self._velocities = [host.yarp.output(f"{name}/velocity:o") for name in names]
        self._vector = host.yarp.output(f"{section.prefix}/odometry_vector:o")
        self._stamp = Stamp()

    def publish(self, traveled: Traveled, stamp: dict[str, int]) -> None:
        """Publish the base's pose and velocity, with the stamp of its encoders."""
        theta = math.remainder(traveled.theta, 2.0 * math.pi)
        rotation = 0.0, 0.0, math.sin(theta / 2.0), math.cos(theta / 2.0)
        place = stamp["sec"], stamp["nanosec"], traveled.x, traveled.y, 0.0, *rotation
        speed = traveled.velocity
        self._odom.offer(lambda: self._odometry.fill(*place, speed.x, speed.y, 0.0, 0.0, 0.0, speed.turn))
        if self._tf is not None:
            self._tf.offer(lambda: self._moved.fill(*place))
        self._write(traveled, theta, stamp)

    def _write(self, traveled: Traveled, theta: float, stamp: dict[str, int]) -> None:
        ports = [*self._poses, *self._odometers, *self._velocities, self._vector]
        if not any(port.has_readers for port in ports):
            return
        self._stamp.update(stamp["sec"] + stamp["nanosec"] / 1e9)
        envelope = self._stamp.to_text()
        vx, vy = traveled.world_velocity
        turn = math.degrees(traveled.velocity.turn)
        data = OdometryData(
            traveled.x,
            traveled.y,
            math.degrees(theta),
            traveled.velocity.x,
            traveled.velocity.y,
            turn,
            vx,
            vy,
            turn,
        )
        for port in self._poses:
            port.write(data, envelope)
        for port in self._odometers:
            port.write([traveled.distance, math.degrees(traveled.angle)], envelope)
        for port in self._velocities:
            port.write([traveled.velocity.speed, turn], envelope)
        self._vector.write(Vector([traveled.x, traveled.y, math.degrees(theta)]), envelope)
