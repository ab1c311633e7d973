"""A patrol: the robot drives to places in turn, repeatedly, until a client ends it. Used on the module's thread.

The patrol sends one goal at a time to the gateway's action, each after the previous goal was reached. Without stops,
one goal has the places of several rounds, and planners that can pass places drive through them. A stop, another
client's goal or an unreachable place ends the patrol. A patrol continues if the page that started it is closed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from bridge.client.actions import ActionClient, SentGoal
from bridge.client.services import ServiceClient
from bridge.config.sections.navigation import ACTION, THROUGH_POSES
from bridge.hub.endpoints.calls import CallError
from bridge.messages.actions import GoalState
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.web.verbs.verbs import PageVerb, VerbError, name_of, number_between
from navigation.gateway.services import GET_LOCATION
from navigation.messages import NAVIGATE, THROUGH

MOST_PLACES = 50
SHORTEST, USUAL, LONGEST = 1.0, 2.0, 3600.0
"""Minimum, default and maximum seconds of the stop between two goals. Because of the minimum, a stop command that is on
its way arrives before the next goal."""

MOST_PASSED = 20
"""Maximum number of places in a goal of several rounds; planners repeatedly plan the path through all of them."""

ANSWER_SECONDS = 5.0
_LOCATE = "/navigation/get_location"
STOPPED, ANOTHER = "the robot was stopped", "another client sent a goal"


def places_of(value: Any) -> list[str]:
    """Check the places of a patrol."""
    if not isinstance(value, list) or not 2 <= len(value) <= MOST_PLACES:
        raise ValueError(f"must be 2 to {MOST_PLACES} names")
    return [name_of(name) for name in value]


_seconds_of = number_between(SHORTEST, LONGEST, " of seconds, 0 for no stop or")


def wait_of(value: Any) -> float:
    """Check the seconds of the stop at each place; 0 means no stop."""
    return 0.0 if type(value) in (int, float) and value == 0 else _seconds_of(value)


@dataclass
class PatrolRoute:
    """The places of a patrol, and the robot's progress.

    Attributes:
        wait: seconds of the stop at each place; 0 for no stop.
        at: index of the place that the robot drives to or stands at.
        round: the current round, from 1.
        last: index of the current goal's last place; in a goal of several rounds, it exceeds the number of places.
        poses: the poses of the next goal's places that are known so far.
    """

    places: Sequence[str]
    wait: float
    at: int = 0
    round: int = 1
    last: int = 0
    poses: list[dict[str, Any]] = field(default_factory=list)

    @property
    def place(self) -> str:
        """The place that the robot drives to or stands at."""
        return self.places[self.at]

    @property
    def next_unknown(self) -> str:
        """The next place whose pose is not known yet."""
        return self.places[(self.at + len(self.poses)) % len(self.places)]

    def advance(self, index: int) -> bool:
        """Advance to a place of the current goal, indexed like ``last``; return False if it is ``at`` already."""
        if index == self.at:
            return False
        rounds, self.at = divmod(index, len(self.places))
        self.last -= rounds * len(self.places)
        self.round += rounds
        return True

    def advance_one(self) -> None:
        """Advance to the next place."""
        self.at = (self.at + 1) % len(self.places)
        self.round += not self.at


class Gateway(Protocol):
    """The state of the gateway."""

    @property
    def state(self) -> str:
        """The gateway's state; "" if unknown."""

    @property
    def goal_id(self) -> bytes:
        """The id of the gateway's goal; zeros if there is none."""

    def on_change(self, action: Callable[[], None]) -> None:
        """Register a callback for changes of the gateway's state."""


