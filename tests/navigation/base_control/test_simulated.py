"""BaseControl on the simulator's wheels, with a simulator that ticks in bursts because its thread is delayed."""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from bridge.modules.worker import ModulesWorker
from tests.sim.test_hub import Place
from tests.support.wait import until

COMMAND = 0.3
"""Commanded speed, m/s. The wheels limit the base to 0.286 m/s."""

SPEED_ERROR, TURN_ERROR = 0.1, 0.25
"""How far odometry may leave the range of the true velocities around it, m/s and rad/s: the base rocks on its wheels
when it starts and brakes. Velocities computed from the time between two bursts would be twice the true ones."""

TICK_NS = 10_000_000
AROUND, TRUTH = 6, 2
"""Ticks before and after an odometry message that are compared with it; ticks between two messages of the truth."""


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    place, modules = Place(tmp_path), ModulesWorker()
    try:
        config = place.config(plan="hall", drive="wheels").model_dump()
        config["modules"]["base_control"]["enabled"] = True
        config = type(place.config()).model_validate(config)
        place.worker.start(config)
        modules.start(config)
        yield place
    finally:
        modules.stop()
        place.close()


def hold_up(place: Place) -> None:
    """Block the simulation's thread for 45 ms of every 60 ms, as a busy machine does, so that it ticks in bursts."""
    running = place.worker._running
    assert running is not None
    never = threading.Event()
    running.host.loop.call(lambda: running.host.loop.every(0.06, lambda: never.wait(0.045)))


Speeds = tuple[float, float]


def speeds(message: dict[str, Any]) -> Speeds:
    twist = message["twist"]["twist"]
    return math.hypot(twist["linear"]["x"], twist["linear"]["y"]), twist["angular"]["z"]


def stamp_ns(message: dict[str, Any]) -> int:
    stamp = message["header"]["stamp"]
    return int(stamp["sec"]) * 1_000_000_000 + int(stamp["nanosec"])


def placed(message: dict[str, Any]) -> tuple[float, float, float]:
    pose = message["pose"]["pose"]
    rotation = pose["orientation"]
    return pose["position"]["x"], pose["position"]["y"], 2.0 * math.atan2(rotation["z"], rotation["w"])


def displacement(messages: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Return the meters between the first and the last pose, and the rotation in radians."""
    first, last = placed(messages[0]), placed(messages[-1])
    return math.dist(first[:2], last[:2]), math.remainder(last[2] - first[2], math.tau)


def test_odometry_of_a_simulator_that_ticks_in_bursts_has_the_true_velocities(place: Place) -> None:
    far = place.far
    odometry = far.subscribe("/odom", "nav_msgs/Odometry", depth=1000)
    truth = far.subscribe("/ground_truth", "nav_msgs/Odometry", depth=1000)
    out = far.advertise("/cmd_vel", "geometry_msgs/Twist")
    for topic in ("/odom", "/ground_truth"):
        far.until_published(topic)
    until(lambda: far.wait(odometry, 1, 0.2) and far.wait(truth, 1, 0.2), "odometry and truth arrive", 20)
    hold_up(place)

    def drive(x: float, angular: float, far_enough: float) -> None:
        last = far.wait(odometry, 1)[-1]

        def drives() -> bool:
            far.publish(out, {"linear": {"x": x}, "angular": {"z": angular}})
            (x0, y0, before), (x1, y1, after) = placed(last), placed(far.wait(odometry, 1)[-1])
            return math.hypot(x1 - x0, y1 - y0) + abs(math.remainder(after - before, math.tau)) > far_enough

        until(drives, "the base drives", 40)

    def standing() -> int:
        """Return the number of odometry messages after the base has stood still for 20 messages of the truth."""
        still = lambda: all(max(map(abs, speeds(m))) < 1e-6 for m in far.wait(truth, 1)[-20:])  # noqa: E731
        until(still, "the base stands", 20)
        return len(far.wait(odometry, 1))

    drive(COMMAND, 0.0, 0.5)
    drive(0.15, 0.5, 0.5)
    drive(-COMMAND, 0.0, 0.3)
    stood = standing()
    standing_still = far.wait(odometry, stood + 60, 20)[stood : stood + 60]
    messages = far.wait(odometry, 1)
    ticks = [(stamp_ns(m) - stamp_ns(messages[0])) / TICK_NS for m in messages]
    true = {round((stamp_ns(m) - stamp_ns(messages[0])) / TICK_NS): m for m in far.wait(truth, 1)}

    assert max(speeds(m)[0] for m in messages) <= 1.1 * COMMAND
    compared = 0
    for tick, message in zip(map(round, ticks), messages, strict=True):
        # leave out ticks that the simulator skipped after a long delay
        if all(around in true for around in range(tick - AROUND, tick + AROUND + 1, TRUTH)):
            near = [speeds(true[around]) for around in range(tick - AROUND, tick + AROUND + 1, TRUTH)]
            for ours, theirs, error in zip(
                speeds(message), zip(*near, strict=True), (SPEED_ERROR, TURN_ERROR), strict=True
            ):
                assert min(theirs) - error <= ours <= max(theirs) + error
            compared += 1
    assert compared > 100
    assert {speeds(m) for m in standing_still} == {(0.0, 0.0)}
    pairs = [(m, true[round(t)]) for t, m in zip(ticks, messages, strict=True) if round(t) in true]
    assert displacement([m for m, _ in pairs]) == pytest.approx(displacement([real for _, real in pairs]), abs=0.03)
    assert ticks == pytest.approx([round(tick) for tick in ticks], abs=1e-3)
    assert min(after - before for before, after in itertools.pairwise(ticks)) == pytest.approx(1.0, abs=1e-3)
    assert abs(time.time() - stamp_ns(messages[-1]) / 1e9) < 1.0
