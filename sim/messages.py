"""Converts the simulation's state to ROS 2 messages, and defines the names of its topics and frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bridge.messages.scan import LaserScan
from sim.base import BasePose, Encoders, Twist
from sim.depth import Depths
from sim.robot import RobotDescription
from sim.section import WHEEL_COMMAND, CameraSection
from sim.sensors import Charge

Message = dict[str, Any]
_SECOND = 1_000_000_000
_UNKNOWN = 0  # sensor_msgs/BatteryState
_DISCHARGING = 2
_LION = 2  # lithium ion
_FLOAT32 = 7  # sensor_msgs/PointField
CAMERA_FRAME, OPTICAL_FRAME = "camera_link", "camera_depth_optical_frame"
FOOTPRINT_FRAME = "base_footprint"  # the floor below the base (REP 120), the origin of heights
DEPTH, DEPTH_INFO, DEPTH_POINTS = "/camera/depth/image_rect_raw", "/camera/depth/camera_info", "/camera/depth/points"
"""Topics of the camera; these and the camera's frames are named as in the driver realsense2_camera."""
_POSE_VARIANCE = np.diag([0.01, 0.01, 1e6, 1e6, 1e6, 0.03]).ravel()
"""Typical covariance of a mobile base's odometry, which does not observe height and tilt."""


def stamp(time_ns: int) -> Message:
    """Return a builtin_interfaces/Time."""
    seconds, nanoseconds = divmod(time_ns, _SECOND)
    return {"sec": seconds, "nanosec": nanoseconds}


def header(time_ns: int, frame: str) -> Message:
    """Return a std_msgs/Header."""
    return {"stamp": stamp(time_ns), "frame_id": frame}


