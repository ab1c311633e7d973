"""The base in DART: driving, collisions with walls and crates, odometry, limits."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from sim import robot
from sim.base import BasePose, Twist
from sim.environment import SimError
from sim.section import SimSection
from sim.simulation import Simulation
from tests.peers.sim.floors import INSIDE, drive, simulation, turn_wheels

REACH = robot.load("r1").body.radius


def tilt(sim: Simulation) -> float:
    """Return the tilt from upright, in degrees."""
    return math.degrees(math.acos(min(1.0, sim.base.body.getTransform().rotation()[2, 2])))


@pytest.mark.parametrize("speed", [1.0, 3.0, 6.3])
@pytest.mark.parametrize("direction", [0.0, 35.0, 80.0])
def test_the_base_never_passes_a_wall(speed: float, direction: float) -> None:
    sim = simulation(drive="wheels", start=(0.0, 0.0, direction))
    bumped = False
    for _ in range(50):
        turn_wheels(sim, 0.1, speed, speed)
        x, y, _ = sim.base.pose()
        assert max(abs(x), abs(y)) < INSIDE - REACH + 0.005
        assert tilt(sim) < 5
        bumped |= bool(sim.bumps)
    # with wheels at 1 rad/s, the base does not reach a wall in this time
    assert bumped == (speed > 1.0)


def test_random_driving_stays_in_the_room() -> None:
    sim = simulation(
        drive="wheels", floor={"boxes": ({"name": "a", "at": (1, 1, 0), "size": (0.4, 0.4, 0.4), "mass": 5},)}
    )
    rng = np.random.default_rng(7)
    for _ in range(60):
        turn_wheels(sim, 0.2, *(rng.choice([-4.0, 4.0, 4.0]) + rng.uniform(-1, 1, 2)))
        assert max(abs(v) for v in sim.base.pose()[:2]) < INSIDE - REACH + 0.01
        assert max(abs(v) for v in (sim.world.crates["a"].now().x, sim.world.crates["a"].now().y)) < INSIDE


def test_a_stalled_base_neither_climbs_nor_slides() -> None:
    sim = simulation()
    drive(sim, 12, 0.3)
    x, y, _ = sim.base.pose()
    assert INSIDE - REACH - 0.005 < x < INSIDE - REACH + 0.005
    assert abs(y) < 0.02
    assert tilt(sim) < 2
    assert sim.bumps[0][0] == pytest.approx(INSIDE, abs=0.01)


def test_wheels_do_not_collide_with_a_wall_alongside() -> None:
    """In DART a wheel is a sphere, which protrudes from the base's cylinder by 0.125 m."""
    sim = simulation(start=(-1.5, INSIDE - REACH - 0.03, 0.0))
    drive(sim, 5, 0.3)
    assert sim.base.pose().x > -0.2
    assert sim.base.pose().y == pytest.approx(INSIDE - REACH - 0.03, abs=0.001)
    assert not sim.bumps


def square(sim: Simulation, side: float) -> None:
    """Drive a square, controlled by odometry."""
    for _ in range(4):
        begun = sim.estimate.traveled
        while (left := side - (sim.estimate.traveled - begun)) > 0.002:
            sim.command(Twist(min(0.3, math.sqrt(0.5 * left)), 0.0, 0.0))
            sim.run(0.05)
        begun = sim.estimate.turned
        while (left := math.pi / 2 - (sim.estimate.turned - begun)) > 0.002:
            sim.command(Twist(0.0, 0.0, min(0.5, math.sqrt(1.5 * left))))
            sim.run(0.05)
    drive(sim, 1, 0.0)


def test_odometry_is_accurate_to_one_percent() -> None:
    sim = simulation(start=(-0.5, -0.5, 0.0))
    square(sim, 1.0)
    truth, believed = sim.base.pose(), sim.estimate
    assert believed.traveled > 4.0
    assert math.hypot(truth.x + 0.5 - believed.pose.x, truth.y + 0.5 - believed.pose.y) < 0.01
    assert abs(math.remainder(truth.yaw - believed.pose.yaw, 2 * math.pi)) < 0.01


