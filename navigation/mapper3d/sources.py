"""Clouds and depth images from the hub, which wait for the sensor's pose."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.tf.errors import TransformError
from bridge.tf.transform import LATEST, Quaternion, Transform
from navigation.clouds import POINT_CLOUD, read_points
from navigation.frames import FramesError, RobotFrames
from navigation.mapper3d.depth import CAMERA_INFO, IMAGE, Rays, read_camera, read_depth
from navigation.mapper3d.section import DepthSource, Mapper3DSection
from navigation.mapper3d.space import OPTICAL, FieldOfView, Floats, Place, SensorPose
from navigation.messages import stamp_ns
from navigation.sensor_queue import SensorQueue

_INFOS = 10  # recent CameraInfos of a camera
_WAITING = 3  # clouds or images that may wait; each may have megabytes
_DEPTH = Qos(depth=2)


class SensorReading(NamedTuple):
    """Points (n, 3) of a sensor in its frame, and its field of view if known; ``stamp`` in ns."""

    frame: str
    stamp: int
    points: NDArray[np.float32]
    view: FieldOfView | None


class SensorPoses:
    """The poses of sensors on the map, from /tf."""

    def __init__(self, host: Host, section: Mapper3DSection) -> None:
        self._frames = RobotFrames(host, section.map_frame, section.base_frame, section.odom_frame)
        self._floor = section.floor

    def pose_of(self, frame: str, stamp: int) -> SensorPose:
        """Return a frame's pose at a time (ns): odometry at that time, with the current correction of the localization.

        Raises `FramesError` if it is not known (yet).
        """
        frames = self._frames
        try:
            if frames.map_frame == frames.odom_frame:
                return _sensor_pose(frames.buffer.lookup_transform(frames.map_frame, frame, stamp))
            try:
                correction = _sensor_pose(frames.buffer.lookup_transform(frames.map_frame, frames.odom_frame, LATEST))
            except TransformError:
                return _sensor_pose(frames.buffer.lookup_transform(frames.map_frame, frame, stamp))
            moved = _sensor_pose(frames.buffer.lookup_transform(frames.odom_frame, frame, stamp))
        except TransformError as err:
            raise FramesError(f"the pose of {frame or 'a sensor without a frame_id'} is unknown: {err}") from None
        x, y, z = (correction.rotation @ moved.origin + correction.origin).tolist()
        return SensorPose(correction.rotation @ moved.rotation, (x, y, z))

    def base(self) -> Place:
        """Return the robot's current position on the floor, meters; raises `FramesError`."""
        base = self.pose_of(self._frames.base_frame, LATEST)
        x, y, z = (base.rotation @ (0.0, 0.0, self._frames.floor(self._floor)) + base.origin).tolist()
        return x, y, z


class Sources:
    """Subscribes to the sensors; ``on_reading`` gets each reading once its sensor's pose is known.

    Used only on the module's thread.
    """

    def __init__(
        self,
        host: Host,
        section: Mapper3DSection,
        poses: SensorPoses,
        on_reading: Callable[[SensorReading, SensorPose], None],
    ) -> None:
        self._clock, self._poses, self._on_reading = host.clock, poses, on_reading
        self.queue: SensorQueue[Callable[[], SensorReading]] = SensorQueue(
            self._use, limit=_WAITING, what="cloud", clock=host.clock, log=host.log
        )
        for topic in section.clouds:
            host.node.subscription(topic, POINT_CLOUD, self._on_cloud, _DEPTH)
        for source in section.depth:
            _DepthCamera(self, host, section, source)

    def _on_cloud(self, message: dict[str, Any]) -> None:
        def read() -> SensorReading:
            points = read_points(message)
            return SensorReading(message["header"]["frame_id"].lstrip("/"), self.time(message), points, None)

        self.add(read)

    def time(self, message: dict[str, Any]) -> int:
        """Return the time of a message, ns."""
        return stamp_ns(message["header"]) or self._clock.now_ns()

    def add(self, read: Callable[[], SensorReading]) -> None:
        """Add a message; ``read`` raises `FramesError` while the message has to wait; a reading is cached."""
        self.queue.add(cache(read))

    def _use(self, read: Callable[[], SensorReading]) -> None:
        reading = read()
        self._on_reading(reading, self._poses.pose_of(reading.frame, reading.stamp))


class _DepthCamera:
    """A depth camera: combines its images with the CameraInfo of the same time."""

    def __init__(self, sources: Sources, host: Host, section: Mapper3DSection, source: DepthSource) -> None:
        self._sources, self._sync_ns = sources, round(section.sync * 1e9)
        self._rays = Rays(section.pixels)
        self._infos: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_INFOS)
        host.node.subscription(source.info, CAMERA_INFO, self._on_info, Qos(depth=_INFOS))
        host.node.subscription(source.image, IMAGE, lambda message: sources.add(partial(self._read, message)), _DEPTH)

    def _on_info(self, message: dict[str, Any]) -> None:
        self._infos.append((self._sources.time(message), message))
        self._sources.queue.work()

    def _read(self, message: dict[str, Any]) -> SensorReading:
        stamp = self._sources.time(message)
        known = min(self._infos, key=lambda info: abs(info[0] - stamp), default=None)
        if known is None or abs(known[0] - stamp) > self._sync_ns:
            raise FramesError("no CameraInfo with the image's time (sync)")
        camera = read_camera(known[1])
        points = self._rays.points(read_depth(message), camera)
        return SensorReading(
            message["header"]["frame_id"].lstrip("/"), stamp, points, FieldOfView(OPTICAL, camera.view)
        )


def _sensor_pose(transform: Transform) -> SensorPose:
    return SensorPose(rotation(transform.rotation), transform.translation)


def rotation(turn: Quaternion) -> Floats:
    """Return the rotation matrix of a quaternion x, y, z, w."""
    x, y, z, w = turn
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
