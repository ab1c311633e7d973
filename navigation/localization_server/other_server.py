"""Another server of ILocalization2D on YARP."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bridge.config.sections.localization_server import LocalizationServerSection
from bridge.modules.host import Host
from navigation.frames import RobotFrames
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate
from navigation.localization_server.sources import Given, PoseSource, Start, start_covariance
from navigation.pose import Pose
from navigation.yarp import PolledServer
from yarp_compat.dev.localization2d import ILocalization2DMsgs
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.matrix import Matrix

_STATUS = "localization_status_"
_PLANE = (3, 3)


class OtherServer(PolledServer[ILocalization2DMsgs], Given):
    """Gives on what another server says of the map that is in use here."""

    hears_starts = True

    def __init__(
        self, host: Host, section: LocalizationServerSection, frames: RobotFrames, map_name: Callable[[], str]
    ) -> None:
        Given.__init__(self, host, section, frames, f"{section.server}/rpc")
        self._map_name, self._map = map_name, ""
        self._particles = np.empty((0, 3))
        self._theirs = LocalizationStatus.NOT_YET
        self._post = host.loop.post
        self._wanted: tuple[Map2DLocation, Matrix] | None = None
        self._there = False
        super().__init__(ILocalization2DMsgs, self.place, host.yarp.naming, "midspan-other-localiser")

    def estimate(self) -> PoseEstimate:
        """What it said last."""
        found = super().estimate()
        if found.status is LocalizationStatus.OK and self._theirs is not LocalizationStatus.OK:
            why = f"{self.place} says {self._theirs.value}"
            return PoseEstimate(found.pose, found.covariance, found.quality, self._theirs, why)
        return found

    def cloud(self) -> Floats:
        """Its particles."""
        return self._particles

    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Send it the start, once it has answered the last question."""
        if not self._there:
            raise RuntimeError(f"{self.place} is not there")
        place = Map2DLocation(self._map_name(), pose.x, pose.y, math.degrees(pose.theta))
        if covariance is None:
            covariance = start_covariance(self._section)
        with self._lock:
            self._wanted = place, Matrix(covariance)
            self._lock.notify()

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """What it said before was of the map before."""
        if grid.name != self._map:
            self.drop()
        self._map = grid.name
        PoseSource.use_map(self, grid, start)

    def _place(self, location: Map2DLocation, covariance: Floats | None) -> None:
        """Take where it says that the robot is, where that is on our map."""
        if self._elsewhere(location):
            self.drop()
            self.refuse(
                f"{self.place} says where the robot is on the map {location.map_id!r}, not on {self._map_name()!r},"
                " which is in use here: change one of them (/change_map, setInitialPose)"
            )
            return
        self.take(Pose(location.x, location.y, math.radians(location.theta)), covariance)

    def _scatter(self, locations: list[Map2DLocation]) -> None:
        here = [(one.x, one.y, math.radians(one.theta)) for one in locations if not self._elsewhere(one)]
        self._particles = np.array(here).reshape(-1, 3)

    def _elsewhere(self, location: Map2DLocation) -> bool:
        """Whether it is on another map of the store; a topic's map has no name of its own."""
        here = self._map_name() if self._section.map in (None, "store") else ""
        return bool(here and location.map_id) and location.map_id != here

    # on its own thread

    def _gone(self, why: str) -> None:
        self._tell_trouble(f"{self.place}: {why}")
        with self._lock:
            self._there, self._wanted = False, None  # a start is of its moment, not of when the server is back

    def _tell_trouble(self, why: str) -> None:
        self._post(lambda: self.refuse(why))

    def _follow(self, remote: ILocalization2DMsgs) -> None:
        self._there = True
        turns = max(1, round(self._section.particles_period / self._section.period))
        turn = 0
        while not self._closed:
            with self._lock:
                wanted, self._wanted = self._wanted, None
            if wanted is not None and not remote.set_initial_pose2_RPC(*wanted):
                self._tell_trouble(f"{self.place} refused where the robot is to begin")
            self._ask(remote, cloud=turn % turns == 0)
            turn += 1
            with self._lock:
                self._lock.wait_for(lambda: self._closed or self._wanted is not None, self._section.period)

    def _ask(self, remote: ILocalization2DMsgs, *, cloud: bool) -> None:
        outcome, status = remote.get_localization_status_RPC()
        theirs = LocalizationStatus(status.name.removeprefix(_STATUS)) if outcome else LocalizationStatus.ERROR
        self._post(lambda: setattr(self, "_theirs", theirs))
        outcome, location, covariance = remote.get_current_position2_RPC()
        whole = covariance.numpy() if outcome else np.zeros((0, 0))
        if not whole.size:  # servers of YARP up to 4.0 answer so, without the location, though they know it
            outcome, location = remote.get_current_position1_RPC()
        if outcome and math.isfinite(location.x + location.y + location.theta):
            usable = whole.shape == _PLANE and np.isfinite(whole).all() and whole.any()
            self._post(lambda: self._place(location, whole if usable else None))
        if cloud:
            outcome, locations = remote.get_estimated_poses_RPC()
            if outcome:
                self._post(lambda: self._scatter(locations))
