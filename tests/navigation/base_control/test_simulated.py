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

RADIUS, SEPARATION = 0.16416, 0.338
"""Radius of the wheels and distance between them, meters."""

SPEED_ERROR, TURN_ERROR = 0.1, 0.25
"""How far odometry may leave the range of the true velocities around it, m/s and rad/s: the base rocks on its wheels
when it starts and brakes. Velocities computed from the time between two bursts would be twice the true ones."""

JUMP, SETTLE = 0.5, 30
"""A change of a wheel's velocity from one reading to the next, rad/s, and the ticks after it in which the base may tip
and slip. The limits of BaseControl allow 0.33 rad/s in the 0.1 s after which the motors stop by themselves. If they do
so while the base drives, the wheels stop within two ticks: the base tips forward on standing wheels at up to 0.28 m/s,
lifts them from the floor and slips. Encoders cannot measure that motion. It ends within 20 ticks of the last jump.
"""

TICK_NS = 10_000_000
AROUND, TRUTH = 6, 2
"""Ticks before and after an odometry message that are compared with it; ticks between two messages of the truth."""

COMPARED = 100
"""Odometry messages that are compared with the truth, at least."""


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


def stand_still(place: Place) -> None:
    """Block the simulation's thread until it refuses commands and the motors stop the wheels."""
    running = place.worker._running
    assert running is not None
    running.host.loop.post(lambda: threading.Event().wait(0.4))


Speeds = tuple[float, float]


def speeds(message: dict[str, Any]) -> Speeds:
    twist = message["twist"]["twist"]
    return math.hypot(twist["linear"]["x"], twist["linear"]["y"]), twist["angular"]["z"]


def of_wheels(joints: dict[str, Any]) -> Speeds:
    """Return the speeds of a base that rolls on its wheels without slip."""
    left, right = joints["velocity"]
    return abs(left + right) / 2.0 * RADIUS, (right - left) / SEPARATION * RADIUS


def jumps_of(wheels: dict[int, dict[str, Any]]) -> list[int]:
    """Return the ticks of the readings at which a wheel's velocity jumped."""
    return [
        tick
        for (_, before), (tick, after) in itertools.pairwise(sorted(wheels.items(), key=lambda reading: reading[0]))
        if max(abs(b - a) for a, b in zip(before["velocity"], after["velocity"], strict=True)) > JUMP
    ]


def rolls(tick: int, jumps: Sequence[int]) -> bool:
    """Return whether the base rolls on its wheels at a tick, and in the ticks around it."""
    return not any(tick - SETTLE <= jump <= tick + AROUND for jump in jumps)


def around(tick: int, true: dict[int, dict[str, Any]]) -> list[Speeds]:
    """Return the true speeds around a tick; none if the simulator skipped some of them after a long delay."""
    near = [true.get(at) for at in range(tick - AROUND, tick + AROUND + 1, TRUTH)]
    return [speeds(message) for message in near if message is not None] if all(near) else []


def stamp_ns(message: dict[str, Any]) -> int:
    stamp = message["header"]["stamp"]
    return int(stamp["sec"]) * 1_000_000_000 + int(stamp["nanosec"])