def turned(yaw: float) -> Message:
    """Return a geometry_msgs/Quaternion of a rotation by ``yaw`` radians about the vertical."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


def odometry(time_ns: int, pose: BasePose, twist: Twist, frame: str, child: str, *, sure: bool = False) -> Message:
    """Return a nav_msgs/Odometry; without covariances if ``sure``."""
    linear, angular = {"x": twist.x, "y": twist.y, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": twist.yaw}
    message: Message = {
        "header": header(time_ns, frame),
        "child_frame_id": child,
        "pose": {"pose": {"position": {"x": pose.x, "y": pose.y, "z": 0.0}, "orientation": turned(pose.yaw)}},
        "twist": {"twist": {"linear": linear, "angular": angular}},
    }
    if not sure:
        message["pose"]["covariance"] = message["twist"]["covariance"] = _POSE_VARIANCE
    return message


def odometry_numbers(time_ns: int, pose: BasePose, twist: Twist) -> tuple[float, ...]:
    """Return the changing numbers of `odometry`, in order: ``header.stamp``, ``pose.pose``, ``twist.twist``."""
    return (*divmod(time_ns, _SECOND), *_placed(pose), twist.x, twist.y, 0.0, 0.0, 0.0, twist.yaw)


def transform_numbers(time_ns: int, pose: BasePose) -> tuple[float, ...]:
    """Return the changing numbers of `transform`, in order: stamp and transform of a child at the same height."""
    return (*divmod(time_ns, _SECOND), *_placed(pose))


def _placed(pose: BasePose) -> tuple[float, ...]:
    return pose.x, pose.y, 0.0, 0.0, 0.0, math.sin(pose.yaw / 2), math.cos(pose.yaw / 2)


def mount(time_ns: int, base: str, laser: str, height: float, camera: CameraSection | None, middle: float) -> Message:
    """Return a tf2_msgs/TFMessage with the laser's frame and, if there is a camera, its frames and `FOOTPRINT_FRAME`.

    The base's frame is ``middle`` meters above the floor.
    """
    message = transform(time_ns, base, laser, BasePose(0.0, 0.0, 0.0), height - middle)
    if camera is not None:
        x, y, z = camera.at
        mounted = transform(time_ns, base, CAMERA_FRAME, BasePose(x, y, 0.0), z - middle)
        optical = transform(time_ns, CAMERA_FRAME, OPTICAL_FRAME, BasePose(0.0, 0.0, 0.0))
        mounted["transforms"][0]["transform"]["rotation"] = tilted(camera.yaw, camera.pitch)
        # z ahead, x to the right, y down (REP 103)
        optical["transforms"][0]["transform"]["rotation"] = {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5}
        below = transform(time_ns, base, FOOTPRINT_FRAME, BasePose(0.0, 0.0, 0.0), -middle)
        message["transforms"] += [*mounted["transforms"], *optical["transforms"], *below["transforms"]]
    return message


def tilted(yaw: float, pitch: float) -> Message:
    """Return a geometry_msgs/Quaternion: a rotation by ``yaw`` to the left, then by ``pitch`` down, in degrees."""
    c, s, cp, sp = (f(math.radians(angle) / 2) for angle in (yaw, pitch) for f in (math.cos, math.sin))
    return {"x": -s * sp, "y": c * sp, "z": s * cp, "w": c * cp}


def depth(time_ns: int, seen: Depths, encoding: str) -> Message:
    """Return a sensor_msgs/Image of depths, in meters (REP 118).

    With the encoding 16UC1, depths are in millimeters and 0 means no value, as in the D435's driver.
    """
    height, width = seen.shape
    if encoding == "16UC1":
        with np.errstate(invalid="ignore"):
            seen = np.where(np.isfinite(seen), np.minimum(np.round(seen * 1000.0), 65535), 0).astype(np.uint16)
    return {
        "header": header(time_ns, OPTICAL_FRAME),
        "height": height,
        "width": width,
        "encoding": encoding,
        "step": width * seen.itemsize,
        "data": seen.view(np.uint8).ravel(),
    }


def camera_info(time_ns: int, lens: tuple[float, float, float, float], width: int, height: int) -> Message:
    """Return a sensor_msgs/CameraInfo without distortion."""
    fx, fy, cx, cy = lens
    return {
        "header": header(time_ns, OPTICAL_FRAME),
        "height": height,
        "width": width,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


def points(time_ns: int, cloud: Depths) -> Message:
    """Return a sensor_msgs/PointCloud2 of (height, width, 3) points, meters; missing points are not finite."""
    height, width, _ = cloud.shape
    return {
        "header": header(time_ns, OPTICAL_FRAME),
        "height": height,
        "width": width,
        "fields": [{"name": n, "offset": 4 * i, "datatype": _FLOAT32, "count": 1} for i, n in enumerate("xyz")],
        "point_step": 12,
        "row_step": 12 * width,
        "data": cloud.view(np.uint8).ravel(),
    }


def transform(time_ns: int, parent: str, child: str, pose: BasePose, height: float = 0.0) -> Message:
    """Return a tf2_msgs/TFMessage of one transform."""
    translation = {"x": pose.x, "y": pose.y, "z": height}
    stamped = {
        "header": header(time_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": translation, "rotation": turned(pose.yaw)},
    }
    return {"transforms": [stamped]}


def joints(time_ns: int, names: tuple[str, ...], encoders: Encoders) -> Message:
    """Return a sensor_msgs/JointState of the wheels."""
    return {
        "header": header(time_ns, ""),
        "name": list(names),
        "position": encoders.positions,
        "velocity": encoders.velocities,
    }


def joint_numbers(time_ns: int, encoders: Encoders) -> tuple[float, ...]:
    """Return the changing numbers of `joints`, in order: ``header.stamp``, ``position``, ``velocity``."""
    return (*divmod(time_ns, _SECOND), *encoders.positions.tolist(), *encoders.velocities.tolist())


def scan(time_ns: int, laser_scan: LaserScan, frame: str, rate: float) -> Message:
    """Return a sensor_msgs/LaserScan, whose beams all have the same time."""
    return {
        "header": header(time_ns, frame),
        "angle_min": laser_scan.first,
        "angle_max": laser_scan.first + (len(laser_scan.ranges) - 1) * laser_scan.step,
        "angle_increment": laser_scan.step,
        "scan_time": 1.0 / rate,
        "range_min": laser_scan.nearest,
        "range_max": laser_scan.farthest,
        "ranges": laser_scan.ranges.astype("<f4"),
    }


def battery(time_ns: int, charge: Charge) -> Message:
    """Return a sensor_msgs/BatteryState."""
    return {
        "header": header(time_ns, ""),
        "voltage": charge.voltage,
        "temperature": math.nan,
        "current": charge.current,
        "charge": charge.share * charge.capacity,
        "capacity": charge.capacity,
        "design_capacity": charge.capacity,
        "percentage": charge.share,
        "power_supply_status": _DISCHARGING,
        "power_supply_health": _UNKNOWN,
        "power_supply_technology": _LION,
        "present": True,
    }


def image(time_ns: int, picture: np.ndarray) -> Message:
    """Return a sensor_msgs/Image of (height, width, 3) bytes."""
    height, width, _ = picture.shape
    return {
        "header": header(time_ns, "map"),
        "height": height,
        "width": width,
        "encoding": "rgb8",
        "step": width * 3,
        "data": np.ascontiguousarray(picture).ravel(),
    }


def velocity(message: Message) -> Twist:
    """Return the velocity of a geometry_msgs/Twist."""
    return Twist(message["linear"]["x"], message["linear"]["y"], message["angular"]["z"])


@dataclass(frozen=True)
class TopicNames:
    """The names of the simulator's topics and frames."""

    scan: str = "/scan"
    odometry: str = "/odom"
    battery: str = "/battery_state"
    joints: str = "/joint_states"
    truth: str = "/ground_truth"
    bumper: str = "/bumper"
    view: str = "/sim/view"
    velocity: str = "/cmd_vel"
    wheels: str = WHEEL_COMMAND
    odom_frame: str = "odom"
    map_frame: str = "map"
    base_frame: str = "base_link"
    laser_frame: str = "laser"


def names_of(kind: str, robot: RobotDescription) -> TopicNames:
    """Return the names for the configuration's ``sim.names``."""
    if kind == "usual":
        return TopicNames()
    return TopicNames(
        scan="/laser",
        odometry="/odometry",
        battery="/battery_status",
        base_frame=robot.frames.base,
        laser_frame=robot.frames.laser,
    )
