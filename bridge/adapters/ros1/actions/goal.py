"""Goals at an actionlib server as ROS 2 sees them, and their store."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from bridge.adapters.ros1.actions.wire import ZERO, GoalInfo, RosTime
from bridge.hub.endpoints.calls import Done
from bridge.messages.actions import GoalState

KEEP_SECONDS = 3600.0
"""How long a result is stored after its goal's end."""

MAX_ENDED = 10_000
MAX_ENDED_BYTES = 64 << 20
"""Limits of the number of stored ended goals, and of the total size of their results; the oldest are dropped first."""

MAX_OPEN = 10_000
"""Maximum number of goals of one action that have not ended; further goals are rejected."""


@dataclass(eq=False, slots=True)
class TrackedGoal:
    """One goal.

    Attributes:
        body: the goal message until the server reports the goal; None after that, and for goals of ROS 1 clients.
        sent: whether the goal message has been sent.
        ours: whether a client of the hub sent the goal.
        asker: the pending send_goal call.
        waiting: the pending get_result calls.
        listed: whether the server's status list has contained the goal.
        refused: whether the goal was rejected, so that ROS 2 has no such goal.
        lost: whether the server no longer reports the goal; its state on ROS 2 is UNKNOWN, and it may be executing.
        result: the serialized result, None until the goal has ended and the result has arrived or counts as lost.
        text: the reason for the final state, from the server or from this bridge.
        result_delivered: whether a client has received the result.
        whole: whether the result came from the server.
    """

    uuid: bytes
    id: str
    since: float
    body: bytes | None = None
    sent: bool = False
    ours: bool = False
    asker: Done | None = None
    waiting: list[Done] = field(default_factory=list)
    stamp: RosTime = ZERO
    state: GoalState = GoalState.UNKNOWN
    listed: bool = False
    refused: bool = False
    lost: bool = False
    result: bytes | None = None
    text: str = ""
    result_delivered: bool = False
    whole: bool = False

    @property
    def info(self) -> GoalInfo:
        """The goal's UUID and the time of its acceptance."""
        return GoalInfo(self.uuid, self.stamp)

    @property
    def reason(self) -> str:
        """Why the goal did not succeed, as far as known; "" if it did."""
        return "" if self.state is GoalState.SUCCEEDED else self.text

    @property
    def unsent(self) -> bool:
        """Whether the goal waits to be sent."""
        return self.body is not None and not self.sent

    @property
    def unconfirmed(self) -> bool:
        """Whether the goal has been sent, but not yet reported by the server."""
        return self.sent and self.state is GoalState.UNKNOWN and not self.refused and not self.lost

    @property
    def accepted(self) -> bool:
        """Whether the server has accepted the goal; false again once the goal is lost."""
        return self.state is not GoalState.UNKNOWN and not self.refused


class GoalStore:
    """All goals of one action by UUID and by ROS 1 id; ended goals are stored for an hour, within limits."""

    def __init__(self) -> None:
        self._by_uuid: dict[bytes, TrackedGoal] = {}
        self._by_id: dict[str, TrackedGoal] = {}
        self._open: dict[bytes, TrackedGoal] = {}
        self._ended: dict[bytes, tuple[float, TrackedGoal]] = {}
        self._bytes = 0

    def add(self, goal: TrackedGoal) -> None:
        """Add a goal that has not ended."""
        self._by_uuid[goal.uuid] = self._by_id[goal.id] = self._open[goal.uuid] = goal

    def by_uuid(self, uuid: bytes) -> TrackedGoal | None:
        """Return a goal by its UUID."""
        return self._by_uuid.get(uuid)

    def by_id(self, id_: str) -> TrackedGoal | None:
        """Return a goal by its ROS 1 id."""
        return self._by_id.get(id_)

    def unfinished(self) -> list[TrackedGoal]:
        """Return the goals that have not ended, in the order of their arrival."""
        return list(self._open.values())

    @property
    def full(self) -> bool:
        """Whether further goals have to be rejected."""
        return len(self._open) >= MAX_OPEN

    def end(self, goal: TrackedGoal, now: float) -> None:
        """Mark a goal as ended: it has its result, or was rejected."""
        self._open.pop(goal.uuid, None)
        self._ended[goal.uuid] = (now, goal)
        self._bytes += len(goal.result or b"")

    def remove(self, goal: TrackedGoal) -> None:
        """Drop a goal, for example one that has expired, or whose id a ROS 1 client reuses."""
        if self._ended.pop(goal.uuid, None) is not None:
            self._bytes -= len(goal.result or b"")
        self._open.pop(goal.uuid, None)
        del self._by_uuid[goal.uuid], self._by_id[goal.id]

    def ended_since(self, time: float) -> Iterator[TrackedGoal]:
        """Yield the goals that ended at or after a time, the last to end first."""
        for ended, goal in reversed(self._ended.values()):
            if ended < time:
                return
            yield goal

    def expire(self, now: float) -> None:
        """Drop ended goals that are too old, too many, or too large together."""
        for ended, goal in list(self._ended.values()):
            crowded = len(self._ended) > MAX_ENDED or self._bytes > MAX_ENDED_BYTES
            if ended > now - KEEP_SECONDS and not crowded:
                return
            self.remove(goal)

    def __len__(self) -> int:
        return len(self._by_uuid)
