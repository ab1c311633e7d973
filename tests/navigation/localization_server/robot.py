"""A robot on the hub that stands or drives in the laboratory: its scans, its odometry, and the laboratory's map."""

from __future__ import annotations

import math
import time

from bridge.clock import SYSTEM
from bridge.config.sections.sim import LaserSection, SimSection
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.modules.host import ModuleNode
from bridge.modules.loop import EventLoop
from bridge.tf.stamped import TF, TF_STATIC, TF_TYPE, Stamped, write
from navigation.pose import Pose
from sim import export, messages
from sim.simulation import Simulation
from yarp_compat.dev.mapgrid import MapGrid2D

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_EVERY = 0.05
_UNIT = (0.0, 0.0, 0.0, 1.0)


class Robot:
    """Stands; says where it is by odometry that began elsewhere, and what its laser sees.

    Attributes:
        silent: what it does not say: "scan", "odometry".
        localized: what it says itself of the odometry's frame on the map, as a localiser would.
    """

    def __init__(self, hub: Hub, registry: Registry) -> None:
        self._sim = Simulation(SimSection(plan="lab", laser=LaserSection(beams=180)))
        self.grid: MapGrid2D = export.grid(self._sim.plan, self._sim.floor)
        self.grid.m_map_name = "lab"
        self.silent: set[str] = set()
        self.localized: Pose | None = None
        self.odometry = Pose(7.0, -3.0, 2.0)
        self._loop = EventLoop("robot")
        self._loop.start()
        self.node = ModuleNode(hub, registry, self._loop, SYSTEM)
        self._tf = self.node.publisher(TF, TF_TYPE, Qos(depth=10))
        static = self.node.publisher(TF_STATIC, TF_TYPE, LATCHED, priority="state")
        # the laser hangs upside down, turned by half a circle
        static.publish_cdr(write([Stamped("base_link", "laser", 0, (0.0, 0.0, 0.2), (0.0, 1.0, 0.0, 0.0))]))
        self._scan = self.node.publisher("/scan", "sensor_msgs/msg/LaserScan", Qos(depth=1))
        self._timer = self._loop.every(_EVERY, self._say)

    @property
    def pose(self) -> Pose:
        """Where it truly is."""
        return Pose(*self._sim.base.pose())

    def carry(self, x: float, y: float, yaw: float) -> None:
        """Stand it elsewhere; its odometry does not notice."""
        self._sim.teleport(self._sim.base.pose()._replace(x=x, y=y, yaw=yaw))
        self._sim.run(0.1)

    def _say(self) -> None:
        now = time.time_ns()
        if "odometry" not in self.silent:
            self._tf.publish_cdr(write([stamped("odom", "base_link", self.odometry, now)]))
        if self.localized is not None:
            self._tf.publish_cdr(write([stamped("map", "odom", self.localized, now + 100_000_000)]))
        if "scan" not in self.silent:
            scan = messages.scan(now, self._sim.scan, "laser", 20.0)
            # as a laser sees it that hangs so: its beams go the other way round, and begin at the back
            first = math.pi - self._sim.scan.first
            step = -self._sim.scan.step
            scan |= {"angle_min": first, "angle_increment": step, "angle_max": first + step * 179}
            self._scan.publish(scan)

    def close(self) -> None:
        self._loop.close()
        self.node.close()


def stamped(parent: str, child: str, pose: Pose, stamp: int) -> Stamped:
    turned = (0.0, 0.0, math.sin(pose.theta / 2), math.cos(pose.theta / 2))
    return Stamped(parent, child, stamp, (pose.x, pose.y, 0.0), turned)
