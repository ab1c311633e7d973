"""The stand-in for move_base behaves as measured on the real one, so that tests with it are meaningful."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.peers.navigation.gateway import pose
from tests.peers.peer import Peer
from tests.peers.ros1.network import ROS1_PYTHON, RosMaster
from tests.support.process import Process
from tests.support.wait import until

pytestmark = pytest.mark.thorough

PENDING, ACTIVE, PREEMPTED, SUCCEEDED, ABORTED, RECALLING, RECALLED = 0, 1, 2, 3, 4, 7, 8
GOAL, RESULT = "move_base_msgs/MoveBaseActionGoal", "move_base_msgs/MoveBaseActionResult"
SECONDS = 30.0


class Direct:
    """A rospy program that publishes and subscribes to actionlib's topics directly."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self._goals = peer.advertise("/move_base/goal", GOAL)
        self._cancels = peer.advertise("/move_base/cancel", "actionlib_msgs/GoalID")
        self._simple = peer.advertise("/move_base_simple/goal", "geometry_msgs/PoseStamped")
        self._results = peer.subscribe("/move_base/result", RESULT)
        self._statuses = peer.subscribe("/move_base/status", "actionlib_msgs/GoalStatusArray")
        self._lists: list[dict[str, tuple[int, str]]] = []
        self.targets = peer.subscribe("/move_base/current_goal", "geometry_msgs/PoseStamped")
        for end in (self._goals, self._cancels, self._simple):
            until(
                lambda end=end: peer.ask("connections", id=end)["count"],
                "the stand-in has subscribed to the goals",
                SECONDS,
            )
        until(lambda: peer.wait(self._statuses, 1, 0.5), "the stand-in publishes its status", SECONDS)

    def goal(self, name: str, x: float, secs: int = 0, frame: str = "map", w: float = 1.0) -> None:
        target = {**pose(x, frame=frame), "pose": {"position": {"x": x}, "orientation": {"w": w}}}
        stamp = {"secs": secs, "nsecs": 0}
        self.peer.publish(self._goals, {"goal_id": {"id": name, "stamp": stamp}, "goal": {"target_pose": target}})

    def cancel(self, name: str = "", secs: int = 0) -> None:
        self.peer.publish(self._cancels, {"id": name, "stamp": {"secs": secs, "nsecs": 0}})

    def simple(self, x: float) -> None:
        self.peer.publish(self._simple, pose(x))

    def listed(self) -> dict[str, tuple[int, str]]:
        """Return the state and the text of each goal in the newest status list."""
        return self.lists()[-1]

    def lists(self) -> list[dict[str, tuple[int, str]]]:
        """Return the state and the text of each goal in every status list so far, after waiting for another list.

        A list has ended goals only for 5 s.
        """
        known = len(self._lists)
        for message in self.peer.wait(self._statuses, known + 1, 1.0, known):
            goals = {item["goal_id"]["id"]: (item["status"], item["text"]) for item in message["status_list"]}
            self._lists.append(goals)
        return self._lists

    def is_in(self, name: str, state: int) -> str:
        """Return the text of a goal, once a status list has the goal in this state."""

        def reached() -> list[str]:
            goals = (listed[name] for listed in self.lists() if name in listed)
            return [text for found, text in goals if found == state]

        return until(reached, f"{name} is in state {state}", SECONDS)[-1]

    def result(self, name: str) -> dict[str, Any]:
        """Return a goal's result."""
        result = [m["status"] for m in self.peer.wait(self._results, 0, 0.0) if m["status"]["goal_id"]["id"] == name]
        return result[0] if len(result) == 1 else {}


@pytest.fixture
def direct() -> Iterator[Direct]:
    program = Path(__file__).parents[1] / "peers" / "ros1" / "move_base.py"
    with RosMaster() as master, Process([ROS1_PYTHON, program, "5.0", "0.3"], master.env), master.peer() as peer:
        yield Direct(peer)


def test_the_stand_in_behaves_like_measurements_of_move_base(direct: Direct) -> None:
    # final states, and their texts
    direct.goal("near", 1.0)
    assert direct.is_in("near", SUCCEEDED) == "Goal reached."
    until(lambda: direct.result("near"), "the result has arrived", SECONDS)
    direct.goal("nowhere", 999.0)
    assert direct.is_in("nowhere", ABORTED).startswith("Failed to find a valid plan.")
    direct.goal("turned", 1.0, w=0.0)
    assert direct.is_in("turned", ABORTED) == "Aborting on goal because it was sent with an invalid quaternion"

    # another goal replaces the active one; a cancellation has an empty text
    direct.goal("first", 500.0)
    direct.is_in("first", ACTIVE)
    direct.goal("second", 500.0)
    direct.is_in("second", ACTIVE)
    assert "another goal was recieved" in direct.is_in("first", PREEMPTED)
    direct.cancel("second")
    assert direct.is_in("second", PREEMPTED) == ""
    assert max(map(len, direct.lists())) >= 3  # a list with many goals

    # a goal in an unknown frame, or in one with a slash, stays active forever and is published again in each cycle
    before = len(direct.peer.wait(direct.targets, 0, 0.0))
    direct.goal("lost", 1.0, frame="/map")
    assert len(direct.peer.wait(direct.targets, before + 5, SECONDS)) >= before + 5
    until(lambda: direct.listed().get("lost", (-1, ""))[0] == ACTIVE, "the goal is active", SECONDS)
    direct.cancel()
    direct.is_in("lost", PREEMPTED)

    # ids and stamps, as in actionlib's server
    direct.simple(500.0)
    name = until(
        lambda: next((n for n, (s, _) in direct.listed().items() if s == ACTIVE), ""), "a goal has an id", SECONDS
    )
    assert re.fullmatch(r"/move_base-\d+-\d+\.\d+", name)
    direct.goal("old", 1.0, secs=5)
    assert "another goal was recieved" in direct.is_in("old", RECALLED)
    direct.cancel(secs=2_000_000_000)
    direct.is_in(name, PREEMPTED)
    direct.goal("late", 1.0, secs=1_900_000_000)
    assert "before the timestamp of the last cancel request" in direct.is_in("late", RECALLED)
    direct.cancel("never seen", secs=2_000_000_001)
    direct.is_in("never seen", RECALLING)  # goals have a separate connection, so the goal could overtake the cancel
    direct.goal("never seen", 1.0, secs=2_100_000_000)
    direct.is_in("never seen", RECALLED)
    direct.goal("again", 1.0, secs=2_100_000_000)
    direct.is_in("again", SUCCEEDED)
    direct.goal("again", 500.0, secs=2_100_000_001)  # ignored, because its id is listed
    direct.goal("last", 1.0, secs=2_100_000_002)
    direct.is_in("last", SUCCEEDED)
    assert direct.listed().get("again", (SUCCEEDED, ""))[0] == SUCCEEDED
    until(lambda: direct.result("last"), "the result has arrived", SECONDS)  # the status may precede it
    late = direct.peer.subscribe("/move_base/result", RESULT)
    assert not direct.peer.wait(late, 1, 1.0)  # a result is not latched
