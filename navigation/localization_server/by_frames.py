"""Localisers that publish the odometry's frame on the map: amcl of ROS 1 and ROS 2, and all others that do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.config.sections.localization_server import LocalizationServerSection
from bridge.hub.call import CallError
from bridge.hub.qos import Durability, Qos
from bridge.modules.host import Host
from navigation.frames import Frames, FramesError
from navigation.localization_server.estimate import Estimate, Floats, Status, covariance_of, unknown
from navigation.localization_server.messages import (
    PARTICLES,
    POSE_COVARIANCE,
    POSES,
    plane_of,
    pose_of,
    spatial,
)
from navigation.localization_server.source import Source, Start
from navigation.maps.grid import to_grid
from navigation.maps.turned import turned
from navigation.messages import pose_message
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_WIDEST = 1.0
"""Metres of amcl's standard deviation above which it does not know where the robot is. A start has 0.5, as rviz tells
it, until the robot drives."""


class ByFrames(Source):
    """Whoever publishes the odometry's frame on the map.

    Args:
        host: the module's.
        section: the frames, and how sure a pose is.
        frames: where the robot is.
    """

    def __init__(self, host: Host, section: LocalizationServerSection, frames: Frames) -> None:
        self._host, self._section, self._frames = host, section, frames
        self._covariance = covariance_of(section.usual_spread[0], math.radians(section.usual_spread[1]))
        self._known = False
        self._starts = host.node.publisher(section.initialpose, POSE_COVARIANCE, Qos(depth=1))

    def estimate(self) -> Estimate:
        """The pose of the frames: it is newer than any topic's."""
        try:
            pose = self._frames.pose()
        except FramesError as err:
            return unknown(str(err), Status.ERROR if self._known else Status.NOT_YET)
        self._known = True
        return Estimate(pose, self._covariance, 1.0, Status.OK, "")

    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Tell the start on the topic that such localisers hear."""
        topic = self._section.initialpose
        if not self._host.node.hub.graph.subscriptions(topic):
            raise RuntimeError(f"nobody hears {topic}: is the localiser there, and does a rule let it cross?")
        self._starts.publish(self._start_message(Start(pose, covariance)))

    def forget(self) -> None:
        """The clock was set back."""
        self._known = False

    def _start_message(self, start: Start) -> dict[str, Any]:
        """A start as ``geometry_msgs/PoseWithCovarianceStamped``."""
        covariance = start.covariance
        if covariance is None:
            metres, degrees = self._section.initial_spread
            covariance = covariance_of(metres, math.radians(degrees))
        return {
            "header": {"stamp": self._host.clock.stamp(), "frame_id": self._frames.map_frame},
            "pose": {"pose": pose_message(start.pose), "covariance": spatial(covariance)},
        }


class Amcl(ByFrames):
    """amcl: the pose of the frames, for its own topic comes only as it resamples; the covariance of that topic."""

    def __init__(self, host: Host, section: LocalizationServerSection, frames: Frames) -> None:
        super().__init__(host, section, frames)
        node = host.node
        self._cloud = np.empty((0, 3))
        self._grid: MapGrid2D | None = None
        self._due: tuple[MapGrid2D, Start | None] | None = None
        self._map_trouble = ""
        self._set_map = node.client(section.set_map, "nav_msgs/srv/SetMap") if section.set_map else None
        node.subscription(section.amcl_pose, POSE_COVARIANCE, self._posed, _LATCHED)
        for topic, kind, listed in (
            (section.particlecloud, POSES, self._clouded),
            (section.particle_cloud, PARTICLES, self._weighted),
        ):
            if topic:
                node.subscription(topic, kind, listed, _LATCHED)

    def estimate(self) -> Estimate:
        """The pose of the frames, as sure as amcl said last."""
        if self._due is not None:
            self._send_map()
        found = super().estimate()
        wide = math.sqrt(max(self._covariance[0, 0], self._covariance[1, 1]))
        if found.status is Status.OK and wide > _WIDEST:
            why = f"amcl's particles are {wide:.1f} m apart (standard deviation)"
            return Estimate(found.pose, found.covariance, found.quality, Status.NOT_YET, why)
        return found

    def cloud(self) -> Floats:
        """The particles that amcl told last."""
        return self._cloud

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Have amcl take a map that came after its first one: it does not follow the topic."""
        first, self._grid = self._grid is None, grid
        if first or self._set_map is None:
            super().use_map(grid, start)
        else:
            self._due = grid, start
            self._send_map()

    def status(self) -> dict[str, Any]:
        """Whether it has the map."""
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
