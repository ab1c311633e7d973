"""A planner on the hub that replaces Midspan's planners. Its robot is a point, which the planner moves."""

from __future__ import annotations

import math
import time
from typing import Any

from bridge.modules.action_server import Goal
from navigation.messages import NAVIGATE
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import pose

SPEED, PATIENCE, UNREACHABLE = 2.0, 0.5, 900.0
"""Speed in m/s; seconds until an unreachable goal is aborted; x in meters from which on goals are unreachable."""


class HubPlanner(HubNode):
    """A planner on the hub that drives like the other stand-ins."""

    def __init__(self, settings: Any, name: str) -> None:
        super().__init__(settings)
        self.x, self._since = 0.0, 0.0
        self._goal: Goal | None = None
        self.on(
            lambda: self.node.action_server(f"/planner/{name}/navigate_to_pose", NAVIGATE, self._accept, self._cancel)
        )
        self.loop.every(0.1, self._step)

    def _accept(self, goal: Goal) -> bool:
        if self._goal is not None:
            self._goal.canceled({"error_msg": "preempted by another goal"})
        self._goal = goal
        self._since = time.monotonic()
        goal.execute()
        return True

    def _cancel(self, goal: Goal) -> bool:
        if goal is self._goal:
            self._goal = None
        self.loop.post(lambda: goal.canceled({"error_msg": "canceled"}))
        return True

    def _step(self) -> None:
        goal = self._goal
        if goal is None:
            return
        x = goal.goal["pose"]["pose"]["position"]["x"]
        left = x - self.x
        if x >= UNREACHABLE:
            if time.monotonic() - self._since > PATIENCE:
                self._goal = None
                goal.abort({"error_code": 20006, "error_msg": "no path to the goal"})
            return
        self.x += math.copysign(min(abs(left), 0.1 * SPEED), left)
        goal.feedback({"current_pose": pose(self.x), "distance_remaining": abs(left)})
        if abs(left) <= 0.1 * SPEED:
            self._goal = None
            goal.succeed()
