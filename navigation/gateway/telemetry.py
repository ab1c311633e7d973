"""The topics that a planner publishes in addition to its action: status, path, local map and current goal."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from bridge.config.sections.navigation import NavigationSection
from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from navigation.messages import GRID, Message
from navigation.status import STATUS, State

PATH, POSE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"
_LOCAL = {"robot_path_planner": "robot_goto"}  # robot_goto publishes the local map of robot_path_planner


def local_map_topic(section: NavigationSection, planner: str) -> str:
    """Return the topic of a planner's local map (``nav_msgs/OccupancyGrid``), "" if the planner has none."""
    other = section.others.get(planner)
    return other.local_map if other else f"/planner/{_LOCAL.get(planner, planner)}/local_map"


class Telemetry:
    """The newest messages on a planner's status, path, local map and current goal topics."""

    def __init__(self, host: Host, section: NavigationSection, planner: str, changed: Callable[[], None]) -> None:
        self._host, self._planner, self._changed = host, planner, changed
        self._beat_at, self._beats = 0.0, 0
        self._status: Message | None = None
        self.path: Message | None = None
        self.local_map: Message | None = None
        self.current_goal: Message | None = None
        other = section.others.get(planner)
        base = f"/planner/{planner}"
        topics = {
            "path": (other.path if other else "", PATH),
            "local_map": (local_map_topic(section, planner), GRID),
            "current_goal": (other.current_goal if other else "", POSE),
        }
        self.topics = [f"{base}/status", *(topic for topic, _ in topics.values() if topic)]
        node = host.node
        self._endpoints = [
            node.subscription(f"{base}/status", STATUS, self._on_status, LATCHED),
            *(
                node.subscription(topic or f"{base}/{name}", kind, partial(setattr, self, name), LATCHED)
                for name, (topic, kind) in topics.items()
            ),
        ]

    @property
    def silent(self) -> float:
        """Seconds since the planner's last message about the goal; 0 for a planner that only publishes changes."""
        return time.monotonic() - self._beat_at if self._beats else 0.0

    def published_since(self, at: float) -> bool:
        """Return whether the planner has published anything since a time (monotonic seconds)."""
        return self._beat_at > at

    def begin(self) -> None:
        """Start a new goal."""
        self.path, self._beats = None, 0

    def beat(self, *, counts: bool = True) -> None:
        """Note that the planner published something; ``counts``: whether that shows that it publishes regularly."""
        self._beat_at, self._beats = time.monotonic(), self._beats + counts

    def reported(self, goal: bytes) -> tuple[State, str] | None:
        """Return the state and the reason that the planner published for a goal, if any."""
        status = self._status
        if status is None or bytes(status["goal_id"]) != goal:
            return None
        return State(status["state"]), str(status["reason"])

    def code(self, goal: bytes) -> int:
        """Return the code of the reason why the goal waits or failed; 0 if unknown."""
        status = self._status
        return int(status["error_code"]) if status is not None and bytes(status["goal_id"]) == goal else 0

    def pose(self, goal: bytes) -> Message | None:
        """Return the pose of a goal of the planner's own client, if the planner publishes that pose."""
        status = self._status
        if status is not None and bytes(status["goal_id"]) == goal:
            return dict(status["goal"])
        return self.current_goal

    def close(self) -> None:
        for endpoint in self._endpoints:
            self._host.node.release(endpoint)

    def _on_status(self, message: Message) -> None:
        try:
            State(message["state"])
        except ValueError:
            self._host.log.warning("the planner %s published an unknown state: %r", self._planner, message["state"])
            return
        self._status = message
        self.beat()
        self._changed()
