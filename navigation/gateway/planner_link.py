"""The planner as the gateway sees it: whether it is reachable, its goals, and everything else that moves the base."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from bridge.config.sections.navigation import OURS, NavigationSection
from bridge.messages.actions import GoalState, names
from bridge.modules.clients import ActionClient, Ended, SentGoal
from bridge.modules.host import Host
from navigation.gateway.action_goals import ActionGoals
from navigation.gateway.contact import Contact
from navigation.gateway.goal_list import GoalList
from navigation.gateway.machine import PLANNER, Machine, PlannerEvent, PlannerState
from navigation.gateway.motion import Base, Motion
from navigation.gateway.telemetry import Telemetry
from navigation.messages import NAVIGATE, Message
from navigation.status import State

ABSENT_SECONDS = 2.0
"""A planner that does not appear for this time after its side's worker has joined is not running there."""

UNSEEN_SECONDS = 10.0
"""The same while the base moves: the worker of a busy machine may take this long to find the planner."""


class GoalMark:
    """Makes goal ids by which the gateway recognizes its own goals, also those from before it was restarted."""

    def __init__(self, daemon: str) -> None:
        self._mark = hashlib.blake2b(f"midspan gateway {daemon}".encode(), digest_size=6).digest()
        self._run = os.urandom(4)

    def new_id(self) -> bytes:
        """Return a new goal id, 16 bytes."""
        return self._mark + self._run + os.urandom(6)

    def is_own(self, goal: bytes) -> bool:
        """Whether a gateway of this daemon made the id."""
        return goal.startswith(self._mark)

    def is_orphan(self, goal: bytes) -> bool:
        """Whether an earlier run of this gateway made the id."""
        return self.is_own(goal) and not goal.startswith(self._mark + self._run)


class ForeignEnd(NamedTuple):
    """How a goal ended that the planner's own client gave it."""

    goal: bytes
    state: State
    reason: str


def _end_of(status: GoalState | None) -> State:
    """Return how a goal ended: aborted if the list does not have it, or has not shown its end."""
    return {GoalState.SUCCEEDED: State.REACHED, GoalState.CANCELED: State.IDLE}.get(
        status or GoalState.ABORTED, State.ABORTED
    )


