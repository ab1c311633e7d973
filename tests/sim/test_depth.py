"""The depth camera: its lens, noise, frames and faults; and collisions over the whole height of the R1."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.tf.buffer import TransformBuffer
from navigation.clouds import read_points, transform_points
from sim import messages
from sim.base import BasePose
from sim.depth import DepthCamera
from sim.plan import Box, Floor, Plan, load_plan
from sim.section import CameraSection, SimSection
from sim.simulation import Simulation
from sim.world import solids_of
from tests.peers.sim.floors import drive, simulation

NONE = np.zeros((0, 8))
WALL = np.array([(4.1, 0.0, 1.0, 0.0, 2.0, 40.0, -20.0, 20.0)])
"""A wall 2.1 m ahead of the origin, much larger than the camera's view."""


def camera(**changed: object) -> DepthCamera:
    values = {"rate": 5.0, "at": (0.1, 0.0, 1.0), "pitch": 0.0, "noise": 0.0, **changed}
    return DepthCamera(CameraSection.model_validate(values), seed=3)


def test_the_default_field_of_view_equals_a_d435s() -> None:
    depth_camera = camera()
    assert depth_camera.size == (640, 480)
    fx, fy, cx, cy = depth_camera.lens
    assert math.degrees(2 * math.atan(320 / fx)) == pytest.approx(87.0)
    assert math.degrees(2 * math.atan(240 / fy)) == pytest.approx(58.0)
    assert (cx, cy) == (319.5, 239.5)


def test_noise_grows_with_the_square_of_the_depth() -> None:
    depth_camera = camera(noise=0.08)
    for depth in (1.0, 2.0, 4.0):
        wall = np.add(WALL, (depth - 2.0, 0, 0, 0, 0, 0, 0, 0))
        seen = depth_camera.picture(7, BasePose(0.0, 0.0, 0.0), wall, NONE)
        middle = seen[:240]  # the upper half, above the floor
        expected = depth**2 * 0.08 / (depth_camera.lens[0] * 0.05)
        assert middle.mean() == pytest.approx(depth, abs=4 * expected / math.sqrt(middle.size))
        assert middle.std() == pytest.approx(expected, rel=0.02)


def test_noise_depends_only_on_the_time() -> None:
    depth_camera = camera(noise=0.5, dropouts=0.1)
    at = BasePose(0.0, 0.0, 0.0)
    first, _, again = (depth_camera.picture(time, at, WALL, NONE) for time in (5, 6, 5))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, depth_camera.picture(6, at, WALL, NONE), equal_nan=True)
    assert np.isnan(first).mean() == pytest.approx(0.1, abs=0.01)


def test_depths_out_of_range_are_infinite() -> None:
    depth_camera = camera(nearest=1.95, farthest=3.0)
    seen = depth_camera.picture(1, BasePose(0.0, 0.0, 0.0), WALL, NONE)
    assert seen[100, 320] == pytest.approx(2.0)
    assert depth_camera.picture(1, BasePose(0.1, 0.0, 0.0), WALL, NONE)[100, 320] == -math.inf
    assert depth_camera.picture(1, BasePose(-2.0, 0.0, 0.0), WALL, NONE)[100, 320] == math.inf
    points = depth_camera.points(seen)
    assert points[100, 320, 2] == pytest.approx(2.0)
    assert points[100, 0, 0] == pytest.approx(-2.0 * math.tan(math.radians(43.5)), rel=2e-3)
    assert not np.isfinite(depth_camera.points(np.full((480, 640), np.inf, np.float32))[..., 2]).any()


def test_the_mounts_pitch_and_yaw_turn_the_rays() -> None:
    """The middle pixel's ray hits the floor at a distance that follows from the pitch, in the direction of the yaw."""
    depth_camera = camera(at=(0.2, 0.1, 1.2), pitch=30.0, yaw=20.0, width=17, height=17)
    box = (1.2 / math.tan(math.radians(30.0))) * np.array([math.cos(math.radians(20.0)), math.sin(math.radians(20.0))])
    spot = np.array([(box[0] + 0.2, box[1] + 0.1, 1.0, 0.0, 0.01, 0.0, 0.0, 1e-4)])
    turned = BasePose(3.0, -2.0, 1.0)
    around = np.array([[math.cos(1.0), -math.sin(1.0)], [math.sin(1.0), math.cos(1.0)]])
    spot[0, :2] = np.add(around @ spot[0, :2], (3.0, -2.0))
    seen, bare = (depth_camera.picture(1, turned, solids, NONE) for solids in (spot, NONE))
    assert np.argwhere(seen != bare).tolist() == [[8, 8]]
    assert seen[8, 8] == pytest.approx(1.2 / math.sin(math.radians(30.0)), rel=1e-3)


def test_the_cloud_fits_the_published_frames() -> None:
    """All points are on the floor or the box; the base frame is at the height of the axle."""
    section = CameraSection(rate=5.0, at=(0.2, -0.1, 1.1), pitch=40.0, yaw=-15.0, noise=0.0, width=32, height=24)
    depth_camera = DepthCamera(section, 0)
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
    cloud = messages.points(0, depth_camera.points(depth_camera.picture(0, BasePose(0.0, 0.0, 0.0), box, NONE)))
    points = transform_points(read_points({"is_bigendian": False, **cloud}), at)
    np.testing.assert_allclose(points[:, 2].min(), -0.16, atol=1e-5)
    top = points[np.abs(points[:, 2] - (0.3 - 0.16)) < 1e-4]
    assert len(top) > 5
    assert (np.abs(top[:, :2] - (1.3, -0.3)) < 0.2001).all()
    assert ((np.abs(points[:, 2] + 0.16) < 1e-4) | (np.abs(points[:, :2] - (1.3, -0.3)) < 0.2001).all(axis=1)).all()


