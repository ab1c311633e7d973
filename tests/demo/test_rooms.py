"""The demo judges a drive by the robot's last pose."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.demo import rooms
from tests.support.clock import Clock


class Course:
    """A robot whose poses arrive one by one, given as distances to a room."""

    def __init__(self, clock: Clock, *distances: float) -> None:
        self._clock, self._distances = clock, list(distances)

    def distance_to(self, _room: str) -> float:
        return self._distances[0]

    def wait(self) -> None:
        self._clock.now += 0.1
        if len(self._distances) > 1:
            self._distances.pop(0)


@pytest.mark.parametrize(
    ("distances", "last"),
    [((0.1,), 0.1), ((3.5, 3.5, 2.0, 1.0, 0.1), 0.1), ((3.5, 2.0), 2.0)],
    ids=["near at once", "late poses", "it stands far away"],
)
def test_a_drive_is_judged_by_its_last_pose(
    distances: tuple[float, ...], last: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(rooms, "time", clock)
    course: Any = Course(clock, *distances)
    rooms.wait_for_poses(course, "kitchen", course.wait)
    assert course.distance_to("kitchen") == last
