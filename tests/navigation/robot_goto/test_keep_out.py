"""RobotGoto stays out of the map's keep-out cells, and avoids obstacles near them."""

import math

import numpy as np
import pytest

from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.robot_goto.keep_out import KeepOut
from navigation.status import State
from sim.plan import Box
from tests.peers.navigation.scene import RADIUS, Scene
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

NEAR_KEEP_OUT = Constraints(beside_keep_out="floor")
AREA = (1.0, -2.0, 2.0, -0.45)
"""A keep-out area to the right of the line ahead: left, bottom, right and top, in meters."""


def keep_out(*areas: tuple[float, float, float, float], resolution: float = 0.05) -> MapGrid2D:
    """Return a map of 10 x 10 m around the origin with keep-out areas."""
    side = round(10.0 / resolution)
    grid = MapGrid2D.of(np.zeros((side, side), np.uint8), name="floor", resolution=resolution, origin=(-5.0, -5.0, 0.0))
    for left, bottom, right, top in areas:
        first, last = grid.cells_at(np.array([(left, top - 1e-6), (right, bottom - 1e-6)]))
        grid.flags[first[1] : last[1], first[0] : last[0]] = MapFlag.KEEP_OUT
    return grid


def depth(pose: Pose, area: tuple[float, float, float, float]) -> float:
    """Return the meters between a point and an area."""
    left, bottom, right, top = area
    return math.hypot(max(left - pose.x, 0.0, pose.x - right), max(bottom - pose.y, 0.0, pose.y - top))


@pytest.mark.parametrize("resolution", [0.05, 0.2])
def test_points_on_the_border_of_an_area_are_obstacles(resolution):
    known, here = KeepOut(), Pose(0.0, 0.0, 0.0)
    known.use(keep_out((1.0, 1.0, 2.0, 2.0), resolution=resolution))
    points = known.near(0.3, here, here)
    assert points.min() == pytest.approx(1.0)
    assert points.max() == pytest.approx(2.0)
    inner = ((points > 1.01 + resolution) & (points < 1.99 - resolution)).all(axis=1)
    assert not inner.any()
    left = np.sort(points[np.isclose(points[:, 0], 1.0), 1])
    assert np.diff(left).max() < 0.051, "no gap"


def test_the_cells_are_unknown_without_a_map_or_a_pose():
    known, here = KeepOut(), Pose(0.0, 0.0, 0.0)
    assert len(known.near(0.3, here, here)) == 0
    assert not known.map_name
    known.use(keep_out(AREA))
    assert len(known.near(0.3, None, here)) == 0
    assert not known.map_name
    near = known.near(0.3, here, Pose(3.0, -2.0, math.pi / 2))
    assert known.map_name == "floor"
    # the area is ahead to the right: in the odometry frame, the robot faces +y
    np.testing.assert_allclose(near.min(axis=0), (3.0 + 0.45, -2.0 + 1.0), atol=1e-6)


@pytest.mark.parametrize("x", [0.0, 0.9, 1.2])
def test_the_cells_have_no_effect_on_a_robot_inside(x):
    known, here = KeepOut(), Pose(x, 0.0, 0.0)
    known.use(keep_out((-1.0, -1.0, 1.0, 1.0)))
    assert len(known.near(0.3, here, here)) == 0
    assert not known.map_name


def test_beside_keep_out_cells_the_robot_drives_around_an_obstacle_without_entering_them():
    scene = Scene()
    scene.driver.keep_out.use(keep_out(AREA))
    scene.sim.world.spawn(Box(at=(1.5, 0.1, 0.0), size=(0.3, 0.3, 1.0)), "box")  # the detour to the right is shorter
    scene.driver.goal(Pose(3.0, 0.0, math.nan), NEAR_KEEP_OUT)
    least = math.inf
    while not scene.driver.status.state.ended:
        scene.tick()
        least = min(least, depth(scene.pose, AREA))
        assert scene.now < 60.0, scene.driver.status
    assert scene.driver.status.state is State.REACHED
    assert least > RADIUS["r1"]
    assert not scene.touched


@pytest.mark.parametrize("known", [None, "attic"])
def test_beside_unknown_keep_out_cells_the_robot_waits(known):
    scene = Scene()
    if known:
        scene.driver.keep_out.use(MapGrid2D.of(np.zeros((40, 40), np.uint8), name=known, resolution=0.05))
    scene.sim.world.spawn(Box(at=(1.5, 0.1, 0.0), size=(0.3, 0.3, 1.0)), "box")
    scene.driver.goal(Pose(3.0, 0.0, math.nan), NEAR_KEEP_OUT)
    scene.until(lambda: scene.driver.status.state is State.WAITING, 20)
    assert scene.driver.status.reason == "an obstacle is on the path"


def test_no_command_leads_into_keep_out_cells():
    scene = Scene()
    ahead = (1.0, -1.0, 1.4, 1.0)
    scene.driver.keep_out.use(keep_out(ahead))
    scene.driver.approach(0.0, 0.3, 8.0)
    scene.run(8.5)
    assert RADIUS["r1"] < depth(scene.pose, ahead) < RADIUS["r1"] + 0.1


def test_a_robot_in_a_keep_out_area_leaves_it():
    scene = Scene()
    scene.driver.keep_out.use(keep_out((-0.5, -0.5, 0.5, 0.5)))
    assert scene.goto(1.5, 0.0) is State.REACHED
