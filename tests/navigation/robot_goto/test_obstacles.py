"""Clouds and layers beside the laser: what the window of voxels keeps and forgets, and a robot that heeds it."""

import math

import numpy as np
import pytest

from bridge.config.sections.planners import ObstacleSection, RobotGotoSection
from navigation.pose import Pose
from navigation.robot_goto.obstacles import CloudWindow, Obstacles
from navigation.status import Fault, State
from sim.pieces import Piece
from tests.navigation.robot_goto.scene import Scene

CLOUD, LAYER = ObstacleSection(topic="/points", type="cloud"), ObstacleSection(topic="/layer")
EYE = np.array((0.1, 0.0, 1.1))
HERE = Pose(0.0, 0.0, 0.0)


def window(memory=20.0):
    return CloudWindow(memory, height=1.3, step=0.05, radius=0.2)


def surface(x, y, z, length=0.3, width=0.3, every=0.02):
    """(n, 3) points of a horizontal surface around a place, as dense as a camera's."""
    xs, ys = np.meshgrid(np.arange(-length / 2, length / 2, every) + x, np.arange(-width / 2, width / 2, every) + y)
    return np.stack((xs.ravel(), ys.ravel(), np.full(xs.size, z)), axis=1).astype(np.float32)


def near(places, x, y, reach=0.05):
    return bool(len(places)) and bool((np.hypot(*(places - (x, y)).T) < reach).any())


# the window


@pytest.mark.parametrize(
    ("z", "counts"), [(0.0, False), (0.04, False), (0.1, True), (0.75, True), (1.29, True), (1.4, False)]
)
def test_what_is_between_the_floor_and_its_height_counts(z, counts):
    seen = window()
    seen.take(1.0, surface(1.0, 0.5, z), EYE, HERE)
    assert bool(len(seen.places(1.0))) is counts
    if counts:
        assert near(seen.places(1.0), 1.0, 0.5)
        assert (np.abs(seen.places(1.0) - (1.0, 0.5)) < 0.2).all()


def test_a_step_down_is_seen_through_the_floor():
    seen = window()
    seen.take(1.0, np.concatenate((surface(1.0, 0.0, 0.0), surface(1.6, 0.0, -0.12))), EYE, HERE)
    places = seen.places(1.0)
    assert len(places)
    # the rays come through the floor's height a little before where they end, and beyond the floor that is seen
    ahead = 0.1 + 1.5 * 1.1 / 1.22
    assert near(places, ahead, 0.0)
    assert places[:, 0].min() > 1.15
    seen.take(2.0, surface(ahead, 0.0, 0.0, 0.8, 0.8), EYE, HERE)  # it was covered
    assert not len(seen.places(2.0))


def test_one_point_is_noise_and_the_robot_itself_is_none():
    seen = window()
    seen.take(
        1.0, np.array([(1.0, 0.0, 0.7), (0.05, 0.0, 0.9), (0.06, 0.0, 0.9), (0.05, 0.01, 0.9)], np.float32), EYE, HERE
    )
    assert not len(seen.places(1.0))


def test_what_went_away_is_forgotten_where_rays_go_on_behind_it_alone():
    seen, board, wall = window(), surface(1.0, 0.0, 0.7), surface(2.0, 0.0, 0.0, 2.4, 3.0)
    seen.take(1.0, board, EYE, HERE)
    aside = wall[np.abs(wall[:, 1]) > 0.8]
    seen.take(2.0, aside, EYE, HERE)  # nobody looks there
    assert near(seen.places(2.0), 1.0, 0.0)
    hidden = board - np.float32([0.25, 0.0, -0.15])  # something nearer stands before it
    seen.take(2.5, hidden, EYE, HERE)
    assert near(seen.places(2.5), 1.0, 0.0)
    seen.take(3.0, wall, EYE, HERE)
    assert not near(seen.places(3.0), 1.0, 0.0)
    seen.take(4.0, board, EYE, HERE)
    assert near(seen.places(23.9), 1.0, 0.0)
    assert not len(seen.places(24.1))


def test_it_goes_with_the_robot():
    seen = window()
    seen.take(1.0, surface(1.0, 0.5, 0.7), EYE, HERE)
    there = Pose(1.03, -0.4, 2.0)
    seen.take(2.0, surface(1.5, -1.5, 0.7), np.array((1.0, -0.4, 1.1)), there)
    assert near(seen.places(2.0), 1.0, 0.5)
    assert near(seen.places(2.0), 1.5, -1.5)
    seen.take(3.0, surface(30.0, 0.0, 0.7), np.array((29.0, 0.0, 1.1)), Pose(29.0, 0.0, 0.0))
    assert (seen.places(3.0)[:, 0] > 29.0).all()
    seen.take(4.0, surface(1.0, 0.5, 0.0), EYE, HERE)
    assert not len(seen.places(4.0))  # it was left behind


