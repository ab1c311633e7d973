"""The pose of the robot from the frames of several publishers."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.clock import RunClock, SystemClock
from bridge.messages.scan import LaserScan
from bridge.tf.stamped import TF, TF_STATIC, Stamped, write
from navigation.frames import FramesError, RobotFrames
from navigation.goals import goal_of
from navigation.pose import Pose
from navigation.robot_goto.module import RobotGoto
from navigation.robot_path_planner.module import ObstacleScans
from navigation.status import PlanError

S = 1_000_000_000
START = 1_790_000_000 * S


class FramePublisher:
    """A host with a clock that only the test advances, and with the frames that the test publishes."""

    def __init__(self, **options: Any) -> None:
        self.now = START
        self.subscribers: dict[str, Callable[[bytes], None]] = {}
        node = SimpleNamespace(
            subscription_cdr=lambda topic, _type, receive, _qos, *, at_once: self.subscribers.update({topic: receive})  # noqa: ARG005
        )
        self.node = node
        clock = SimpleNamespace(now_ns=lambda: self.now, on_jump=lambda _: None)
        host: Any = SimpleNamespace(node=node, clock=clock)
        self.frames = RobotFrames(host, **options)

    def publish(self, parent: str, child: str, pose: Pose, ago: float = 0.0, topic: str = TF) -> None:
        rotation = (0.0, 0.0, math.sin(pose.theta / 2), math.cos(pose.theta / 2))
        transform = Stamped(parent, child, self.now - round(ago * S), (pose.x, pose.y, 0.0), rotation)
        self.subscribers[topic](write([transform]))


def test_the_pose_is_the_newest_odometry_in_the_newest_correction() -> None:
    publisher = FramePublisher()
    publisher.publish("map", "odom", Pose(1.0, 2.0, math.pi / 2), ago=1.5)
    publisher.publish("odom", "base_link", Pose(9.0, 9.0, 0.0), ago=1.5)
    publisher.publish("odom", "base_link", Pose(3.0, 0.5, 0.25), ago=0.1)
    pose = publisher.frames.pose()
    assert pose[:3] == pytest.approx((0.5, 5.0, math.pi / 2 + 0.25))
    assert pose.stamp_ns == START - S // 10


def test_a_correction_with_a_future_stamp_is_used() -> None:
    publisher = FramePublisher()
    publisher.publish("map", "odom", Pose(1.0, 0.0, 0.0), ago=-0.3)
    publisher.publish("odom", "base_link", Pose(1.0, 0.0, 0.0))
    assert publisher.frames.pose()[:3] == pytest.approx((2.0, 0.0, 0.0))


def test_the_silent_source_is_named() -> None:
    publisher = FramePublisher()
    with pytest.raises(FramesError, match="no transform from base_link to"):
        publisher.frames.pose()
    publisher.publish("odom", "base_link", Pose(0.0, 0.0, 0.0))
    with pytest.raises(FramesError, match="no transform from odom to map"):
        publisher.frames.pose()
    publisher.publish("map", "odom", Pose(0.0, 0.0, 0.0))
    publisher.now += S
    with pytest.raises(FramesError, match=r"odometry is stale: base_link in odom was last published 1\.0 s ago"):
        publisher.frames.pose()
    publisher.now += 2 * S
    publisher.publish("odom", "base_link", Pose(0.0, 0.0, 0.0))
    with pytest.raises(FramesError, match=r"localization is stale: odom in map was last published 3\.0 s ago"):
        publisher.frames.pose()


def test_without_an_odometry_frame_the_localizer_gives_the_pose_directly() -> None:
    publisher = FramePublisher(base_frame="/body")
    publisher.publish("map", "body", Pose(1.0, 2.0, 0.5))
    assert publisher.frames.pose()[:3] == pytest.approx((1.0, 2.0, 0.5))
    publisher.now += 3 * S
    with pytest.raises(FramesError, match="localization is stale"):
        publisher.frames.pose()


def test_a_pose_and_its_inverse_cancel() -> None:
    publisher = FramePublisher()
    publisher.publish("base_link", "laser", Pose(0.1, 0.0, math.pi), topic="/tf_static")
    assert publisher.frames.transform("base_link", "laser")[:3] == pytest.approx((0.1, 0.0, math.pi))
    pose = Pose(1.0, 2.0, 3.0)
    assert (pose @ pose.inverse)[:3] == pytest.approx((0.0, 0.0, 0.0))
    assert (pose.inverse @ pose)[:3] == pytest.approx((0.0, 0.0, 0.0))


def test_a_frame_of_the_robot_is_placed_by_its_current_pose() -> None:
    publisher = FramePublisher()
    publisher.publish("map", "odom", Pose(1.0, 0.0, 0.0))
    publisher.publish("map", "dock", Pose(5.0, 5.0, 0.0))
    publisher.publish("odom", "base_footprint", Pose(2.0, 0.0, 0.0))
    publisher.publish("base_footprint", "base_link", Pose(0.0, 0.0, 0.0), topic="/tf_static")
    publisher.publish("base_link", "laser", Pose(0.1, 0.0, 0.0), topic="/tf_static")
    on_map = publisher.frames.on_map
    for frame, x in (("base_link", 3.0), ("base_footprint", 3.0), ("laser", 3.1), ("odom", 1.0), ("dock", 5.0)):
        assert on_map(frame).x == pytest.approx(x)
    publisher.now += S
    for frame in ("base_link", "base_footprint", "laser"):
        with pytest.raises(FramesError, match="odometry is stale"):
            on_map(frame)
    assert on_map("odom").x == 1.0
    publisher.now += 2 * S
    with pytest.raises(FramesError, match="localization is stale"):
        on_map("odom")
    assert on_map("dock").x == 5.0, "the dock is fixed on the map"
    origin = {"position": {"x": 1.0, "y": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    goal = {"pose": {"header": {"frame_id": "base_link"}, "pose": origin}, "behavior_tree": ""}
    with pytest.raises(PlanError, match="the goal is in the frame 'base_link': the odometry is stale"):
        goal_of(goal, publisher.frames, lambda: ())


def test_scans_of_a_laser_that_is_mounted_upside_down_are_mirrored() -> None:
    publisher = FramePublisher()
    publisher.publish("map", "odom", Pose(0.0, 0.0, 0.0))
    publisher.publish("odom", "base_link", Pose(0.0, 0.0, 0.0))
    # the laser is mounted upside down, and then turned by half a radian on the base
    mounting = Stamped("base_link", "laser", 0, (0.0, 0.0, 0.5), (math.cos(0.25), math.sin(0.25), 0.0, 0.0))
    publisher.publish("base_link", "upright", Pose(0.0, 0.0, 0.5))
    publisher.subscribers[TF_STATIC](write([mounting]))
    answers = {frame: publisher.frames.is_upside_down(frame) for frame in ("laser", "upright", "nowhere")}
    assert answers == {"laser": True, "upright": False, "nowhere": False}
    stamp = {"sec": publisher.now // S, "nanosec": publisher.now % S}
    scan = {"range_min": 0.1, "range_max": 9.0, "angle_min": 0.2, "angle_increment": 0.1, "ranges": [1.0, 2.0]}
    message = {"header": {"stamp": stamp, "frame_id": "laser"}, **scan}
    seen: list[tuple[Pose, LaserScan]] = []
    planner: Any = SimpleNamespace(active=True, scan=lambda _now, pose, turn: seen.append((pose, turn)))
    ObstacleScans(planner, publisher.frames).on_scan(0.0, message)
    driver = SimpleNamespace(scan=lambda turn, _moved, laser: seen.append((laser, turn)))
    clock = SimpleNamespace(now_ns=lambda: publisher.now)
    goto: Any = SimpleNamespace(
        _frames=publisher.frames, driver=driver, now=lambda: 0.0, _host=SimpleNamespace(clock=clock)
    )
    goto._see = partial(RobotGoto._see, goto)
    RobotGoto._on_scan(goto, message)
    assert len(seen) == 2
    for pose, turn in seen:
        # the first beam is 0.2 rad to the left of the laser, which is 0.5 - 0.2 rad on the base
        assert [pose.theta + turn.first, turn.step] == pytest.approx([0.3, -0.1])


def test_the_floor_is_as_configured_or_at_the_base_footprint() -> None:
    publisher = FramePublisher(base_frame="r2/base_link")
    assert publisher.frames.floor(None) == 0.0
    foot = Stamped("r2/base_link", "r2/base_footprint", publisher.now, (0.0, 0.0, -0.164), (0.0, 0.0, 0.0, 1.0))
    publisher.subscribers[TF_STATIC](write([foot]))
    assert publisher.frames.floor(None) == pytest.approx(-0.164)
    assert publisher.frames.floor(-0.1) == -0.1


@pytest.mark.parametrize("jump", [-40 * S, -3600 * S, 3600 * S])
def test_the_pose_is_known_again_once_it_is_published_after_a_jump_of_the_system_clock(jump: int) -> None:
    publisher = FramePublisher()
    system = SystemClock(lambda: publisher.now, lambda: 0, poll=0)
    host: Any = SimpleNamespace(node=publisher.node, clock=RunClock(system=system))
    frames = RobotFrames(host)
    publisher.publish("base_link", "laser", Pose(0.1, 0.0, 0.0), topic=TF_STATIC)
    publisher.publish("map", "odom", Pose(1.0, 0.0, 0.0), ago=-0.2)
    publisher.publish("odom", "base_link", Pose(1.0, 0.0, 0.0))
    assert frames.pose().x == pytest.approx(2.0)
    publisher.now += jump
    assert system.check() == jump
    with pytest.raises(FramesError):
        frames.pose()
    publisher.publish("map", "odom", Pose(1.0, 0.0, 0.0))
    publisher.publish("odom", "base_link", Pose(2.0, 0.0, 0.0))
    assert frames.pose().x == pytest.approx(3.0)
    assert frames.transform("base_link", "laser", publisher.now).x == pytest.approx(0.1)
