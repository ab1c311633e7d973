"""The current planner, and the one that replaces it."""

from __future__ import annotations

import time
from collections.abc import Callable

from bridge.config.sections.navigation import ACTION, NavigationSection
from bridge.messages.actions import names
from bridge.modules.host import Host
from navigation.gateway.foreign import GoalMark
from navigation.gateway.machine import StopState
from navigation.gateway.planner_link import PlannerLink

RELEASE_SECONDS = 30.0
"""Another planner waits this long for the current one to release a goal that has ended at the gateway."""


class RequestError(RuntimeError):
    """A request that is refused now; the text is the reason."""


class PlannerChoice:
    """The current planner, and the one that replaces it; used only on the module's thread."""

    def __init__(self, host: Host, section: NavigationSection, changed: Callable[[], None]) -> None:
        self._host, self.section, self._changed = host, section, changed
        self._mark = GoalMark(host.config.name)
        self._chosen = ""
        self._next: NavigationSection | None = None
        self._unreleased_since: float | None = None
        self.link = PlannerLink(host, section, section.planner, changed, self._mark)  # to the current planner

    @property
    def pending(self) -> str:
        """The planner that takes over when the robot stands still; "" for none."""
        following = self._next  # another thread reads this
        return "" if following is None else self._wanted(following)

    @property
    def has_action(self) -> bool:
        """Whether the current planner, or one that takes over, serves the gateway's action itself."""
        following = self._next is not None and self._next.has_action(self._wanted(self._next))
        return following or self.section.has_action(self.link.planner)

    def choose(self, planner: str, *, driving: bool) -> None:
        """Select another planner; raises `RequestError` if it is unknown, or the current planner is driving."""
        current = self.link.planner
        if planner not in self.section.choices:
            raise RequestError(f"unknown planner {planner!r}; choose one of {', '.join(self.section.choices)}")
        if planner != current and driving:
            raise RequestError(f"{current} is driving; stop it first")
        self._chosen = planner
        self._next = self._next or self.section

    def configure(self, section: NavigationSection) -> None:
        """Use another section, but change the planner only when the robot stands still.

        A planner that a client has chosen stays unless the section names another planner than before.
        """
        if section.planner != (self._next or self.section).planner:
            self._chosen = ""
        self._next = section

    def settle(self, *, driving: bool, stop: StopState) -> bool:
        """Use a section that was waiting for the end of a drive.

        Returns whether the previous planner has failed to release its goals in time; the goals are no longer followed.
        """
        section = self._next
        if section is None:
            return False
        planner = self._wanted(section)
        same = planner == self.link.planner and section.others == self.section.others
        if not same and (driving or self._unreleased(stop)):  # only the link to the current planner can stop the robot
            return False
        if not same and section.has_action(planner) and self._serves_action():  # it would be taken for the planner's
            return False
        self.section, self._next = section, None
        return not same and self._link_to(planner)

    def _serves_action(self) -> bool:
        """Whether the gateway still serves a part of its action."""
        graph, parts = self._host.node.hub.graph, names(ACTION)
        servers = map(graph.servers, (parts.send_goal, parts.cancel_goal, parts.get_result))
        return any(server.own for part in servers for server in part)

    def _wanted(self, section: NavigationSection) -> str:
        return self._chosen if self._chosen in section.choices else section.planner

    def _unreleased(self, stop: StopState) -> bool:
        """Whether the planner may still drive to a goal that has ended at the gateway."""
        resting_without_it = stop is StopState.RESTING and not self.link.reachable
        if not self.link.left and (not stop.open or resting_without_it):
            self._unreleased_since = None
            return False
        now = time.monotonic()
        if self._unreleased_since is None:
            self._unreleased_since = now
        return now < self._unreleased_since + RELEASE_SECONDS

    def _link_to(self, planner: str) -> bool:
        given_up, self._unreleased_since = self._unreleased_since is not None, None
        if given_up:
            self._host.log.warning("%s has not released its goal for %g s", self.link.planner, RELEASE_SECONDS)
        self.link.close()
        self.link = PlannerLink(self._host, self.section, planner, self._changed, self._mark)
        self._host.log.info("planner: %s", planner)
        return given_up