def test_a_cloud_of_millions_is_taken_in_time_and_memory_stays():
    seen = window()
    many = np.tile(surface(1.5, 0.0, 0.7, 1.0, 1.0, 0.01), (100, 1))
    assert len(many) == 1_000_000
    for now in (1.0, 2.0):
        seen.take(now, many, EYE, HERE)
    assert len(seen.places(2.0)) <= 22 * 22


# its sources


def test_a_source_is_silent_until_it_comes_and_after_its_timeout():
    there = Obstacles(RobotGotoSection(obstacles=(CLOUD, LAYER)))
    assert there.unheard(1.0) == "the cloud /points has not come yet"
    there.cloud("/points", 1.0, surface(1.0, 0.0, 0.7), EYE, HERE)
    assert there.unheard(1.2) == "the layer /layer has not come yet"
    there.layer("/layer", np.empty((0, 2)))
    assert there.unheard(1.5) == ""
    assert "the cloud /points is silent: it said nothing for 0.6 s" in there.unheard(1.6)
    there.cloud("/points", 1.7, np.empty((0, 3), np.float32), EYE, HERE)
    assert "none of its points says anything" in there.unheard(1.7)
    there.cloud("/points", 6.4, surface(1.0, 0.0, 0.7), EYE, HERE)
    there.silent = "the layer /layer is silent"  # as who hears it says
    assert there.unheard(6.4) == "the layer /layer is silent"
    assert Obstacles(RobotGotoSection()).unheard(9.0) == ""


def test_a_layer_lies_on_the_map_and_is_given_in_the_odometrys_frame():
    there = Obstacles(RobotGotoSection(obstacles=(LAYER,)))
    there.layer("/layer", np.array([(2.0, 3.0), (50.0, 0.0)]))
    found = there.places(1.0, Pose(1.0, 3.0, 0.0), Pose(-4.0, 0.0, math.pi / 2))
    np.testing.assert_allclose(found, [(-4.0, 1.0)], atol=1e-9)
    assert not len(there.places(1.0, None, HERE))


def test_a_layer_stands_when_the_clock_is_set_back():
    there = Obstacles(RobotGotoSection(obstacles=(CLOUD, LAYER)))
    there.cloud("/points", 100.0, surface(1.0, 0.0, 0.7), EYE, HERE)
    there.layer("/layer", np.array([(2.0, 3.0)]))
    there.clear()
    assert there.unheard(1.0) == "the cloud /points has not come yet"
    np.testing.assert_allclose(there.places(1.0, HERE, HERE), [(2.0, 3.0)])


# driving

BOARD = Piece("board", 1.4, 0.0, 0.0, 0.8, 1.0, 0.03, above=0.72)
"""A table without legs: the laser sees nothing of it."""


def test_with_the_laser_alone_it_strikes_a_table():
    scene = Scene()
    scene.sim.world.spawn(BOARD, "board")
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    scene.run(10.0)
    assert scene.touched


def test_with_clouds_it_drives_round_a_table():
    scene = Scene(camera=True, obstacles=(CLOUD,))
    scene.sim.world.spawn(BOARD, "board")
    assert scene.goto(3.0, 0.0, 0.0) is State.REACHED
    assert not scene.touched
    assert "the way is blocked" not in scene.reasons


def test_without_avoidance_it_stops_at_a_tables_edge_and_goes_on_when_it_is_gone():
    scene = Scene(camera=True, obstacles=(CLOUD,), enable_obstacles_avoidance=False, memory=5.0)
    scene.sim.world.spawn(BOARD, "board")
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    scene.until(lambda: scene.driver.status.fault is Fault.BLOCKED, 20.0)
    scene.run(2.0)
    assert scene.driver.status.reason == "there is an obstacle on the way"
    assert 0.2 < scene.pose.x < 1.0 - 0.3
    scene.sim.world.remove("board")
    scene.until(lambda: scene.driver.status.state is State.REACHED, 40.0)
    assert not scene.touched


def test_where_clouds_fall_silent_it_stands_as_without_a_laser():
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


def test_before_a_drop_it_turns_away():
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
