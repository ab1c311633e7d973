"""Whether a base stands, judged from scripted odometry."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, cast

import pytest

from navigation.frames import FramesError
from navigation.gateway import motion as motion_module
from navigation.gateway.motion import FRESH_SECONDS, Motion
from navigation.pose import Pose

TENTH = 100_000_000


class Odometry:
    """Stands in for `RobotFrames`: returns the pose that the test has set, or raises an error."""

    def __init__(self) -> None:
        self.x, self.stamp, self.known = 0.0, 0, True

    def odometry(self) -> Pose:
        if not self.known:
            raise FramesError("odometry is missing")
        return Pose(self.x, 0.0, 0.0, self.stamp)


def test_only_fresh_odometry_shows_that_the_base_stands() -> None:
    odometry = Odometry()
    motion = Motion(cast("Any", odometry), simulated=True)
    assert motion.is_standing() is None
    for _ in range(6):
        odometry.x, odometry.stamp = odometry.x + 0.03, odometry.stamp + TENTH
        motion.poll()
    assert motion.is_standing() is False
    for _ in range(20):  # odometry stops in mid-drive: the last pose does not show the current motion
        motion.poll()
    assert motion.is_standing() is False
    for _ in range(4):
        odometry.stamp += TENTH
        motion.poll()
    assert motion.is_standing() is True
    assert motion.is_standing(since=float("inf")) is None
    odometry.known = False
    motion.poll()
    assert motion.is_standing() is None


def test_other_threads_read_while_it_polls() -> None:
    """YARP's threads read the status while the module's own thread polls."""
    odometry = Odometry()
    motion, over, failed = Motion(cast("Any", odometry)), threading.Event(), list[BaseException]()

    def ask() -> None:
        try:
            while not over.is_set():
                motion.is_standing()
        except RuntimeError as err:
            failed.append(err)

    asking = threading.Thread(target=ask)
    asking.start()
    for _ in range(5_000):
        odometry.stamp += TENTH // 1000
        motion.poll()
    over.set()
    asking.join()
    assert not failed


def test_a_step_of_the_odometrys_clock_is_not_time_that_passed() -> None:
    """NTP sets the clock forward while the robot drives slowly: odometry's stamps jump, and the pose hardly changes."""
    odometry = Odometry()
    motion = Motion(cast("Any", odometry))
    for _ in range(3):
        odometry.x, odometry.stamp = odometry.x + 0.0004, odometry.stamp + 5 * TENTH
        motion.poll()
    assert motion.is_standing() is None


def test_odometry_that_has_ended_does_not_show_that_the_base_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker that carries odometry is killed as the robot is about to start."""
    odometry, now = Odometry(), 100.0
    motion = Motion(cast("Any", odometry))
    monkeypatch.setattr(motion_module, "time", SimpleNamespace(monotonic=lambda: now))
    for _ in range(6):
        odometry.stamp, now = odometry.stamp + TENTH, now + 0.1
        motion.poll()
    assert motion.is_standing() is True
    now += FRESH_SECONDS
    motion.poll()
    assert motion.is_standing() is None
