"""The sources of the robot's pose: transforms of another localizer, a topic, or a YARP port."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from bridge.hub.endpoints.calls import CallError
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.modules.host import Host
from bridge.modules.loop import Newest
from bridge.status import Part
from navigation.frames import LATE, FramesError, RobotFrames
from navigation.localization_server import estimate as estimates
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate, plane_of, pose_of, unknown
from navigation.localization_server.section import LocalizationServerSection
from navigation.maps.grid import to_grid, turned
from navigation.messages import pose_message, stamp_ns
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.pythonic import Received


class Start(NamedTuple):
    """A client's initial pose, with its uncertainty."""

    pose: Pose
    covariance: Floats | None = None  #: (3, 3) of x, y, theta: meters, radians; None for the default


def start_covariance(section: LocalizationServerSection) -> Floats:
    """Return the default covariance of an initial pose."""
    return estimates.covariance_of(section.initial_spread[0], math.radians(section.initial_spread[1]))


class PoseSource(ABC):
    """A source of the robot's pose; its methods run on the module's thread.

    A source from outside Midspan is created with the host, LocalizationServer's section (which has the source's
    ``options``), and the robot's frames on ``/tf``.
    """

    # whether the module passes on initial poses from a topic; amcl subscribes to them itself
    accepts_starts = False
    corrects = False  # whether the module publishes the source's transform from the map to the odometry frame

    @abstractmethod
    def estimate(self) -> PoseEstimate:
        """Return the current estimate, or the reason why the pose is unknown."""

    def correction(self) -> Pose | None:
        """Return the pose of the odometry frame in the map's frame, for a source that `corrects`; None if unknown."""
        return None

    def cloud(self) -> Floats:
        """Return possible poses of the robot, (n, 3): meters, radians."""
        return np.empty((0, 3))

    @abstractmethod
    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Start at a pose; covariance None is the default. Raises `RuntimeError` with the reason on failure."""

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:  # noqa: ARG002 - most sources ignore the map
        """Switch to another map; ``start`` is the pose on that map, if given. Raises `RuntimeError` on failure."""
        if start is not None:
            self.initial(*start)

    def pause(self, *, on: bool) -> None:  # noqa: B027 - optional
        """Pause or resume."""

    def on_clock_jump(self) -> None:  # noqa: B027 - optional
        """Discard data that depends on time, after the clock jumped."""

    def status(self) -> Part:
        """Return additional entries of the status document."""
        return Part()

    def close(self) -> None:  # noqa: B027 - optional
        ...


_WIDEST = 1.0
"""Above this standard deviation in meters, amcl counts as not localized. An initial pose set in rviz has 0.5 until
the robot drives."""


_AGAIN_SECONDS = 1.0
"""Time until a map is sent to amcl again after a failed call."""


class FrameSource(PoseSource):
    """The pose on /tf, for any localizer that publishes the transform from the map to the odometry frame."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        self._host, self._section, self._frames = host, section, frames
        self._covariance = estimates.covariance_of(section.usual_spread[0], math.radians(section.usual_spread[1]))
        self._known = False
        self._starts = host.node.publisher(section.initialpose, estimates.POSE_COVARIANCE, Qos(depth=1))

    @override
    def estimate(self) -> PoseEstimate:
        try:
            pose = self._frames.pose()
        except FramesError as err:
            return unknown(str(err), LocalizationStatus.ERROR if self._known else LocalizationStatus.NOT_YET)
        self._known = True
        return PoseEstimate(pose, self._covariance, 1.0, LocalizationStatus.OK, "")

    @override
    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        topic = self._section.initialpose
        if not self._host.node.hub.graph.subscriptions(topic):
            raise RuntimeError(f"no subscriber to {topic}: is the localizer running, and does a rule bridge the topic?")
        self._starts.publish(self._start_message(Start(pose, covariance)))

    @override
    def on_clock_jump(self) -> None:
        self._known = False

    def _start_message(self, start: Start) -> dict[str, Any]:
        """Return an initial pose as ``geometry_msgs/PoseWithCovarianceStamped``."""
        covariance = start_covariance(self._section) if start.covariance is None else start.covariance
        return {
            "header": {"stamp": self._host.clock.stamp(), "frame_id": self._frames.map_frame},
            "pose": {"pose": pose_message(start.pose), "covariance": estimates.spatial(covariance)},
        }