@pytest.mark.parametrize(
    ("changed", "error"),
    [
        ({"nearest": 5.0, "farthest": 4.0}, "nearest must be less than farthest"),
        ({"fov": (180.0, 58.0)}, "fov"),
        ({"width": 8}, "width"),
        ({"encoding": "mono8"}, "encoding"),
        ({"pitch": 91.0}, "pitch"),
    ],
)
def test_invalid_camera_settings_are_rejected(changed: dict[str, object], error: str) -> None:
    with pytest.raises(ValidationError, match=error):
        CameraSection.model_validate(changed)


def test_pictures_have_the_configured_rate_and_faults() -> None:
    sim = simulation(camera={"rate": 5.0, "width": 16, "height": 16})
    taken = set[int]()
    for _ in range(100):
        sim.tick()
        taken.add(sim.pictured)
    assert sorted(taken)[-5:] == [round(t * 1e9) for t in (0.2, 0.4, 0.6, 0.8, 1.0)]
    assert np.isfinite(sim.depth()).any()
    sim.faults.set("camera_blind", on=True)
    sim.run(0.2)
    assert np.isnan(sim.depth()).all()
    sim.faults.set("camera_silent", on=True)
    last = sim.pictured
    sim.run(0.5)
    assert sim.pictured == last
    assert simulation().camera is None


BOARD = {"boxes": [Box(name="board", at=(1.2, 0.0, 0.0), size=(0.6, 1.0, 0.03), above=0.72)]}


def test_the_laser_sees_a_tables_legs_and_the_robot_hits_its_board() -> None:
    plan = Floor.model_validate({"tables": [{"name": "table", "at": (1.4, 0.0, 0.0), "size": (0.8, 1.0, 0.75)}]})
    sim = simulation(floor={"tables": plan.tables})
    ahead = sim.scan.ranges[len(sim.scan.ranges) // 2]
    assert ahead == pytest.approx(1.95, abs=0.02)  # the wall, between the legs
    assert np.isclose(sim.scan.ranges, math.hypot(1.0, 0.45), atol=0.03).any()  # a leg
    drive(sim, 6.0, 0.3)
    assert sim.bumps
    assert sim.base.pose().x == pytest.approx(1.0 - 0.2, abs=0.02)


def test_the_robot_fits_under_a_high_board() -> None:
    high = {"boxes": [BOARD["boxes"][0].model_copy(update={"above": 1.3})]}
    sim = simulation(floor=high)
    drive(sim, 6.0, 0.3)
    assert sim.base.pose().x > 1.5
    low = simulation(floor=BOARD)
    drive(low, 6.0, 0.3)
    assert low.base.pose().x == pytest.approx(0.9 - 0.2, abs=0.02)


def test_the_robot_tips_into_a_drop() -> None:
    sim = simulation(floor={"drops": [{"at": (1.0, 0.0), "size": (1.0, 1.0), "depth": 0.12}]})
    drive(sim, 1.0, 0.2)
    level = sim.base.body.getTransform().translation()[2]
    drive(sim, 3.0, 0.3)
    assert sim.base.body.getTransform().translation()[2] < level - 0.03
    seen = simulation(floor={"drops": [{"at": (1.0, 0.0), "size": (1.0, 1.0)}]}, camera={"rate": 5.0, "noise": 0.0})
    flat = simulation(camera={"rate": 5.0, "noise": 0.0})
    assert (seen.depth() > flat.depth() + 0.05).any()


def test_a_map_contains_only_things_that_the_laser_sees() -> None:
    from sim.export import grid
    from yarp_compat.dev.mapflag import MapFlag

    plan = load_plan("tables")
    occupancy = grid(plan, "tables")

    def flag(x: float, y: float) -> int:
        column, row = occupancy.cells_at((x, y))
        return int(occupancy.flags[row, column])

    assert flag(2.6, 2.3) == MapFlag.FREE  # under the table
    assert flag(2.6 - 0.875, 2.3 - 0.425) == MapFlag.WALL  # its leg
    assert flag(8.2, 7.2) == flag(10.3, 6.6) == MapFlag.FREE  # the steps
    assert flag(8.0, 0.35) == MapFlag.WALL


def test_boxes_above_the_floor_cannot_be_movable() -> None:
    with pytest.raises(ValidationError, match="mass and above"):
        Box(at=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0), mass=1.0, above=0.5)
    with pytest.raises(ValidationError, match="must be thinner than the table"):
        Floor.model_validate({"tables": [{"at": (0, 0, 0), "size": (1.0, 0.05, 0.7)}]})


def test_pictures_no_longer_show_removed_things() -> None:
    sim = Simulation(
        SimSection(camera={"rate": 5.0, "noise": 0.0}),
        Plan(name="p", floors={"p": Floor(boxes=(Box(name="crate", at=(1.0, 0, 0), size=(0.3,) * 3, mass=2.0),))}),
    )
    sim.run(0.2)
    assert len(sim.world.solids()) == len(solids_of([c.now() for c in sim.world.crates.values()])) == 1
    before = sim.depth().copy()
    sim.world.remove("crate")
    sim.run(0.2)
    assert (sim.depth() > before + 0.1).any()
