"""A ROS 2 client drives a ROS 1 actionlib server and a ROS 1 client a ROS 2 server, through the daemon."""

from __future__ import annotations

from typing import Any

from tests.interop.deployment import Deployment
from tests.support.peer import Peer

SECONDS = 40.0
TYPES = {"ros1": "move_base_msgs/MoveBase", "ros2": "nav2_msgs/NavigateToPose"}
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def pose(x: float) -> dict[str, Any]:
    return {"header": {"frame_id": "map"}, "pose": {"position": {"x": x}, "orientation": {"w": 1.0}}}


GOAL = {"ros1": {"target_pose": pose(3.5)}, "ros2": {"pose": pose(3.5)}}
FEEDBACK = {"ros1": {"base_position": pose(1.5)}, "ros2": {"current_pose": pose(1.5)}}
FIELDS = {"ros1": ("target_pose", "base_position"), "ros2": ("pose", "current_pose")}


class Pair:
    """A server on one side and a client on the other."""

    def __init__(self, deployment: Deployment, server: str, client: str) -> None:
        programs = {"ros1": deployment.ros1, "ros2": deployment.ros2}
        self.sides = server, client
        self.server: Peer = programs[server]()
        self.client: Peer = programs[client]()

    def name(self, kind: str) -> str:
        """An action's name of this pair's own."""
        return f"/{self.sides[0]}_{kind}"

    def act(self, name: str, **more: Any) -> int:
        """Serve an action."""
        side = self.sides[0]
        feedback = [FEEDBACK[side]]
        return int(self.server.ask("act", action=name, type=TYPES[side], feedback=feedback, **more)["id"])

    def send(self, name: str) -> int:
        """Send a goal."""
        side = self.sides[1]
        more = {"goal": GOAL[side], "seconds": SECONDS}
        return int(self.client.ask("send_goal", action=name, type=TYPES[side], **more)["id"])

    def goal(self, goal: int, **until: Any) -> dict[str, Any]:
        """What the client knows of a goal, once these fields are so."""
        found = self.client.ask("goal", id=goal, until=until, seconds=SECONDS)
        assert {k: len(found[k]) if k == "feedback" else found[k] for k in until} == until
        return found


def at(message: dict[str, Any]) -> tuple[str, float]:
    """Frame and place of a stamped pose."""
    return message["header"]["frame_id"], message["pose"]["position"]["x"]


def test_actions_between_ros1_and_ros2(running: Deployment) -> None:
    for server, client in (("ros1", "ros2"), ("ros2", "ros1")):
        pair = Pair(running, server, client)
        drive(pair)
        pair.act(pair.name("killed"), held=True)
        goal = pair.send(pair.name("killed"))
        pair.goal(goal, accepted=True, feedback=1)
        pair.server.stop(0)
        pair.goal(goal, status=ABORTED)


def drive(pair: Pair) -> None:
    """One goal of each kind."""
    server, client = pair.sides
    held = pair.act(pair.name("held"), held=True)
    goal = pair.send(pair.name("held"))
    heard = pair.goal(goal, accepted=True, feedback=1)
    (seen,) = pair.server.ask("goals", id=held)["goals"]
    assert at(seen[FIELDS[server][0]]) == ("map", 3.5)
    assert at(heard["feedback"][0][FIELDS[client][1]]) == ("map", 1.5)
    pair.server.ask("release", id=held)
    assert pair.goal(goal, status=SUCCEEDED)["result"] is not None
    for kind, more, status in (
        ("abort", {"outcome": "abort"}, ABORTED),
        ("cancel", {"held": True}, CANCELED),
        ("reject", {"outcome": "reject"}, 0),
    ):
        pair.act(pair.name(kind), **more)
        goal = pair.send(pair.name(kind))
        if kind == "cancel":
            pair.goal(goal, accepted=True, feedback=1)
            pair.client.ask("cancel", id=goal)
            pair.goal(goal, cancel=[0, 1])
        pair.goal(goal, accepted=kind != "reject", status=status)
