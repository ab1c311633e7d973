"""The pose from another server of ILocalization2D on YARP."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from typing_extensions import override

from bridge.modules.host import Host
from navigation.frames import RobotFrames
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate
from navigation.localization_server.section import LocalizationServerSection
from navigation.localization_server.sources import ExternalSource, PoseSource, Start, start_covariance
from navigation.pose import Pose
from navigation.yarp import PolledServer
from yarp_compat.dev.localization2d import ILocalization2DMsgs
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.matrix import Matrix

_STATUS = "localization_status_"
_PLANE = (3, 3)


class YarpLocalizerClient(PolledServer[ILocalization2DMsgs], ExternalSource):
    """A client of another localization server, which forwards the server's pose if that is on the current map."""

    accepts_starts = True

    def __init__(
        self, host: Host, section: LocalizationServerSection, frames: RobotFrames, map_name: Callable[[], str]
    ) -> None:
        ExternalSource.__init__(self, host, section, frames, f"{section.server}/rpc")
        self._map_name, self._map = map_name, ""
        self._particles = np.empty((0, 3))
        self._server_status = LocalizationStatus.NOT_YET
        self._post = host.loop.post
        self._pending_start: tuple[Map2DLocation, Matrix] | None = None
        self._connected = False
        super().__init__(ILocalization2DMsgs, self.source, host.yarp.naming, "midspan-other-localizer")

    @override
    def estimate(self) -> PoseEstimate:
        """Return the server's last pose, with the server's status if that is worse."""
        estimate = super().estimate()
        if estimate.status is LocalizationStatus.OK and self._server_status is not LocalizationStatus.OK:
            reason = f"{self.source} reports {self._server_status.value}"
            return PoseEstimate(estimate.pose, estimate.covariance, estimate.quality, self._server_status, reason)
        return estimate

    @override
    def cloud(self) -> Floats:
        return self._particles

    @override
    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Have the polling thread send the initial pose; raises `RuntimeError` if the server is unavailable."""
        if not self._connected:
            raise RuntimeError(f"{self.source} is not available; start the localization server")
        location = Map2DLocation(self._map_name(), pose.x, pose.y, math.degrees(pose.theta))
        if covariance is None:
            covariance = start_covariance(self._section)
        with self._lock:
            self._pending_start = location, Matrix(covariance)
            self._lock.notify()

    @override
    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Discard the last pose, which was on the previous map."""
        if grid.name != self._map:
            self.drop()
        self._map = grid.name
        PoseSource.use_map(self, grid, start)

    def _accept(self, location: Map2DLocation, covariance: Floats | None) -> None:
        """Accept a pose if it is on the current map; otherwise report the mismatch."""
        if self._is_on_another_map(location):
            self.drop()
            self.refuse(
                f"{self.source} localizes the robot on the map {location.map_id!r}, not on {self._map_name()!r},"
                " the current map; change one of them (/change_map, setInitialPose)"
            )
            return
        self.set_pose(Pose(location.x, location.y, math.radians(location.theta)), covariance)

    def _set_cloud(self, locations: list[Map2DLocation]) -> None:
        poses = [
            (location.x, location.y, math.radians(location.theta))
            for location in locations
            if not self._is_on_another_map(location)
        ]
        self._particles = np.array(poses).reshape(-1, 3)

    def _is_on_another_map(self, location: Map2DLocation) -> bool:
        """Whether a location is on another map of the store; a map from a topic has no name to compare."""
        current = self._map_name() if self._section.map in (None, "store") else ""
        return bool(current and location.map_id) and location.map_id != current

    # on the polling thread

    @override
    def _on_unreachable(self, reason: str) -> None:
        self._report(f"{self.source}: {reason}")
        with self._lock:
            # an old initial pose would be wrong when the server is back
            self._connected, self._pending_start = False, None

    def _report(self, reason: str) -> None:
        self._post(lambda: self.refuse(reason))

    @override
    def _follow(self, remote: ILocalization2DMsgs) -> None:
        self._connected = True
        cloud_interval = max(1, round(self._section.particles_period / self._section.period))
        polls = 0
        while not self._closed:
            with self._lock:
                start, self._pending_start = self._pending_start, None
            if start is not None and not remote.set_initial_pose2_RPC(*start):
                self._report(f"{self.source} refused the initial pose; check that it is on the server's map")
            self._poll_pose(remote, cloud=polls % cloud_interval == 0)
            polls += 1
            with self._lock:
                self._lock.wait_for(lambda: self._closed or self._pending_start is not None, self._section.period)

    def _poll_pose(self, remote: ILocalization2DMsgs, *, cloud: bool) -> None:
        outcome, status = remote.get_localization_status_RPC()
        server_status = LocalizationStatus(status.name.removeprefix(_STATUS)) if outcome else LocalizationStatus.ERROR
        self._post(lambda: setattr(self, "_server_status", server_status))
        outcome, location, covariance = remote.get_current_position2_RPC()
        matrix = covariance.numpy() if outcome else np.zeros((0, 0))
        if not matrix.size:  # without a covariance, servers of YARP up to 4.0 omit the location as well
            outcome, location = remote.get_current_position1_RPC()
        if outcome and math.isfinite(location.x + location.y + location.theta):
            usable = matrix.shape == _PLANE and np.isfinite(matrix).all() and matrix.any()
            self._post(lambda: self._accept(location, matrix if usable else None))
        if cloud:
            outcome, locations = remote.get_estimated_poses_RPC()
            if outcome:
                self._post(lambda: self._set_cloud(locations))
