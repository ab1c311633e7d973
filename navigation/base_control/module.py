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
from bridge.hub.qos import Qos
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.services import Answer
from bridge.routing.age import Pulse
from bridge.worker import Health
from navigation.base_control.answers import Reset
from navigation.base_control.base import Base
from navigation.base_control.doors import Doors
from navigation.base_control.kinematics import Array
from navigation.base_control.rpc import Words
from navigation.base_control.settings import settings
from navigation.base_control.told import Told

JOINTS = "sensor_msgs/msg/JointState"
RESET = "std_srvs/srv/Trigger"

SILENT_SECONDS = 0.5
"""After so long without encoders there is no odometry, and it is told."""

_BEAT = 0.1


class BaseControl(Module):
    """Drives a mobile base as its inputs command."""

    name = "base_control"

    def start(self, host: Host, section: Section) -> None:
        """Open what the section names, and begin to drive."""
        assert isinstance(section, BaseControlSection)
        self._host = host
        given = settings(section)
        for note in given.notes:
            host.log.warning("%s", note)
        self._notes = given.notes
        self.base = Base(given)
        self._joints = given.joints
        self._trouble = ""
        self._heard: float | None = None
        pulse = Pulse()
        host.loop.every(_BEAT, pulse.beat)
        self.doors = Doors(host, section, self.base, self.now, pulse)
        self._told = Told(host, section, given)
        self._wheels = host.node.publisher(section.wheel_command, JOINTS, Qos(depth=1), priority="command")
        host.node.subscription(section.joint_states, JOINTS, self._encoders, Qos(depth=10))
        self._offer(host, section)
        host.on_jump(self.base.forget)
        host.every(given.period, self._step)

    def _offer(self, host: Host, section: BaseControlSection) -> None:
        words = Words(self.base)
        host.yarp.respond(f"{section.prefix}/rpc", lambda values: host.loop.call(lambda: words.answer(values)))
        host.yarp.serve(f"{section.odometry}/rpc", Reset(lambda: host.loop.call(self.reset_odometry)))
        host.node.server(f"/{self.name}/reset_odometry", RESET, self._reset_asked)
        host.answer("halt", lambda _params: host.loop.call(self.halt))

    def now(self) -> float:
        """The time of commands, seconds: the run's where it is simulated, else of a clock that nobody sets."""
        clock = self._host.clock
        return clock.now_ns() / 1e9 if clock.simulated else time.monotonic()

    def halt(self) -> dict[str, Any]:
        """Stand still: forget what was commanded. Who commands on is obeyed again."""
        self.base.stop()
        self._step()
        return {"halted": True}

    def _step(self) -> None:
        self._turn(self.base.step(self.now()))

    def _turn(self, velocities: Array) -> None:
        header = {"stamp": self._host.clock.stamp(), "frame_id": ""}
        self._wheels.publish({"header": header, "name": list(self._joints), "velocity": velocities})

    def _encoders(self, message: dict[str, Any]) -> None:
        places = {name: place for place, name in enumerate(message["name"])}
        missing = [joint for joint in self._joints if places.get(joint, math.inf) >= len(message["position"])]
        if missing:
            if not set(self._joints) & places.keys():
                return  # the arms' driver, on the same topic
            self._trouble = f"{missing[0]} is not in the joint states; set modules.base_control.joints"
            return
        stamp = message["header"]["stamp"]
        angles = np.array([message["position"][places[joint]] for joint in self._joints])
        try:
            found = self.base.measured(angles, stamp["sec"] + stamp["nanosec"] / 1e9)
        except ValueError as err:
            self._trouble = str(err)
            return
        self._trouble = ""
        self._heard = time.monotonic()
        self._told.tell(found, stamp)

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
                name: {"commands": one.commands, "refused": one.refused, "error": self.doors.trouble.get(name, "")}
                for name, one in base.inputs.items()
            },
            "stale": self.doors.stale,
            "notes": list(self._notes),
        }

    def stop(self) -> None:
        """Tell the wheels to stand still."""
        self._turn(np.zeros(len(self._joints)))
