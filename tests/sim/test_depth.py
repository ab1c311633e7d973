"""The depth camera: its lens and noise, what it sees of a floor, its faults; and what the R1's whole height touches."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from bridge.config.sections.sim import CameraSection, SimSection
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.tf.buffer import TransformBuffer
from navigation.clouds import placed, read_points
from sim import messages
from sim.base import BasePose
from sim.depth import DepthCamera
from sim.plan import Box, Floor, Plan, load_plan
from sim.simulation import Simulation
from sim.world import solids_of
from tests.sim.floors import drive, simulation

NONE = np.zeros((0, 8))
WALL = np.array([(4.1, 0.0, 1.0, 0.0, 2.0, 40.0, -20.0, 20.0)])
"""2.1 m ahead of the origin, and much larger than a picture."""


def camera(**changed: object) -> DepthCamera:
    values = {"rate": 5.0, "at": (0.1, 0.0, 1.0), "pitch": 0.0, "noise": 0.0, **changed}
    return DepthCamera(CameraSection.model_validate(values), seed=3)


def test_the_lens_sees_as_wide_as_a_d435() -> None:
    made = camera()
    assert made.size == (640, 480)
    fx, fy, cx, cy = made.lens
    assert math.degrees(2 * math.atan(320 / fx)) == pytest.approx(87.0)
    assert math.degrees(2 * math.atan(240 / fy)) == pytest.approx(58.0)
    assert (cx, cy) == (319.5, 239.5)


def test_noise_grows_with_the_square_of_the_depth() -> None:
    made = camera(noise=0.08)
    for depth in (1.0, 2.0, 4.0):
        wall = np.add(WALL, (depth - 2.0, 0, 0, 0, 0, 0, 0, 0))
        seen = made.picture(7, BasePose(0.0, 0.0, 0.0), wall, NONE)
        middle = seen[:240]  # above the horizon there is no floor before the wall
        expected = depth**2 * 0.08 / (made.lens[0] * 0.05)
        assert middle.mean() == pytest.approx(depth, abs=4 * expected / math.sqrt(middle.size))
        assert middle.std() == pytest.approx(expected, rel=0.02)


def test_a_picture_is_that_of_its_time() -> None:
    made = camera(noise=0.5, dropouts=0.1)
    at = BasePose(0.0, 0.0, 0.0)
    one, _, again = (made.picture(time, at, WALL, NONE) for time in (5, 6, 5))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, made.picture(6, at, WALL, NONE), equal_nan=True)
    assert np.isnan(one).mean() == pytest.approx(0.1, abs=0.01)


def test_too_near_and_too_far_are_no_depths() -> None:
    made = camera(nearest=1.95, farthest=3.0)
    seen = made.picture(1, BasePose(0.0, 0.0, 0.0), WALL, NONE)
    assert seen[100, 320] == pytest.approx(2.0)
    assert made.picture(1, BasePose(0.1, 0.0, 0.0), WALL, NONE)[100, 320] == -math.inf
    assert made.picture(1, BasePose(-2.0, 0.0, 0.0), WALL, NONE)[100, 320] == math.inf
    points = made.points(seen)
    assert points[100, 320, 2] == pytest.approx(2.0)
    assert points[100, 0, 0] == pytest.approx(-2.0 * math.tan(math.radians(43.5)), rel=2e-3)
    assert not np.isfinite(made.points(np.full((480, 640), np.inf, np.float32))[..., 2]).any()


def test_where_it_is_mounted() -> None:
    """The middle pixel's ray meets the floor where the pitch says, to the left where the yaw says."""
    made = camera(at=(0.2, 0.1, 1.2), pitch=30.0, yaw=20.0, width=17, height=17)
    box = (1.2 / math.tan(math.radians(30.0))) * np.array([math.cos(math.radians(20.0)), math.sin(math.radians(20.0))])
    spot = np.array([(box[0] + 0.2, box[1] + 0.1, 1.0, 0.0, 0.01, 0.0, 0.0, 1e-4)])
    turned = BasePose(3.0, -2.0, 1.0)
    around = np.array([[math.cos(1.0), -math.sin(1.0)], [math.sin(1.0), math.cos(1.0)]])
    spot[0, :2] = np.add(around @ spot[0, :2], (3.0, -2.0))
    seen, bare = (made.picture(1, turned, solids, NONE) for solids in (spot, NONE))
    assert np.argwhere(seen != bare).tolist() == [[8, 8]]
    assert seen[8, 8] == pytest.approx(1.2 / math.sin(math.radians(30.0)), rel=1e-3)


