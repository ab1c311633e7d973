"""The chosen planner, as the gateway sees it, and which one that is."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from bridge.config.sections.navigation import OURS, NavigationSection
from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import STATUSES, GoalState, names
from bridge.modules.clients import ActionClient, Ended, SentGoal
from bridge.modules.host import Host
from navigation.gateway.drive import UnconfirmedStop
from navigation.messages import GRID, NAVIGATE, Message
from navigation.status import STATUS, State

PATH, POSE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"
_LOCAL = {"robot_path_planner": "robot_goto"}  # the planner that publishes the local map of another one
_SENT_KEPT = 1000
_AGAIN_SECONDS = 1.0
_LIST_SECONDS = 1.0
"""A planner that has published no list of goals for so long has none: an action server publishes it with its first."""


def local_map_topic(section: NavigationSection, planner: str) -> str:
    """The topic of a planner's local map (``nav_msgs/OccupancyGrid``), "" where it has none."""
    other = section.others.get(planner)
    return other.local_map if other else f"/planner/{_LOCAL.get(planner, planner)}/local_map"


class PlannerLink:
    """Sends goals to a planner, and calls ``changed`` when it tells something new. On the module's thread."""

    def __init__(self, host: Host, section: NavigationSection, planner: str, changed: Callable[[], None]) -> None:
        self.planner, self._changed = planner, changed
        self._host = host
        action = section.at(planner)
        self._client = ActionClient(host.node, action, NAVIGATE)
        self._mine: dict[bytes, SentGoal] = {}
        # when it was last seen not to be there, and to be there (monotonic); before the first look, now
        self.lost_at = self.seen_at = self._made_at = time.monotonic()
        self._condemned: dict[bytes, None] = {}
        self._asked: dict[bytes, float] = {}
        self._heard_at, self._beats = 0.0, 0
        self._listed_since, self._before = False, set[bytes]()
        self._listed: dict[bytes, GoalState] = {}
        self._lister, self._lister_seen, self._listed_at = b"", False, 0.0
        self._followed: bytes | None = None
        self._own: Message | None = None
        self.ended: tuple[bytes, State, str] | None = None  # a goal of others that ended last, how, and why if known
        # a goal of others that it drove to as it went out of reach, and when; None once it is known how that ended
        self.gone: tuple[bytes, float] | None = None
        # what it told last
        self.path: Message | None = None
        self.local_map: Message | None = None
        self.current_goal: Message | None = None
        other = section.others.get(planner)
        base = f"/planner/{planner}"
        node = host.node
        topics = {
            "path": (other.path if other else "", PATH),
            "local_map": (local_map_topic(section, planner), GRID),
            "current_goal": (other.current_goal if other else "", POSE),
        }
        self._topics = [
            names(action).status,
            names(action).feedback,
            f"{base}/status",
            *(t for t, _ in topics.values() if t),
        ]
        self._list = node.subscription(names(action).status, STATUSES, self._hear_list, LATCHED)
        self._ends = [
            self._list,
            node.subscription(f"{base}/status", STATUS, self._hear_status, LATCHED),
            *(
                node.subscription(topic or f"{base}/{name}", kind, partial(setattr, self, name), LATCHED)
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
        return [one for one, status in listed.items() if not status.ended and one not in self._mine]

    @property
    def may_drive(self) -> bool:
        """Whether it drives to a goal according to its last list, even if it is out of reach."""
        return any(not status.ended for status in self._listed.values())

    @property
    def unknown(self) -> bool:
        """Whether it was found, or looked for, so lately that its list of goals cannot have come yet."""
        since = self.lost_at if self.ready else self._made_at
        return not self._listed_since and time.monotonic() < since + _LIST_SECONDS

    @property
    def holds_on(self) -> bool:
        """Whether it is there, and has not said that all goals have ended that it was to give up."""
        return self.ready and (bool(self._left()) or any(sent.active for sent in self._mine.values()))

    @property
    def let_go(self) -> bool:
        """Whether it is there and, by a list that had the time to come, has no goal left to give up."""
        if not self.ready or self.holds_on:
            return False
        return self._listed_since or time.monotonic() > self.lost_at + _LIST_SECONDS

    def _left(self) -> list[bytes]:
        """The goals that it drives to and is to give up: they ended here, or were to be cancelled with all others."""
        return [
            one
            for one, status in self._listed.items()
            if not status.ended
            and (one in self._condemned or (one in self._mine and not self._mine[one].active))
        ]  # fmt: skip

    @property
    def silent(self) -> float:
        """Seconds since it spoke of the last goal; 0 for one that only publishes changes: its silence means nothing."""
        return time.monotonic() - self._heard_at if self._beats else 0.0

    def _heard(self, beats: int = 1) -> None:
        self._heard_at, self._beats = time.monotonic(), self._beats + beats

    @property
    def coming_up(self) -> bool:
        """Whether parts of it have come to the hub while it is not there as a whole."""
        return not self.ready and bool(self._there() - self._before)

    def _there(self) -> set[bytes]:
        graph = self._host.node.hub.graph
        return {one.gid for topic in self._topics for one in graph.publishers(topic)}

    def told(self, goal_id: bytes) -> tuple[State, str] | None:
        """The state and the reason that it published for a goal, if any."""
        own = self._own
        if own is None or bytes(own["goal_id"]) != goal_id:
            return None
        return State(own["state"]), str(own["reason"])

    def code(self, goal_id: bytes) -> int:
        """The number of the reason why the goal waits or failed; 0 if unknown."""
        own = self._own
        return int(own["error_code"]) if own is not None and bytes(own["goal_id"]) == goal_id else 0

    def pose(self, goal_id: bytes) -> Message | None:
        """The pose of a goal that others gave it, if it publishes that."""
        own = self._own
        if own is not None and bytes(own["goal_id"]) == goal_id:
            return dict(own["goal"])
        return self.current_goal

    def send(self, goal: Mapping[str, Any], ended: Ended, feedback: Callable[[Message], None]) -> SentGoal:
        """Send a goal, under a new id."""
        self.path = self.gone = None
        self._beats = 0

        def heard(told: Message) -> None:
            self._heard()
            feedback(told)

        sent = self._client.send(goal, ended, heard)
        while len(self._mine) >= _SENT_KEPT:
            del self._mine[next(iter(self._mine))]
        self._mine[sent.id] = sent
        return sent

    def look(self) -> None:
        """Note whether it is there; have it give up goals that ended here while the link to it was cut."""
        ready, now = self.ready, time.monotonic()
        if ready:
            self.seen_at = now
            self._forget_the_dead()
        self._follow()
        if ready and self.gone is not None and (self._listed_since or now > self.lost_at + _LIST_SECONDS):
            self.give_up_gone()
        if ready:
            self._ask_to_let_go()
            return
        if self.seen_at >= self.lost_at:
            self._before = self._there()
        self.lost_at, self._listed_since = now, False
        self._asked.clear()

    def give_up_gone(self) -> None:
        """The goal of others that it drove to as it went has ended: it is back without that one, or the base stands."""
        if self.gone is not None and self.gone[0] not in self.others:
            self.ended = self.gone[0], State.ABORTED, f"the planner {self.planner} has gone"
        self.gone = None

    def _ask_to_let_go(self) -> None:
        now, left = time.monotonic(), self._left()
        self._asked = {one: at for one, at in self._asked.items() if one in left}
        for one in left:
            if now >= self._asked.get(one, 0.0):
                self._asked[one] = now + _AGAIN_SECONDS
                self._client.cancel(one)

    def _forget_the_dead(self) -> None:
        """Drop the list of a program that has gone, once another one is there: that one has none of its goals.

        A list may come before the graph tells of the program that sent it.
        """
        there = {one.gid for one in self._host.node.hub.graph.publishers(self._list.topic)}
        if self._lister in there:
            self._lister_seen = True
        elif there and (self._lister_seen or time.monotonic() > self._listed_at + _LIST_SECONDS):
            self._listed = {}

    def _follow(self) -> None:
        """Note which goal of others it drives to; one that it drove to as it went out of reach may go on there."""
        others = self.others
        if others:
            self.gone = None
        elif self._followed is not None and (self.ended is None or self.ended[0] != self._followed):
            self.gone = self._followed, time.monotonic()
        self._followed = others[-1] if others else None

    def cancel_all(self) -> None:
        """Have it give up all goals, also those of others; where it is not there, once it is again."""
        self._condemned |= {one: None for one, status in self._listed.items() if not status.ended}
        while len(self._condemned) > _SENT_KEPT:
            del self._condemned[next(iter(self._condemned))]
        self._client.cancel()

    def close(self) -> None:
        """Close the subscriptions and the client."""
        self._client.close()
        for end in self._ends:
            self._host.node.release(end)

    def _hear_list(self, message: Message) -> None:
        listed = {
            bytes(one["goal_info"]["goal_id"]["uuid"]): GoalState(one["status"]) for one in message["status_list"]
        }
        for goal in self.others:
            end = listed.get(goal, GoalState.ABORTED)
            if end.ended:
                self.ended = goal, _ENDS[end], ""
        if self.gone is not None and self.gone[0] in listed and listed[self.gone[0]].ended:
            self.ended, self.gone = (self.gone[0], _ENDS[listed[self.gone[0]]], ""), None
        self._heard(listed == self._listed)
        self._lister_seen = self._lister_seen and self._lister == self._list.sender
        self._listed, self._lister, self._listed_since = listed, self._list.sender, True
        self._listed_at = time.monotonic()
        if self.ready:
            self._ask_to_let_go()  # before anything else that comes
        self._follow()
        self._changed()

    def _hear_status(self, message: Message) -> None:
        try:
            State(message["state"])
        except ValueError:
            self._host.log.warning("the planner %s reported an unknown state: %r", self.planner, message["state"])
            return
        self._own = message
        self._heard()
        self._changed()


_ENDS = {GoalState.SUCCEEDED: State.REACHED, GoalState.CANCELED: State.IDLE, GoalState.ABORTED: State.ABORTED}


LETTING_GO_SECONDS = 30.0
"""For so long another planner waits for one that does not let go of a goal that ended here, and is asked to."""


class RequestError(RuntimeError):
    """A request that cannot be met now; the text says why."""


class PlannerChoice:
    """The planner at hand, and the one that takes its place. On the module's thread."""

    def __init__(self, host: Host, section: NavigationSection, changed: Callable[[], None]) -> None:
        self._host, self.section, self._changed = host, section, changed  # the section that holds
        self._chosen = ""
        self._next: NavigationSection | None = None
        self._held_since: float | None = None
        self.link = PlannerLink(host, section, section.planner, changed)  # to the planner at hand

    @property
    def pending(self) -> str:
        """The planner that drives once the one at hand stands; "" for none."""
        return "" if self._next is None else self._wanted(self._next)

    def choose(self, planner: str, *, driving: bool) -> None:
        """Have another planner drive; raises `RequestError` if it is unknown, or the one at hand is driving."""
        at_hand = self.link.planner
        if planner not in self.section.choices:
            raise RequestError(f"there is no planner {planner!r}; there are {', '.join(self.section.choices)}")
        if planner != at_hand and driving:
            raise RequestError(f"{at_hand} is driving; stop it first")
        self._chosen = planner
        self._next = self._next or self.section

    def configure(self, section: NavigationSection) -> None:
        """Take up another section once nothing drives; a chosen planner stays unless the section names another one."""
        if section.planner != (self._next or self.section).planner:
            self._chosen = ""
        self._next = section

    def settle(self, *, driving: bool, stop: UnconfirmedStop | None) -> bool:
        """Take up a section that waited for a drive's end; whether the planner before never let go, nor is followed."""
        section = self._next
        if section is None:
            return False
        planner = self._wanted(section)
        same = planner == self.link.planner and section.others == self.section.others
        if not same and (driving or self._holds_on(stop)):  # without the link nobody would ask it to stop
            return False
        self.section, self._next = section, None
        return not same and self._link_to(planner)

    def _wanted(self, section: NavigationSection) -> str:
        return self._chosen if self._chosen in section.choices else section.planner

    def _holds_on(self, stop: UnconfirmedStop | None) -> bool:
        """Whether the planner may still drive to a goal that ended here."""
        if not self.link.holds_on and (stop is None or (stop.stands and not self.link.ready)):
            self._held_since = None
            return False
        now = time.monotonic()
        if self._held_since is None:
            self._held_since = now
        return now < self._held_since + LETTING_GO_SECONDS

    def _link_to(self, planner: str) -> bool:
        given_up, self._held_since = self._held_since is not None, None
        if given_up:
            self._host.log.warning("%s has not let go of its goal for %g s", self.link.planner, LETTING_GO_SECONDS)
        self.link.close()
        self.link = PlannerLink(self._host, self.section, planner, self._changed)
        self._host.log.info("%s is the planner now", planner)
        return given_up
