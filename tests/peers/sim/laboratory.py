"""A robot on the hub that stands in the laboratory, and publishes scans, odometry and the laboratory's map."""

from __future__ import annotations

import math
import time

from bridge.hub.node import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.tf.stamped import TF, TF_STATIC, TF_TYPE, Stamped, write
from navigation.pose import Pose
from sim import export, messages
from sim.section import LaserSection, SimSection
from sim.simulation import Simulation
from tests.peers.hub.node import HubNode
from yarp_compat.dev.mapgrid import MapGrid2D

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_PERIOD = 0.05
_UNIT = (0.0, 0.0, 0.0, 1.0)


class Robot(HubNode):
    """A standing robot that publishes its scans, and odometry whose origin is away from the map's.

    Attributes:
        silent: the outputs that the robot does not publish: "scan", "odometry".
        localized: the odometry frame's pose in the map that the robot publishes, as a localizer would; None to publish
        none.
    """

    def __init__(self, hub: Hub, registry: Registry) -> None:
        self._sim = Simulation(SimSection(plan="lab", laser=LaserSection(beams=180)))
        self.grid: MapGrid2D = export.grid(self._sim.plan, self._sim.floor)
        self.grid.m_map_name = "lab"
        self.silent: set[str] = set()
        self.localized: Pose | None = None
        self.odometry = Pose(7.0, -3.0, 2.0)
        super().__init__(hub, registry)
        self._tf = self.node.publisher(TF, TF_TYPE, Qos(depth=10))
        static = self.node.publisher(TF_STATIC, TF_TYPE, LATCHED, priority="state")
        # the laser is mounted upside down and rotated by 180 degrees
        static.publish_cdr(write([Stamped("base_link", "laser", 0, (0.0, 0.0, 0.2), (0.0, 1.0, 0.0, 0.0))]))
        self._scan = self.node.publisher("/scan", "sensor_msgs/msg/LaserScan", Qos(depth=1))
        self._timer = self.loop.every(_PERIOD, self._publish)

    @property
    def pose(self) -> Pose:
        """Return the robot's true pose."""
        return Pose(*self._sim.base.pose())

    def carry(self, x: float, y: float, yaw: float) -> None:
        """Move the robot to another place without a change of its odometry."""
        self._sim.teleport(self._sim.base.pose()._replace(x=x, y=y, yaw=yaw))
        self._sim.run(0.1)

    def _publish(self) -> None:
        now = time.time_ns()
        if "odometry" not in self.silent:
            self._tf.publish_cdr(write([stamped("odom", "base_link", self.odometry, now)]))
        localized = self.localized  # a test may set it meanwhile
        if localized is not None:
            self._tf.publish_cdr(write([stamped("map", "odom", localized, now + 100_000_000)]))
        if "scan" not in self.silent:
            scan = messages.scan(now, self._sim.scan, "laser", 20.0)
            # because of the laser's mounting, the beams run clockwise and start at the back
            first = math.pi - self._sim.scan.first
            step = -self._sim.scan.step
            scan |= {"angle_min": first, "angle_increment": step, "angle_max": first + step * 179}
            self._scan.publish(scan)

    def close(self) -> None:
        self._timer.close()
        super().close()


def stamped(parent: str, child: str, pose: Pose, stamp: int) -> Stamped:
    rotation = (0.0, 0.0, math.sin(pose.theta / 2), math.cos(pose.theta / 2))
    return Stamped(parent, child, stamp, (pose.x, pose.y, 0.0), rotation)
