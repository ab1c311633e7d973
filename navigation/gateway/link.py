"""The chosen planner, as the gateway sees it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from bridge.config.sections.navigation import OURS, NavigationSection
from bridge.hub.qos import Durability, Qos
from bridge.modules.action_client import ActionClient, Ended, SentGoal
from bridge.modules.goal import STATUSES, Status, parts
from bridge.modules.host import Host
from navigation.status import STATUS, State

NAVIGATE = "nav2_msgs/action/NavigateToPose"
PATH, GRID, POSE = "nav_msgs/msg/Path", "nav_msgs/msg/OccupancyGrid", "geometry_msgs/msg/PoseStamped"
KEPT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_LOCAL = {"robot_path_planner": "robot_goto"}
"""Who has the local map of a planner that drives by another."""

_SENT_KEPT = 1000
_AGAIN_SECONDS = 5.0

Message = dict[str, Any]


class Link:
    """Sends goals to a planner, and follows what it tells; all on the module's thread.

    Args:
        host: the module's.
        section: says where the planner is.
        planner: which one.
        changed: called when the planner told something new.

    Attributes:
        lost_at: when it was last seen not to be there (monotonic); before the first look it was not.
        ended: a goal of others that ended last, how, and why where that is known.
        path: what it told last, as are ``local_map`` and ``current_goal``.
    """

    def __init__(self, host: Host, section: NavigationSection, planner: str, changed: Callable[[], None]) -> None:
        self.planner, self._changed = planner, changed
        self._host = host
        action = section.at(planner)
        self._client = ActionClient(host.node, action, NAVIGATE)
        self._mine: dict[bytes, SentGoal] = {}
        self.lost_at = time.monotonic()
        self._orphans: dict[bytes, float] = {}
        self._listed: dict[bytes, Status] = {}
        self._lister = b""
        self._followed: bytes | None = None
        self._own: Message | None = None
        self.ended: tuple[bytes, State, str] | None = None
        self.path: Message | None = None
        self.local_map: Message | None = None
        self.current_goal: Message | None = None
        other = section.others.get(planner)
        base = f"/planner/{planner}"
        node = host.node
        topics = {
            "path": (other.path if other else "", PATH),
            "local_map": (other.local_map if other else f"/planner/{_LOCAL.get(planner, planner)}/local_map", GRID),
            "current_goal": (other.current_goal if other else "", POSE),
        }
        self._list = node.subscription(parts(action).status, STATUSES, self._hear_list, KEPT)
        self._ends = [
            self._list,
            node.subscription(f"{base}/status", STATUS, self._hear_status, KEPT),
            *(
                node.subscription(topic or f"{base}/{name}", kind, partial(setattr, self, name), KEPT)
                for name, (topic, kind) in topics.items()
            ),
        ]

    @property
    def ours(self) -> bool:
        """Whether it is one of Midspan's."""
        return self.planner in OURS

    @property
    def ready(self) -> bool:
        """Whether it is there."""
        return self._client.ready

    @property
    def others(self) -> list[bytes]:
        """The goals that it drives to and that it was given by others."""
        listed = self._listed if self.ready else {}
        return [one for one, status in listed.items() if not status.terminal and one not in self._mine]

    @property
    def holds_on(self) -> bool:
        """Whether it is there, and has not said that all goals have ended that it was given here."""
        if not self.ready:
            return False
        listed = any(not self._listed[one].terminal for one in self._orphans if one in self._listed)
        return listed or any(sent.active for sent in self._mine.values())

    def told(self, goal_id: bytes) -> tuple[State, str] | None:
        """The state and the reason that it tells of a goal; None where it tells none."""
        own = self._own
        if own is None or bytes(own["goal_id"]) != goal_id:
            return None
        return State(own["state"]), str(own["reason"])

    def code(self, goal_id: bytes) -> int:
        """Why the goal waits, or was not reached, as a number; 0 where it tells none."""
        own = self._own
        return int(own["error_code"]) if own is not None and bytes(own["goal_id"]) == goal_id else 0

    def pose(self, goal_id: bytes) -> Message | None:
        """Where a goal that it was given by others leads to, as far as it tells."""
        own = self._own
        if own is not None and bytes(own["goal_id"]) == goal_id:
            return dict(own["goal"])
        return self.current_goal

    def send(self, goal: Mapping[str, Any], ended: Ended, feedback: Callable[[Message], None]) -> SentGoal:
        """Send a goal, under a new id."""
        self.path = None
        sent = self._client.send(goal, ended, feedback)
        while len(self._mine) >= _SENT_KEPT:
            del self._mine[next(iter(self._mine))]
        self._mine[sent.id] = sent
        return sent

    def look(self) -> None:
        """Note whether it is there; have it give up goals that ended here while the link to it was cut."""
        ready = self.ready
        if ready:
            self._forget_the_dead()
        if self._followed is not None and not self.others:
            self.ended = self._followed, State.ABORTED, f"the planner {self.planner} has gone"
        self._follow()
        if not ready:
            self.lost_at = time.monotonic()
            self._orphans.clear()
            return
        now = time.monotonic()
        for one, status in self._listed.items():
            sent = self._mine.get(one)
            if sent is None or sent.active or status.terminal:
                self._orphans.pop(one, None)
            elif now >= self._orphans.get(one, 0.0):
                self._orphans[one] = now + _AGAIN_SECONDS
                self._client.cancel(one)

    def _forget_the_dead(self) -> None:
        """Drop the list of a program that has gone, once another one is there: that one has none of its goals."""
        there = {one.gid for one in self._host.node.hub.graph.publishers(self._list.topic)}
        if there and self._lister not in there:
            self._listed = {}

    def _follow(self) -> None:
        others = self.others
        self._followed = others[-1] if others else None

    def cancel_all(self) -> None:
        """Have it give up all goals, also those of others."""
        self._client.cancel()

    def close(self) -> None:
        """Hear no more of it."""
        self._client.close()
        for end in self._ends:
            self._host.node.release(end)

    def _hear_list(self, message: Message) -> None:
        listed = {bytes(one["goal_info"]["goal_id"]["uuid"]): Status(one["status"]) for one in message["status_list"]}
        for goal in self.others:
            end = listed.get(goal, Status.ABORTED)
            if end.terminal:
                self.ended = goal, _ENDS[end], ""
        self._listed, self._lister = listed, self._list.sender
        self._follow()
        self._changed()

    def _hear_status(self, message: Message) -> None:
        try:
            State(message["state"])
        except ValueError:
            self._host.log.warning("planner %s tells a state that is none: %r", self.planner, message["state"])
            return
        self._own = message
        self._changed()


_ENDS = {Status.SUCCEEDED: State.REACHED, Status.CANCELED: State.IDLE, Status.ABORTED: State.ABORTED}