class AmclSource(FrameSource):
    """amcl's pose from /tf, since amcl publishes its topic only after resampling; the covariance from that topic."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        super().__init__(host, section, frames)
        node = host.node
        self._cloud = np.empty((0, 3))
        self._grid: MapGrid2D | None = None
        self._due: tuple[MapGrid2D, Start | None] | None = None
        self._map_trouble = ""
        self._has_map = True  # False from a change of the map until amcl accepts the new map
        self._outdated: int | None = None  # stamp of the last transform that amcl published on the previous map
        self._send_after = -math.inf  # when the map may be sent, monotonic seconds
        self._set_map = node.client(section.set_map, "nav_msgs/srv/SetMap") if section.set_map else None
        node.subscription(section.amcl_pose, estimates.POSE_COVARIANCE, self._on_pose, LATCHED)
        for topic, kind, on_message in (
            (section.particlecloud, estimates.POSES, self._on_pose_array),
            (section.particle_cloud, estimates.PARTICLES, self._on_particle_cloud),
        ):
            if topic:
                node.subscription(topic, kind, on_message, LATCHED)

    @override
    def estimate(self) -> PoseEstimate:
        if self._due is not None and time.monotonic() >= self._send_after:
            self._send_map()
        estimate = super().estimate()
        if estimate.status is not LocalizationStatus.OK:
            return estimate
        if not self._has_map:
            trouble = self._map_trouble or f"{self._section.set_map} has not answered"
            reason = f"amcl still has the previous map: {trouble}"
            return replace(estimate, status=LocalizationStatus.NOT_YET, reason=reason)
        if self._outdated is not None and self._outdated == self._correction_stamp():
            reason = "amcl has the new map, and has not published its pose on that map yet"
            return replace(estimate, status=LocalizationStatus.NOT_YET, reason=reason)
        wide = math.sqrt(max(self._covariance[0, 0], self._covariance[1, 1]))
        if wide > _WIDEST:
            reason = f"amcl's particles are spread over {wide:.1f} m (standard deviation)"
            return replace(estimate, status=LocalizationStatus.NOT_YET, reason=reason)
        return estimate

    @override
    def cloud(self) -> Floats:
        return self._cloud

    @override
    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Send amcl every map after the first, since amcl does not follow the map's topic."""
        first, self._grid = self._grid is None, grid
        if first or self._set_map is None:
            super().use_map(grid, start)
        else:
            self._due, self._has_map, self._map_trouble = (grid, start), False, ""
            self._send_map()

    @override
    def status(self) -> Part:
        return Part(set_map=self._map_trouble or ("done" if self._has_map else "waits"))

    def _correction_stamp(self) -> int | None:
        """Return the stamp of the newest transform from amcl, None if it is unknown."""
        try:
            return self._frames.correction().stamp_ns
        except FramesError:
            return None

    def _send_map(self) -> None:
        assert self._set_map is not None
        assert self._due is not None
        if not self._set_map.ready:
            self._map_trouble = f"{self._section.set_map} is not available; if amcl follows /map, set `set_map` to ''"
            return
        sent, self._due, self._map_trouble = self._due, None, ""
        grid, start = sent
        if start is None:
            try:
                start = Start(self._frames.pose())
            except FramesError:
                start = Start(Pose(0.0, 0.0, 0.0))
        self._set_map.call(
            {
                "map": to_grid(turned(grid), self._frames.map_frame, self._host.clock.now_ns()),
                "initial_pose": self._start_message(start),
            },
            lambda reply: self._on_map_set(sent, reply),
        )

    def _on_map_set(self, sent: tuple[MapGrid2D, Start | None], reply: Mapping[str, Any] | CallError) -> None:
        """Note whether amcl has the map; send it again after a failed call. A map that was replaced does not count."""
        if sent[0] is not self._grid:
            return
        if isinstance(reply, CallError):
            self._due, self._send_after = sent, time.monotonic() + _AGAIN_SECONDS
            self._map_trouble = f"{self._section.set_map}: {reply}"
        else:
            self._has_map, self._outdated = bool(reply["success"]), self._correction_stamp()
            self._map_trouble = "" if self._has_map else f"{self._section.set_map} refused the map"

    def _on_pose(self, message: dict[str, Any]) -> None:
        covariance = plane_of(message["pose"]["covariance"])
        if covariance is not None:
            self._covariance = covariance

    def _on_pose_array(self, message: dict[str, Any]) -> None:
        self._set_cloud(message["poses"])

    def _on_particle_cloud(self, message: dict[str, Any]) -> None:
        self._set_cloud([particle["pose"] for particle in message["particles"]])

    def _set_cloud(self, poses: list[dict[str, Any]]) -> None:
        try:
            self._cloud = np.array([pose_of(pose)[:3] for pose in poses]).reshape(-1, 3)
        except ValueError:
            return  # ignore a cloud with invalid poses


