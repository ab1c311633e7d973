"""The module BaseControl: drives wheels through topics, as any driver or the simulator offers them.

What robotology/navigation's ``baseControl2`` is to a YARP robot: ports and forms of both its generations, ``/cmd_vel``
of ROS 1, ROS 2 and zenoh beside them. The wheels' driver stops by itself where BaseControl falls silent.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from bridge.config.sections.base_control import BaseControlSection
from bridge.config.sections.section import Section
from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.services import Answer
from bridge.routing.stall import StallDetector
from bridge.worker import Health
from navigation.base_control.base import BaseCommands, DrivenBase
from navigation.base_control.encoders import ReadingTimes
from navigation.base_control.kinematics import Array
from navigation.base_control.ports import CommandInputs, OdometryPublisher, OdometryRpc
from navigation.base_control.settings import resolved

JOINTS = "sensor_msgs/msg/JointState"
RESET = "std_srvs/srv/Trigger"

SILENT_SECONDS = 0.5  # after so long without encoders the module reports that there is no odometry
_BEAT = 0.1


class BaseControl(Module):
    """Drives a mobile base as its inputs command."""

    name = "base_control"

    def start(self, host: Host, section: Section) -> None:
        """Open what the section names, and begin to drive."""
        assert isinstance(section, BaseControlSection)
        self._host = host
        section, self._notes = resolved(section)
        for note in self._notes:
            host.log.warning("%s", note)
        self.base = DrivenBase(section)
        self._joints = section.joints
        self._times = ReadingTimes()
        self._trouble = ""
        self._heard: float | None = None
        self._named: list[str] = []  # the joints of the last encoders, and the wheels' places among them
        self._places: list[int | None] = [None] * len(self._joints)
        stall_detector = StallDetector()
        host.loop.every(_BEAT, stall_detector.beat)
        self.inputs = CommandInputs(host, section, self.base, self.now, stall_detector)
        self._publisher = OdometryPublisher(host, section)
        self._wheels = host.node.publisher(section.wheel_command, JOINTS, Qos(depth=1), priority="command")
        still = {"name": list(section.joints), "velocity": [0.0] * len(section.joints)}
        self._command = self._wheels.template(still, "header.stamp", "velocity")
        host.node.subscription(section.joint_states, JOINTS, self._encoders, Qos(depth=10))
        self._offer(host, section)
        host.on_jump(self._forget)
        host.every(section.period, self._step)

    def _offer(self, host: Host, section: BaseControlSection) -> None:
        commands = BaseCommands(self.base)
        host.yarp.respond(f"{section.prefix}/rpc", lambda values: host.loop.call(lambda: commands.answer(values)))
        host.yarp.serve(f"{section.odometry}/rpc", OdometryRpc(lambda: host.loop.call(self.reset_odometry)))
        host.node.server(f"/{self.name}/reset_odometry", RESET, self._reset_asked)
        host.answer("halt", lambda _params: host.loop.call(self.halt))

    def now(self) -> float:
        """The time of commands in seconds: the simulated clock where there is one, else a monotonic one."""
        clock = self._host.clock
        return clock.now_ns() / 1e9 if clock.simulated else time.monotonic()

    def halt(self) -> dict[str, Any]:
        """Forget all commands and stand still; later commands are obeyed again."""
        self.base.stop()
        self._turn(self.base.step(self.now()))
        return {"halted": True}

    def _step(self) -> None:
        velocities = self.base.step(self.now())
        if self.base.due(velocities):
            self._turn(velocities)

    def _turn(self, velocities: Array) -> None:
        stamp = self._host.clock.stamp()
        self._wheels.offer(lambda: self._command.fill(stamp["sec"], stamp["nanosec"], *velocities.tolist()))

    def _encoders(self, message: dict[str, Any]) -> None:
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
        self._heard = time.monotonic()
        if at is None:
            return
        velocities = message["velocity"].tolist()
        rates = [velocities[place] for place in self._places if place is not None and place < len(velocities)]
        try:
            travelled = self.base.measured(angles, at.seconds, rates if len(velocities) == len(positions) else None)
        except ValueError as err:
            self._trouble = str(err)
            return
        self._trouble = ""
        seconds, nanoseconds = divmod(at.stamp_ns, 1_000_000_000)
        self._publisher.publish(travelled, {"sec": seconds, "nanosec": nanoseconds})

    def _forget(self) -> None:
        """Forget what depends on the clock, which was set back."""
        self._times = ReadingTimes()
        self.base.forget()

    def _miss(self, positions: int) -> None:
        """Say which wheel has no encoder, unless none has: then it is the arms' driver, on the same topic."""
        if any(at is not None for at in self._places):
            missing = next(
                joint for joint, at in zip(self._joints, self._places, strict=True) if at is None or at >= positions
            )
            self._trouble = f"{missing} is not in the joint states; set modules.base_control.joints"

    def reset_odometry(self) -> None:
        """Begin at zero from here."""
        self.base.odometry.reset()

    def _reset_asked(self, _request: dict[str, Any], answer: Answer) -> None:
        self.reset_odometry()
        answer({"success": True, "message": "odometry begins at zero"})

    def health(self) -> Health:
        """Whether there are encoders, and who commands."""
        if self._trouble:
            return Health("waiting", self._trouble)
        if self._heard is None or time.monotonic() - self._heard > SILENT_SECONDS:
            return Health("waiting", "no wheel encoders are heard; is the base's driver there?")
        choice = self.base.choice
        who = choice.input or "nobody"
        state = "idle" if self.base.idle else "obeys " + who if choice.fresh or not choice.input else f"{who} is silent"
        return Health("running", state)

    def status(self) -> dict[str, Any]:
        """Who commands what, and where the base is."""
        base, moved = self.base, self.base.odometry.now
        return {
            "input": base.choice.input,
            "idle": base.idle,
            "velocity": [base.limiter.now.x, base.limiter.now.y, math.degrees(base.limiter.now.turn)],
            "odometry": [moved.x, moved.y, math.degrees(moved.theta)],
            "inputs": {
                name: {"commands": one.commands, "refused": one.refused, "error": self.inputs.trouble.get(name, "")}
                for name, one in base.inputs.items()
            },
            "stale": self.inputs.stale,
            "notes": list(self._notes),
        }

    def stop(self) -> None:
        """Command the wheels to stand still."""
        self._turn(np.zeros(len(self._joints)))
