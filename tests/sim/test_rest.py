"""For a base at rest, DART's steps are skipped; it later moves as if they had not been skipped."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim import world
from sim.base import BasePose, Twist
from sim.plan import Box
from sim.sensors import WheelEncoders
from sim.simulation import Simulation
from tests.peers.sim.floors import drive, simulation, turn_wheels

ROBOTS = ("r1", "ikart_v1")


def standing(**options: object) -> Simulation:
    """Return a simulation that has come to rest."""
    sim = simulation(**options)
    sim.run(6.0)
    assert sim.world.rests
    return sim


def state(sim: Simulation) -> list[float]:
    skeleton = sim.base.skeleton
    return [*skeleton.getPositions(), *skeleton.getVelocities()]


@pytest.mark.parametrize("robot", ROBOTS)
def test_time_continues_at_rest(robot: str) -> None:
    sim = standing(robot=robot)
    before, time, scan = state(sim), sim.time_ns, sim.scan.time_ns
    sim.run(1.0)
    assert state(sim) == before
    assert sim.time_ns - time == 1_000_000_000
    assert sim.scan.time_ns > scan
    assert sim.wheels.motors.encoders().time_ns == sim.time_ns


@pytest.mark.parametrize("robot", ROBOTS)
def test_rest_does_not_change_a_later_drive(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rested = standing(robot=robot)
    monkeypatch.setattr(world, "_REST", 0.0)
    awake = simulation(robot=robot)
    awake.run(6.0)
    assert not awake.world.rests
    for sim in (rested, awake):
        drive(sim, 2.0, 0.2, 0.3)
    assert not rested.world.rests
    np.testing.assert_allclose(rested.base.pose(), awake.base.pose(), atol=1e-6)
    np.testing.assert_allclose(rested.estimate.pose, awake.estimate.pose, atol=1e-6)
    assert rested.battery.charge.share == pytest.approx(awake.battery.charge.share, rel=1e-9)


@pytest.mark.parametrize("robot", ROBOTS)
def test_rest_does_not_change_sensor_values(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> list[bytes]:
        sim = standing(robot=robot, encoders={"noise": 0.05}, laser={"noise": 0.01})
        readings = []
        for fault in (False, True, False):
            sim.faults.set("encoders_frozen", on=fault)
            sim.run(0.5)
            readings.append(sim.wheels.motors.encoders())
        drive(sim, 2.0, 0.2, 0.3)
        readings.append(sim.wheels.motors.encoders())
        parts = [part.tobytes() for encoders in readings for part in (encoders.positions, encoders.velocities)]
        return [*parts, np.array([*sim.estimate.pose, *sim.estimate.twist]).tobytes(), sim.scan.ranges.tobytes()]

    quick, read = run(), WheelEncoders.read
    monkeypatch.setattr(WheelEncoders, "read", lambda encoders, time_ns, *, rests=False: read(encoders, time_ns))  # noqa: ARG005
    assert run() == quick


def test_the_base_moves_with_the_first_command() -> None:
    sim = standing()
    sim.command(Twist(0.2, 0.0, 0.0))
    sim.tick()
    assert not sim.world.rests
    assert max(abs(velocity) for velocity in sim.base.skeleton.getVelocities()) > 1e-3


def test_wheel_commands_end_the_rest() -> None:
    sim = standing(drive="wheels")
    turn_wheels(sim, 0.05, 1.0, 1.0)
    assert not sim.world.rests


def test_contacts_are_reported_at_rest_and_cleared_by_a_teleport() -> None:
    sim = simulation(start=(0.0, 0.0, 0.0))
    drive(sim, 15.0, 0.2)
    assert sim.bumps  # the wall ahead
    sim.run(10.0)
    assert bool(sim.bumps) == bool(sim.world.bumps())
    sim.teleport(BasePose(0.0, 0.0, 0.0))
    sim.run(10.0)
    assert sim.world.rests
    assert not sim.bumps


def test_the_base_does_not_rest_while_it_is_commanded_to_drive() -> None:
    sim = simulation(start=(0.0, 0.0, 0.0))
    drive(sim, 15.0, 0.2)
    before = state(sim)
    assert not sim.world.rests  # it pushes against a wall
    drive(sim, 0.1, -0.2)
    assert state(sim) != before


@pytest.mark.parametrize(
    "change",
    [
        lambda sim: sim.teleport(BasePose(0.5, 0.5, 0.0)),
        lambda sim: sim.world.spawn(Box(at=(0.8, 0.0, 0.0), size=(0.2, 0.2, 1.0)), "post"),
        lambda sim: sim.world.spawn(Box(at=(0.8, 0.0, 0.0), size=(0.2, 0.2, 0.5), mass=2.0), "crate"),
        lambda sim: sim.begin(),
    ],
)
def test_changes_of_the_floor_end_the_rest(change: Callable[[Simulation], object]) -> None:
    sim = standing()
    change(sim)
    assert not sim.world.rests
    sim.run(8.0)
    assert sim.world.rests


def test_a_sliding_crate_prevents_rest() -> None:
    sim = simulation(floor={"boxes": ({"name": "box", "at": (1.5, 0.0, 0.0), "size": (0.3, 0.3, 0.3), "mass": 2.0},)})
    sim.run(6.0)
    skeleton = sim.world.crates["box"].skeleton
    assert sim.world.crates["box"].inside
    sim.teleport(BasePose(-0.5, 0.0, 0.0))
    skeleton.setVelocities([0.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    before = sim.world.crates["box"].now()
    sim.run(0.2)
    after = sim.world.crates["box"].now()
    assert np.hypot(after.x - before.x, after.y - before.y) > 0.01
    for tick in range(600):  # longer than the base takes to come to rest
        skeleton.setVelocities([0.0, 0.0, 0.0, 0.5 - tick % 2, 0.0, 0.0])
        sim.tick()
        assert not sim.world.rests
    sim.run(8.0)
    assert sim.world.rests
