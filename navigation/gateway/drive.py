"""One client's drive: where it goes, goal by goal."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bridge.config.sections.navigation import OURS
from bridge.modules.action_client import SentGoal
from bridge.modules.action_server import Goal
from bridge.modules.goal import Status
from navigation.constraints import PREFIX, Constraints
from navigation.maps.grid import yaw_of
from navigation.messages import pose_message
from navigation.pose import Pose

_NO_STAMP = {"sec": 0, "nanosec": 0}


@dataclass(frozen=True)
class Target:
    """A pose to drive to.

    Attributes:
        pose: where, metres and rad; a theta that is no number means that any heading will do.
        frame: what it is in; the name of another map of the store for a place there.
        tree: the client's ``behavior_tree``.
    """

    pose: Pose
    frame: str
    tree: str = ""

    def goal(self, planner: str, robot: Pose | None) -> dict[str, Any]:
        """The goal for a planner, without a stamp: those of two machines' clocks would decide what it means.

        Args:
            planner: its id; Midspan's own words are for those of ours, names of behaviour trees for others.
            robot: where the robot is, where that is known: in any heading is the one that it comes with.
        """
        ours, tree = planner in OURS, self.tree
        if tree.startswith(PREFIX) != ours:
            tree = ""
        if math.isnan(self.pose.theta) and ours and not tree:
            tree = Constraints(heading=False).to_text()
        return {"pose": self.stamped(robot), "behavior_tree": tree}

    def stamped(self, robot: Pose | None = None) -> dict[str, Any]:
        """As a ``geometry_msgs/PoseStamped``."""
        pose = self.pose
        if math.isnan(pose.theta) and robot is not None:
            pose = pose._replace(theta=math.atan2(pose.y - robot.y, pose.x - robot.x))
        return {"header": {"stamp": _NO_STAMP, "frame_id": self.frame}, "pose": pose_message(pose)}


class TargetError(ValueError):
    """A goal that no planner could follow; the text says why."""


def target_of(message: Mapping[str, Any], tree: str = "") -> Target:
    """The target of a ``geometry_msgs/PoseStamped``.

    Raises:
        TargetError: it has no frame, or a number that is none, or its quaternion is no rotation.
    """
    frame = str(message["header"]["frame_id"]).lstrip("/")
    position, turn = message["pose"]["position"], message["pose"]["orientation"]
    if not frame:
        raise TargetError("the goal's frame is empty; on the map it is 'map'")
    if not all(map(math.isfinite, (*position.values(), *turn.values()))):
        raise TargetError("the goal's pose has a number that is none")
    length = math.sqrt(sum(value * value for value in turn.values()))
    if not 0.9 < length < 1.1:
        raise TargetError(f"the goal's quaternion is no rotation: its length is {length:.2f}, not 1")
    return Target(Pose(float(position["x"]), float(position["y"]), yaw_of(turn)), frame, tree)


@dataclass
class Drive:
    """What a client wants, until it is there or given up. A goal of an action stays active in pauses and repetitions.

    Attributes:
        targets: the goals, one after the other.
        who: the client, for people.
        goal: the client's own goal, where it came by the action.
        name: of the place, where it was given one.
        at: which of the targets it is driving to.
        sent: the goal that the planner has now, or had last.
        sent_at: when it was sent (monotonic).
        paused: whether it stands because it was told to.
        stopping: why it is being given up, "" where it is not.
        waiting_until: when it is given up because the planner is not there (monotonic), None while that is.
    """

    targets: Sequence[Target]
    who: str
    goal: Goal | None = None
    name: str = ""
    at: int = 0
    sent: SentGoal | None = None
    sent_at: float = 0.0
    paused: bool = False
    stopping: str = ""
    waiting_until: float | None = None
    began: float = field(default_factory=time.monotonic)
    own_id: bytes = field(default_factory=lambda: uuid.uuid4().bytes)

    @property
    def id(self) -> bytes:
        """The client's goal id, or one of our own."""
        return self.own_id if self.goal is None else self.goal.id

    @property
    def target(self) -> Target:
        """Where it is driving to."""
        return self.targets[self.at]

    @property
    def below(self) -> SentGoal | None:
        """The planner's goal, while it has one."""
        return self.sent if self.sent is not None and self.sent.active else None

    def end(self, status: Status, code: int, why: str) -> None:
        """Tell the client how its goal ended."""
        if self.goal is None:
            return
        result = {"error_code": int(code), "error_msg": why}
        if status is Status.SUCCEEDED:
            self.goal.succeed({})
        elif status is Status.CANCELED:
            self.goal.canceled(result)
        else:
            self.goal.abort(result)
