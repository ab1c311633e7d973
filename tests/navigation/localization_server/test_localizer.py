"""The localizer in the simulator, in lock-step: it tracks, recovers, and reports when the pose is unknown."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.localizer import DEGREES, METERS, Tour, drive, simulated
from navigation.localization_server.estimate import LocalizationStatus
from navigation.localization_server.localizer import Localizer
from navigation.localization_server.own import Memory
from navigation.localization_server.section import LocalizerSection
from navigation.pose import Pose, wrapped
from navigation.scan import scan_points
from sim.base import Twist
from sim.section import LaserSection, SimSection
from sim.simulation import Simulation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

S = 1_000_000_000


def tour(world: str = "lab", seed: int = 0) -> Tour:
    return Tour(simulated(world, seed), seed)


def truth(run: Tour) -> Pose:
    return Pose(*run.there.base.pose())


def error_of(localizer: Localizer, run: Tour) -> tuple[float, float]:
    """Return the error of the estimated pose in meters and degrees."""
    pose, true = localizer.pose, truth(run)
    assert pose is not None
    return pose.distance(true), abs(math.degrees(wrapped(pose.theta - true.theta)))


def test_the_localizer_tracks_the_robot_while_odometry_drifts() -> None:
    run = tour()
    localizer = Localizer(run.grid)
    start = truth(run)
    localizer.initial(start)
    errors = np.array([error for _, *error in drive(run, localizer, 20.0, [])])
    assert errors[:, 0].max() < METERS
    assert errors[:, 1].max() < DEGREES
    drifted = start @ Pose(*run.there.estimate.pose)
    assert abs(math.degrees(wrapped(drifted.theta - truth(run).theta))) > DEGREES  # otherwise the test shows nothing
    estimate = localizer.estimate()
    assert (estimate.status, estimate.reason) == (LocalizationStatus.OK, "")
    assert estimate.quality > 0.7
    assert 0.0 < math.sqrt(estimate.covariance[0, 0]) < METERS
    cloud = localizer.cloud()
    assert cloud.shape == (1000, 3)
    assert np.hypot(*(cloud[:, :2].mean(axis=0) - truth(run)[:2])) < METERS


@pytest.mark.parametrize("world", ["apartment", "lab"])
def test_the_localizer_recovers_from_a_wrong_start(world: str) -> None:
    run = tour(world, 1)
    localizer = Localizer(run.grid)
    true = truth(run)
    localizer.initial(Pose(true.x + 2.1, true.y - 2.1, true.theta + math.radians(30.0)))
    for _, meters, degrees in drive(run, localizer, 60.0, []):
        if meters < METERS and degrees < DEGREES and localizer.estimate().status is LocalizationStatus.OK:
            return
    pytest.fail(f"the error is still {error_of(localizer, run)}")


def stand(localizer: Localizer, run: Tour, scans: int) -> None:
    """Use scans of the standing robot, one every tenth of a second."""
    points = scan_points(run.there.scan)
    for n in range(scans):
        stamp = run.there.time_ns + n * S // 10
        localizer.odometry(Pose(0.0, 0.0, 0.0, stamp))
        localizer.scan(stamp, points)


def test_missing_inputs_are_reported() -> None:
    run = tour()
    localizer = Localizer(run.grid)
    assert localizer.pose is None
    assert localizer.check(0) == (LocalizationStatus.NOT_YET, "no initial pose")
    localizer.initial(truth(run))
    assert localizer.check(0) == (LocalizationStatus.NOT_YET, "odometry is not arriving")
    stand(localizer, run, 1)
    now = run.there.time_ns
    assert localizer.check(now) == (LocalizationStatus.OK, "")
    assert localizer.check(now + 3 * S // 2) == (LocalizationStatus.ERROR, "odometry is silent for 1.5 s")
    localizer.odometry(Pose(0.0, 0.0, 0.0, now + 3 * S // 2))
    assert localizer.check(now + 3 * S // 2) == (LocalizationStatus.ERROR, "the laser is silent for 1.5 s")


def test_frozen_odometry_is_reported_and_the_laser_still_locates_the_robot() -> None:
    run = tour()
    localizer = Localizer(run.grid)
    localizer.initial(truth(run))
    stand(localizer, run, 5)
    run.there.teleport(run.there.base.pose()._replace(x=9.6, y=9.0, yaw=2.5))
    run.there.run(0.2)
    stand(localizer, run, 8)
    status, reason = localizer.check(run.there.time_ns)
    assert status is LocalizationStatus.ERROR
    assert "by odometry the base has not moved: the odometry is frozen, or the robot was carried" in reason
    for _ in range(40):
        stand(localizer, run, 10)
        run.there.run(1.0)
        if localizer.estimate().status is LocalizationStatus.OK:
            break
    assert error_of(localizer, run)[0] < METERS


def test_a_laser_without_echoes_gives_no_pose() -> None:
    run = tour()
    localizer = Localizer(run.grid)
    localizer.initial(truth(run))
    for n in range(20):
        localizer.odometry(Pose(0.1 * n, 0.0, 0.0, n * S // 10))
        assert not localizer.scan(n * S // 10, np.empty((0, 2)))
    assert localizer.check(2 * S) == (LocalizationStatus.ERROR, "too few echoes in the scan")


def test_a_map_with_a_rotated_origin_is_used() -> None:
    sim = Simulation(SimSection(plan="lab", laser=LaserSection(beams=180)))
    grid = Tour(sim, 0).grid
    # the same walls in a frame that is rotated by 40 degrees and moved, as given by the origin of a ROS map
    origin = Pose(*grid.origin.to_ros())
    moved = Pose(3.0, -2.0, math.radians(40.0))
    turned = MapGrid2D.of(grid.flags.copy(), name="turned", resolution=grid.resolution)
    turned.m_origin = type(turned.m_origin).from_ros(*(moved @ origin)[:3])
    localizer = Localizer(turned)
    true = moved @ Pose(*sim.base.pose())
    localizer.initial(true @ Pose(0.2, -0.1, 0.1), np.diag([0.04, 0.04, 0.01]))
    for n in range(6):
        localizer.odometry(Pose(0.0, 0.0, 0.0, n * S))
        localizer.scan(n * S, scan_points(sim.scan))
    pose = localizer.pose
    assert pose is not None
    assert pose.distance(true) < 0.05
    assert abs(wrapped(pose.theta - true.theta)) < 0.03
    assert np.hypot(*(localizer.cloud()[:, :2].mean(axis=0) - true[:2])) < 0.1


def test_a_map_without_walls_is_rejected() -> None:
    with pytest.raises(ValueError, match="the map 'empty' is impossible: it has no walls"):
        Localizer(MapGrid2D.of(np.full((9, 9), MapFlag.FREE, np.uint8), name="empty", resolution=0.1))


def test_a_start_pose_that_is_not_finite_is_rejected() -> None:
    localizer = Localizer(tour().grid)
    with pytest.raises(ValueError, match="invalid initial pose"):
        localizer.initial(Pose(math.nan, 0.0, 0.0))


def test_points_of_a_scan_are_in_the_base_frame() -> None:
    class Scan:
        first, step, nearest, farthest = 0.0, math.pi / 2, 0.5, 9.0
        ranges = np.array([1.0, math.nan, 0.2, math.inf, 2.0, 9.0], np.float32)

    points = scan_points(Scan(), Pose(0.1, 0.0, math.pi))
    assert points == pytest.approx(np.array([[-0.9, 0.0], [-1.9, 0.0]]), abs=1e-6)


def test_a_holonomic_base_that_moves_sideways_is_tracked() -> None:
    settings = LocalizerSection(holonomic=True)
    sim = Simulation(SimSection(plan="lab", robot="ikart_v1", laser=LaserSection(beams=180)))
    localizer = Localizer(Tour(sim, 0).grid, settings)
    localizer.initial(Pose(*sim.base.pose()))
    for _ in range(400):
        sim.command(Twist(0.1, 0.15, 0.05))
        sim.tick()
        localizer.odometry(Pose(*sim.estimate.pose, stamp_ns=sim.time_ns))
        if sim.scan.time_ns == sim.time_ns:
            localizer.scan(sim.time_ns, scan_points(sim.scan))
    pose = localizer.pose
    assert pose is not None
    assert pose.distance(Pose(*sim.base.pose())) < METERS
    assert localizer.updates > 3


def test_a_pose_is_stored_across_restarts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = Memory(tmp_path)
    assert memory.recall("lab", of_this_run=False) is None
    memory.save("lab", Pose(1.0, 2.0, 0.5, 7))
    memory.save("lab", Pose(3.0, 2.0, 0.5))  # not stored: too soon after the previous pose
    assert memory.recall("lab", of_this_run=True) == Pose(1.0, 2.0, 0.5)
    memory.save("lab", Pose(3.0, 2.0, 0.5), now=True)
    again = Memory(tmp_path)
    assert again.recall("lab", of_this_run=True) == Pose(3.0, 2.0, 0.5)
    assert again.recall("hall", of_this_run=False) is None
    for run in ("", "another of the same number"):
        monkeypatch.setattr("navigation.localization_server.own.process_name", lambda _pid, run=run: run)
        assert again.recall("lab", of_this_run=True) is None
    assert again.recall("lab", of_this_run=False) == Pose(3.0, 2.0, 0.5)
    (tmp_path / "pose.json").write_text('{"map": "lab", "pose": [1, 2')
    assert again.recall("lab", of_this_run=False) is None


def test_the_robot_stays_localized_when_the_system_clock_is_set() -> None:
    run = tour()
    localizer = Localizer(run.grid)
    localizer.initial(truth(run))
    list(drive(run, localizer, 5.0, []))
    before, cloud = localizer.estimate(), localizer.cloud()
    localizer.forget_stamps()
    after = localizer.estimate()
    assert (after.pose, after.status) == (before.pose, LocalizationStatus.OK)
    assert np.array_equal(localizer.cloud(), cloud)
    assert localizer.check(0)[1] == "odometry is not arriving"
    assert before.pose is not None
    odometry = Pose(*run.there.estimate.pose)._replace(stamp_ns=S)  # 1 s: seconds before the previous stamp
    localizer.odometry(odometry)
    assert error_of(localizer, run)[0] < METERS
    assert max(error[0] for _, *error in drive(run, localizer, 5.0, [])) < METERS


def test_a_pose_that_could_not_be_saved_is_saved_later(tmp_path: Path) -> None:
    folder = tmp_path / "missing"
    memory = Memory(folder)
    with pytest.raises(OSError, match="missing"):
        memory.save("lab", Pose(1.0, 2.0, 0.5))
    folder.mkdir()
    memory.save("lab", Pose(1.0, 2.0, 0.5), now=True)
    assert memory.recall("lab", of_this_run=True) == Pose(1.0, 2.0, 0.5)