@pytest.mark.parametrize(("scale", "name"), [((0.02, 0.02), "r1"), ((), "r1_gazebo")])
def test_odometry_has_the_configured_scale_error(scale: tuple[float, ...], name: str) -> None:
    wanted = 1.026 if name == "r1_gazebo" else 1.02
    sim = simulation(start=(-1.5, 0.0, 0.0), robot=name, encoders={"scale": scale})
    drive(sim, 8, 0.3)
    drive(sim, 2, 0.0)
    assert sim.estimate.pose.x / (sim.base.pose().x + 1.5) == pytest.approx(wanted, abs=0.002)


def test_encoder_noise_accumulates() -> None:
    def error(seed: int) -> float:
        sim = simulation(start=(-1.5, 0.0, 0.0), encoders={"noise": 0.05}, seed=seed)
        drive(sim, 6, 0.3)
        return sim.estimate.pose.x - (sim.base.pose().x + 1.5)

    errors = [error(seed) for seed in range(4)]
    assert len(set(errors)) == 4
    assert 0.0005 < float(np.std(errors)) < 0.1


def test_the_same_seed_and_commands_give_identical_runs() -> None:
    def run(seed: int) -> str:
        options = {"encoders": {"noise": 0.01}, "laser": {"noise": 0.01, "dropouts": 0.02}}
        sim = Simulation(SimSection(plan="lab", seed=seed, **options))
        rng, digest = np.random.default_rng(1), hashlib.sha256()
        for _ in range(40):
            sim.command(Twist(rng.uniform(-0.3, 0.3), 0.0, rng.uniform(-1, 1)))
            sim.run(0.1)
            digest.update(np.array([*sim.base.pose(), *sim.estimate.pose]).tobytes() + sim.scan.ranges.tobytes())
        return digest.hexdigest()

    first = run(3)
    assert run(3) == first
    assert run(4) != first


def test_the_base_pushes_a_crate_to_the_wall() -> None:
    sim = simulation(floor={"boxes": ({"name": "a", "at": (0.6, 0, 0), "size": (0.4, 0.4, 0.4), "mass": 4},)})
    drive(sim, 3, 0.3)
    moved = sim.world.crates["a"].now()
    assert moved.x > 0.7
    assert abs(moved.y) < 0.05
    drive(sim, 8, 0.3)
    stuck = sim.world.crates["a"].now()
    assert stuck.x == pytest.approx(INSIDE - 0.2, abs=0.01)
    assert sim.base.pose().x < stuck.x - 0.2 - REACH + 0.01


def test_wheels_and_base_stop_when_commands_end() -> None:
    by_wheels = simulation(drive="wheels", start=(-1.5, 0.0, 0.0))
    turn_wheels(by_wheels, 1.0, 1.0, 1.0)
    assert by_wheels.base.twist().x > 0.15
    by_wheels.run(0.05)
    assert by_wheels.base.twist().x > 0.15
    by_wheels.run(0.2)
    assert abs(by_wheels.base.twist().x) < 0.02
    by_velocity = simulation(start=(-1.5, 0.0, 0.0))
    drive(by_velocity, 2, 0.3)
    by_velocity.run(0.3)
    assert by_velocity.base.twist().x > 0.28
    by_velocity.run(1.4)
    assert abs(by_velocity.base.twist().x) < 0.01


def test_speed_and_acceleration_are_limited() -> None:
    sim = simulation(start=(-1.5, 0.0, 0.0))
    fastest = 0.0
    for _ in range(30):
        before = sim.estimate.twist.x
        drive(sim, 0.1, 50.0, 20.0)
        fastest = max(fastest, sim.estimate.twist.x)
        assert sim.estimate.twist.x - before < 0.035
        assert abs(sim.estimate.twist.yaw) < math.radians(31)
    assert 0.29 < fastest < 0.31


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e6])
def test_invalid_commands_are_rejected_and_the_base_brakes(bad: float) -> None:
    sim = simulation()
    for twist in (Twist(bad, 0, 0), Twist(0, bad, 0), Twist(0, 0, bad)):
        with pytest.raises(SimError, match="rejected"):
            sim.command(twist)
    wheeled = simulation(drive="wheels")
    if not math.isfinite(bad):
        with pytest.raises(SimError, match="invalid velocities"):
            wheeled.wheels.motors.drive([bad, 0.0])
    with pytest.raises(SimError, match="invalid velocities"):
        wheeled.wheels.motors.drive([1.0])
    wheeled.wheels.motors.drive([1e5, 1e5])
    wheeled.run(0.1)
    assert abs(wheeled.base.joints()[1]).max() < 6.5


