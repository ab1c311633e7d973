"""Obstacles from clouds and layers: the voxel window, and a robot that avoids them."""

import math

import numpy as np
import pytest

from bridge.config.sections.obstacles import ObstacleSection
from navigation.pose import Pose
from navigation.robot_goto.obstacles import CloudWindow, Obstacles
from navigation.robot_goto.section import RobotGotoSection
from navigation.status import Fault, State
from sim.pieces import Piece
from tests.peers.navigation.scene import Scene

CLOUD, LAYER = ObstacleSection(topic="/points", type="cloud"), ObstacleSection(topic="/layer")
EYE = np.array((0.1, 0.0, 1.1))
HERE = Pose(0.0, 0.0, 0.0)


def window(memory=20.0):
    return CloudWindow(memory, height=1.3, step=0.05, radius=0.2)


def surface(x, y, z, length=0.3, width=0.3, every=0.02):
    """Return the points of a horizontal surface, (n, 3), as dense as a camera's."""
    xs, ys = np.meshgrid(np.arange(-length / 2, length / 2, every) + x, np.arange(-width / 2, width / 2, every) + y)
    return np.stack((xs.ravel(), ys.ravel(), np.full(xs.size, z)), axis=1).astype(np.float32)


def near(places, x, y, reach=0.05):
    return bool(len(places)) and bool((np.hypot(*(places - (x, y)).T) < reach).any())


# the window


@pytest.mark.parametrize(
    ("z", "counts"), [(0.0, False), (0.04, False), (0.1, True), (0.75, True), (1.29, True), (1.4, False)]
)
def test_points_between_the_floor_and_the_robots_height_count(z, counts):
    voxels = window()
    voxels.add(1.0, surface(1.0, 0.5, z), EYE, HERE)
    assert bool(len(voxels.places(1.0))) is counts
    if counts:
        assert near(voxels.places(1.0), 1.0, 0.5)
        assert (np.abs(voxels.places(1.0) - (1.0, 0.5)) < 0.2).all()


def test_a_step_down_is_detected_below_the_floor():
    voxels = window()
    voxels.add(1.0, np.concatenate((surface(1.0, 0.0, 0.0), surface(1.6, 0.0, -0.12))), EYE, HERE)
    places = voxels.places(1.0)
    assert len(places)
    # the rays cross the floor's height a little before they end, and become voxels where no floor was seen
    ahead = 0.1 + 1.5 * 1.1 / 1.22
    assert near(places, ahead, 0.0)
    assert places[:, 0].min() > 1.15
    voxels.add(2.0, surface(ahead, 0.0, 0.0, 0.8, 0.8), EYE, HERE)  # the step is covered by floor
    assert not len(voxels.places(2.0))


def test_single_points_and_the_robots_own_points_are_ignored():
    voxels = window()
    voxels.add(
        1.0, np.array([(1.0, 0.0, 0.7), (0.05, 0.0, 0.9), (0.06, 0.0, 0.9), (0.05, 0.01, 0.9)], np.float32), EYE, HERE
    )
    assert not len(voxels.places(1.0))


def test_voxels_are_freed_only_by_rays_that_pass_through_them():
    voxels, board, wall = window(), surface(1.0, 0.0, 0.7), surface(2.0, 0.0, 0.0, 2.4, 3.0)
    voxels.add(1.0, board, EYE, HERE)
    aside = wall[np.abs(wall[:, 1]) > 0.8]
    voxels.add(2.0, aside, EYE, HERE)  # no ray in this direction
    assert near(voxels.places(2.0), 1.0, 0.0)
    hidden = board - np.float32([0.25, 0.0, -0.15])  # a nearer object hides it
    voxels.add(2.5, hidden, EYE, HERE)
    assert near(voxels.places(2.5), 1.0, 0.0)
    voxels.add(3.0, wall, EYE, HERE)
    assert not near(voxels.places(3.0), 1.0, 0.0)
    voxels.add(4.0, board, EYE, HERE)
    assert near(voxels.places(23.9), 1.0, 0.0)
    assert not len(voxels.places(24.1))


def test_the_window_moves_with_the_robot():
    voxels = window()
    voxels.add(1.0, surface(1.0, 0.5, 0.7), EYE, HERE)
    moved = Pose(1.03, -0.4, 2.0)
    voxels.add(2.0, surface(1.5, -1.5, 0.7), np.array((1.0, -0.4, 1.1)), moved)
    assert near(voxels.places(2.0), 1.0, 0.5)
    assert near(voxels.places(2.0), 1.5, -1.5)
    voxels.add(3.0, surface(30.0, 0.0, 0.7), np.array((29.0, 0.0, 1.1)), Pose(29.0, 0.0, 0.0))
    assert (voxels.places(3.0)[:, 0] > 29.0).all()
    voxels.add(4.0, surface(1.0, 0.5, 0.0), EYE, HERE)
    assert not len(voxels.places(4.0))  # it left the window


def test_a_cloud_of_a_million_points_is_handled():
    voxels = window()
    many = np.tile(surface(1.5, 0.0, 0.7, 1.0, 1.0, 0.01), (100, 1))
    assert len(many) == 1_000_000
    for now in (1.0, 2.0):
        voxels.add(now, many, EYE, HERE)
    assert len(voxels.places(2.0)) <= 22 * 22


