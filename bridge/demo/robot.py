"""A ROS 1 robot in one program: scan, odometry, tf, map and camera of a small simulation that obeys ``/cmd_vel``.

Runs on the Python that ROS 1 is installed for: ``python3 -m bridge.demo.robot`` with a ROS master in ROS_MASTER_URI.
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

from bridge.demo import camera, topics, wording
from bridge.demo.base import Base
from bridge.demo.floor_plan import RESOLUTION, FloorPlan
from bridge.demo.report import Voice

_LASER_REACH = 8.0


class Robot:
    """The simulation and its ROS 1 endpoints."""

    def __init__(self) -> None:
        self._plan = FloorPlan()
        self._base = Base(lambda x, y: not self._plan.occupied(x, y))
        self._lock = threading.Lock()
        self._angles = [-math.pi + i * math.tau / topics.BEAMS for i in range(topics.BEAMS)]
        self._hellos = 0
        self._map_text = wording.grid_text(*self._plan.size, self._plan.occupancy())
        self.voice = Voice(self._state)
        rospy.init_node("robot", disable_signals=True)
        self._scan = rospy.Publisher(topics.SCAN, LaserScan, queue_size=5)
        self._odom = rospy.Publisher(topics.ODOM, Odometry, queue_size=10)
        self._tf = rospy.Publisher(topics.TF, TFMessage, queue_size=10)
        self._tf_static = rospy.Publisher(topics.TF_STATIC, TFMessage, queue_size=1, latch=True)
        self._map = rospy.Publisher(topics.MAP, OccupancyGrid, queue_size=1, latch=True)
        self._image = rospy.Publisher(topics.IMAGE, Image, queue_size=2)
        self._hello = rospy.Publisher(topics.FROM_ROS1, String, queue_size=5)
        rospy.Subscriber(topics.CMD_VEL, Twist, self._obey, queue_size=1, tcp_nodelay=True)
        for topic in topics.HELLOS:
            rospy.Subscriber(topic, String, self._listen, callback_args=topic, queue_size=20)

    def run(self, ended: threading.Event) -> None:
        """Publish and move until the event is set."""
        self._tf_static.publish(TFMessage(self._mounts(rospy.Time.now())))
        self._map.publish(self._map_message(rospy.Time.now()))
        period = 1 / topics.BASE_RATE
        tick, due = 0, time.monotonic()
        while not ended.wait(max(0.0, due - time.monotonic())):
            due = max(due + period, time.monotonic() - 5 * period)
            with self._lock:
                self._base.step(period, time.monotonic())
                x, y, yaw = self._base.x, self._base.y, self._base.yaw
            self._publish(tick, x, y, yaw)
            tick += 1

    def _publish(self, tick: int, x: float, y: float, yaw: float) -> None:
        now = rospy.Time.now()
        self._publish_odometry(now, x, y, yaw)
        if tick % round(topics.BASE_RATE / topics.SCAN_RATE) == 0:
            self._publish_scan(now, x, y, yaw)
        if tick % round(topics.BASE_RATE / topics.IMAGE_RATE) == 0:
            self._publish_image(now, camera.picture(self._plan, x, y, yaw))
        if tick % round(topics.BASE_RATE / topics.HELLO_RATE) == 0:
            self._hellos += 1
            self._hello.publish(String(f"hello {self._hellos} from ROS 1"))

    def _state(self) -> dict[str, Any]:
        with self._lock:
            base = self._base
            return {
                "pose": [base.x, base.y, base.yaw],
                "velocity": [base.linear, base.angular],
                "time": base.now,
                "map": self._map_text,
            }

    def _obey(self, command: Twist) -> None:
        with self._lock:
            self._base.command(command.linear.x, command.angular.z, time.monotonic())
        self.voice.ear(topics.CMD_VEL).hear(None, f"{command.linear.x:.2f} m/s, {command.angular.z:.2f} rad/s")

    def _listen(self, message: String, topic: str) -> None:
        self.voice.ear(topic).hear(message.data, message.data)

    def _publish_odometry(self, now: rospy.Time, x: float, y: float, yaw: float) -> None:
        odom = Odometry(child_frame_id="base_link")
        odom.header.stamp, odom.header.frame_id = now, "odom"
        odom.pose.pose.position.x, odom.pose.pose.position.y = x, y
        odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        odom.twist.twist.linear.x, odom.twist.twist.angular.z = self._base.linear, self._base.angular
        self._odom.publish(odom)
        self._tf.publish(TFMessage([_transform(now, "odom", "base_link", x, y, 0.0, yaw)]))

    def _publish_scan(self, now: rospy.Time, x: float, y: float, yaw: float) -> None:
        scan = LaserScan(angle_min=-math.pi, angle_increment=math.tau / topics.BEAMS, range_min=0.05)
        scan.header.stamp, scan.header.frame_id = now, "laser"
        scan.angle_max = scan.angle_min + (topics.BEAMS - 1) * scan.angle_increment
        scan.scan_time, scan.range_max = 1 / topics.SCAN_RATE, _LASER_REACH
        scan.ranges = [self._plan.cast(x, y, yaw + angle, _LASER_REACH) for angle in self._angles]
        self._scan.publish(scan)

    def _publish_image(self, now: rospy.Time, picture: bytes) -> None:
        image = Image(width=camera.WIDTH, height=camera.HEIGHT, encoding="rgb8", step=3 * camera.WIDTH, data=picture)
        image.header.stamp, image.header.frame_id = now, "camera"
        self._image.publish(image)

    def _map_message(self, now: rospy.Time) -> OccupancyGrid:
        grid = OccupancyGrid(data=list(self._plan.occupancy()))
        grid.header.stamp, grid.header.frame_id = now, "map"
        grid.info.map_load_time, grid.info.resolution = now, RESOLUTION
        grid.info.width, grid.info.height = self._plan.size
        grid.info.origin.position.x, grid.info.origin.position.y = self._plan.origin
        grid.info.origin.orientation.w = 1.0
        return grid

    @staticmethod
    def _mounts(now: rospy.Time) -> list[TransformStamped]:
        return [
            _transform(now, "map", "odom", 0.0, 0.0, 0.0, 0.0),
            _transform(now, "base_link", "laser", 0.1, 0.0, 0.2, 0.0),
            _transform(now, "base_link", "camera", 0.15, 0.0, 0.6, 0.0),
        ]


def _transform(now: rospy.Time, parent: str, child: str, x: float, y: float, z: float, yaw: float) -> TransformStamped:
    transform = TransformStamped(child_frame_id=child)
    transform.header.stamp, transform.header.frame_id = now, parent
    translation, rotation = transform.transform.translation, transform.transform.rotation
    translation.x, translation.y, translation.z = x, y, z
    rotation.z, rotation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return transform


def main() -> int:
    """Run until the standard input ends."""
    robot, ended = Robot(), threading.Event()
    simulation = threading.Thread(target=robot.run, args=(ended,), name="simulation", daemon=True)
    simulation.start()
    try:
        robot.voice.tell("ready")
        robot.voice.attend({})
    finally:
        ended.set()
        simulation.join(2.0)
        rospy.signal_shutdown("the demo is over")
    return 0


if __name__ == "__main__":
    sys.exit(main())
