"""Our own localiser, fed from the hub."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bridge.config.sections.localization_server import LocalizationServerSection
from bridge.hub.qos import Qos
from bridge.modules.host import Host
from navigation.frames import LATE, Frames, FramesError
from navigation.localization_server.estimate import Estimate, Floats, Status, unknown
from navigation.localization_server.localizer import Localizer
from navigation.localization_server.memory import Memory
from navigation.localization_server.messages import stamp_ns
from navigation.localization_server.scan import scan_points
from navigation.localization_server.settings import Settings
from navigation.localization_server.source import Source, Start
from navigation.pose import Pose
from navigation.scan import SCAN, ScanError, of_ros
from yarp_compat.dev.mapgrid import MapGrid2D


class Own(Source):
    """The localiser, with the laser and the odometry of the hub.

    Args:
        host: the module's.
        section: what to hear, and how to work.
        frames: where the base and the laser are.
    """

    hears_starts = True
    corrects = True

    def __init__(self, host: Host, section: LocalizationServerSection, frames: Frames) -> None:
        self._now_ns, self._frames, self._section = host.clock.now_ns, frames, section
        self._settings = settings_of(section)
        self._localizer: Localizer | None = None
        self._trouble = "no map is there yet"
        self._start = None if section.initial_pose is None else _pose(section.initial_pose)
        self._memory, self._map, self._log = Memory(host.folder), "", host.log
        self._resting = self._unkept = False
        self._scans = self._left_out = 0
        self._laser = ""
        host.node.subscription(section.scan, SCAN, self._scan, Qos(depth=2))

    def estimate(self) -> Estimate:
        """Where the robot is now, or why nobody knows."""
        localizer = self._localizer
        if localizer is None:
            return unknown(self._trouble)
        self._heed_odometry(localizer)
        found = localizer.estimate()
        status, reason = localizer.check(self._now_ns())
        if "laser" in reason and self._laser:
            reason = f"{reason}: {self._laser}"
        found = Estimate(found.pose, found.covariance, found.quality, status, reason)
        self._keep(found)
        return found

    def _heed_odometry(self, localizer: Localizer) -> None:
        try:
            localizer.odometry(self._frames.odometry())
        except FramesError:
            return  # the localiser tells how long nothing was heard

    def correction(self) -> Pose | None:
        """The odometry's frame on the map; None while the laser is silent: what does not hold any more ages."""
        localizer = self._localizer
        if localizer is None or localizer.scan_age(self._now_ns()) > self._settings.scan_age:
            return None
        return localizer.correction

    def cloud(self) -> Floats:
        """The particles."""
        return np.empty((0, 3)) if self._localizer is None else self._localizer.cloud()

    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Begin there."""
        if self._localizer is None:
            raise RuntimeError(f"nobody can be localised: {self._trouble}")
        self._heed_odometry(self._localizer)
        try:
            self._localizer.initial(pose, covariance)
        except ValueError as err:
            raise RuntimeError(str(err)) from None

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Hold scans against another map, from where the robot is now unless somebody said."""
        before = self._localizer.estimate() if self._localizer else None
        if start is None and before is not None and before.pose is not None:
            start = Start(before.pose, before.covariance if self._map == grid.name else None)
        self._map = grid.name
        if start is None and (first := self._first()) is not None:
            start = Start(first)
        try:
            self._localizer = Localizer(grid, self._settings)
        except ValueError as err:
            self._localizer, self._trouble = None, str(err)
            return
        if start is not None:
            self.initial(*start)

    def _first(self) -> Pose | None:
        """Where to begin, of what is known: where the robot was in this run, what the section says, where it was."""
        memory, name = self._memory, self._map
        return memory.recall(name, of_this_run=True) or self._start or memory.recall(name, of_this_run=False)

    def _keep(self, found: Estimate, *, now: bool = False) -> None:
        """Keep where the robot is."""
        if found.pose is None or found.status is not Status.OK:
            return
        try:
            self._memory.keep(self._map, found.pose, now=now)
        except OSError as err:
            if not self._unkept:
                self._log.warning("the pose cannot be kept over restarts: %s", err)
            self._unkept = True

    def close(self) -> None:
        """Keep where the robot is for the next start."""
        self._keep(self.estimate(), now=True)

    def rest(self, *, on: bool) -> None:
        """Take up no scans, or again."""
        self._resting = on

    def forget(self) -> None:
        """The clock was set back."""
        if self._localizer is not None:
            self._localizer.forget_time()

    def status(self) -> dict[str, Any]:
        """How it is getting on."""
        found: dict[str, Any] = {"scans": self._scans, "left_out": self._left_out, "laser": self._laser}
        if self._localizer is not None:
            found |= {"updates": self._localizer.updates, "searches": self._localizer.searches}
        return found

    def _scan(self, message: dict[str, Any]) -> None:
        localizer = self._localizer
        if localizer is None or self._resting:
            return
        stamp = stamp_ns(message["header"]) or self._now_ns()
        frames = self._frames
        try:
            odometry = frames.transform(frames.odom_frame, frames.base_frame, stamp, extrapolate=LATE)
            points = self._points(message, stamp)
        except (FramesError, ScanError) as err:
            self._left_out += 1
            self._laser = str(err)
            return
        self._scans, self._laser = self._scans + 1, ""
        localizer.scan(stamp, points, odometry)

    def _points(self, message: dict[str, Any], stamp: int) -> Floats:
        """A scan's points in the base's frame."""
        frame = message["header"]["frame_id"] or self._frames.base_frame
        turn = of_ros(message, stamp, hangs=self._frames.hangs(frame))
        return scan_points(turn, self._frames.transform(self._frames.base_frame, frame))


def settings_of(section: LocalizationServerSection) -> Settings:
    """The localiser's settings."""
    how = section.localiser
    a1, a2, a3, a4, a5 = how.odom_alpha
    return Settings(
        particles=how.particles,
        beams=how.beams,
        holonomic=how.holonomic,
        alphas=(a1, a2, a3, a4, a5),
        sigma=how.laser_sigma,
        hit=how.laser_hit,
        update_distance=how.update_min_d,
        update_angle=math.radians(how.update_min_a),
        initial_spread=(section.initial_spread[0], math.radians(section.initial_spread[1])),
        good=how.good,
        poor=how.poor,
        search_reach=how.recovery,
    )


def _pose(told: tuple[float, float, float]) -> Pose:
    return Pose(told[0], told[1], math.radians(told[2]))