def by_tick(messages: Sequence[dict[str, Any]], begin_ns: int) -> dict[int, dict[str, Any]]:
    return {round((stamp_ns(message) - begin_ns) / TICK_NS): message for message in messages}


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
    joints = far.subscribe("/joint_states", "sensor_msgs/JointState", depth=1000)
    out = far.advertise("/cmd_vel", "geometry_msgs/Twist")
    for topic in ("/odom", "/ground_truth", "/joint_states"):
        far.until_published(topic)
    for end in (odometry, truth, joints):
        until(lambda end=end: far.wait(end, 1, 0.2), "odometry, truth and readings of the encoders arrive", 20)
    hold_up(place)

    def drive(x: float, angular: float, far_enough: float) -> None:
        last = far.wait(odometry, 1)[-1]

        def drives() -> bool:
            far.publish(out, {"linear": {"x": x}, "angular": {"z": angular}})
            (x0, y0, before), (x1, y1, after) = placed(last), placed(far.wait(odometry, 1)[-1])
            return math.hypot(x1 - x0, y1 - y0) + abs(math.remainder(after - before, math.tau)) > far_enough

        until(drives, "the base drives", 40)

    def standing() -> list[dict[str, Any]]:
        """Return 60 odometry messages from after the base has stood still for 20 messages of the truth."""
        still = lambda: all(max(map(abs, speeds(m))) < 1e-6 for m in far.wait(truth, 1)[-20:])  # noqa: E731
        until(still, "the base stands", 20)
        stood_ns = stamp_ns(far.wait(truth, 1)[-1])  # earlier odometry may still arrive

        def later() -> list[dict[str, Any]]:
            messages = [message for message in far.wait(odometry, 1) if stamp_ns(message) > stood_ns][:60]
            return messages if len(messages) == 60 else []

        return until(later, "odometry of the standing base arrives", 20)

    drive(COMMAND, 0.0, 0.5)
    stand_still(place)
    drive(COMMAND, 0.0, 0.5)
    drive(0.15, 0.5, 0.5)
    drive(-COMMAND, 0.0, 0.3)
    begin_ns = stamp_ns(far.wait(odometry, 1)[0])
    directions = itertools.cycle((COMMAND, -COMMAND))

    def enough() -> bool:
        """Return whether enough messages can be compared with the truth; drive on if not."""
        true, jumps = by_tick(far.wait(truth, 1), begin_ns), jumps_of(by_tick(far.wait(joints, 1), begin_ns))
        ticks = by_tick(far.wait(odometry, 1), begin_ns)
        # a jump that arrives later may exclude the last messages
        if sum(rolls(tick, jumps) and bool(around(tick, true)) for tick in ticks) > COMPARED + AROUND:
            return True
        drive(next(directions), 0.0, 0.3)
        return False

    until(enough, "enough messages while the base rolls", 60)
    standing_still = standing()
    messages = far.wait(odometry, 1)
    ticks = [(stamp_ns(m) - begin_ns) / TICK_NS for m in messages]
    true, wheels = by_tick(far.wait(truth, 1), begin_ns), by_tick(far.wait(joints, 1), begin_ns)
    jumps = jumps_of(wheels)
    assert jumps, "the motors stopped the wheels"
    # before the encoders have reported a velocity, BaseControl computes velocities from angles
    driven = min(tick for tick, reading in wheels.items() if of_wheels(reading)[0] > 0.01)

    compared = measured = 0
    for tick, message in zip(map(round, ticks), messages, strict=True):
        if tick >= driven and tick in wheels:
            assert speeds(message) == pytest.approx(of_wheels(wheels[tick]), abs=1e-6)
            measured += 1
        near = around(tick, true)
        if rolls(tick, jumps) and near:
            for ours, theirs, error in zip(
                speeds(message), zip(*near, strict=True), (SPEED_ERROR, TURN_ERROR), strict=True
            ):
                assert min(theirs) - error <= ours <= max(theirs) + error
            compared += 1
    assert compared > COMPARED
    assert measured > 0.9 * sum(tick >= driven for tick in ticks)
    assert max(speeds(m)[0] for t, m in zip(ticks, messages, strict=True) if rolls(round(t), jumps)) <= 1.1 * COMMAND
    assert {speeds(m) for m in standing_still} == {(0.0, 0.0)}
    pairs = [(round(t), m, true[round(t)]) for t, m in zip(ticks, messages, strict=True) if round(t) in true]
    for rolling, stretch in itertools.groupby(pairs, lambda pair: rolls(pair[0], jumps)):
        _, estimated, real = zip(*stretch, strict=True)
        assert not rolling or displacement(estimated) == pytest.approx(displacement(real), abs=0.03)
    assert ticks == pytest.approx([round(tick) for tick in ticks], abs=1e-3)
    assert min(after - before for before, after in itertools.pairwise(ticks)) == pytest.approx(1.0, abs=1e-3)
    current = lambda: abs(time.time() - stamp_ns(far.wait(odometry, 1)[-1]) / 1e9) < 1.0  # noqa: E731
    until(current, "the stamps are the current time", 20)
