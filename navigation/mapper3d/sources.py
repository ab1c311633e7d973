"""Clouds and depth images of the hub, until it is known where they were made."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.config.sections.mapper3d import DepthSource, Mapper3DSection
from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.tf.errors import TransformError
from bridge.tf.transform import LATEST, Quaternion, Transform
from navigation.clouds import POINT_CLOUD, read_points
from navigation.frames import FramesError, RobotFrames
from navigation.mapper3d.depth import CAMERA_INFO, IMAGE, Rays, read_camera, read_depth
from navigation.mapper3d.space import OPTICAL, FieldOfView, Floats, Place, Seat
from navigation.messages import stamp_ns

_INFOS = 10  # of a camera, that may be of an image that comes
_WAITING = 3  # clouds or images that may wait: each may have megabytes
_PATIENCE_NS = 1_000_000_000
_DEPTH = Qos(depth=2)


class Seen(NamedTuple):
    """What a sensor saw: points (n, 3) in its frame, and at what it looked, if that is known; ``stamp``: ns."""

    frame: str
    stamp: int
    points: NDArray[np.float32]
    view: FieldOfView | None


@dataclass
class _Waiting:
    """A message that waits; ``came``: ns of the run's clock. ``read`` gives None where it must wait on."""

    came: int
    read: Callable[[], Seen | None]
    seen: Seen | None = None
    why: str = "it came faster than it could be taken"


class Seats:
    """Where sensors were on the map, by the frames of all sides."""

    def __init__(self, host: Host, section: Mapper3DSection) -> None:
        self._frames = RobotFrames(host, section.map_frame, section.base_frame, section.odom_frame)
        self._floor = section.floor

    def at(self, frame: str, stamp: int) -> Seat:
        """Where a frame was at a time (ns): odometry then, in what localisation says of the odometry's frame now.

        Raises `FramesError` where that is not known, or not yet.
        """
        frames = self._frames
        try:
            if frames.map_frame == frames.odom_frame:
                return _seat(frames.buffer.lookup_transform(frames.map_frame, frame, stamp))
            try:
                correction = _seat(frames.buffer.lookup_transform(frames.map_frame, frames.odom_frame, LATEST))
            except TransformError:
                return _seat(frames.buffer.lookup_transform(frames.map_frame, frame, stamp))
            moved = _seat(frames.buffer.lookup_transform(frames.odom_frame, frame, stamp))
        except TransformError as err:
            raise FramesError(f"it is not known where {frame or 'a sensor without a frame_id'} is: {err}") from None
        x, y, z = (correction.turn @ moved.origin + correction.origin).tolist()
        return Seat(correction.turn @ moved.turn, (x, y, z))

    def base(self) -> Place:
        """Where the robot stands on the floor now, metres; raises `FramesError`."""
        at = self.at(self._frames.base_frame, LATEST)
        x, y, z = (at.turn @ (0.0, 0.0, self._frames.floor(self._floor)) + at.origin).tolist()
        return x, y, z


class Sources:
    """Hears the sensors, and gives out what they saw once all that belongs to it is there. On the module's thread."""

    def __init__(self, host: Host, section: Mapper3DSection, seats: Seats, take: Callable[[Seen, Seat], None]) -> None:
        self._host, self._section, self._seats, self._take = host, section, seats, take
        self._waiting: deque[_Waiting] = deque()
        self.heard: int | None = None
        self.dropped, self.trouble = 0, ""
        for topic in section.clouds:
            host.node.subscription(topic, POINT_CLOUD, self._hear_cloud, _DEPTH)
        for source in section.depth:
            _Depth(self, host, section, source)

    def _hear_cloud(self, message: dict[str, Any]) -> None:
        def read() -> Seen:
            points = read_points(message)
            return Seen(message["header"]["frame_id"].lstrip("/"), self.time(message), points, None)

        self.put(read)

    def time(self, message: dict[str, Any]) -> int:
        """When a message was made, ns."""
        return stamp_ns(message["header"]) or self._host.clock.now_ns()

    def put(self, read: Callable[[], Seen | None]) -> None:
        """Take a message as soon as it can be read, and it is known where it was made."""
        self.heard = now = self._host.clock.now_ns()
        if len(self._waiting) == _WAITING:
            self._drop(self._waiting.popleft().why)
        self._waiting.append(_Waiting(now, read))
        self.work()

    def work(self) -> None:
        """Take what can be taken by now, and drop what waited for too long."""
        now, self._waiting, waiting = self._host.clock.now_ns(), deque(), self._waiting
        for each in waiting:
            each.why = "no CameraInfo of its time came (sync)"
            try:
                each.seen = seen = each.seen or each.read()
                if seen is not None:
                    self._take(seen, self._seats.at(seen.frame, seen.stamp))
                    self.trouble = ""
                    continue
            except FramesError as err:
                each.why = str(err)
            except ValueError as err:
                self._drop(str(err))
                continue
            if 0 <= now - each.came < _PATIENCE_NS:
                self._waiting.append(each)
            else:
                self._drop(each.why)

    def forget(self) -> None:
        """Forget what waits: the clock was set back."""
        self._waiting.clear()
        self.heard = None

    def _drop(self, why: str) -> None:
        self.dropped += 1
        if why != self.trouble:
            self._host.log.warning("a cloud is left out: %s", why)
        self.trouble = why


class _Depth:
    """One depth camera."""

    def __init__(self, sources: Sources, host: Host, section: Mapper3DSection, source: DepthSource) -> None:
        self._sources, self._sync_ns = sources, round(section.sync * 1e9)
        self._rays = Rays(section.pixels)
        self._infos: deque[tuple[int, dict[str, Any]]] = deque(maxlen=_INFOS)
        host.node.subscription(source.info, CAMERA_INFO, self._hear_info, Qos(depth=_INFOS))
        host.node.subscription(source.image, IMAGE, lambda message: sources.put(partial(self._read, message)), _DEPTH)

    def _hear_info(self, message: dict[str, Any]) -> None:
        self._infos.append((self._sources.time(message), message))
        self._sources.work()

    def _read(self, message: dict[str, Any]) -> Seen | None:
        stamp = self._sources.time(message)
        known = min(self._infos, key=lambda info: abs(info[0] - stamp), default=None)
        if known is None or abs(known[0] - stamp) > self._sync_ns:
            return None
        camera = read_camera(known[1])
        points = self._rays.points(read_depth(message), camera)
        return Seen(message["header"]["frame_id"].lstrip("/"), stamp, points, FieldOfView(OPTICAL, camera.view))


def _seat(transform: Transform) -> Seat:
    return Seat(rotation(transform.rotation), transform.translation)


def rotation(turn: Quaternion) -> Floats:
    """(3, 3) of a quaternion x, y, z, w."""
    x, y, z, w = turn
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
