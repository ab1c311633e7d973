"""The module BaseControl: drives wheels through the topics that a driver or the simulator offers.

It replaces robotology/navigation's ``baseControl2`` on a YARP robot, with the ports and message forms of both its
generations, and also accepts ``/cmd_vel`` from ROS 1, ROS 2 and zenoh. The wheels' driver must stop by itself when
BaseControl stops sending.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.config.sections.section import Section
from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.services import Answer
from bridge.routing.stall import StallDetector
from bridge.status import Part
from bridge.worker import Health
from navigation.base_control.base import BaseCommands, DrivenBase
from navigation.base_control.encoders import ReadingTimes
from navigation.base_control.kinematics import Array
from navigation.base_control.ports import CommandInputs, OdometryPublisher, OdometryRpc
from navigation.base_control.section import BaseControlSection
from navigation.base_control.settings import resolved

JOINTS = "sensor_msgs/msg/JointState"
RESET = "std_srvs/srv/Trigger"

SILENT_SECONDS = 0.5  # seconds without encoder readings until the health reports it
_BEAT = 0.1  # seconds between two beats of the stall detector


class BaseControl(Module):
    """Drives a mobile base with the commands of its inputs."""

    name = "base_control"

    _can_command = False  # until `start` has a publisher for the wheels; if it fails earlier, nothing has to stop

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, BaseControlSection)
        self._host = host
        section, self._notes = resolved(section)
        for note in self._notes:
            host.log.warning("%s", note)
        self.base = DrivenBase(section)
        self._joints = section.joints
        self._times = ReadingTimes(simulated=host.clock.simulated)
        self._trouble = ""
        self._received: float | None = None  # when the last reading arrived, monotonic seconds
        self._named: list[str] = []  # the joints of the last reading, and the indices of the wheels in it
        self._places: list[int | None] = [None] * len(self._joints)
        stall_detector = StallDetector()
        host.loop.every(_BEAT, stall_detector.beat)
        self.inputs = CommandInputs(host, section, self.base, self.now, stall_detector)
        self._publisher = OdometryPublisher(host, section)
        self._wheels = host.node.publisher(section.wheel_command, JOINTS, Qos(depth=1), priority="command")
        still = {"name": list(section.joints), "velocity": [0.0] * len(section.joints)}
        self._command = self._wheels.template(still, "header.stamp", "velocity")
        self._can_command = True
        host.node.subscription(section.joint_states, JOINTS, self._on_encoders, Qos(depth=10))
        self._offer(host, section)
        host.on_jump(self._restart)
        host.every(section.period, self._step)

    def _offer(self, host: Host, section: BaseControlSection) -> None:
        commands = BaseCommands(self.base)
        host.yarp.respond(f"{section.prefix}/rpc", lambda values: host.loop.call(lambda: commands.answer(values)))
        host.yarp.serve(f"{section.odometry}/rpc", OdometryRpc(lambda: host.loop.call(self.reset_odometry)))
        host.node.server(f"/{self.name}/reset_odometry", RESET, self._on_reset)
        host.answer("halt", lambda _params: host.loop.call(self.halt))

    def now(self) -> float:
        """Return the time of commands in seconds: of the simulated clock if configured, else of a monotonic one."""
        clock = self._host.clock
        return clock.now_ns() / 1e9 if clock.simulated else time.monotonic()

    def halt(self) -> dict[str, Any]:
        """Discard all commands and stop; later commands are accepted again."""
        self.base.stop()
        self._turn(self.base.step(self.now()))
        return {"halted": True}

    def _step(self) -> None:
        velocities = self.base.step(self.now())
        if self.base.due(velocities):
            self._turn(velocities)

    @override
    def on_failure(self, error: BaseException) -> bool:
        """Stop the base, because the next step may fail as well and send no command."""
        if self._can_command:
            self.base.stop()
            self._turn(np.zeros(len(self._joints)))
        return super().on_failure(error)

    def _turn(self, velocities: Array) -> None:
        stamp = self._host.clock.stamp()
        self._wheels.offer(lambda: self._command.fill(stamp["sec"], stamp["nanosec"], *velocities.tolist()))

    def _on_encoders(self, message: dict[str, Any]) -> None:
        if message["name"] != self._named:
            self._named = message["name"]
            places = {name: place for place, name in enumerate(self._named)}
            self._places = [places.get(joint) for joint in self._joints]
        positions = message["position"].tolist()
        angles = [positions[at] for at in self._places if at is not None and at < len(positions)]
        if len(angles) < len(self._joints):
            self._miss(len(positions))
            return
        stamp = message["header"]["stamp"]
        stamp_ns = stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
        at = self._times.add(stamp_ns, self.now(), self._host.clock.now_ns())
        self._received = time.monotonic()
        if at is None:
            return
        velocities = message["velocity"].tolist()
        rates = [velocities[place] for place in self._places if place is not None and place < len(velocities)]
        try:
            traveled = self.base.measured(angles, at.seconds, rates if len(velocities) == len(positions) else None)
        except ValueError as err:
            self._trouble = str(err)
            return
        self._trouble = ""
        seconds, nanoseconds = divmod(at.stamp_ns, 1_000_000_000)
        self._publisher.publish(traveled, {"sec": seconds, "nanosec": nanoseconds})

    def _restart(self) -> None:
        """Discard all times, after the clock jumped back."""
        self._times = ReadingTimes(simulated=self._host.clock.simulated)
        self.base.restart()

    def _miss(self, positions: int) -> None:
        """Report the wheel without an encoder; ignore a message without any wheel, which another driver published."""
        if any(at is not None for at in self._places):
            missing = next(
                joint for joint, at in zip(self._joints, self._places, strict=True) if at is None or at >= positions
            )
            self._trouble = f"{missing} is not in the joint states; set modules.base_control.joints"

    def reset_odometry(self) -> None:
        """Set the odometry to zero."""
        self.base.odometry.reset()

    def _on_reset(self, _request: dict[str, Any], answer: Answer) -> None:
        self.reset_odometry()
        answer({"success": True, "message": "odometry set to zero"})

    @override
    def health(self) -> Health:
        if self._trouble:
            return Health("waiting", self._trouble)
        if self._received is None or time.monotonic() - self._received > SILENT_SECONDS:
            return Health("waiting", "no wheel encoders received; is the driver of the base running?")
        choice = self.base.choice
        source = choice.input
        if self.base.idle:
            return Health("running", "idle")
        if not source:
            return Health("running", "no active command source")
        return Health("running", f"following {source}" if choice.fresh else f"{source} is silent")

    @override
    def status(self) -> Part:
        base, moved = self.base, self.base.odometry.now
        return Part(
            input=base.choice.input,
            idle=base.idle,
            velocity=[base.limiter.now.x, base.limiter.now.y, math.degrees(base.limiter.now.turn)],
            odometry=[moved.x, moved.y, math.degrees(moved.theta)],
            inputs={
                name: {
                    "commands": source.commands,
                    "refused": source.refused,
                    "error": self.inputs.trouble.get(name, ""),
                }
                for name, source in base.inputs.items()
            },
            stale=self.inputs.stale,
            notes=list(self._notes),
        )

    @override
    def stop(self) -> None:
        if self._can_command:
            self._turn(np.zeros(len(self._joints)))
