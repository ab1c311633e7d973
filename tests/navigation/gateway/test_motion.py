"""Whether a base stands, judged from scripted odometry."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, cast

import pytest

from navigation.frames import FramesError
from navigation.gateway import motion as motion_module
from navigation.gateway.motion import FRESH_SECONDS, Base, Motion
from navigation.pose import Pose

TENTH = 100_000_000


class Odometry:
    """Stands in for `RobotFrames`: returns the pose that the test has set, or raises an error."""

    def __init__(self) -> None:
        self.x, self.stamp, self.age, self.known = 0.0, 0, 0, True

    def odometry(self) -> Pose:
        if not self.known:
            raise FramesError("odometry is missing")
        return Pose(self.x, 0.0, 0.0, self.stamp)

    def now_ns(self) -> int:
        """Return the time of the stamps' clock."""
        return self.stamp + self.age


def test_only_fresh_odometry_shows_that_the_base_stands() -> None:
    odometry = Odometry()
    motion = Motion(cast("Any", odometry), odometry.now_ns, simulated=True)
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


def test_poses_that_arrive_late_do_not_show_that_the_base_stands_now(monkeypatch: pytest.MonkeyPatch) -> None:
    """A starved worker delays odometry: each pose is 0.45 s old when it arrives."""
    odometry, now = Odometry(), 100.0
    motion = Motion(cast("Any", odometry), odometry.now_ns)
    monkeypatch.setattr(motion_module, "time", SimpleNamespace(monotonic=lambda: now))
    odometry.age = 450_000_000
    for _ in range(10):
        odometry.stamp, now = odometry.stamp + TENTH, now + 0.1
        motion.poll()
    assert motion.is_standing() is True
    assert motion.is_standing(since=now - 0.6) is None, "the poses since then were measured before"
    assert motion.is_standing(since=now - 1.0) is True
    now += 0.2
    assert motion.is_standing() is None, "the last pose is 0.65 s old"


@pytest.mark.parametrize("moved", [True, False])
def test_a_base_whose_odometry_ended_in_motion_is_not_known_to_stand(
    monkeypatch: pytest.MonkeyPatch, *, moved: bool
) -> None:
    odometry, now = Odometry(), 100.0
    motion = Motion(cast("Any", odometry), odometry.now_ns)
    monkeypatch.setattr(motion_module, "time", SimpleNamespace(monotonic=lambda: now))

    def run(seconds: float, speed: float) -> None:
        nonlocal now
        for _ in range(round(seconds * 10)):
            odometry.x, odometry.stamp, now = odometry.x + speed / 10, odometry.stamp + TENTH, now + 0.1
            motion.poll()

    run(1.0, 0.3 if moved else 0.0)
    unknown = Base.MOVING if moved else Base.UNKNOWN
    odometry.known = False
    run(5.0, 0.0)
    assert not motion.known
    assert motion.base() is unknown
    odometry.known = True
    run(0.3, 0.0)
    assert motion.base() is unknown, "odometry does not cover enough time yet"
    run(0.3, 0.0)
    assert motion.base() is Base.STANDING
    odometry.known = False
    run(1.0, 0.0)
    assert motion.base() is Base.UNKNOWN


def test_other_threads_read_while_it_polls() -> None:
    """YARP's threads read the status while the module's own thread polls."""
    odometry = Odometry()
    motion, over, failed = Motion(cast("Any", odometry), odometry.now_ns), threading.Event(), list[BaseException]()

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


def test_a_step_of_the_odometrys_clock_is_not_time_that_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    """NTP sets the clock forward while the robot drives slowly: odometry's stamps jump, and the pose hardly changes."""
    odometry = Odometry()
    motion = Motion(cast("Any", odometry), odometry.now_ns)
    monkeypatch.setattr(motion_module, "time", SimpleNamespace(monotonic=lambda: 100.0))
    for _ in range(3):
        odometry.x, odometry.stamp = odometry.x + 0.0004, odometry.stamp + 5 * TENTH
        motion.poll()
    assert motion.is_standing() is None


def test_odometry_that_has_ended_does_not_show_that_the_base_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker that carries odometry is killed as the robot is about to start."""
    odometry, now = Odometry(), 100.0
    motion = Motion(cast("Any", odometry), odometry.now_ns)
    monkeypatch.setattr(motion_module, "time", SimpleNamespace(monotonic=lambda: now))
    for _ in range(6):
        odometry.stamp, now = odometry.stamp + TENTH, now + 0.1
        motion.poll()
    assert motion.is_standing() is True
    now += FRESH_SECONDS
    motion.poll()
    assert motion.is_standing() is None
