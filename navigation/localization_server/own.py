"""Midspan's own localizer on topics of the hub; it keeps its last pose across restarts."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.routing.processes import process_name
from bridge.status import Part
from navigation.frames import LATE, FramesError, RobotFrames
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate, unknown
from navigation.localization_server.localizer import SCAN_AGE, Localizer
from navigation.localization_server.section import LocalizationServerSection
from navigation.localization_server.sources import PoseSource, Start, start_covariance
from navigation.messages import stamp_ns
from navigation.pose import Pose, wrapped
from navigation.scan import SCAN, ScanError, of_ros, scan_points
from yarp_compat.dev.mapgrid import MapGrid2D


class OwnLocalizer(PoseSource):
    """The localizer with laser scans and odometry from the hub.

    ``changed`` is called after a scan that changes the status, since a pose may be lost for only one scan, between two
    publications.
    """

    accepts_starts = True
    corrects = True

    def __init__(
        self, host: Host, section: LocalizationServerSection, frames: RobotFrames, changed: Callable[[], None]
    ) -> None:
        self._clock, self._frames, self._section, self._changed = host.clock, frames, section, changed
        self._localizer: Localizer | None = None
        self._trouble = "waiting for a map"
        self._start: Pose | None = None
        if section.initial_pose is not None:
            x, y, theta = section.initial_pose
            self._start = Pose(x, y, math.radians(theta))
        self._memory, self._map, self._log = Memory(host.folder), "", host.log
        self._paused = self._unsaved = False
        self._scans = self._left_out = 0
        self._laser = ""
        host.node.subscription(section.scan, SCAN, self._on_scan, Qos(depth=2))

    @override
    def estimate(self) -> PoseEstimate:
        localizer = self._localizer
        if localizer is None:
            return unknown(self._trouble)
        self._add_odometry(localizer)
        estimate = localizer.estimate()
        status, reason = localizer.check(self._clock.now_ns())
        if "laser" in reason and self._laser:
            reason = f"{reason}: {self._laser}"
        estimate = replace(estimate, status=status, reason=reason)
        self._save(estimate)
        return estimate

    def _add_odometry(self, localizer: Localizer) -> None:
        try:
            localizer.odometry(self._frames.odometry())
        except FramesError:
            return  # the localizer reports how long odometry has been missing

    @override
    def correction(self) -> Pose | None:
        localizer = self._localizer
        if localizer is None or localizer.scan_age(self._clock.now_ns()) > SCAN_AGE:
            return None
        return localizer.correction

    @override
    def cloud(self) -> Floats:
        return np.empty((0, 3)) if self._localizer is None else self._localizer.cloud()

    @override
    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        if self._localizer is None:
            raise RuntimeError(f"localization is impossible: {self._trouble}")
        self._add_odometry(self._localizer)
        try:
            self._localizer.initial(pose, start_covariance(self._section) if covariance is None else covariance)
        except ValueError as err:
            raise RuntimeError(str(err)) from None

    @override
    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        before = self._localizer.estimate() if self._localizer else None
        if start is None and before is not None and before.pose is not None:
            start = Start(before.pose, before.covariance if self._map == grid.name else None)
        self._map = grid.name
        if start is None and (first := self._first()) is not None:
            start = Start(first)
        try:
            self._localizer = Localizer(grid, self._section.localiser)
        except ValueError as err:
            self._localizer, self._trouble = None, str(err)
            return
        if start is not None:
            self.initial(*start)

    def _first(self) -> Pose | None:
        """Return the initial pose: the last pose of this run, else the configured pose, else an earlier run's last."""
        memory, name = self._memory, self._map
        return memory.recall(name, of_this_run=True) or self._start or memory.recall(name, of_this_run=False)

    def _save(self, estimate: PoseEstimate, *, now: bool = False) -> None:
        if estimate.pose is None or estimate.status is not LocalizationStatus.OK:
            return
        try:
            self._memory.save(self._map, estimate.pose, now=now)
        except OSError as err:
            if not self._unsaved:
                self._log.warning("cannot save the pose: %s", err)
            self._unsaved = True

    @override
    def close(self) -> None:
        self._save(self.estimate(), now=True)

    @override
    def pause(self, *, on: bool) -> None:
        self._paused = on

    @override
    def on_clock_jump(self) -> None:
        if self._localizer is not None and self._clock.simulated:
            self._localizer.restart()
        elif self._localizer is not None:
            self._localizer.forget_stamps()

    @override
    def status(self) -> Part:
        localizer, counts = self._localizer, {}
        if localizer is not None:
            counts = {"updates": localizer.updates, "searches": localizer.searches}
        return Part(scans=self._scans, left_out=self._left_out, laser=self._laser, **counts)

    def _on_scan(self, message: dict[str, Any]) -> None:
        localizer = self._localizer
        if localizer is None or self._paused:
            return
        stamp = stamp_ns(message["header"]) or self._clock.now_ns()
        frames = self._frames
        try:
            odometry = frames.transform(frames.odom_frame, frames.base_frame, stamp, extrapolate=LATE)
            points = self._points(message, stamp)
        except (FramesError, ScanError) as err:
            self._left_out += 1
            self._laser = str(err)
            return
        self._scans, self._laser = self._scans + 1, ""
        before = localizer.estimate().status
        localizer.scan(stamp, points, odometry)
        if localizer.estimate().status is not before:
            self._changed()

    def _points(self, message: dict[str, Any], stamp: int) -> Floats:
        """Return a scan's points in the base frame."""
        frame = message["header"]["frame_id"] or self._frames.base_frame
        turn = of_ros(message, stamp, upside_down=self._frames.is_upside_down(frame))
        return scan_points(turn, self._frames.transform(self._frames.base_frame, frame))


_MOVED, _TURNED = 0.05, math.radians(3.0)
_PERIOD = 2.0  # minimum seconds between two writes


class Memory:
    """The file with the robot's last pose."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "pose.json"
        self._saved: tuple[str, Pose] | None = None
        self._written = -math.inf

    def save(self, map_name: str, pose: Pose, *, now: bool = False) -> None:
        """Save a pose if the robot has moved, at most every 2 s unless ``now``; raises `OSError` on failure."""
        if self._saved is not None and not self._is_far(map_name, pose, self._saved):
            return
        if not now and time.monotonic() - self._written < _PERIOD:
            return
        self._written = time.monotonic()
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps({"map": map_name, "pose": pose[:3], "run": _run()}), encoding="utf-8")
        new.replace(self._file)
        self._saved = map_name, pose  # last, so that a pose that could not be written is written later

    def recall(self, map_name: str, *, of_this_run: bool) -> Pose | None:
        """Return the saved pose on a map, if any; ``of_this_run``: only a pose that this run of the daemon saved."""
        try:
            kept = json.loads(self._file.read_text(encoding="utf-8"))
            x, y, theta = map(float, kept["pose"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        if kept.get("map") != map_name or (of_this_run and kept.get("run") != (_run() or None)):
            return None
        return Pose(x, y, theta) if math.isfinite(x + y + theta) else None

    @staticmethod
    def _is_far(map_name: str, pose: Pose, kept: tuple[str, Pose]) -> bool:
        turned = abs(wrapped(pose.theta - kept[1].theta))
        return map_name != kept[0] or pose.distance(kept[1]) > _MOVED or turned > _TURNED


def _run() -> str:
    """Return a unique name of the daemon's process, since its id is 1 in every container; "" if unknown."""
    return process_name(os.getppid())
