"""Velocities of the dialects' programs arrive although a clock is set: zenoh's hybrid logical clock never goes back."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from tests.adapters.zenoh.conftest import Place
from tests.support.process import Process
from tests.support.shifted_clock import ShiftedClock

TWIST = "geometry_msgs/Twist"
TELEOP = """
import sys, time
from tests.adapters.zenoh.conftest import PERIOD, ROS1, ROS2
from tests.peers.zenoh.programs import JsonProgram, Ros1Bridge, Ros2ddsBridge

dialect, endpoint = sys.argv[1:]
program = {
    "ros2dds": lambda: Ros2ddsBridge(endpoint, ROS2),
    "ros1": lambda: Ros1Bridge(endpoint, ROS1, "*", PERIOD),
    "json": lambda: JsonProgram(endpoint),
}[dialect]()
out = program.advertise("/cmd_vel", "geometry_msgs/Twist")
while True:
    program.publish(out, {"linear": {"x": 0.1, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}})
    time.sleep(0.05)
"""
PLAIN = """
import sys, time, json
from tests.peers.zenoh.programs import open_session

session = open_session(sys.argv[1], timestamping={"enabled": False})
publisher = session.declare_publisher("cmd_vel")
while True:
    publisher.put(json.dumps({"linear": {"x": 0.1}}).encode())
    time.sleep(0.05)
"""
KEYS = [{"key": "cmd_vel", "type": "geometry_msgs/msg/Twist", "direction": "in"}]
DIALECTS = {"ros2dds": {"dialect": "ros2dds"}, "ros1": {"dialect": "ros1"}, "json": {"dialect": "json", "keys": KEYS}}


class Velocities:
    """The velocities that arrive on the hub."""

    def __init__(self, place: Place) -> None:
        self._far = place.far
        self._number = self._far.subscribe("/cmd_vel", TWIST)

    def further(self, count: int, seconds: float = 30.0) -> int:
        """Return how many further velocities have arrived, once there are ``count``, or the time is over.

        By default the time is shorter than the shift of a clock, after which velocities would arrive in any case.
        """
        before = len(self._far.wait(self._number, 0))
        return len(self._far.wait(self._number, before + count, seconds)) - before


def start(place: Place, dialect: str, clock: ShiftedClock, program: str, *arguments: Any) -> Velocities:
    place.bridge(DIALECTS[dialect])
    velocities = Velocities(place)
    place.keep(Process([sys.executable, "-c", program, *arguments, place.router.endpoint], clock.environment))
    assert velocities.further(20, 40) >= 20
    return velocities


@pytest.mark.parametrize(
    "shifts", [pytest.param((0, -40), id="slow afterwards"), pytest.param((40, 0), id="fast before")]
)
@pytest.mark.parametrize(
    "dialect", ["ros2dds", *(pytest.param(dialect, marks=pytest.mark.thorough) for dialect in ("ros1", "json"))]
)
def test_velocities_arrive_after_the_clock_was_set_back(
    place: Place, tmp_path: Path, dialect: str, shifts: tuple[int, int]
) -> None:
    """The first clock is the program's, relative to this machine's; zenoh allows it to be up to 0.5 s fast."""
    clock = ShiftedClock(tmp_path, shifts[0])
    velocities = start(place, dialect, clock, TELEOP, dialect)
    clock.set(shifts[1])
    assert velocities.further(60) >= 60


def test_velocities_of_a_plain_peer_arrive(place: Place, tmp_path: Path) -> None:
    """A peer with zenoh's default settings sends no stamps."""
    velocities = start(place, "json", ShiftedClock(tmp_path), PLAIN)
    assert velocities.further(20) >= 20
