"""Poses that somebody gives: on a topic, or at a YARP port."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from bridge.config.sections.localization_server import LocalizationServerSection
from bridge.hub.qos import Qos
from bridge.modules.host import Host
from bridge.modules.newest import Newest
from navigation.frames import LATE, Frames, FramesError
from navigation.localization_server.estimate import Estimate, Floats, Status, covariance_of, unknown
from navigation.localization_server.messages import (
    ODOMETRY,
    POSE_COVARIANCE,
    POSE_STAMPED,
    plane_of,
    pose_of,
    stamp_ns,
)
from navigation.localization_server.source import Source, Start
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.pythonic import Received


class Given(Source):
    """The pose that was given last, carried on by odometry where there is one.

    Args:
        host: the module's.
        section: how long a pose holds, and how sure it is.
        frames: where odometry says that the base is.
    """

    corrects = True

    def __init__(self, host: Host, section: LocalizationServerSection, frames: Frames) -> None:
        self._host, self._section, self._frames = host, section, frames
        self._usual = covariance_of(section.usual_spread[0], math.radians(section.usual_spread[1]))
        self._covariance = self._usual
        self._pose: Pose | None = None
        self._correction: Pose | None = None
        self._heard_ns = 0
        self._trouble = ""

    @property
    @abstractmethod
    def place(self) -> str:
        """Where poses come from."""

    def take(self, pose: Pose, covariance: Floats | None = None) -> None:
        """A pose of a time was given; without a time it is of now."""
        now = self._host.clock.now_ns()
        if not pose.stamp_ns:
            pose = pose._replace(stamp_ns=now)
        self._pose, self._heard_ns, self._trouble = pose, now, ""
        self._covariance = self._usual if covariance is None else covariance
        self._correction = self._corrected(pose)

    def _corrected(self, pose: Pose) -> Pose | None:
        """The odometry's frame on the map by a pose; None where odometry does not know of its time."""
        frames = self._frames
        try:
            then = frames.transform(frames.odom_frame, frames.base_frame, pose.stamp_ns, extrapolate=LATE)
        except FramesError:
            return None
        return pose @ then.inverse

    def refuse(self, why: str) -> None:
        """What was given is no pose."""
        if why != self._trouble:
            self._host.log.warning("%s: %s", self.place, why)
        self._trouble = why

    def estimate(self) -> Estimate:
        """The pose, or why there is none."""
        if self._pose is None:
            return unknown(self._trouble or f"no pose has come from {self.place}")
        age = (self._host.clock.now_ns() - self._heard_ns) / 1e9
        if age > self._section.pose_age:
            return unknown(self._trouble or f"{self.place} has been silent for {age:.1f} s", Status.ERROR)
        if self._correction is None:  # odometry may have been heard of since
            self._correction = self._corrected(self._pose)
        return Estimate(self._now(self._pose), self._covariance, 1.0, Status.OK, "")

    def _now(self, pose: Pose) -> Pose:
        if self._correction is not None:
            try:
                return self._correction @ self._frames.odometry()
            except FramesError:
                pass
        return pose

    def correction(self) -> Pose | None:
        """The odometry's frame on the map, as long as the pose holds."""
        return self._correction if self.estimate().pose is not None else None

    def initial(self, pose: Pose, covariance: Floats | None) -> None:  # noqa: ARG002 - whatever is said
        """Nobody asks us."""
        raise RuntimeError(f"where the robot is, {self.place} says; tell its publisher where it begins")

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Poses come as before: nobody asks us where it begins."""

    def forget(self) -> None:
        """The clock was set back."""
        self._pose = self._correction = None


class Topic(Given):
    """A pose topic of any side, of one of three types."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: Frames) -> None:
        super().__init__(host, section, frames)
        node, topic, newest = host.node, section.topic, Qos(depth=1)
        node.subscription(topic, POSE_COVARIANCE, lambda message: self._covered(message, message["pose"]), newest)
        node.subscription(topic, ODOMETRY, lambda message: self._covered(message, message["pose"]), newest)
        node.subscription(topic, POSE_STAMPED, lambda message: self._covered(message, message), newest)

    @property
    def place(self) -> str:
        """The topic."""
        return self._section.topic

    def _covered(self, message: Mapping[str, Any], part: Mapping[str, Any]) -> None:
        frame = message["header"]["frame_id"].lstrip("/")
        if frame not in ("", self._frames.map_frame):
            self.refuse(f"its poses are in the frame {frame!r}, not in {self._frames.map_frame!r}")
            return
        try:
            pose = pose_of(part["pose"], stamp_ns(message["header"]))
        except ValueError as err:
            self.refuse(str(err))
            return
        self.take(pose, plane_of(part["covariance"]) if "covariance" in part else None)


class Port(Given):
    """A port that YARP programs write poses to: a Map2DLocation, or x, y and degrees."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: Frames) -> None:
        super().__init__(host, section, frames)
        self._poses = Newest(host.loop, self._valued)
        host.yarp.input(section.pose_port, self._received)

    @property
    def place(self) -> str:
        """The port."""
        return self._section.pose_port

    def _received(self, received: Received) -> None:
        """On the thread of the connection."""
        self._poses.put((self._host.clock.now_ns(), list(received.values)))

    def _valued(self, said: tuple[int, list[Any]]) -> None:
        came, values = said
        numbers = values[1:4] if len(values) in (4, 5) and isinstance(values[0], str) else values
        if len(numbers) != 3 or not all(isinstance(n, int | float) and math.isfinite(n) for n in numbers):
            self.refuse(f"{values} is neither a Map2DLocation nor x, y and degrees")
            return
        x, y, degrees = map(float, numbers)
        self.take(Pose(x, y, math.radians(degrees), came))