def test_the_emergency_stop_holds_the_wheels() -> None:
    sim = simulation()
    drive(sim, 1, 0.3)
    sim.stop(on=True)
    drive(sim, 0.5, 0.3)
    at = sim.base.pose()
    drive(sim, 1, 0.3)
    assert math.hypot(sim.base.pose().x - at.x, sim.base.pose().y - at.y) < 0.005
    sim.stop(on=False)
    sim.run(1.0)
    assert sim.base.pose().x < at.x + 0.005  # commands from before the release do not move it
    drive(sim, 1, 0.3)
    assert sim.base.pose().x > at.x + 0.05


def test_a_base_with_three_omnidirectional_wheels_drives_in_all_directions() -> None:
    sim = simulation(robot="ikart_v1")
    drive(sim, 3, 0.2, 0.1, 0.1)
    drive(sim, 1, 0.0)
    truth, believed = sim.base.pose(), sim.estimate.pose
    assert np.allclose(truth, believed, atol=1e-6)
    assert truth.x > 0.3
    assert truth.y > 0.1
    assert truth.yaw > 0.2
    wheels = sim.base.matrix(0.0625, 0.2734) @ (0.1, 0.0, 0.0)
    assert np.allclose(wheels, [0.1 / 0.0625 * math.sqrt(3) / 2, -0.1 / 0.0625 * math.sqrt(3) / 2, 0.0])
    drive(sim, 12, 0.3, 0.0, 0.2)
    assert max(abs(v) for v in sim.base.pose()[:2]) < INSIDE - 0.3575 + 0.005


def test_the_battery_runs_down_faster_while_driving() -> None:
    idle, busy = simulation(), simulation(drive="wheels")
    idle.run(2)
    for _ in range(20):
        turn_wheels(busy, 0.1, 3.0, -3.0)
    assert busy.battery.charge.share < idle.battery.charge.share < 1
    assert busy.battery.charge.current < idle.battery.charge.current < 0


def test_robots_are_loaded_from_files(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    text = (Path(robot.__file__).parent / "robots" / "r1.yaml").read_text()
    path.write_text(text.replace("separation: 0.338", "separation: 0.5").replace("name: r1", "name: mine"))
    sim = simulation(robot=str(path))
    drive(sim, 3, 0.0, 0.5)
    assert sim.base.pose().yaw == pytest.approx(sim.estimate.pose.yaw, abs=0.01)
    assert sim.robot.name == "mine"
    path.write_text(text.replace("torque: 30.0", "torque: none"))
    with pytest.raises(SimError, match=r"mine.yaml:13:\d+: wheels.torque"):
        robot.load(str(path))
    data = robot.load("r1").model_dump()
    with pytest.raises(ValidationError, match="'ikart_V2' are not supported"):
        robot.RobotDescription.model_validate({**data, "kinematics": "ikart_V2"})
    with pytest.raises(ValidationError, match="3 wheels, not 2"):
        robot.RobotDescription.model_validate({**data, "kinematics": "ikart_V1"})
    with pytest.raises(SimError, match="neither a file nor one of the robots"):
        robot.load("unknown")


def test_a_reset_restores_the_start() -> None:
    sim = simulation(start=(0.5, 0.5, 90.0))
    drive(sim, 2, 0.3)
    sim.begin()
    assert np.allclose(sim.base.pose(), BasePose(0.5, 0.5, math.pi / 2))
    assert sim.estimate.traveled == 0.0
    assert sim.time_ns == 2_000_000_000
