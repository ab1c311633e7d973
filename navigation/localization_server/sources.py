"""The sources of the robot's pose: frames that another localiser publishes, a topic, or a YARP port."""

# ruff: noqa: D102 - documented in `PoseSource`

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bridge.config.sections.localization_server import LocalizationServerSection
from bridge.hub.endpoints.calls import CallError
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.modules.host import Host
from bridge.modules.loop import Newest
from navigation.frames import LATE, FramesError, RobotFrames
from navigation.localization_server import estimate as estimates
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate, plane_of, pose_of, unknown
from navigation.maps.grid import to_grid, turned
from navigation.messages import pose_message, stamp_ns
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.pythonic import Received


class Start(NamedTuple):
    """A start pose that a client gave, with its uncertainty."""

    pose: Pose
    covariance: Floats | None = None  #: (3, 3) of x, y, theta: metres, radians; None: as sure as usual


def start_covariance(section: LocalizationServerSection) -> Floats:
    """The covariance of a start that comes without one."""
    return estimates.covariance_of(section.initial_spread[0], math.radians(section.initial_spread[1]))


class PoseSource(ABC):
    """A source of the robot's pose. On the module's thread."""

    # whether the module passes starts from a topic on; amcl subscribes to them by itself
    hears_starts = False
    corrects = False  # whether the odometry's frame on the map is to be published for it

    @abstractmethod
    def estimate(self) -> PoseEstimate:
        """Return the current estimate, or the reason why the pose is unknown."""

    def correction(self) -> Pose | None:
        """Return the odometry frame on the map if it `corrects`; None if it is unknown."""
        return None

    def cloud(self) -> Floats:
        """Return possible poses of the robot, (n, 3): meters, radians."""
        return np.empty((0, 3))

    @abstractmethod
    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Begin there; None: with the usual covariance. Raises `RuntimeError` with why it cannot."""

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:  # noqa: ARG002 - most need not know the map
        """Switch to another map; ``start``: the pose on it, if given. Raises `RuntimeError` if it cannot."""
        if start is not None:
            self.initial(*start)

    def rest(self, *, on: bool) -> None:  # noqa: B027 - most need not
        """Pause, or continue."""

    def forget(self) -> None:  # noqa: B027 - most need not
        """Discard what depends on time: the clock has jumped."""

    def status(self) -> dict[str, Any]:
        """Further entries of the status document."""
        return {}

    def close(self) -> None:  # noqa: B027 - most need not
        """End what it began by itself."""


_WIDEST = 1.0
"""Metres of amcl's standard deviation above which it is not localised. A start has 0.5, as rviz publishes
it, until the robot drives."""


class FrameSource(PoseSource):
    """Any publisher of the odometry frame on the map."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        self._host, self._section, self._frames = host, section, frames
        self._covariance = estimates.covariance_of(section.usual_spread[0], math.radians(section.usual_spread[1]))
        self._known = False
        self._starts = host.node.publisher(section.initialpose, estimates.POSE_COVARIANCE, Qos(depth=1))

    def estimate(self) -> PoseEstimate:
        try:
            pose = self._frames.pose()
        except FramesError as err:
            return unknown(str(err), LocalizationStatus.ERROR if self._known else LocalizationStatus.NOT_YET)
        self._known = True
        return PoseEstimate(pose, self._covariance, 1.0, LocalizationStatus.OK, "")

    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        topic = self._section.initialpose
        if not self._host.node.hub.graph.subscriptions(topic):
            raise RuntimeError(f"no subscriber to {topic}: is the localizer running, and does a rule bridge the topic?")
        self._starts.publish(self._start_message(Start(pose, covariance)))

    def forget(self) -> None:
        self._known = False

    def _start_message(self, start: Start) -> dict[str, Any]:
        """A start as ``geometry_msgs/PoseWithCovarianceStamped``."""
        covariance = start_covariance(self._section) if start.covariance is None else start.covariance
        return {
            "header": {"stamp": self._host.clock.stamp(), "frame_id": self._frames.map_frame},
            "pose": {"pose": pose_message(start.pose), "covariance": estimates.spatial(covariance)},
        }