class ExternalSource(PoseSource):
    """The newest pose from a topic or port, updated by odometry if available; ``source`` is its name."""

    corrects = True

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames, source: str) -> None:
        self._host, self._section, self._frames, self.source = host, section, frames, source
        self._usual = estimates.covariance_of(section.usual_spread[0], math.radians(section.usual_spread[1]))
        self._covariance = self._usual
        self._pose: Pose | None = None
        self._correction: Pose | None = None
        self._received_ns = 0
        self._trouble = ""

    def set_pose(self, pose: Pose, covariance: Floats | None = None) -> None:
        """Set the pose; a pose without a stamp gets the current time."""
        now = self._host.clock.now_ns()
        if not pose.stamp_ns:
            pose = pose._replace(stamp_ns=now)
        self._pose, self._received_ns, self._trouble = pose, self._host.clock.elapsed_ns(), ""
        self._covariance = self._usual if covariance is None else covariance
        self._correction = self._correction_of(pose)

    def _correction_of(self, pose: Pose) -> Pose | None:
        """Return the correction that a pose implies; None if odometry does not cover the pose's time."""
        frames = self._frames
        try:
            then = frames.transform(frames.odom_frame, frames.base_frame, pose.stamp_ns, extrapolate=LATE)
        except FramesError:
            return None
        return pose @ then.inverse

    def refuse(self, reason: str) -> None:
        """Report an invalid pose."""
        if reason != self._trouble:
            self._host.log.warning("%s: %s", self.source, reason)
        self._trouble = reason

    @override
    def estimate(self) -> PoseEstimate:
        if self._pose is None:
            return unknown(self._trouble or f"waiting for a pose on {self.source}")
        age = (self._host.clock.elapsed_ns() - self._received_ns) / 1e9
        if age > self._section.pose_age:
            return unknown(self._trouble or f"{self.source} has been silent for {age:.1f} s", LocalizationStatus.ERROR)
        if self._correction is None:  # odometry may have arrived since
            self._correction = self._correction_of(self._pose)
        return PoseEstimate(self._now(self._pose), self._covariance, 1.0, LocalizationStatus.OK, "")

    def _now(self, pose: Pose) -> Pose:
        if self._correction is not None:
            try:
                return self._correction @ self._frames.odometry()
            except FramesError:
                pass
        return pose

    @override
    def correction(self) -> Pose | None:
        return self._correction if self.estimate().pose is not None else None

    @override
    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Raise `RuntimeError`, because the pose's publisher sets the initial pose."""
        raise RuntimeError(f"poses come from {self.source}; set the initial pose at its publisher")

    @override
    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Ignore the map: poses arrive as before."""

    @override
    def on_clock_jump(self) -> None:
        if self._host.clock.simulated:  # the robot may be elsewhere when a simulation restarts
            self.drop()

    def drop(self) -> None:
        """Discard the pose."""
        self._pose = self._correction = None


class TopicSource(ExternalSource):
    """A pose topic on any side, with one of three message types."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        super().__init__(host, section, frames, section.topic)
        node, topic, newest = host.node, section.topic, Qos(depth=1)
        node.subscription(
            topic, estimates.POSE_COVARIANCE, lambda message: self._on_message(message, message["pose"]), newest
        )
        node.subscription(topic, estimates.ODOMETRY, lambda message: self._on_message(message, message["pose"]), newest)
        node.subscription(topic, estimates.POSE_STAMPED, lambda message: self._on_message(message, message), newest)

    def _on_message(self, message: Mapping[str, Any], part: Mapping[str, Any]) -> None:
        frame = message["header"]["frame_id"].lstrip("/")
        if frame not in ("", self._frames.map_frame):
            self.refuse(f"poses are in the frame {frame!r}, not in {self._frames.map_frame!r}")
            return
        try:
            pose = pose_of(part["pose"], stamp_ns(message["header"]))
        except ValueError as err:
            self.refuse(str(err))
            return
        self.set_pose(pose, plane_of(part["covariance"]) if "covariance" in part else None)


class PortSource(ExternalSource):
    """A port to which YARP programs write poses: a Map2DLocation, or x, y and degrees."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        super().__init__(host, section, frames, section.pose_port)
        self._poses = Newest(host.loop, self._on_values)
        host.yarp.input(section.pose_port, self._queue)

    def _queue(self, received: Received) -> None:
        """Queue a pose; runs on the connection's thread."""
        self._poses.put((self._host.clock.now_ns(), list(received.values)))

    def _on_values(self, received: tuple[int, list[Any]]) -> None:
        stamp, values = received
        numbers = values[1:4] if len(values) in (4, 5) and isinstance(values[0], str) else values
        if len(numbers) != 3 or not all(isinstance(n, int | float) and math.isfinite(n) for n in numbers):
            self.refuse(f"invalid pose {values}: use a Map2DLocation, or x, y and degrees")
            return
        x, y, degrees = map(float, numbers)
        self.set_pose(Pose(x, y, math.radians(degrees), stamp))
