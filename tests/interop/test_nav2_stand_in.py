"""The stand-ins for Nav2 behave like Nav2's sources, and as measured on Nav2; see `tests/peers/ros2/nav2.py`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import pytest

from tests.peers.navigation.gateway import pose
from tests.peers.navigation.mix_truth import Base, Nav2
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, ros2_environment, ros2_python
from tests.support.wait import until

pytestmark = pytest.mark.thorough

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
FAR = 500.0
SECONDS = 30.0
BEHAVIORS = {
    "spin": ("Spin", {"target_yaw": 1.0, "time_allowance": {"sec": 60}}),
    "backup": ("BackUp", {"target": {"x": -FAR}, "speed": -0.5}),
    "drive_on_heading": ("DriveOnHeading", {"target": {"x": FAR}, "speed": 0.5}),
}


class Direct:
    """A client of all of Nav2's actions, and the robot's base."""

    def __init__(self, **options: Any) -> None:
        self.base = Base.ros2("--watchdog", "30")  # stands only if the velocity is zero, not if a program stalls
        self.nav2 = Nav2(2.0, 0.3, **options)
        self.peer = Peer(ROS2_PEER, ros2_python(), ros2_environment(), "direct")
        until(self.nav2.ready, "Nav2 is up", SECONDS)

    def goto(self, x: float, frame: str = "map") -> int:
        return self.send("navigate_to_pose", "NavigateToPose", {"pose": pose(x, frame=frame)})

    def follow(self, x: float) -> int:
        return self.send("follow_path", "FollowPath", {"path": {"header": {"frame_id": "map"}, "poses": [pose(x)]}})

    def send(self, action: str, type_: str, goal: dict[str, Any]) -> int:
        sent = self.peer.ask("send_goal", action=f"/{action}", type=f"nav2_msgs/{type_}", goal=goal, seconds=SECONDS)
        return int(sent["id"])

    def end(self, goal: int) -> tuple[int, int, str]:
        """Return the status, error code and error text of a goal, once it ends."""
        seen = self.peer.ask("goal", id=goal, until={"ends": 1}, seconds=SECONDS)
        assert seen["ends"] == 1, seen
        return seen["status"], seen["result"]["error_code"], seen["result"]["error_msg"]

    def cancel(self, goal: int) -> None:
        self.peer.ask("cancel", id=goal)

    def moves(self) -> None:
        until(lambda: self.base.moves, "the base moves", SECONDS)

    def stands(self) -> None:
        until(lambda: not self.base.moves, "the base stands", SECONDS)

    def close(self) -> None:
        for program in (self.peer, self.nav2, self.base):
            program.stop()


@pytest.fixture
def direct() -> Iterator[Direct]:
    direct = Direct()
    yield direct
    direct.close()


def test_goals_end_with_the_codes_of_nav2(direct: Direct) -> None:
    assert direct.end(direct.goto(1.0)) == (SUCCEEDED, 0, "")
    direct.stands()
    assert direct.end(direct.goto(999.0)) == (ABORTED, 208, "")  # an error code without a text
    assert direct.end(direct.goto(1.0, frame="nowhere")) == (ABORTED, 0, "")

    # a new goal ends the old one ABORTED without a code, and the robot keeps driving
    first = direct.goto(FAR)
    direct.moves()
    second = direct.goto(FAR + 100.0)
    assert direct.end(first) == (ABORTED, 0, "")
    assert direct.base.moves
    direct.cancel(second)
    assert direct.end(second) == (CANCELED, 0, "")
    direct.stands()


def test_the_tree_aborts_while_the_controller_keeps_driving(direct: Direct) -> None:
    goal = direct.goto(FAR)
    direct.moves()
    direct.nav2.give_up()
    assert direct.end(goal) == (ABORTED, 0, "")
    before = len(direct.base.changes())
    again = direct.goto(FAR + 100.0)  # its path replaces the abandoned one
    feedback = direct.peer.ask("goal", id=again, until={"feedback": 5}, seconds=SECONDS)["feedback"]
    assert len(feedback) >= 5
    assert len(direct.base.changes()) == before, "the base never stood"
    direct.cancel(again)
    direct.stands()


def test_paths_of_another_client_end_the_goals_path(direct: Direct) -> None:
    goal = direct.goto(FAR)
    direct.moves()
    path = direct.follow(FAR)
    assert direct.end(goal) == (ABORTED, 0, ""), "the tree lost its path to another client"
    direct.cancel(path)
    assert direct.end(path)[0] == CANCELED
    direct.stands()

    goal = direct.goto(FAR)
    direct.moves()
    cancel_all = {"goal_info": {"goal_id": {"uuid": [0] * 16}}}
    direct.peer.ask(
        "call", service="/follow_path/_action/cancel_goal", type="action_msgs/CancelGoal", request=cancel_all
    )
    assert direct.end(goal)[0] == SUCCEEDED, "the tree counts a canceled path as done"
    direct.stands()


@pytest.mark.parametrize("behavior", BEHAVIORS)
def test_a_canceled_behavior_stops_the_base(direct: Direct, behavior: str) -> None:
    goal = direct.send(behavior, *BEHAVIORS[behavior])
    direct.moves()
    direct.cancel(goal)
    assert direct.end(goal)[0] == CANCELED
    direct.stands()


def test_assisted_teleop_drives_until_it_is_canceled(direct: Direct) -> None:
    goal = direct.send("assisted_teleop", "AssistedTeleop", {"time_allowance": {"sec": 60}})
    out = direct.peer.advertise("/cmd_vel_teleop", "geometry_msgs/Twist")

    def teleoperated() -> bool:
        direct.peer.publish(out, {"linear": {"x": 0.5}})
        return direct.base.moves

    until(teleoperated, "the base moves", SECONDS, 0.2)
    direct.cancel(goal)
    assert direct.end(goal)[0] == CANCELED
    direct.stands()


def test_the_tree_reports_the_end_before_a_braking_controller_stands() -> None:
    direct = Direct(controller=("--braking", "4.0"))  # much longer than the client may take to notice the end
    goal = direct.goto(FAR)
    direct.moves()
    direct.cancel(goal)
    status, _, _ = direct.end(goal)
    ended = direct.peer.ask("goal", id=goal, seconds=0.0)["ended_at"]
    direct.stands()
    assert status == CANCELED
    assert 0.5 < direct.base.stands_after(ended) - ended < math.inf, "the tree reports the end first"
    direct.close()


@pytest.mark.parametrize(
    ("navigator", "controller", "code"),
    [((), ("--tf-tolerance", "2.0"), 102), (("--tf-tolerance", "2.0"), ("--tf-tolerance", "inf"), 202)],
)
def test_missing_transforms_abort_the_goal(navigator: tuple[str, ...], controller: tuple[str, ...], code: int) -> None:
    direct = Direct(navigator=navigator, controller=controller)
    goal = direct.goto(FAR)
    direct.moves()
    direct.base.stop(0)
    assert direct.end(goal) == (ABORTED, code, "")
    assert direct.end(direct.goto(FAR)) == (ABORTED, code, "")
    direct.close()
