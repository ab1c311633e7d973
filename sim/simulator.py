"""The simulator as a node of the hub: its commands and services, and the worker that runs it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.clock import DONE_TOPIC, DONE_TYPE
from bridge.config.model import Config
from bridge.config.sections.section import Section
from bridge.hub.wire.qos import Qos, Reliability
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.ports import ports_stay
from bridge.modules.worker import Running
from bridge.status import Part
from bridge.worker import Health, Worker
from sim import messages
from sim.base import TICK_NS
from sim.environment import SimError
from sim.messages import names_of
from sim.pace import Pace
from sim.publishers import SimPublishers
from sim.section import JOINTS, SimSection
from sim.services import ChangeServices, Stepping, answered
from sim.simulation import Simulation
from sim.stamps import WallStamps

_ALL = Qos(depth=1000)  # every participant acknowledges each tick of a step
_NEWEST = Qos(Reliability.BEST_EFFORT, depth=1)
_BUNDLE = 5  # ticks between two rounds of message handling, at maximum speed


class Simulator(Module):
    """Runs a simulation on its host's thread, at the configured pace."""

    name = "sim"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, SimSection)
        self._host = host
        self.simulation = Simulation(section)
        self._paused = False
        self._refused, self._refusal = 0, ""
        self._real = section.speed == 1.0 and not host.clock.simulated
        self._pace = Pace(section.speed) if isinstance(section.speed, float) else None
        names = names_of(section.names, self.simulation.robot)
        node = host.node
        self._publishers = SimPublishers(node, names, self.simulation, clock=not self._real)
        host.clock.source = not self._real
        self._stamps = WallStamps() if self._real else None
        self._stepping = Stepping(host.loop, self._tick, paced=self._real)
        if section.drive == "velocity":
            node.subscription(names.velocity, "geometry_msgs/msg/Twist", self._velocity, _NEWEST)
            node.subscription(names.velocity, "geometry_msgs/msg/TwistStamped", self._stamped_velocity, _NEWEST)
        else:
            node.subscription(names.wheels, JOINTS, self._wheels, _NEWEST)
        node.subscription(DONE_TOPIC, DONE_TYPE, self._stepping.acknowledge, _ALL)
        for name, (kind, do) in ChangeServices(self.simulation).services().items():
            node.server(name, kind, answered(do))
        node.server("/sim/reset", "std_srvs/srv/Trigger", answered(self._reset))
        node.server("/sim/pause", "std_srvs/srv/SetBool", answered(self._pause))
        node.server("/sim/step", "midspan_msgs/srv/Step", self._stepping.serve)
        self._ports: Any = None
        if section.yarp:
            from sim.ports import RobotPorts

            self._ports = RobotPorts(host, section.yarp, self.simulation)
        self._publishers.begin(self._now())
        if self._pace is not None:
            self._pace.begin()
            host.loop.every(TICK_NS / 1e9, self._keep_pace)
        elif section.speed == "max":
            host.loop.post(self._hurry)

    @override
    def health(self) -> Health:
        how = "paused" if self._paused else f"{self.simulation.time_ns / 1e9:.0f} s"
        text = f"{self.simulation.plan.name}/{self.simulation.floor}, {how}"
        if self._refused:
            text += f"; {self._refused:,} commands refused (last: {self._refusal})"
        return Health("running", text)

    @override
    def status(self) -> Part:
        simulation, pace = self.simulation, self._pace
        pose = simulation.base.pose()
        return Part(
            time=simulation.time_ns / 1e9,
            paused=self._paused,
            late_steps=pace.late if pace else 0,
            left_out_steps=pace.left_out if pace else 0,
            refused_commands=self._refused,
            emergency_stop=simulation.wheels.stopped,
            faults=list(simulation.faults),
            floor=simulation.floor,
            robot=simulation.robot.name,
            truth=[round(v, 4) for v in pose],
            doors=dict(simulation.world.doors),
        )

    def _now(self) -> int:
        return time.time_ns() if self._real else self.simulation.time_ns

    def _tick(self) -> int:
        self.simulation.tick()
        at = self.simulation.time_ns
        if self._stamps is not None and self._pace is not None:
            at = self._stamps.stamp(self._pace.moment())
        self._publishers.publish(at)
        if self._ports is not None:
            self._ports.publish(at)
        return at

    def _keep_pace(self) -> None:
        assert self._pace is not None
        if self._stepping.busy and self._real:
            self._stepping.advance(self._pace.due())
        elif self._stepping.busy or self._paused:
            self._pace.begin()
        else:
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
        velocity = messages.velocity(message)
        self._try(lambda: self.simulation.command(velocity), stops=not any(velocity))

    def _stamped_velocity(self, message: dict[str, Any]) -> None:
        self._velocity(message["twist"])

    def _wheels(self, message: dict[str, Any]) -> None:
        stops = len(message["velocity"]) > 0 and not np.any(message["velocity"])
        self._try(lambda: self._drive_wheels(message, stops=stops), stops=stops)

    def _drive_wheels(self, message: dict[str, Any], *, stops: bool) -> None:
        motors = self.simulation.wheels.motors
        wanted = dict(zip(message["name"], message["velocity"], strict=False))
        if set(wanted) != set(motors.names):
            msg = f"wheel command for {', '.join(wanted) or 'no wheels'}; the base has {', '.join(motors.names)}"
            raise SimError(msg)
        at = message["header"]["stamp"]["sec"] * 1_000_000_000 + message["header"]["stamp"]["nanosec"]
        if at and not stops and self._now() - at > self.simulation.robot.motor_timeout * 1e9:
            raise SimError("the wheel command is older than the motors' time-out")
        motors.drive([wanted[name] for name in motors.names])

    def _try(self, do: Callable[[], None], *, stops: bool) -> None:
        """Execute a command, unless it may be old; one that ``stops`` the robot is always executed."""
        if self._pace is not None and self._pace.stood_still() and not stops:
            self._refuse("the command may have been queued while the simulator stood still")
            return
        try:
            do()
        except SimError as err:
            self._refuse(str(err))

    def _refuse(self, why: str) -> None:
        self._refused, self._refusal = self._refused + 1, why
        if self._refused in (1, 10, 100) or self._refused % 1000 == 0:
            self._host.log.warning("command refused (%d so far): %s", self._refused, why)

    def _reset(self, _request: dict[str, Any]) -> str:
        self._stepping.give_up("the simulation was reset")
        self.simulation.begin()
        return "the simulation was reset; its time continues"

    def _pause(self, request: dict[str, Any]) -> str:
        self._paused = bool(request["data"])
        return "paused" if self._paused else "running"