class PlannerLink:
    """Sends goals to a planner, and calls ``changed`` when it reports something. On the module's thread."""

    def __init__(
        self, host: Host, section: NavigationSection, planner: str, changed: Callable[[], None], mark: GoalMark
    ) -> None:
        self.planner, self._host, self._changed, self.mark = planner, host, changed, mark
        other = section.others.get(planner)
        self._side = other.side if other else ""
        self.machine: Machine[PlannerState, PlannerEvent] = Machine(PLANNER, PlannerState.UNKNOWN)
        self.seen_at = time.monotonic()  # when it was last reachable; before that, when this began
        self.unreachable_at = time.monotonic()  # when it was last seen to be unreachable
        self._side_since: float | None = None
        action = section.at(planner)
        self._client = ActionClient(host.node, action, NAVIGATE)
        self._goals = ActionGoals(host, action, always=self._side in ("", "ros1"), changed=self._on_list)
        self._motion = [
            ActionGoals(host, name, always=False, changed=lambda _differs: changed())
            for name in (other.motion if other is not None else ())
        ]
        self._foreign: tuple[bytes, ...] = ()
        self.foreign_end: ForeignEnd | None = None  # the last end of a goal of the planner's own clients
        self.doubtful: bytes | None = None  # such a goal, while the planner is out of reach
        self._parts_before: set[bytes] = set()
        self.telemetry = Telemetry(host, section, planner, changed)
        self._names, self._contact = names(action), Contact()
        self._topics = [self._names.status, self._names.feedback, *self.telemetry.topics]

    # -- what is known -------------------------------------------------------------------------------------------------

    @property
    def state(self) -> PlannerState:
        """What is known of it."""
        return self.machine.state

    @property
    def reachable(self) -> bool:
        """Whether all parts of its action are on the hub."""
        return self.machine.state.reachable

    @property
    def ours(self) -> bool:
        """Whether Midspan hosts it."""
        return self.planner in OURS

    @property
    def foreign(self) -> tuple[bytes, ...]:
        """The active goals that its own clients gave it, the oldest first, while its list is valid."""
        return self._foreign if self.machine.state.reported else ()

    @property
    def motion(self) -> tuple[str, ...]:
        """The other actions on its side that move the base now, such as Nav2's ``/follow_path``."""
        return tuple(one.action for one in self._motion if one.list.known and one.list.active)

    @property
    def goals(self) -> bool | None:
        """Whether its newest list has active goals, valid or not; None before the first list."""
        return bool(self._goals.list.active) if self._goals.list.any else None

    @property
    def released(self) -> bool:
        """Whether it is known that it, and everything else that moves the base, has no goal left that has to end."""
        reachable = self.reachable and self._goals.released
        return reachable and all(one.released or not one.there for one in self._motion)

    @property
    def left(self) -> bool:
        """Whether there are goals that have to end, and have not by the newest lists."""
        return bool(self._goals.left) or any(one.left for one in self._motion)

    def lists(self, sent: SentGoal) -> GoalState | None:
        """Return the state of a goal in a valid list; None if the list does not have it, or is not valid."""
        return self._goals.list.status(sent.id) if self.machine.state.reported else None

    @property
    def coming_up(self) -> bool:
        """Whether parts of it have come to the hub while it is not reachable as a whole."""
        return not self.reachable and bool(self._parts() - self._parts_before)

    def _parts(self) -> set[bytes]:
        graph = self._host.node.hub.graph
        return {one.gid for topic in self._topics for one in graph.publishers(topic)}

    # -- goals ---------------------------------------------------------------------------------------------------------

    def send(self, goal: Mapping[str, Any], ended: Ended, feedback: Callable[[Message], None]) -> SentGoal:
        """Send a goal, under a new id."""
        self.telemetry.begin()
        self.doubtful = None

        def on_feedback(message: Message) -> None:
            self._contact.prove()
            self.telemetry.beat()
            feedback(message)

        sent = self._client.send(goal, ended, on_feedback, self.mark.new_id())
        for action in (self._goals, *self._motion):
            action.spare(sent.id)
        return sent

    def follow(self, sent: SentGoal) -> None:
        """Ask again for the result of a goal that the planner still has."""
        if not sent.active:
            self._client.follow(sent)

    def end(self, sent: SentGoal) -> None:
        """Cancel a goal, now or as soon as that is possible, until the planner's list shows that it has ended."""
        if sent.active:
            sent.cancel()
        self._goals.end(sent.id)

    def end_all(self) -> None:
        """Cancel everything that moves the base, also what its own clients gave it."""
        for action in (self._goals, *self._motion):
            action.end_all()

    def end_motion(self) -> None:
        """Cancel the goals of the other actions that move the base."""
        for action in self._motion:
            action.end_all()

    def end_no_more(self) -> None:
        """The stop is over: goals that appear now may go on."""
        for action in (self._goals, *self._motion):
            action.end_no_more()

    # -- what happens --------------------------------------------------------------------------------------------------

    def refresh(self, motion: Motion) -> None:
        """Read the hub's graph and the lists again; called about ten times a second."""
        now = time.monotonic()
        for action in (self._goals, *self._motion):
            action.refresh()
        if self._client.ready and self._contact.answers(self._action_parts()):
            if self._contact.proven:
                self.seen_at = now
            self._side_since = None
            self.machine.on(PlannerEvent.FOUND)
        else:
            if self.reachable:
                self._parts_before = self._parts()
            self._doubt()
            self.machine.on(PlannerEvent.LOST)
            self.unreachable_at = now
            if self._side_reported(moving=motion.base() is Base.MOVING):
                self.machine.on(PlannerEvent.SIDE_REPORTED)
        self._update()
        if not self.reachable and motion.stands(self.machine.since):
            self._close_doubt()

    def lose_contact(self) -> None:
        """A call of the planner failed: it is out of reach until its parts or its goal list show the contrary."""
        self._contact.lose(self._action_parts())
        self._doubt()
        self.machine.on(PlannerEvent.LOST)
        self.unreachable_at = time.monotonic()

    def _action_parts(self) -> set[bytes]:
        """The GIDs of all servers and publishers of its action."""
        graph, parts = self._host.node.hub.graph, self._names
        servers = (parts.send_goal, parts.get_result, parts.cancel_goal)
        return {
            endpoint.gid
            for endpoints in (*map(graph.servers, servers), *map(graph.publishers, (parts.feedback, parts.status)))
            for endpoint in endpoints
        }

    def _update(self) -> None:
        """Derive the planner's state, and the foreign goals, from the newest list: both in one step."""
        goals = self._goals.list
        if not self.reachable:
            return
        if goals.known:
            self.machine.on(PlannerEvent.GOALS if goals.active else PlannerEvent.NO_GOALS)
            self._update_foreign(goals)
        else:
            self._doubt()
            self.machine.on(PlannerEvent.UNREPORTED)

    def _doubt(self) -> None:
        """The list is no longer valid: what becomes of a goal of the planner's own clients is not known for now."""
        if self.machine.state.reported and self._foreign:
            self.doubtful = self._foreign[-1]

    def _update_foreign(self, goals: GoalList) -> None:
        before, self._foreign = self._foreign, tuple(goal for goal in goals.active if not self.mark.is_own(goal))
        for goal in goals.active:
            if self.mark.is_orphan(goal):
                self._goals.end(goal)  # its client has lost it: no other program could stop the robot
        for goal in before:
            if goal not in self._foreign and goal != self.doubtful:
                self.foreign_end = ForeignEnd(goal, _end_of(goals.status(goal)), "")
        if self.doubtful is not None:
            self._close_doubt()

    def _close_doubt(self) -> None:
        """It is known again how the planner's own goal does, or the base stands."""
        goal, self.doubtful = self.doubtful, None
        if goal is None or (goal in self._foreign and self.machine.state.reported):
            return
        status = self._goals.list.status(goal) if self.machine.state.reported else None
        why = "" if status is not None and status.ended else f"the planner {self.planner} has gone"
        self.foreign_end = ForeignEnd(goal, _end_of(status), why)

    @property
    def orphans(self) -> bool:
        """Whether it drives to a goal that this gateway gave it before it was restarted."""
        return any(self.mark.is_orphan(goal) for goal in self._goals.list.active)

    def _side_reported(self, *, moving: bool) -> bool:
        """Whether the planner's side had the time to show it: its worker has joined, and it is not there."""
        now = time.monotonic()
        origins = self._host.node.hub.graph.origins().values()
        here = self._side == "" and self.planner in self._host.config.hosted
        if not here and self._side not in {origin.side for origin in origins} | {"zenoh"}:
            self._side_since = None
            return False
        if self._side_since is None:
            self._side_since = now
        return now > self._side_since + (UNSEEN_SECONDS if moving else ABSENT_SECONDS)

    def _on_list(self, differs: bool) -> None:
        self._contact.prove()
        self.telemetry.beat(counts=not differs)
        self._update()
        self._changed()

    def close(self) -> None:
        """Close the subscriptions and the clients."""
        self._client.close()
        self.telemetry.close()
        for action in (self._goals, *self._motion):
            action.close()