# sources


def test_a_source_is_silent_before_its_first_message_and_after_its_timeout():
    obstacles = Obstacles(RobotGotoSection(obstacles=(CLOUD, LAYER)))
    assert obstacles.silence(1.0) == "the cloud /points has not arrived yet"
    obstacles.cloud("/points", 1.0, surface(1.0, 0.0, 0.7), EYE, HERE)
    assert obstacles.silence(1.2) == "the layer /layer has not arrived yet"
    obstacles.layer("/layer", np.empty((0, 2)))
    assert obstacles.silence(1.5) == ""
    assert "the cloud /points is silent: no message for 0.6 s" in obstacles.silence(1.6)
    obstacles.cloud("/points", 1.7, np.empty((0, 3), np.float32), EYE, HERE)
    assert "the cloud has no valid points" in obstacles.silence(1.7)
    obstacles.cloud("/points", 6.4, surface(1.0, 0.0, 0.7), EYE, HERE)
    obstacles.silent = "the layer /layer is silent"  # set by the subscriptions
    assert obstacles.silence(6.4) == "the layer /layer is silent"
    assert Obstacles(RobotGotoSection()).silence(9.0) == ""


def test_a_layer_on_the_map_is_transformed_to_the_odometry_frame():
    obstacles = Obstacles(RobotGotoSection(obstacles=(LAYER,)))
    obstacles.layer("/layer", np.array([(2.0, 3.0), (50.0, 0.0)]))
    places = obstacles.places(1.0, Pose(1.0, 3.0, 0.0), Pose(-4.0, 0.0, math.pi / 2))
    np.testing.assert_allclose(places, [(-4.0, 1.0)], atol=1e-9)
    assert not len(obstacles.places(1.0, None, HERE))


def test_a_layer_survives_a_clock_jump():
    obstacles = Obstacles(RobotGotoSection(obstacles=(CLOUD, LAYER)))
    obstacles.cloud("/points", 100.0, surface(1.0, 0.0, 0.7), EYE, HERE)
    obstacles.layer("/layer", np.array([(2.0, 3.0)]))
    obstacles.clear()
    assert obstacles.silence(1.0) == "the cloud /points has not arrived yet"
    np.testing.assert_allclose(obstacles.places(1.0, HERE, HERE), [(2.0, 3.0)])


# driving

BOARD = Piece("board", 1.4, 0.0, 0.0, 0.8, 1.0, 0.03, above=0.72)
"""A table without legs, which the laser does not see."""


def test_with_only_a_laser_the_robot_hits_a_table():
    scene = Scene()
    scene.sim.world.spawn(BOARD, "board")
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    scene.run(10.0)
    assert scene.touched


def test_with_clouds_the_robot_drives_around_a_table():
    scene = Scene(camera=True, obstacles=(CLOUD,))
    scene.sim.world.spawn(BOARD, "board")
    assert scene.goto(3.0, 0.0, 0.0) is State.REACHED
    assert not scene.touched
    assert "the path is blocked" not in scene.reasons


def test_without_avoidance_the_robot_waits_at_a_tables_edge():
    scene = Scene(camera=True, obstacles=(CLOUD,), enable_obstacles_avoidance=False, memory=5.0)
    scene.sim.world.spawn(BOARD, "board")
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    scene.until(lambda: scene.driver.status.fault is Fault.BLOCKED, 20.0)
    scene.run(2.0)
    assert scene.driver.status.reason == "an obstacle is on the path"
    assert 0.1 < scene.pose.x < 1.0 - 0.3
    scene.sim.world.remove("board")
    scene.until(lambda: scene.driver.status.state is State.REACHED, 40.0)
    assert not scene.touched


def test_silent_clouds_stop_the_robot_like_a_silent_laser():
    scene = Scene(camera=True, obstacles=(CLOUD,))
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    scene.until(lambda: scene.pose.x > 0.3, 20.0)
    scene.depth = False
    scene.until(lambda: scene.driver.status.fault is Fault.NO_LASER, 1.0)
    assert "the cloud /points is silent" in scene.driver.status.reason
    scene.run(1.5)
    stood = scene.pose.x
    scene.run(1.0)
    assert scene.pose.x == pytest.approx(stood, abs=1e-3)
    scene.depth = True
    scene.until(lambda: scene.driver.status.state is State.REACHED, 30.0)


def test_the_robot_avoids_a_drop():
    from sim.plan import Drop, Floor, Plan
    from sim.simulation import Simulation

    scene = Scene(camera=True, obstacles=(CLOUD,))
    hole = Drop(at=(1.5, 0.0), size=(0.6, 0.8), depth=0.12)
    floor = Floor(walls=(((-4, -4), (5, -4), (5, 4), (-4, 4), (-4, -4)),), drops=(hole,))
    scene.sim = Simulation(scene.sim.section, Plan(name="hole", floors={"hole": floor}))
    over = []
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    while not scene.driver.status.state.ended:
        scene.tick()
        away = np.maximum(np.abs(np.subtract(scene.pose[:2], hole.at)) - np.divide(hole.size, 2), 0.0)
        over.append(math.hypot(*away) - 0.208)
        assert scene.now < 60.0
    assert scene.driver.status.state is State.REACHED
    assert min(over) > 0.0