def test_its_cloud_in_the_frames_that_it_tells() -> None:
    """On an empty floor all points are on it, below the frame of the base, which is at its axle."""
    section = CameraSection(rate=5.0, at=(0.2, -0.1, 1.1), pitch=40.0, yaw=-15.0, noise=0.0, width=32, height=24)
    made = DepthCamera(section, 0)
    schema = Registry().schema("tf2_msgs/msg/TFMessage")
    buffer = TransformBuffer()
    buffer.set_message(
        MessageWriter(schema).message(messages.mount(0, "base", "laser", 0.2, section, 0.16)), static=True
    )
    at = buffer.lookup_transform("base", messages.OPTICAL_FRAME)
    assert at.translation == pytest.approx((0.2, -0.1, 1.1 - 0.16))
    assert buffer.lookup_transform(messages.FOOTPRINT_FRAME, messages.OPTICAL_FRAME).translation[2] == pytest.approx(
        1.1
    )
    box = np.array([(1.3, -0.3, 1.0, 0.0, 0.2, 0.2, 0.0, 0.3)])
    cloud = messages.points(0, made.points(made.picture(0, BasePose(0.0, 0.0, 0.0), box, NONE)))
    points = placed(read_points({"is_bigendian": False, **cloud}), at)
    np.testing.assert_allclose(points[:, 2].min(), -0.16, atol=1e-5)
    top = points[np.abs(points[:, 2] - (0.3 - 0.16)) < 1e-4]
    assert len(top) > 5
    assert (np.abs(top[:, :2] - (1.3, -0.3)) < 0.2001).all()
    assert ((np.abs(points[:, 2] + 0.16) < 1e-4) | (np.abs(points[:, :2] - (1.3, -0.3)) < 0.2001).all(axis=1)).all()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"nearest": 5.0, "farthest": 4.0}, "nearest is less than farthest"),
        ({"fov": (180.0, 58.0)}, "fov"),
        ({"width": 8}, "width"),
        ({"encoding": "mono8"}, "encoding"),
        ({"pitch": 91.0}, "pitch"),
    ],
)
def test_a_bad_camera_is_refused(changed: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        CameraSection.model_validate(changed)


def test_it_takes_pictures_at_its_rate_until_it_fails() -> None:
    there = simulation(camera={"rate": 5.0, "width": 16, "height": 16})
    taken = set[int]()
    for _ in range(100):
        there.tick()
        taken.add(there.pictured)
    assert sorted(taken)[-5:] == [round(t * 1e9) for t in (0.2, 0.4, 0.6, 0.8, 1.0)]
    assert np.isfinite(there.depth()).any()
    there.faults.set("camera_blind", on=True)
    there.run(0.2)
    assert np.isnan(there.depth()).all()
    there.faults.set("camera_silent", on=True)
    last = there.pictured
    there.run(0.5)
    assert there.pictured == last
    assert simulation().camera is None


BOARD = {"boxes": [Box(name="board", at=(1.2, 0.0, 0.0), size=(0.6, 1.0, 0.03), above=0.72)]}


def test_the_laser_sees_legs_and_the_robot_touches_the_board() -> None:
    plan = Floor.model_validate({"tables": [{"name": "table", "at": (1.4, 0.0, 0.0), "size": (0.8, 1.0, 0.75)}]})
    there = simulation(floor={"tables": plan.tables})
    ahead = there.scan.ranges[len(there.scan.ranges) // 2]
    assert ahead == pytest.approx(1.95, abs=0.02)  # the wall, between the legs
    assert np.isclose(there.scan.ranges, math.hypot(1.0, 0.45), atol=0.03).any()  # a leg
    drive(there, 6.0, 0.3)
    assert there.bumps
    assert there.base.pose().x == pytest.approx(1.0 - 0.2, abs=0.02)


def test_under_a_board_that_is_high_enough_it_fits() -> None:
    high = {"boxes": [BOARD["boxes"][0].model_copy(update={"above": 1.3})]}
    there = simulation(floor=high)
    drive(there, 6.0, 0.3)
    assert there.base.pose().x > 1.5
    low = simulation(floor=BOARD)
    drive(low, 6.0, 0.3)
    assert low.base.pose().x == pytest.approx(0.9 - 0.2, abs=0.02)


def test_into_a_drop_it_tips() -> None:
    there = simulation(floor={"drops": [{"at": (1.0, 0.0), "size": (1.0, 1.0), "depth": 0.12}]})
    drive(there, 1.0, 0.2)
    level = there.base.body.getTransform().translation()[2]
    drive(there, 3.0, 0.3)
    assert there.base.body.getTransform().translation()[2] < level - 0.03
    seen = simulation(floor={"drops": [{"at": (1.0, 0.0), "size": (1.0, 1.0)}]}, camera={"rate": 5.0, "noise": 0.0})
    flat = simulation(camera={"rate": 5.0, "noise": 0.0})
    assert (seen.depth() > flat.depth() + 0.05).any()


def test_a_map_has_what_the_laser_sees() -> None:
    from sim.export import grid
    from yarp_compat.dev.mapflag import MapFlag

    plan = load_plan("tables")
    made = grid(plan, "tables")

    def flag(x: float, y: float) -> int:
        column, row = made.cells_at((x, y))
        return int(made.flags[row, column])

    assert flag(2.6, 2.3) == MapFlag.FREE  # under the table
    assert flag(2.6 - 0.875, 2.3 - 0.425) == MapFlag.WALL  # its leg
    assert flag(8.2, 7.2) == flag(10.3, 6.6) == MapFlag.FREE  # the steps
    assert flag(8.0, 0.35) == MapFlag.WALL


def test_a_box_that_hangs_cannot_be_pushed() -> None:
    with pytest.raises(ValidationError, match="mass and above"):
        Box(at=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0), mass=1.0, above=0.5)
    with pytest.raises(ValidationError, match="thinner than the table"):
        Floor.model_validate({"tables": [{"at": (0, 0, 0), "size": (1.0, 0.05, 0.7)}]})


def test_what_stands_moves_with_the_picture() -> None:
    there = Simulation(
        SimSection(camera={"rate": 5.0, "noise": 0.0}),
        Plan(name="p", floors={"p": Floor(boxes=(Box(name="crate", at=(1.0, 0, 0), size=(0.3,) * 3, mass=2.0),))}),
    )
    there.run(0.2)
    assert len(there.world.solids()) == len(solids_of([c.now() for c in there.world.crates.values()])) == 1
    before = there.depth().copy()
    there.world.remove("crate")
    there.run(0.2)
    assert (there.depth() > before + 0.1).any()
