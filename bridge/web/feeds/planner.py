"""The gateway's planner, which other clients may change too, and which outlasts a restart of the console."""

from __future__ import annotations

from functools import partial

from bridge.client.session import Client
from bridge.concurrency import SerialExecutor
from bridge.hub.errors import HubError
from bridge.modules.host import Host
from bridge.web.feeds.robot import DrivingFeed

PLANNER_SECONDS = 2.0
"""Interval of the queries while a page is open."""

_ASK_SECONDS = 1.0


class PlannerFollower:
    """Passes the gateway's planner to the feed ``driving``; used on the module's thread."""

    def __init__(self, host: Host, client: Client, driving: DrivingFeed, executor: SerialExecutor) -> None:
        self._host, self._client, self._driving, self._executor = host, client, driving, executor
        self._asking = False

    def refresh(self) -> None:
        """Query the gateway, unless a query is running."""
        if not self._asking:
            self._asking = True
            self._executor.submit(partial(self._ask, self._driving.planner))

    def _ask(self, shown: str) -> None:
        """Query on a thread that may block; ``shown`` is the planner that pages show now."""
        planner = ""
        try:
            planner = self._planner()
        except HubError:
            pass  # the next query may succeed
        finally:
            self._host.loop.post(partial(self._on_planner, shown, planner))

    def _planner(self) -> str:
        """Return the planner of this daemon's gateway, or of the only gateway on the hub; "" if there is none."""
        answers = self._client.ask("status", worker="gateway", timeout=_ASK_SECONDS)
        planners = {
            answer.daemon: str(answer.value.get("planner", "")) for answer in answers if isinstance(answer.value, dict)
        }
        only = next(iter(planners.values())) if len(planners) == 1 else ""
        return planners.get(self._client.config.name, only)

    def _on_planner(self, shown: str, planner: str) -> None:
        self._asking = False
        known = self._client.config.navigation.choices
        if planner in known and planner != shown == self._driving.planner:  # else a page has chosen one meanwhile
            self._driving.on_planner(planner)
