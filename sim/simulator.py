"""The simulator as a node of the hub: its pace, commands and publishers, and the worker that runs it."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any

from typing_extensions import override

from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE, DONE_TOPIC, DONE_TYPE
from bridge.config.model import Config
from bridge.config.sections.section import Section
from bridge.hub.wire.qos import LATCHED, Qos, Reliability
from bridge.messages.registry import Registry
from bridge.modules.endpoints import ModulePublisher
from bridge.modules.host import Host, ModuleNode
from bridge.modules.module import Module
from bridge.modules.ports import ports_stay
from bridge.modules.worker import Running
from bridge.worker import Health, Worker
from sim import messages
from sim.base import TICK_NS, BasePose, Twist
from sim.environment import SimError
from sim.messages import TopicNames, names_of
from sim.section import SimSection
from sim.services import ChangeServices, Stepping, answered
from sim.simulation import Simulation
from sim.stamps import WallStamps

_PICTURE = Qos(depth=2)  # large messages, of which only the newest count
_ALL = Qos(depth=1000)  # every participant acknowledges each tick of a step
_NEWEST = Qos(Reliability.BEST_EFFORT, depth=1)
_BUNDLE = 5  # ticks without handling messages, at maximum speed


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
        self._outlets = Outlets(node, names, self.simulation, clock=not self._real)
        host.clock.source = not self._real
        self._stamps = WallStamps() if self._real else None
        self._stepping = Stepping(host.loop, self._tick, paced=self._real)
        if section.drive == "velocity":
            node.subscription(names.velocity, "geometry_msgs/msg/Twist", self._velocity, _NEWEST)
            node.subscription(names.velocity, "geometry_msgs/msg/TwistStamped", self._stamped_velocity, _NEWEST)
        else:
            node.subscription(names.wheels, "sensor_msgs/msg/JointState", self._wheels, _NEWEST)
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
        self._outlets.begin(self._now())
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
    def status(self) -> dict[str, Any]:
        simulation, pace = self.simulation, self._pace
        pose = simulation.base.pose()
        return {
            "time": simulation.time_ns / 1e9,
            "paused": self._paused,
            "late_steps": pace.late if pace else 0,
            "left_out_steps": pace.left_out if pace else 0,
            "refused_commands": self._refused,
            "emergency_stop": simulation.wheels.stopped,
            "faults": list(simulation.faults),
            "floor": simulation.floor,
            "robot": simulation.robot.name,
            "truth": [round(v, 4) for v in pose],
            "doors": dict(simulation.world.doors),
        }

    def _now(self) -> int:
        return time.time_ns() if self._real else self.simulation.time_ns

    def _tick(self) -> int:
        self.simulation.tick()
        at = self.simulation.time_ns
        if self._stamps is not None and self._pace is not None:
            at = self._stamps.stamp(self._pace.moment())
        self._outlets.publish(at)
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
        self._try(lambda: self.simulation.command(messages.velocity(message)))

    def _stamped_velocity(self, message: dict[str, Any]) -> None:
        self._velocity(message["twist"])

    def _wheels(self, message: dict[str, Any]) -> None:
        self._try(lambda: self._drive_wheels(message))

    def _drive_wheels(self, message: dict[str, Any]) -> None:
        motors = self.simulation.wheels.motors
        wanted = dict(zip(message["name"], message["velocity"], strict=False))
        if set(wanted) != set(motors.names):
            msg = f"wheel command for {', '.join(wanted) or 'no wheels'}; the base has {', '.join(motors.names)}"
            raise SimError(msg)
        at = message["header"]["stamp"]["sec"] * 1_000_000_000 + message["header"]["stamp"]["nanosec"]
        if at and self._now() - at > self.simulation.robot.motor_timeout * 1e9:
            raise SimError("a wheel command is older than the motors' time-out")
        motors.drive([wanted[name] for name in motors.names])

    def _try(self, do: Callable[[], None]) -> None:
        if self._pace is not None and self._pace.stood_still():
            self._refuse("it may have been queued while the simulator stood still")
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


_CATCH_UP = 0.05  # seconds to catch up on at once, before messages are handled
_EARLY = 0.002  # seconds by which a tick may be early, since timers are not exact
_FORGIVEN = 0.25  # seconds of delay after which missed ticks are left out, so that a base does not rush


class Pace:
    """Determines how many ticks are due, and when each was due.

    Args:
        speed: simulated seconds per second.
    """

    def __init__(self, speed: float) -> None:
        self._seconds = TICK_NS / 1e9 / speed
        self._next = -math.inf  # when the next tick is due
        self._owed = 0  # ticks that `due` has counted and `moment` has not passed
        self.begin()
        self.late = 0  # ticks that were late by their duration or more
        self.left_out = 0  # ticks that were skipped because this process stood still
        self._stood = -_PILED

    def begin(self) -> None:
        """Start from now on: after a pause nothing is due."""
        self._next = max(self._next, time.monotonic() + self._seconds)

    def stood_still(self) -> bool:
        """Return whether messages that arrive now may have waited while this process stood still."""
        return time.monotonic() - self._stood < _PILED

    def due(self) -> int:
        """Return the number of ticks that are due, and count them as done."""
        now = time.monotonic()
        behind = now - self._next
        if behind > _FORGIVEN:
            missed = int(behind / self._seconds)
            self.left_out += missed
            self._stood = now
            self._next += missed * self._seconds
            behind = now - self._next
        count = int(behind / self._seconds) + 1 if behind > -_EARLY else 0
        count = min(count, max(1, int(_CATCH_UP / self._seconds)))
        self.late += max(0, min(count, int(behind / self._seconds))) if self._seconds >= _TICK_WAIT else 0
        self._next += count * self._seconds
        self._owed = count
        return count

    def moment(self) -> float:
        """Return when the next of the ticks that `due` counted was due, in seconds of the monotonic clock.

        That is the earliest time at which a tick may run, so it is never in the future.
        """
        moment = self._next - self._owed * self._seconds - _EARLY
        self._owed -= 1
        return moment


_PILED = 0.5  # seconds after a standstill in which queued messages may still arrive
_TICK_WAIT = 0.005  # seconds; shorter ticks run in bundles, and are not counted as late


_ODOMETRY = 2
_BUMPER = 10
_BATTERY = 100  # ticks between two messages: 50 Hz, 10 Hz, 1 Hz


class Outlets:
    """The simulator's publishers.

    Args:
        clock: whether to publish ``/clock``.
    """

    def __init__(self, node: ModuleNode, names: TopicNames, simulation: Simulation, *, clock: bool) -> None:
        self._names, self._simulation = names, simulation
        section = simulation.section
        self._drives = section.drive == "velocity"
        self._joints = node.publisher(names.joints, "sensor_msgs/msg/JointState")
        self._scan = node.publisher(names.scan, "sensor_msgs/msg/LaserScan")
        self._truth = node.publisher(names.truth, "nav_msgs/msg/Odometry")
        self._battery = node.publisher(names.battery, "sensor_msgs/msg/BatteryState")
        self._bumper = node.publisher(names.bumper, "std_msgs/msg/Bool")
        self._static = node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED, priority="state")
        self._odometry = node.publisher(names.odometry, "nav_msgs/msg/Odometry") if self._drives else None
        self._tf = node.publisher("/tf", "tf2_msgs/msg/TFMessage") if self._drives else None
        self._clock = node.publisher(CLOCK_TOPIC, CLOCK_TYPE) if clock else None
        self._view = node.publisher(names.view, "sensor_msgs/msg/Image") if section.view else None
        self._every_view = max(1, round(1e9 / section.view / TICK_NS)) if section.view else 0
        self._camera = CameraOutlets(node, simulation) if simulation.section.camera.rate else None
        self._ticks = 0
        self._scanned = -1
        self._bumped = False
        self._prepare()

    def _prepare(self) -> None:
        """Encode the frequent messages once, so that later only their numbers are filled in."""
        names, simulation, still = self._names, self._simulation, Twist(0.0, 0.0, 0.0)
        place, motion = BasePose(0.0, 0.0, 0.0), ("header.stamp", "pose.pose", "twist.twist")
        joints = messages.joints(0, simulation.base.names, simulation.wheels.motors.encoders())
        self._turning = self._joints.template(joints, "header.stamp", "position", "velocity")
        truth = messages.odometry(0, place, still, names.map_frame, names.base_frame, sure=True)
        self._true = self._truth.template(truth, *motion)
        if self._odometry is not None and self._tf is not None:
            odometry = messages.odometry(0, place, still, names.odom_frame, names.base_frame)
            self._estimated = self._odometry.template(odometry, *motion)
            frame = messages.transform(0, names.odom_frame, names.base_frame, place)
            self._moved = self._tf.template(frame, "transforms[0].header.stamp", "transforms[0].transform")

    def begin(self, time_ns: int) -> None:
        """Publish the static transforms."""
        names, robot = self._names, self._simulation.robot
        middle = robot.wheels.radius if robot.kinematics == "differential" else 0.0
        camera = None if self._simulation.camera is None else self._simulation.section.camera
        frames = names.base_frame, names.laser_frame
        self._static.publish(messages.mount(time_ns, *frames, robot.lasers.height, camera, middle))

    def publish(self, time_ns: int) -> None:
        """Publish the messages that are due after a tick, with stamps of ``time_ns``."""
        simulation, names = self._simulation, self._names
        self._ticks += 1
        if "encoders_silent" not in simulation.faults:
            self._joints.offer(
                lambda: self._turning.fill(*messages.turning(time_ns, simulation.wheels.motors.encoders()))
            )
        if self._ticks % _ODOMETRY == 0:
            self._publish_pose(time_ns)
        if simulation.scan.time_ns != self._scanned:
            self._scanned = simulation.scan.time_ns
            rate = simulation.section.laser.rate
            scan, frame = simulation.scan, names.laser_frame
            self._scan.offer(lambda: self._scan.encoded(messages.scan(time_ns, scan, frame, rate)))
        if self._camera is not None and simulation.pictured == simulation.time_ns:
            self._camera.publish(time_ns)
        bumped = bool(simulation.bumps)
        if bumped != self._bumped or self._ticks % _BUMPER == 0:
            self._bumped = bumped
            self._bumper.offer(lambda: self._bumper.encoded({"data": bumped}))
        if self._ticks % _BATTERY == 0:
            self._battery.publish(messages.battery(time_ns, simulation.battery.charge))
        if self._view is not None and self._ticks % self._every_view == 0:
            self._publish_view(self._view, time_ns)
        if self._clock is not None:
            # last, and with the same priority: the measurements of a time arrive before it
            self._clock.publish({"clock": messages.stamp(time_ns)})

    def _publish_view(self, view: ModulePublisher, time_ns: int) -> None:
        from sim.export import draw

        view.offer(lambda: view.encoded(messages.image(time_ns, draw(self._simulation))))

    def _publish_pose(self, time_ns: int) -> None:
        simulation = self._simulation
        base = simulation.base
        self._truth.offer(lambda: self._true.fill(*messages.moving(time_ns, base.pose(), base.twist())))
        if self._odometry is not None and self._tf is not None and "encoders_silent" not in simulation.faults:
            estimate = simulation.estimate
            self._odometry.offer(lambda: self._estimated.fill(*messages.moving(time_ns, estimate.pose, estimate.twist)))
            self._tf.offer(lambda: self._moved.fill(*messages.placed(time_ns, estimate.pose)))


class CameraOutlets:
    """The depth camera's publishers; pictures are computed only for subscribers."""

    def __init__(self, node: ModuleNode, simulation: Simulation) -> None:
        self._simulation = simulation
        self._depth = node.publisher(messages.DEPTH, "sensor_msgs/msg/Image", _PICTURE)
        self._info = node.publisher(messages.DEPTH_INFO, "sensor_msgs/msg/CameraInfo")
        self._points = node.publisher(messages.DEPTH_POINTS, "sensor_msgs/msg/PointCloud2", _PICTURE)

    def publish(self, time_ns: int) -> None:
        """Publish the latest picture, with stamps of ``time_ns``."""
        simulation, camera = self._simulation, self._simulation.camera
        assert camera is not None
        depth, info, points, encoding = self._depth, self._info, self._points, simulation.section.camera.encoding
        info.offer(lambda: info.encoded(messages.camera_info(time_ns, camera.lens, *camera.size)))
        depth.offer(lambda: depth.encoded(messages.depth(time_ns, simulation.depth(), encoding)))
        points.offer(lambda: points.encoded(messages.points(time_ns, camera.points(simulation.depth()))))


_FIXED = ("name", "state", "hub", "types", "limits", "clock")


class SimWorker(Worker):
    """One simulation in a separate process, because DART holds Python's lock while it computes."""

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
        """Restart the simulation with another section; return False if only a restart of the worker can apply it."""
        old, running = self._config, self._running
        if old is None or running is None or not ports_stay(config, old):
            return False
        if any(getattr(config, part) != getattr(old, part) for part in _FIXED):
            return False
        self._config = config
        logging.getLogger().setLevel(config.log.level.upper())
        running.take_up_releases(config)
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
