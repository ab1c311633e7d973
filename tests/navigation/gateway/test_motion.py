"""Whether a base stands, by odometry that a test makes up."""

from __future__ import annotations

import threading
from typing import Any, cast

from navigation.frames import FramesError
from navigation.gateway.motion import Motion
from navigation.pose import Pose

TENTH = 100_000_000


class Odometry:
    """What `Frames` tells: the next pose each time, or that none is known."""

    def __init__(self) -> None:
        self.x, self.stamp, self.known = 0.0, 0, True

    def odometry(self) -> Pose:
        if not self.known:
            raise FramesError("nobody says where the base is")
        return Pose(self.x, 0.0, 0.0, self.stamp)


def test_only_odometry_that_goes_on_tells_that_the_base_stands() -> None:
    said = Odometry()
    motion = Motion(cast("Any", said), simulated=True)
    assert motion.stands() is None
    for _ in range(6):
        said.x, said.stamp = said.x + 0.03, said.stamp + TENTH
        motion.poll()
    assert motion.stands() is False
    for _ in range(20):  # it falls silent in mid-drive: the last pose says nothing of where the base is now
        motion.poll()
    assert motion.stands() is False
    for _ in range(4):
        said.stamp += TENTH
        motion.poll()
    assert motion.stands() is True
    assert motion.stands(since=float("inf")) is None
    said.known = False
    motion.poll()
    assert motion.stands() is None


def test_it_is_asked_while_it_looks() -> None:
    """YARP's threads ask for the status as the module's own looks."""
    said = Odometry()
    motion, over, failed = Motion(cast("Any", said)), threading.Event(), list[BaseException]()

    def ask() -> None:
        try:
            while not over.is_set():
                motion.stands()
        except RuntimeError as err:
            failed.append(err)

    asking = threading.Thread(target=ask)
    asking.start()
    for _ in range(5_000):
        said.stamp += TENTH // 1000
        motion.poll()
    over.set()
    asking.join()
    assert not failed


def test_a_step_of_the_odometrys_clock_is_not_time_that_passed() -> None:
    """NTP sets the robot's clock forward while it drives slowly: its stamps jump, and the pose hardly changes."""
    odometry = Odometry()
    motion = Motion(cast("Any", odometry))
    for _ in range(3):
        odometry.x, odometry.stamp = odometry.x + 0.0004, odometry.stamp + 5 * TENTH
        motion.poll()
    assert motion.stands() is None
