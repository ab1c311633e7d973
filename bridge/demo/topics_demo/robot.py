"""A ROS 1 robot in one program: the simulated R1 (`sim`) with rospy's endpoints, driven by ``/cmd_vel``.

Runs on Midspan's Python in the environment of `bridge.demo.rospy_packages`:
``python -m bridge.demo.topics_demo.robot``.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import Any

import rospy
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import Image, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from bridge.demo.topics_demo import messages
from bridge.demo.topics_demo.report import Reporter
from navigation.maps.grid import occupied
from sim import export
from sim.base import BasePose
from sim.base import Twist as Velocity
from sim.environment import SimError
from sim.section import SimSection
from sim.simulation import Simulation

_LASER = {"beams": messages.BEAMS, "rate": messages.SCAN_RATE, "farthest": 8.0}


class Robot:
    """The simulation and its ROS 1 endpoints."""

    def __init__(self) -> None:
        self.reporter = Reporter(self._state)
        section = SimSection.model_validate({"enabled": True, "people": False, "laser": _LASER})
        self._simulation = Simulation(section)
        self._grid = export.grid(self._simulation.plan, self._simulation.floor)
        self._cells = occupied(self._grid)
        self._picture = export.draw(self._simulation)
        self._lock = threading.Lock()
        self._now = 0.0
        self._hellos = 0
        rospy.init_node("robot", disable_signals=True)
        self._scan = rospy.Publisher(messages.SCAN, LaserScan, queue_size=5)
        self._odom = rospy.Publisher(messages.ODOM, Odometry, queue_size=10)
        self._tf = rospy.Publisher(messages.TF, TFMessage, queue_size=10)
        self._tf_static = rospy.Publisher(messages.TF_STATIC, TFMessage, queue_size=1, latch=True)
        self._map = rospy.Publisher(messages.MAP, OccupancyGrid, queue_size=1, latch=True)
        self._image = rospy.Publisher(messages.IMAGE, Image, queue_size=2)
        self._hello = rospy.Publisher(messages.FROM_ROS1, String, queue_size=5)
        rospy.Subscriber(messages.CMD_VEL, Twist, self._on_command, queue_size=1, tcp_nodelay=True)
        for topic in messages.HELLOS:
            rospy.Subscriber(topic, String, self._on_greeting, callback_args=topic, queue_size=20)

    def run(self, ended: threading.Event) -> None:
        """Publish and move until the event is set."""
        now = rospy.Time.now()
        start = self._simulation.base.pose()
        laser, camera = BasePose(0.0, 0.0, 0.0), BasePose(0.15, 0.0, 0.0)
        mounts = [("map", "odom", start, 0.0), ("base_link", "laser", laser, 0.2), ("base_link", "camera", camera, 0.6)]
        self._tf_static.publish(TFMessage([_transform(now, *mount) for mount in mounts]))
        self._map.publish(self._map_message(now))
        period = 1 / messages.BASE_RATE
        tick, due = 0, time.monotonic()
        while not ended.wait(max(0.0, due - time.monotonic())):
            due = max(due + period, time.monotonic() - 5 * period)
            with self._lock:
                self._simulation.run(period)
                self._now = time.monotonic()
            self._publish(tick)
            tick += 1

    def _publish(self, tick: int) -> None:
        now = rospy.Time.now()
        self._publish_odometry(now)
        if tick % round(messages.BASE_RATE / messages.SCAN_RATE) == 0:
            self._publish_scan(now)
        if tick % round(messages.BASE_RATE / messages.IMAGE_RATE) == 0:
            self._publish_image(now)
        if tick % round(messages.BASE_RATE / messages.HELLO_RATE) == 0:
            self._hellos += 1
            self._hello.publish(String(f"hello {self._hellos} from ROS 1"))

    def _state(self) -> dict[str, Any]:
        with self._lock:
            at, velocity = self._simulation.estimate.pose, self._simulation.estimate.twist
        height, width = self._picture.shape[:2]
        return {
            "pose": list(at),
            "velocity": [velocity.x, velocity.yaw],
            "time": self._now,
            "map": messages.grid_text(self._grid.width(), self._grid.height(), self._cells.tobytes()),
            "image": f"{width} x {height} rgb8, {self._picture.nbytes} bytes",
        }

    def _on_command(self, command: Twist) -> None:
        try:
            with self._lock:
                self._simulation.command(Velocity(command.linear.x, 0.0, command.angular.z))
        except SimError as err:
            rospy.logwarn("%s", err)
        self.reporter.received(messages.CMD_VEL).add(None, f"{command.linear.x:.2f} m/s, {command.angular.z:.2f} rad/s")

    def _on_greeting(self, message: String, topic: str) -> None:
        self.reporter.received(topic).add(message.data, message.data)

    def _publish_odometry(self, now: rospy.Time) -> None:
        at, velocity = self._simulation.estimate.pose, self._simulation.estimate.twist
        odom = Odometry(child_frame_id="base_link")
        odom.header.stamp, odom.header.frame_id = now, "odom"
        odom.pose.pose.position.x, odom.pose.pose.position.y = at.x, at.y
        odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = math.sin(at.yaw / 2), math.cos(at.yaw / 2)
        odom.twist.twist.linear.x, odom.twist.twist.angular.z = velocity.x, velocity.yaw
        self._odom.publish(odom)
        self._tf.publish(TFMessage([_transform(now, "odom", "base_link", at, 0.0)]))

    def _publish_scan(self, now: rospy.Time) -> None:
        simulated = self._simulation.scan
        scan = LaserScan(angle_min=simulated.first, angle_increment=simulated.step, range_min=simulated.nearest)
        scan.header.stamp, scan.header.frame_id = now, "laser"
        scan.angle_max = simulated.first + (len(simulated.ranges) - 1) * simulated.step
        scan.scan_time, scan.range_max = 1 / messages.SCAN_RATE, simulated.farthest
        scan.ranges = simulated.ranges.tolist()
        self._scan.publish(scan)

    def _publish_image(self, now: rospy.Time) -> None:
        """Publish an image of the floor, as seen by a camera above it."""
        self._picture = export.draw(self._simulation)
        height, width = self._picture.shape[:2]
        image = Image(width=width, height=height, encoding="rgb8", step=3 * width, data=self._picture.tobytes())
        image.header.stamp, image.header.frame_id = now, "camera"
        self._image.publish(image)

    def _map_message(self, now: rospy.Time) -> OccupancyGrid:
        grid = OccupancyGrid(data=self._cells.tolist())
        grid.header.stamp, grid.header.frame_id = now, "map"
        grid.info.map_load_time, grid.info.resolution = now, self._grid.resolution
        grid.info.width, grid.info.height = self._grid.width(), self._grid.height()
        grid.info.origin.position.x, grid.info.origin.position.y, _ = self._grid.origin
        grid.info.origin.orientation.w = 1.0
        return grid


def _transform(now: rospy.Time, parent: str, child: str, at: BasePose, height: float) -> TransformStamped:
    transform = TransformStamped(child_frame_id=child)
    transform.header.stamp, transform.header.frame_id = now, parent
    translation, rotation = transform.transform.translation, transform.transform.rotation
    translation.x, translation.y, translation.z = at.x, at.y, height
    rotation.z, rotation.w = math.sin(at.yaw / 2), math.cos(at.yaw / 2)
    return transform


def main() -> int:
    """Run until standard input ends."""
    robot, ended = Robot(), threading.Event()
    moving = threading.Thread(target=robot.run, args=(ended,), name="simulation", daemon=True)
    moving.start()
    try:
        robot.reporter.write("ready")
        robot.reporter.run({})
    finally:
        ended.set()
        moving.join(2.0)
        rospy.signal_shutdown("the demo is over")
    return 0


if __name__ == "__main__":
    sys.exit(main())
