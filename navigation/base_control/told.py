"""What a base tells of its way: topics, ``/tf`` and ports."""

from __future__ import annotations

import math

from bridge.config.sections.base_control import BaseControlSection
from bridge.modules.host import Host
from navigation.base_control.odometry import Travelled
from navigation.base_control.settings import Settings
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.os.stamp import Stamp
from yarp_compat.sig.vector import Vector

ODOMETRY, TF = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"

_POSE_VARIANCE = 1e-3
_UNKNOWN = 1e6
"""Variances of what encoders cannot tell (height, roll, pitch), as ROS's planar drivers state them."""

_COVARIANCE = [
    (_POSE_VARIANCE if row in (0, 1, 5) else _UNKNOWN) if row == column else 0.0
    for row in range(6)
    for column in range(6)
]


class Told:
    """Tells each reading of the encoders.

    As `nav_msgs/Odometry` and on ``/tf``; by the ports of ``odometry2D_nws_yarp``, and of ``baseControl`` before 2022.

    Args:
        host: gives the ends.
        section: names them.
        settings: name the frames.
    """

    def __init__(self, host: Host, section: BaseControlSection, settings: Settings) -> None:
        self._frames = settings.odom_frame, settings.base_frame
        self._odom = host.node.publisher(settings.odom, ODOMETRY)
        self._tf = host.node.publisher("/tf", TF) if section.publish_tf else None
        names = dict.fromkeys((section.odometry, section.prefix))
        self._poses = [host.yarp.output(f"{name}/odometry:o") for name in names]
        self._odometers = [host.yarp.output(f"{name}/odometer:o") for name in names]
        self._velocities = [host.yarp.output(f"{name}/velocity:o") for name in names]
        self._vector = host.yarp.output(f"{section.prefix}/odometry_vector:o")
        self._stamp = Stamp()

    def tell(self, found: Travelled, stamp: dict[str, int]) -> None:
        """Tell where the base is, at this stamp of its encoders."""
        theta = math.remainder(found.theta, 2.0 * math.pi)
        rotation = {"x": 0.0, "y": 0.0, "z": math.sin(theta / 2.0), "w": math.cos(theta / 2.0)}
        header = {"stamp": stamp, "frame_id": self._frames[0]}
        self._odom.publish({
            "header": header,
            "child_frame_id": self._frames[1],
            "pose": {
                "pose": {"position": {"x": found.x, "y": found.y, "z": 0.0}, "orientation": rotation},
                "covariance": _COVARIANCE,
            },
            "twist": {
                "twist": {
                    "linear": {"x": found.velocity.x, "y": found.velocity.y, "z": 0.0},
                    "angular": {"x": 0.0, "y": 0.0, "z": found.velocity.turn},
                },
                "covariance": _COVARIANCE,
            },
        })  # fmt: skip
        if self._tf is not None:
            translation = {"x": found.x, "y": found.y, "z": 0.0}
            transform = {"translation": translation, "rotation": rotation}
            self._tf.publish(
                {"transforms": [{"header": header, "child_frame_id": self._frames[1], "transform": transform}]}
            )
        self._write(found, theta, stamp)

    def _write(self, found: Travelled, theta: float, stamp: dict[str, int]) -> None:
        ports = [*self._poses, *self._odometers, *self._velocities, self._vector]
        if not any(port.heard for port in ports):
            return
        self._stamp.update(stamp["sec"] + stamp["nanosec"] / 1e9)
        envelope = self._stamp.to_text()
        vx, vy = found.world_velocity
        turn = math.degrees(found.velocity.turn)
        data = OdometryData(
            found.x, found.y, math.degrees(theta), found.velocity.x, found.velocity.y, turn, vx, vy, turn
        )
        for port in self._poses:
            port.write(data, envelope)
        for port in self._odometers:
            port.write([found.distance, math.degrees(found.angle)], envelope)
        for port in self._velocities:
            port.write([found.velocity.speed, turn], envelope)
        self._vector.write(Vector([found.x, found.y, math.degrees(theta)]), envelope)
