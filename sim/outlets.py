"""What the simulator publishes on the hub, and how often."""

from __future__ import annotations

from bridge.clock import CLOCK_TOPIC, CLOCK_TYPE
from bridge.hub.qos import Durability, Qos
from bridge.modules.node import Node
from sim import messages
from sim.base import Pose
from sim.names import Names
from sim.simulation import TICK_NS, Simulation

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_ODOMETRY = 2
_BUMPER = 10
_BATTERY = 100
"""Ticks between two messages: 50 Hz, 10 Hz, 1 Hz."""


class Outlets:
    """The simulator's publishers.

    Args:
        node: on the hub.
        names: of topics and frames.
        simulation: what is told of.
        clock: whether ``/clock`` is said.
    """

    def __init__(self, node: Node, names: Names, simulation: Simulation, *, clock: bool) -> None:
        self._names, self._simulation = names, simulation
        section = simulation.section
        self._drives = section.drive == "velocity"
        self._joints = node.publisher(names.joints, "sensor_msgs/msg/JointState")
        self._scan = node.publisher(names.scan, "sensor_msgs/msg/LaserScan")
        self._truth = node.publisher(names.truth, "nav_msgs/msg/Odometry")
        self._battery = node.publisher(names.battery, "sensor_msgs/msg/BatteryState")
        self._bumper = node.publisher(names.bumper, "std_msgs/msg/Bool")
        self._static = node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", _LATCHED, priority="state")
        self._odometry = node.publisher(names.odometry, "nav_msgs/msg/Odometry") if self._drives else None
        self._tf = node.publisher("/tf", "tf2_msgs/msg/TFMessage") if self._drives else None
        self._clock = node.publisher(CLOCK_TOPIC, CLOCK_TYPE) if clock else None
        self._view = node.publisher(names.view, "sensor_msgs/msg/Image") if section.view else None
        self._every_view = max(1, round(1e9 / section.view / TICK_NS)) if section.view else 0
        self._ticks = 0
        self._scanned = -1
        self._bumped = False

    def begin(self, time_ns: int) -> None:
        """Say what is said once."""
        names, robot = self._names, self._simulation.robot
        height = robot.lasers.height - (robot.wheels.radius if robot.kinematics == "differential" else 0.0)
        place = Pose(0.0, 0.0, 0.0)
        self._static.publish(messages.transform(time_ns, names.base_frame, names.laser_frame, place, height))

    def tell(self, time_ns: int) -> None:
        """Say what is due after a tick; ``time_ns`` is the time of the stamps."""
        simulation, names = self._simulation, self._names
        self._ticks += 1
        if "encoders_silent" not in simulation.faults:
            self._joints.publish(messages.joints(time_ns, simulation.base.names, simulation.motors.encoders()))
        if self._ticks % _ODOMETRY == 0:
            self._tell_pose(time_ns)
        if simulation.scan.time_ns != self._scanned:
            self._scanned = simulation.scan.time_ns
            self._scan.publish(
                messages.scan(time_ns, simulation.scan, names.laser_frame, simulation.section.laser.rate)
            )
        bumped = bool(simulation.bumps)
        if bumped != self._bumped or self._ticks % _BUMPER == 0:
            self._bumped = bumped
            self._bumper.publish({"data": bumped})
        if self._ticks % _BATTERY == 0:
            self._battery.publish(messages.battery(time_ns, simulation.battery.charge))
        if self._view is not None and self._ticks % self._every_view == 0:
            from sim.picture import draw

            self._view.publish(messages.image(time_ns, draw(simulation)))
        if self._clock is not None:
            # the last, and with the priority of the rest: who hears the time has heard what was measured at it
            self._clock.publish({"clock": messages.stamp(time_ns)})

    def _tell_pose(self, time_ns: int) -> None:
        simulation, names = self._simulation, self._names
        pose, twist = simulation.base.pose(), simulation.base.twist()
        self._truth.publish(messages.odometry(time_ns, pose, twist, names.map_frame, names.base_frame, sure=True))
        if self._odometry is not None and self._tf is not None and "encoders_silent" not in simulation.faults:
            found = simulation.estimate
            self._odometry.publish(messages.estimate(time_ns, found, names))
            self._tf.publish(messages.transform(time_ns, names.odom_frame, names.base_frame, found.pose))