_FIXED = ("name", "state", "hub", "types", "limits", "clock")  # changes need a restart of the worker


class SimWorker(Worker):
    """One simulation in a separate process, because DART holds Python's GIL while it computes."""

    def __init__(self) -> None:
        self._config: Config | None = None
        self._running: Running | None = None

    @override
    def start(self, config: Config) -> None:
        """Start the simulation; after a failure it is retried, and `health` gives the reason."""
        self._config = config
        registry = Registry.of(config.types)
        self._running = Running(Simulator, Simulator.name, config.section(SimSection), config, registry)
        self._running.start()

    @override
    def reload(self, config: Config) -> bool:
        """Apply a configuration, and restart the simulation if its section differs.

        Return False if only a restart of the worker can apply the configuration.
        """
        old, running = self._config, self._running
        if old is None or running is None or not ports_stay(config, old):
            return False
        if any(getattr(config, part) != getattr(old, part) for part in _FIXED):
            return False
        self._config = config
        logging.getLogger().setLevel(config.log.level.upper())
        running.adopt_releases(config)
        section = config.section(SimSection)
        if running.section != section:
            running.reload(section, config)
        return True

    @override
    def health(self) -> Health:
        return self._running.health() if self._running is not None else Health("waiting", "stopped")

    @override
    def stop(self) -> None:
        running, self._running = self._running, None
        if running is not None:
            running.stop()
