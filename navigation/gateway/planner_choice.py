"""Which planner drives: the one of the configuration or the one that was chosen, once the other has let go."""

from __future__ import annotations

import time
from collections.abc import Callable

from bridge.config.sections.navigation import NavigationSection
from bridge.modules.host import Host
from navigation.gateway.planner_link import PlannerLink
from navigation.gateway.stop import UnconfirmedStop

LETTING_GO_SECONDS = 30.0
"""For so long another planner waits for one that does not let go of a goal that ended here, and is asked to."""


class RequestError(RuntimeError):
    """A request that cannot be met now; the text says why."""


class PlannerChoice:
    """The planner at hand, and the one that takes its place; ``changed`` is called when it tells something new.

    On the module's thread.
    """

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