class Patrol:
    """The patrol of a console, which has at most one at a time.

    Args:
        gateway: shows whether a client stops the robot, or sends it elsewhere, during the stop at a place.
        publish: called with each new state of the patrol.
    """

    def __init__(self, host: Host, gateway: Gateway, publish: Callable[[Mapping[str, Any]], None]) -> None:
        self._host, self._gateway, self._publish_state = host, gateway, publish
        self._locate: ServiceClient | None = None
        self._goals: dict[str, ActionClient] = {}  # by the action's name
        self._route = PatrolRoute((), USUAL)
        self._step = 0  # increases with each step; callbacks of earlier steps are ignored
        self._active = self._paused = self._goal_seen = False
        self._goal: SentGoal | None = None
        self._newest_id = b""  # the id of the newest goal
        self._timer: Timer | None = None
        gateway.on_change(self._on_status)

    def verbs(self) -> dict[str, PageVerb]:
        """Return the verb by its name."""
        return {"patrol": PageVerb(self._patrol, {"places": places_of}, {"wait": wait_of}, drives=True)}

    @property
    def busy(self) -> str:
        """Why manual driving is refused; "" if it is allowed."""
        return "a patrol is active; pause or stop it first" if self._active and not self._paused else ""

    def end(self, why: str) -> None:
        """End the patrol, and cancel its goal."""
        if not self._active:
            return
        self._active = self._paused = False
        self._next_step()
        goal, self._goal = self._goal, None
        if goal is not None:
            goal.cancel()
        self._host.log.info("patrol ended: %s", why)
        self._publish("ended", why)

    def pause_or_resume(self, verb: str) -> str:
        """Pause or resume a patrol between two goals; return the reply, or "" if the gateway has to do it."""
        if not self._active or self._goal is not None:
            return ""
        if verb == "pause" and not self._paused:
            self._paused = True
            self._next_step()
            self._publish("held")
            return "patrol paused"
        if verb == "resume" and self._paused:
            self._paused = False
            self._find()
            return "patrol resumed"
        return ""

    # -- step by step --------------------------------------------------------------------------------------------------

    def _patrol(self, places: Sequence[str], wait: float = USUAL) -> str:
        self._host.loop.call(partial(self._begin, places, wait), late=False)
        return f"patrolling {len(places)} places"

    def _begin(self, places: Sequence[str], wait: float) -> None:
        if self._active:
            raise VerbError("a patrol is active; stop it first")
        self._route = PatrolRoute(places, wait)
        self._active, self._paused, self._goal_seen = True, False, False
        self._host.log.info("patrolling %s", ", ".join(places))
        self._find()

    def _next_step(self) -> int:
        self._step += 1
        if self._timer is not None:
            self._timer.close()
            self._timer = None
        return self._step

    def _after(self, seconds: float, action: Callable[[], Any]) -> None:
        self._timer = self._host.loop.after(seconds, action)

    def _find(self) -> None:
        """Request the poses of the next goal's places."""
        self._route.poses = []
        self._find_next()
        self._publish("drives")

    def _find_next(self) -> None:
        step = self._next_step()
        self._locate = self._locate or self._host.node.client(_LOCATE, GET_LOCATION)
        self._locate.call({"name": self._route.next_unknown}, partial(self._on_pose, step))
        self._after(ANSWER_SECONDS, lambda: self.end(f"{_LOCATE} has not answered in {ANSWER_SECONDS:g} s"))

    def _on_pose(self, step: int, reply: dict[str, Any] | CallError) -> None:
        if step != self._step:
            return
        if isinstance(reply, CallError):
            self.end(f"{_LOCATE}: {reply}")
        elif not reply["success"]:
            self.end(str(reply["message"]))
        else:
            route = self._route
            route.poses.append(reply["pose"])
            if route.wait:
                self._send(ACTION, NAVIGATE, {"pose": reply["pose"]}, 1)
            elif len(route.poses) < len(route.places):
                self._find_next()
            else:
                poses = route.poses * max(1, MOST_PASSED // len(route.poses))
                self._send(THROUGH_POSES, THROUGH, {"poses": poses}, len(poses))

    def _send(self, action: str, kind: str, goal: dict[str, Any], count: int) -> None:
        """Send a goal with ``count`` places, of which the first is the next place."""
        step = self._next_step()
        if action not in self._goals:
            self._goals[action] = self._host.node.action_client(action, kind)
        self._route.last = self._route.at + count - 1
        self._goal = self._goals[action].send(goal, self._ended, partial(self._on_feedback, step))
        self._newest_id = self._goal.id
        self._after(ANSWER_SECONDS, self._accepted)

    def _on_feedback(self, step: int, feedback: dict[str, Any]) -> None:
        left, last = int(feedback.get("number_of_poses_remaining", 0)), self._route.last
        if step == self._step and 0 < left <= last + 1 - self._route.at:
            self._advance(last + 1 - left)

    def _advance(self, index: int) -> None:
        if self._route.advance(index):
            self._publish("held" if self._paused else "drives")

    def _accepted(self) -> None:
        if self._goal is not None and self._goal.accepted is None:
            self.end(f"the gateway did not accept or reject the goal within {ANSWER_SECONDS:g} s")

    def _ended(self, goal: SentGoal, result: dict[str, Any] | None, why: str) -> None:
        if goal is not self._goal:
            return
        self._goal = None
        if goal.status is not GoalState.SUCCEEDED:
            reason = why or (result or {}).get("error_msg", "") or "the goal was aborted"
            self.end(f"driving to {self._route.place}: {reason}")
            return
        self._next_step()
        self._paused = False
        self._advance(self._route.last)
        self._after(self._route.wait or SHORTEST, self._next_place)
        self._publish("waits")

    def _next_place(self) -> None:
        self._route.advance_one()
        self._find()

    # -- status of the gateway -----------------------------------------------------------------------------------------

    def _on_status(self) -> None:
        """Check the gateway's status, which shows a pause of the goal, a stop, or another client's goal."""
        if not self._active:
            return
        state, goal_id = self._gateway.state, self._gateway.goal_id
        if self._goal is not None and goal_id == self._goal.id:
            self._goal_seen = True
            paused = state == "paused"
            if paused != self._paused:
                self._paused = paused
                self._publish("held" if paused else "drives")
        elif self._goal_seen and state == "idle":
            self.end(STOPPED)
        elif self._goal_seen and self._goal is None and any(goal_id) and goal_id != self._newest_id:
            self.end(ANOTHER)

    def _publish(self, state: str, why: str = "") -> None:
        route = self._route
        value = {"state": state, "places": list(route.places), "at": route.at, "round": route.round}
        self._publish_state({**value, "wait": route.wait, "why": why})
