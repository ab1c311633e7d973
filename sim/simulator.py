"""The simulator as a node of the hub: its time, its commands, its services."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from bridge.clock import DONE_TOPIC, DONE_TYPE
from bridge.config.sections.section import Section
from bridge.config.sections.sim import SimSection
from bridge.hub.qos import Qos, Reliability
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.worker import Health
from sim import messages
from sim.errors import SimError
from sim.names import names_of
from sim.outlets import Outlets
from sim.pace import Pace
from sim.services import Wishes, answered
from sim.simulation import TICK_NS, Simulation
from sim.stepping import Stepping

_NEWEST = Qos(Reliability.BEST_EFFORT, depth=1)
_BUNDLE = 5
"""Ticks at one go where it runs as fast as it can: then others are heard."""


class Simulator(Module):
    """Runs a simulation on its host's thread, at the pace that its section says."""

    name = "sim"

    def start(self, host: Host, section: Section) -> None:
        """See `Module.start`."""
        assert isinstance(section, SimSection)
        self._host, self._section = host, section
        self.simulation = Simulation(section)
        self._paused = False
        self._refused = 0
        self._real = section.speed == 1.0 and not host.clock.simulated
        self._pace = Pace(section.speed) if isinstance(section.speed, float) else None
        names = names_of(section.names, self.simulation.robot)
        node = host.node
        self._outlets = Outlets(node, names, self.simulation, clock=not self._real)
        self._stepping = Stepping(host.loop, self._tick)
        if section.drive == "velocity":
            node.subscription(names.velocity, "geometry_msgs/msg/Twist", self._velocity, _NEWEST)
        else:
            node.subscription(names.wheels, "sensor_msgs/msg/JointState", self._wheels, _NEWEST)
        node.subscription(DONE_TOPIC, DONE_TYPE, self._stepping.acknowledge)
        for name, (kind, do) in Wishes(self.simulation).services().items():
            node.server(name, kind, answered(do))
        node.server("/sim/reset", "std_srvs/srv/Trigger", answered(self._reset))
        node.server("/sim/pause", "std_srvs/srv/SetBool", answered(self._pause))
        node.server("/sim/step", "midspan_msgs/srv/Step", self._stepping.serve)
        self._ports: Any = None
        if section.yarp:
            from sim.ports import Ports

            self._ports = Ports(host, section.yarp, self.simulation)
        self._outlets.begin(self._stamp())
        if self._pace is not None:
            self._pace.begin()
            host.loop.every(TICK_NS / 1e9, self._keep_pace)
        elif section.speed == "max":
            host.loop.post(self._hurry)

    def health(self) -> Health:
        """See `Module.health`."""
        how = "paused" if self._paused else f"{self.simulation.time_ns / 1e9:.0f} s"
        return Health("running", f"{self.simulation.plan.name}/{self.simulation.floor}, {how}")

    def status(self) -> dict[str, Any]:
        """See `Module.status`."""
        simulation, pace = self.simulation, self._pace
        pose = simulation.base.pose()
        return {
            "time": simulation.time_ns / 1e9,
            "paused": self._paused,
            "late_steps": pace.late if pace else 0,
            "left_out_steps": pace.left_out if pace else 0,
            "refused_commands": self._refused,
            "emergency_stop": simulation.stopped,
            "faults": list(simulation.faults),
            "floor": simulation.floor,
            "robot": simulation.robot.name,
            "truth": [round(v, 4) for v in pose],
            "doors": dict(simulation.world.doors),
        }

    def _stamp(self) -> int:
        return time.time_ns() if self._real else self.simulation.time_ns

    def _tick(self) -> int:
        self.simulation.tick()
        at = self._stamp()
        self._outlets.tell(at)
        if self._ports is not None:
            self._ports.tell(at)
        return at

    def _keep_pace(self) -> None:
        assert self._pace is not None
        if self._paused or self._stepping.busy:
            self._pace.begin()
            return
        for _ in range(self._pace.due()):
            self._tick()

    def _hurry(self) -> None:
        if not self._paused and not self._stepping.busy:
            for _ in range(_BUNDLE):
                self._tick()
        if self._paused:
            self._host.loop.after(0.01, self._hurry)
        else:
            self._host.loop.post(self._hurry)

    def _velocity(self, message: dict[str, Any]) -> None:
        self._try(lambda: self.simulation.command(messages.velocity(message)))

    def _wheels(self, message: dict[str, Any]) -> None:
        self._try(lambda: self._drive_wheels(message))

    def _drive_wheels(self, message: dict[str, Any]) -> None:
        motors = self.simulation.motors
        said = dict(zip(message["name"], message["velocity"], strict=False))
        if set(said) != set(motors.names):
            msg = f"a wheel command is for {', '.join(said) or 'nothing'}, and the base has {', '.join(motors.names)}"
            raise SimError(msg)
        at = message["header"]["stamp"]["sec"] * 1_000_000_000 + message["header"]["stamp"]["nanosec"]
        if at and self._stamp() - at > self.simulation.robot.motor_timeout * 1e9:
            msg = "a wheel command is older than the motors' time-out"
            raise SimError(msg)
        motors.drive([said[name] for name in motors.names])

    def _try(self, do: Callable[[], None]) -> None:
        if self._pace is not None and self._pace.stood_still():
            self._refuse("it may have waited while the simulator stood still")
            return
        try:
            do()
        except SimError as err:
            self._refuse(str(err))

    def _refuse(self, why: str) -> None:
        self._refused += 1
        if self._refused in (1, 10, 100) or self._refused % 1000 == 0:
            self._host.log.warning("command refused (%d so far): %s", self._refused, why)

    def _reset(self, _request: dict[str, Any]) -> str:
        self._stepping.give_up("the simulation was reset")
        self.simulation.begin()
        return "everything is as at the start; the time goes on"

    def _pause(self, request: dict[str, Any]) -> str:
        self._paused = bool(request["data"])
        return "paused" if self._paused else "running"
