"""A base that stands costs no steps of DART: it comes to rest, and wakes as if it had never rested."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim import world
from sim.base import BasePose, Twist
from sim.plan import Box
from sim.sensors import Sensed
from sim.simulation import Simulation
from tests.sim.floors import drive, simulation, turn_wheels

ROBOTS = ("r1", "ikart_v1")


def standing(**options: object) -> Simulation:
    """A base that stood until it rested."""
    there = simulation(**options)
    there.run(6.0)
    assert there.world.rests
    return there


def state(there: Simulation) -> list[float]:
    skeleton = there.base.skeleton
    return [*skeleton.getPositions(), *skeleton.getVelocities()]


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_base_that_stands_rests_and_the_time_goes_on(robot: str) -> None:
    there = standing(robot=robot)
    before, time, scan = state(there), there.time_ns, there.scan.time_ns
    there.run(1.0)
    assert state(there) == before
    assert there.time_ns - time == 1_000_000_000
    assert there.scan.time_ns > scan
    assert there.motors.encoders().time_ns == there.time_ns


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_rest_changes_nothing_of_the_drive_after_it(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rested = standing(robot=robot)
    monkeypatch.setattr(world, "_REST", 0.0)
    awake = simulation(robot=robot)
    awake.run(6.0)
    assert not awake.world.rests
    for there in (rested, awake):
        drive(there, 2.0, 0.2, 0.3)
    assert not rested.world.rests
    np.testing.assert_allclose(rested.base.pose(), awake.base.pose(), atol=1e-6)
    np.testing.assert_allclose(rested.estimate.pose, awake.estimate.pose, atol=1e-6)
    assert rested.battery.charge.share == pytest.approx(awake.battery.charge.share, rel=1e-9)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_rest_changes_no_bit_of_what_is_sensed(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> list[bytes]:
        there = standing(robot=robot, encoders={"noise": 0.05}, laser={"noise": 0.01})
        found = []
        for fault in (False, True, False):
            there.faults.set("encoders_frozen", on=fault)
            there.run(0.5)
            found.append(there.motors.encoders())
        drive(there, 2.0, 0.2, 0.3)
        found.append(there.motors.encoders())
        said = [part.tobytes() for encoders in found for part in (encoders.positions, encoders.velocities)]
        return [*said, np.array([*there.estimate.pose, *there.estimate.twist]).tobytes(), there.scan.ranges.tobytes()]

    quick, read = run(), Sensed.read
    monkeypatch.setattr(Sensed, "read", lambda sensed, time_ns, *, rests=False: read(sensed, time_ns))  # noqa: ARG005
    assert run() == quick


def test_it_moves_with_the_first_command() -> None:
    there = standing()
    there.command(Twist(0.2, 0.0, 0.0))
    there.tick()
    assert not there.world.rests
    assert max(abs(velocity) for velocity in there.base.skeleton.getVelocities()) > 1e-3


def test_wheels_that_are_told_to_turn_wake_it_too() -> None:
    there = standing(drive="wheels")
    turn_wheels(there, 0.05, 1.0, 1.0)
    assert not there.world.rests


def test_what_it_touches_is_told_while_it_rests_and_forgotten_when_it_is_gone() -> None:
    there = simulation(start=(0.0, 0.0, 0.0))
    drive(there, 15.0, 0.2)
    assert there.bumps  # the wall ahead
    there.run(10.0)
    assert bool(there.bumps) == bool(there.world.bumps())
    there.teleport(BasePose(0.0, 0.0, 0.0))
    there.run(10.0)
    assert there.world.rests
    assert not there.bumps


def test_it_does_not_rest_while_it_is_told_to_drive() -> None:
    there = simulation(start=(0.0, 0.0, 0.0))
    drive(there, 15.0, 0.2)
    before = state(there)
    assert not there.world.rests  # it stands at a wall, and pushes
    drive(there, 0.1, -0.2)
    assert state(there) != before


@pytest.mark.parametrize(
    "change",
    [
        lambda there: there.teleport(BasePose(0.5, 0.5, 0.0)),
        lambda there: there.world.spawn(Box(at=(0.8, 0.0, 0.0), size=(0.2, 0.2, 1.0)), "post"),
        lambda there: there.world.spawn(Box(at=(0.8, 0.0, 0.0), size=(0.2, 0.2, 0.5), mass=2.0), "crate"),
        lambda there: there.begin(),
    ],
)
def test_what_changes_around_it_wakes_it(change: Callable[[Simulation], object]) -> None:
    there = standing()
    change(there)
    assert not there.world.rests
    there.run(8.0)
    assert there.world.rests


def test_a_crate_that_slides_keeps_it_awake() -> None:
    there = simulation(floor={"boxes": ({"name": "box", "at": (1.5, 0.0, 0.0), "size": (0.3, 0.3, 0.3), "mass": 2.0},)})
    there.run(6.0)
    skeleton = there.world.crates["box"].skeleton
    assert there.world.crates["box"].inside
    there.teleport(BasePose(-0.5, 0.0, 0.0))
    skeleton.setVelocities([0.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    before = there.world.crates["box"].now()
    there.run(0.2)
    after = there.world.crates["box"].now()
    assert np.hypot(after.x - before.x, after.y - before.y) > 0.01