class AmclSource(FrameSource):
    """amcl: the pose of the frames, for its own topic comes only as it resamples; the covariance of that topic."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        super().__init__(host, section, frames)
        node = host.node
        self._cloud = np.empty((0, 3))
        self._grid: MapGrid2D | None = None
        self._due: tuple[MapGrid2D, Start | None] | None = None
        self._map_trouble = ""
        self._set_map = node.client(section.set_map, "nav_msgs/srv/SetMap") if section.set_map else None
        node.subscription(section.amcl_pose, estimates.POSE_COVARIANCE, self._posed, LATCHED)
        for topic, kind, listed in (
            (section.particlecloud, estimates.POSES, self._clouded),
            (section.particle_cloud, estimates.PARTICLES, self._weighted),
        ):
            if topic:
                node.subscription(topic, kind, listed, LATCHED)

    def estimate(self) -> PoseEstimate:
        if self._due is not None:
            self._send_map()
        found = super().estimate()
        wide = math.sqrt(max(self._covariance[0, 0], self._covariance[1, 1]))
        if found.status is LocalizationStatus.OK and wide > _WIDEST:
            why = f"amcl's particles are {wide:.1f} m apart (standard deviation)"
            return PoseEstimate(found.pose, found.covariance, found.quality, LocalizationStatus.NOT_YET, why)
        return found

    def cloud(self) -> Floats:
        return self._cloud

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Send amcl every map after its first one: it does not follow the topic."""
        first, self._grid = self._grid is None, grid
        if first or self._set_map is None:
            super().use_map(grid, start)
        else:
            self._due = grid, start
            self._send_map()

    def status(self) -> dict[str, Any]:
        return {"set_map": self._map_trouble or ("waits" if self._due else "done")}

    def _send_map(self) -> None:
        assert self._set_map is not None
        assert self._due is not None
        if not self._set_map.ready:
            self._map_trouble = f"{self._section.set_map} is not there: amcl still has the map before"
            return
        (grid, start), self._due = self._due, None
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
            self._map_taken,
        )

    def _map_taken(self, reply: Mapping[str, Any] | CallError) -> None:
        if isinstance(reply, CallError):
            self._map_trouble = f"{self._section.set_map}: {reply}"
        else:
            self._map_trouble = "" if reply["success"] else f"{self._section.set_map} refused the map"

    def _posed(self, message: dict[str, Any]) -> None:
        found = plane_of(message["pose"]["covariance"])
        if found is not None:
            self._covariance = found

    def _clouded(self, message: dict[str, Any]) -> None:
        self._take_cloud(message["poses"])

    def _weighted(self, message: dict[str, Any]) -> None:
        self._take_cloud([one["pose"] for one in message["particles"]])

    def _take_cloud(self, poses: list[dict[str, Any]]) -> None:
        try:
            self._cloud = np.array([pose_of(pose)[:3] for pose in poses]).reshape(-1, 3)
        except ValueError:
            return  # a cloud with poses that are nowhere


class Given(PoseSource):
    """The newest pose from a topic or port, moved on by odometry if available; ``place``: that topic or port."""

    corrects = True

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames, place: str) -> None:
        self._host, self._section, self._frames, self.place = host, section, frames, place
        self._usual = estimates.covariance_of(section.usual_spread[0], math.radians(section.usual_spread[1]))
        self._covariance = self._usual
        self._pose: Pose | None = None
        self._correction: Pose | None = None
        self._heard_ns = 0
        self._trouble = ""

    def take(self, pose: Pose, covariance: Floats | None = None) -> None:
        """Accept a pose; without a stamp it is of now."""
        now = self._host.clock.now_ns()
        if not pose.stamp_ns:
            pose = pose._replace(stamp_ns=now)
        self._pose, self._heard_ns, self._trouble = pose, self._host.clock.elapsed_ns(), ""
        self._covariance = self._usual if covariance is None else covariance
        self._correction = self._corrected(pose)

    def _corrected(self, pose: Pose) -> Pose | None:
        """Return the odometry frame on the map by a pose; None if odometry does not cover its time."""
        frames = self._frames
        try:
            then = frames.transform(frames.odom_frame, frames.base_frame, pose.stamp_ns, extrapolate=LATE)
        except FramesError:
            return None
        return pose @ then.inverse

    def refuse(self, why: str) -> None:
        """Report an invalid pose."""
        if why != self._trouble:
            self._host.log.warning("%s: %s", self.place, why)
        self._trouble = why

    def estimate(self) -> PoseEstimate:
        if self._pose is None:
            return unknown(self._trouble or f"no pose has come from {self.place}")
        age = (self._host.clock.elapsed_ns() - self._heard_ns) / 1e9
        if age > self._section.pose_age:
            return unknown(self._trouble or f"{self.place} has been silent for {age:.1f} s", LocalizationStatus.ERROR)
        if self._correction is None:  # odometry may have arrived since
            self._correction = self._corrected(self._pose)
        return PoseEstimate(self._now(self._pose), self._covariance, 1.0, LocalizationStatus.OK, "")

    def _now(self, pose: Pose) -> Pose:
        if self._correction is not None:
            try:
                return self._correction @ self._frames.odometry()
            except FramesError:
                pass
        return pose

    def correction(self) -> Pose | None:
        return self._correction if self.estimate().pose is not None else None

    def initial(self, pose: Pose, covariance: Floats | None) -> None:  # noqa: ARG002 - refused in any case
        """Refuse: the poses come from elsewhere."""
        raise RuntimeError(f"poses come from {self.place}; set the start pose at its publisher")

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Ignore it: poses come as before."""

    def forget(self) -> None:
        if self._host.clock.simulated:  # the robot may be somewhere else when a simulation starts again
            self.drop()

    def drop(self) -> None:
        """Discard the pose."""
        self._pose = self._correction = None


class TopicSource(Given):
    """A pose topic of any side, of one of three types."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        super().__init__(host, section, frames, section.topic)
        node, topic, newest = host.node, section.topic, Qos(depth=1)
        node.subscription(
            topic, estimates.POSE_COVARIANCE, lambda message: self._covered(message, message["pose"]), newest
        )
        node.subscription(topic, estimates.ODOMETRY, lambda message: self._covered(message, message["pose"]), newest)
        node.subscription(topic, estimates.POSE_STAMPED, lambda message: self._covered(message, message), newest)

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


class PortSource(Given):
    """A port to which YARP programs write poses: a Map2DLocation, or x, y and degrees."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        super().__init__(host, section, frames, section.pose_port)
        self._poses = Newest(host.loop, self._valued)
        host.yarp.input(section.pose_port, self._received)

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
