"""The gateway's link to a planner: whether it is reachable, its goals, and other actions that move the base."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bridge.client.actions import ActionClient, Ended, SentGoal
from bridge.config.sections.navigation import OURS, NavigationSection
from bridge.messages.actions import GoalState
from bridge.modules.host import Host
from navigation.gateway.action_goals import ActionGoals
from navigation.gateway.foreign import ForeignGoals, GoalMark
from navigation.gateway.lifecycle import LifecycleNodes
from navigation.gateway.machine import PlannerEvent, PlannerState
from navigation.gateway.motion import Base, Motion
from navigation.gateway.presence import Presence
from navigation.gateway.telemetry import Telemetry
from navigation.messages import NAVIGATE, THROUGH, Message

_KEPT_IDS = 16
"""Maximum number of stored ids of goals with several poses, whose states are in another action's list: the current goal
and replaced goals that may not have ended."""

ASK_SECONDS = 5.0
"""The result of a followed goal is requested again if the planner publishes nothing for this time after a request."""


class PlannerLink:
    """Sends goals to a planner, and calls ``changed`` when it reports something. Used on the module's thread."""

    def __init__(
        self, host: Host, section: NavigationSection, planner: str, changed: Callable[[], None], mark: GoalMark
    ) -> None:
        self.planner, self._changed, self.mark = planner, changed, mark
        other, action = section.others.get(planner), section.at(planner)
        side = other.side if other else ""
        self._client = ActionClient(host.node, action, NAVIGATE)
        self._goals = ActionGoals(host, action, always=side in ("", "ros1"), changed=self._on_list)
        through = section.through(planner)
        self._motion = [
            ActionGoals(host, name, always=not side, changed=lambda _differs: changed())
            for name in (other.motion if other is not None else filter(None, [through]))
        ]
        self._through = ActionClient(host.node, through, THROUGH) if through else None
        self._through_goals = next((action for action in self._motion if action.action == through), None)
        self._through_ids = deque[bytes](maxlen=_KEPT_IDS)  # ids of goals of several poses
        self._asked_at, self._ask_pause = 0.0, ASK_SECONDS
        self.foreign_goals = ForeignGoals(mark, f"the planner {planner} has disappeared")
        self.telemetry = Telemetry(host, section, planner, changed)
        self.lifecycle = LifecycleNodes(host, other.lifecycle_nodes if other is not None else (), changed)
        hosted = not side and planner in host.config.hosted
        self.presence = Presence(host, action, side, hosted=hosted, topics=self.telemetry.topics)

    # -- state ---------------------------------------------------------------------------------------------------------

    @property
    def state(self) -> PlannerState:
        return self.presence.machine.state

    @property
    def reachable(self) -> bool:
        """Whether all parts of the planner's action are on the hub."""
        return self.state.reachable

    @property
    def ours(self) -> bool:
        """Whether the planner is one of Midspan's own."""
        return self.planner in OURS

    @property
    def foreign(self) -> tuple[bytes, ...]:
        """The active goals from the planner's own clients, oldest first; empty unless the planner's list is valid."""
        return self.foreign_goals.active if self.state.reported else ()

    @property
    def motion(self) -> tuple[str, ...]:
        """The other actions on the planner's side that move the base now, such as Nav2's ``/follow_path``."""
        return tuple(action.action for action in self._motion if action.list.known and action.list.active)

    @property
    def motion_since(self) -> float:
        """When the last of the actions in `motion` became active (monotonic); 0 if no action is active."""
        return max((action.list.active_since for action in self._motion if action.list.known), default=0.0)

    @property
    def may_move(self) -> bool:
        """Whether another action moves the base, or may do so because its goals are unknown."""
        return any(action.is_present and (action.list.active or not action.list.known) for action in self._motion)

    @property
    def goals(self) -> bool | None:
        """Whether the planner's newest list, even an invalid one, has active goals; None before the first list."""
        return bool(self._goals.list.active) if self._goals.list.any else None

    @property
    def released(self) -> bool:
        """Whether planner and other actions that move the base are known to have ended all goals that must end."""
        reachable = self.reachable and self._goals.released
        return reachable and all(action.released or not action.is_present for action in self._motion)

    @property
    def left(self) -> bool:
        """Whether goals that have to end are still in the newest lists."""
        return bool(self._goals.left) or any(action.left for action in self._motion)

    def lists(self, sent: SentGoal) -> GoalState | None:
        """Return the state of a goal in a valid list; None if the list does not have it, or is not valid."""
        goals = self._goals_of(sent)
        valid = self.state.reported if goals is self._goals else self.reachable and goals.list.known
        return goals.list.status(sent.id) if valid else None

    def may_execute(self, sent: SentGoal | None) -> bool:
        """Whether a goal may still be executing according to its list, or its end has not arrived yet."""
        status = None if sent is None else self.lists(sent)
        return (status is not None and not status.ended) or (sent is not None and sent.active)

    def _goals_of(self, sent: SentGoal) -> ActionGoals:
        through = self._through_goals
        return through if through is not None and sent.id in self._through_ids else self._goals

    # -- goals ---------------------------------------------------------------------------------------------------------

    @property
    def passes(self) -> bool:
        """Whether the planner now accepts a goal of several poses."""
        return self._through is not None and self._through.ready

    def other_goals(self, sent: Sequence[SentGoal], *, several: bool) -> bool:
        """Whether a goal of the gateway is active at the action that ``several`` does not select.

        Nav2 rejects new goals until such a goal has ended. ``sent`` are goals that may be missing from its list yet.
        Always False for Midspan's own planners.
        """
        other = self._goals if several else self._through_goals
        if other is None or self.ours:
            return False
        unlisted = [goal for goal in sent if goal.active and other.list.status(goal.id) is None]
        return any(map(self.mark.is_own, other.list.active)) or any(self._goals_of(goal) is other for goal in unlisted)

    def send(
        self, goal: Mapping[str, Any], ended: Ended, feedback: Callable[[Message], None], *, several: bool = False
    ) -> SentGoal:
        """Send a goal with a new id; ``several``: a goal of several poses, which the planner must accept (`passes`)."""
        self.telemetry.begin()
        self.foreign_goals.doubtful = None

        def on_feedback(message: Message) -> None:
            self.presence.contact.prove()
            self.telemetry.beat()
            feedback(message)

        client, goal_id = self._client, self.mark.new_id()
        if several:
            assert self._through is not None
            client = self._through
            self._through_ids.append(goal_id)
        sent = client.send(goal, ended, on_feedback, goal_id)
        for action in (self._goals, *self._motion):
            action.spare(sent.id)
        return sent

    def follow(self, sent: SentGoal) -> None:
        """Ask again for the result of a goal that the planner still has, unless it is already awaited."""
        if not sent.active:
            self._client_of(sent).follow(sent)
            self._asked_at, self._ask_pause = time.monotonic(), ASK_SECONDS

    def ask_again(self, sent: SentGoal) -> None:
        """Repeat the request for the result of a followed goal while the planner publishes nothing.

        Call this regularly. A server on DDS that has just started loses its reply if it has not discovered the
        client's reader within 0.1 s (rmw_fastrtps, rmw_response.cpp), and the client would wait forever. The pauses
        double, so that few requests are pending at a planner that never publishes anything.
        """
        now = time.monotonic()
        waited = now > self._asked_at + self._ask_pause
        if waited and sent.active and not self.telemetry.published_since(self._asked_at):
            self._client_of(sent).ask_result(sent)
            self._asked_at, self._ask_pause = now, 2 * self._ask_pause

    def _client_of(self, sent: SentGoal) -> ActionClient:
        through = self._through
        return through if through is not None and sent.id in self._through_ids else self._client

    def end(self, sent: SentGoal) -> None:
        """Cancel a goal, now or as soon as possible, and repeat that until the planner's list shows its end."""
        if sent.active:
            sent.cancel()
        self._goals_of(sent).end(sent.id)

    def end_all(self) -> None:
        """Cancel everything that moves the base, including goals from the planner's own clients."""
        for action in (self._goals, *self._motion):
            action.end_all()

    def end_motion(self) -> bool:
        """Cancel the goals of the other actions that move the base, also those that are not in their lists yet.

        Return whether this may end the path of a planner's goal; Nav2 then counts that goal as reached.
        """
        for action in self._motion:
            action.end_all()
        return any(action.is_present for action in self._motion if action is not self._through_goals)

    def end_no_more(self) -> None:
        """End the stop: goals that appear from now on may continue."""
        for action in (self._goals, *self._motion):
            action.end_no_more()

    # -- updates -------------------------------------------------------------------------------------------------------

    def refresh(self, motion: Motion) -> None:
        """Read the hub's graph and the lists again; called about ten times a second."""
        for action in (self._goals, *self._motion):
            action.refresh()
        self.lifecycle.refresh()
        if self._through_goals is not None:
            for goal in filter(self.mark.is_orphan, self._through_goals.list.active):
                self._through_goals.end(goal)
        reported = self.state.reported
        self.presence.refresh(complete=self._client.ready, moving=motion.base() is Base.MOVING)
        self._update(reported=reported)
        if not self.reachable and motion.is_standing(self.presence.machine.since):
            self.foreign_goals.settle()

    def lose_contact(self) -> None:
        """Count the planner as unreachable until its parts or its goal list change, because a call to it failed."""
        reported = self.state.reported
        self.presence.lose_contact()
        self._update(reported=reported)

    def _update(self, *, reported: bool) -> None:
        """Derive the planner's state and the foreign goals from the newest list, both in one step.

        ``reported`` is whether the planner's goals were known before.
        """
        goals, machine = self._goals.list, self.presence.machine
        if self.reachable and goals.known:
            machine.on(PlannerEvent.GOALS if goals.active else PlannerEvent.NO_GOALS)
            self.foreign_goals.update(goals)
            for goal in filter(self.mark.is_orphan, goals.active):
                self._goals.end(goal)  # sent before a restart of the gateway: no other program could cancel it
            return
        machine.on(PlannerEvent.UNREPORTED)
        if reported:
            self.foreign_goals.doubt()

    @property
    def unlisted(self) -> bool:
        """Whether the planner serves goals of several poses, but it is unknown whether it has any."""
        through = self._through_goals
        return through is not None and through.is_present and not through.list.known

    @property
    def orphans(self) -> bool:
        """Whether the planner drives to a goal that this gateway sent before a restart."""
        several = () if self._through_goals is None else self._through_goals.list.active
        return any(map(self.mark.is_orphan, (*self._goals.list.active, *several)))

    def _on_list(self, differs: bool) -> None:
        self.presence.contact.prove()
        self.telemetry.beat(counts=not differs)
        self._update(reported=self.state.reported)
        self._changed()

    def close(self) -> None:
        self._client.close()
        if self._through is not None:
            self._through.close()
        self.telemetry.close()
        self.lifecycle.close()
        for action in (self._goals, *self._motion):
            action.close()
