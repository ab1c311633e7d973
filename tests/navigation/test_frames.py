"""The pose of the robot by the frames of several publishers."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.clock import RunClock, SystemClock
from bridge.messages.scan import Turn
from bridge.tf.stamped import TF, TF_STATIC, Stamped, write
from navigation.frames import FramesError, RobotFrames
from navigation.goals import goal_of
from navigation.pose import Pose
from navigation.robot_goto.module import RobotGoto
from navigation.robot_path_planner.module import ObstacleScans
from navigation.status import PlanError

S = 1_000_000_000
START = 1_790_000_000 * S


class Said:
    """A host with a clock that only the test advances, and the frames that the test publishes."""

    def __init__(self, **options: Any) -> None:
        self.now = START
        self.heard: dict[str, Callable[[bytes], None]] = {}
        node = SimpleNamespace(
            subscription_cdr=lambda topic, _type, heard, _qos, *, at_once: self.heard.update({topic: heard})  # noqa: ARG005
        )
        self.node = node
        clock = SimpleNamespace(now_ns=lambda: self.now, on_jump=lambda _: None)
        host: Any = SimpleNamespace(node=node, clock=clock)
        self.frames = RobotFrames(host, **options)

    def say(self, parent: str, child: str, pose: Pose, ago: float = 0.0, topic: str = TF) -> None:
        turned = (0.0, 0.0, math.sin(pose.theta / 2), math.cos(pose.theta / 2))
        one = Stamped(parent, child, self.now - round(ago * S), (pose.x, pose.y, 0.0), turned)
        self.heard[topic](write([one]))


def test_the_pose_is_the_newest_odometry_in_the_newest_correction() -> None:
    said = Said()
    said.say("map", "odom", Pose(1.0, 2.0, math.pi / 2), ago=1.5)
    said.say("odom", "base_link", Pose(9.0, 9.0, 0.0), ago=1.5)
    said.say("odom", "base_link", Pose(3.0, 0.5, 0.25), ago=0.1)
    found = said.frames.pose()
    assert found[:3] == pytest.approx((0.5, 5.0, math.pi / 2 + 0.25))
    assert found.stamp_ns == START - S // 10


def test_a_correction_that_is_stamped_ahead_holds() -> None:
    said = Said()
    said.say("map", "odom", Pose(1.0, 0.0, 0.0), ago=-0.3)
    said.say("odom", "base_link", Pose(1.0, 0.0, 0.0))
    assert said.frames.pose()[:3] == pytest.approx((2.0, 0.0, 0.0))


def test_who_has_fallen_silent_is_told() -> None:
    said = Said()
    with pytest.raises(FramesError, match="not known where base_link is"):
        said.frames.pose()
    said.say("odom", "base_link", Pose(0.0, 0.0, 0.0))
    with pytest.raises(FramesError, match="not known where odom is in map"):
        said.frames.pose()
    said.say("map", "odom", Pose(0.0, 0.0, 0.0))
    said.now += S
    with pytest.raises(FramesError, match=r"odometry is stale: base_link in odom was last said 1\.0 s ago"):
        said.frames.pose()
    said.now += 2 * S
    said.say("odom", "base_link", Pose(0.0, 0.0, 0.0))
    with pytest.raises(FramesError, match=r"localisation is stale: odom in map was last said 3\.0 s ago"):
        said.frames.pose()


def test_without_an_odometry_frame_the_pose_is_said_at_once() -> None:
    said = Said(base_frame="/body")
    said.say("map", "body", Pose(1.0, 2.0, 0.5))
    assert said.frames.pose()[:3] == pytest.approx((1.0, 2.0, 0.5))
    said.now += 3 * S
    with pytest.raises(FramesError, match="localisation is stale"):
        said.frames.pose()


def test_frames_in_frames() -> None:
    said = Said()
    said.say("base_link", "laser", Pose(0.1, 0.0, math.pi), topic="/tf_static")
    assert said.frames.transform("base_link", "laser")[:3] == pytest.approx((0.1, 0.0, math.pi))
    there = Pose(1.0, 2.0, 3.0)
    assert (there @ there.inverse)[:3] == pytest.approx((0.0, 0.0, 0.0))
    assert (there.inverse @ there)[:3] == pytest.approx((0.0, 0.0, 0.0))


def test_what_is_said_in_a_frame_of_the_robots_is_where_that_is_now() -> None:
    said = Said()
    said.say("map", "odom", Pose(1.0, 0.0, 0.0))
    said.say("map", "dock", Pose(5.0, 5.0, 0.0))
    said.say("odom", "base_footprint", Pose(2.0, 0.0, 0.0))
    said.say("base_footprint", "base_link", Pose(0.0, 0.0, 0.0), topic="/tf_static")
    said.say("base_link", "laser", Pose(0.1, 0.0, 0.0), topic="/tf_static")
    on_map = said.frames.on_map
    for frame, x in (("base_link", 3.0), ("base_footprint", 3.0), ("laser", 3.1), ("odom", 1.0), ("dock", 5.0)):
        assert on_map(frame).x == pytest.approx(x)
    said.now += S
    for frame in ("base_link", "base_footprint", "laser"):
        with pytest.raises(FramesError, match="odometry is stale"):
            on_map(frame)
    assert on_map("odom").x == 1.0
    said.now += 2 * S
    with pytest.raises(FramesError, match="localisation is stale"):
        on_map("odom")
    assert on_map("dock").x == 5.0, "it does not move"
    here = {"position": {"x": 1.0, "y": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    goal = {"pose": {"header": {"frame_id": "base_link"}, "pose": here}, "behavior_tree": ""}
    with pytest.raises(PlanError, match="the goal is in the frame 'base_link': the odometry is stale"):
        goal_of(goal, said.frames, lambda: ())


def test_a_laser_that_hangs_upside_down_sees_what_is_on_its_left_on_the_right() -> None:
    said = Said()
    said.say("map", "odom", Pose(0.0, 0.0, 0.0))
    said.say("odom", "base_link", Pose(0.0, 0.0, 0.0))
    # rolled over, and then turned by half a radian on the base
    hanging = Stamped("base_link", "laser", 0, (0.0, 0.0, 0.5), (math.cos(0.25), math.sin(0.25), 0.0, 0.0))
    said.say("base_link", "upright", Pose(0.0, 0.0, 0.5))
    said.heard[TF_STATIC](write([hanging]))
    assert (said.frames.hangs("laser"), said.frames.hangs("upright"), said.frames.hangs("nowhere")) == (
        True,
        False,
        False,
    )
    stamp = {"sec": said.now // S, "nanosec": said.now % S}
    scan = {"range_min": 0.1, "range_max": 9.0, "angle_min": 0.2, "angle_increment": 0.1, "ranges": [1.0, 2.0]}
    message = {"header": {"stamp": stamp, "frame_id": "laser"}, **scan}
    seen: list[tuple[Pose, Turn]] = []
    planner: Any = SimpleNamespace(active=True, scan=lambda _now, pose, turn: seen.append((pose, turn)))
    ObstacleScans(planner, said.frames).take(0.0, message)
    driver = SimpleNamespace(scan=lambda turn, _moved, laser: seen.append((laser, turn)))
    clock = SimpleNamespace(now_ns=lambda: said.now)
    goto: Any = SimpleNamespace(_frames=said.frames, driver=driver, now=lambda: 0.0, _host=SimpleNamespace(clock=clock))
    goto._see = partial(RobotGoto._see, goto)
    RobotGoto._scanned(goto, message)
    assert len(seen) == 2
    for pose, turn in seen:
        # the first beam is 0.2 to the laser's left, which is 0.5 - 0.2 on the base
        assert [pose.theta + turn.first, turn.step] == pytest.approx([0.3, -0.1])


def test_the_floor_is_as_it_is_told_or_at_the_robots_footprint() -> None:
    said = Said(base_frame="r2/base_link")
    assert said.frames.floor(None) == 0.0
    foot = Stamped("r2/base_link", "r2/base_footprint", said.now, (0.0, 0.0, -0.164), (0.0, 0.0, 0.0, 1.0))
    said.heard[TF_STATIC](write([foot]))
    assert said.frames.floor(None) == pytest.approx(-0.164)
    assert said.frames.floor(-0.1) == -0.1


@pytest.mark.parametrize("jump", [-40 * S, -3600 * S, 3600 * S])
def test_the_pose_is_known_again_as_soon_as_it_is_published_after_a_jump_of_the_system_clock(jump: int) -> None:
    said = Said()
    system = SystemClock(lambda: said.now, lambda: 0, poll=0)
    host: Any = SimpleNamespace(node=said.node, clock=RunClock(system=system))
    frames = RobotFrames(host)
    said.say("base_link", "laser", Pose(0.1, 0.0, 0.0), topic=TF_STATIC)
    said.say("map", "odom", Pose(1.0, 0.0, 0.0), ago=-0.2)
    said.say("odom", "base_link", Pose(1.0, 0.0, 0.0))
    assert frames.pose().x == pytest.approx(2.0)
    said.now += jump
    assert system.check() == jump
    with pytest.raises(FramesError):
        frames.pose()
    said.say("map", "odom", Pose(1.0, 0.0, 0.0))
    said.say("odom", "base_link", Pose(2.0, 0.0, 0.0))
    assert frames.pose().x == pytest.approx(3.0)
    assert frames.transform("base_link", "laser", said.now).x == pytest.approx(0.1)
