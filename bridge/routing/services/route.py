"""A service that crosses: its server is on the one network, its callers are on the other."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Callable
from threading import Lock
from typing import Any

from bridge.adapters.base import EdgeCaller, EdgeServer
from bridge.hub.call import Abandon, CallError, Done
from bridge.hub.queries import LEFT
from bridge.hub.service import HubClient, HubServer
from bridge.messages.conversion import ServiceConversion
from bridge.routing.joint import Joint
from bridge.routing.lane import Lane
from bridge.routing.route import BULK, QUEUE_BYTES, Route, RouteKey
from bridge.routing.rules import Decision
from bridge.routing.services.call import Convert, Passing
from bridge.routing.services.counters import CallCounters

_log = logging.getLogger(__name__)

MAX_CALLS = 1000
"""Calls of one route that are under way at most; the next ones get an error at once."""

MAX_RESULTS = 10_000
"""The same for the results of an action's goals, which are asked for while the goals are under way."""


class ServiceRoute(Route):
    """One service; ``direction`` is the way that the service is offered, against which its calls go.

    Nothing is kept for later: a call that finds no server ends with an error.
    """

    kind = "service"
    request: Convert = None
    reply: Convert = None

    def __init__(
        self,
        key: RouteKey,
        names: tuple[str, str],
        conversion: ServiceConversion,
        decision: Decision,
        joint: Joint,
    ) -> None:
        super().__init__(key, names[0], names[1], (conversion.hub.name, conversion.side.name), decision)
        self.counters: CallCounters = CallCounters()
        self.conversion = conversion
        self.servers = 0
        self._most = MAX_RESULTS if self.hub_type.endswith("_GetResult") else MAX_CALLS
        self._joint = joint
        self._calls: dict[Passing, None] = {}
        self._lock = Lock()
        self._far: HubClient | EdgeCaller | None = None
        self._near: HubServer | EdgeServer | None = None
        name = f"midspan-{self.direction}{self.side_topic}"
        self._large = Lane[Callable[[], None]](name, 2 * self._most, QUEUE_BYTES, lambda work: work(), lambda: None)

    @abstractmethod
    def open(self) -> None:
        """Make what is missing of both ends; called by the engine's loop alone."""

    @property
    def offered(self) -> bool:
        """Whether callers can see the service."""
        return self._near is not None

    # -- a call --------------------------------------------------------------------------------------------------------

    def call(self, request: bytes, done: Done) -> Abandon:
        """A caller on the near network asks; see `bridge.hub.call.Call`."""
        call = Passing(self, done)
        trouble = ""
        with self._lock:
            self.counters.crossed(len(request))
            self.counters.pending += 1
            if len(self._calls) >= self._most:
                trouble = f"{self._most} calls of {self.side_topic} are under way already; call again later"
            self._calls[call] = None
        if trouble:
            self.counters.dropped("queue")
        elif self._joint.lease.over:
            trouble = f"the bridge to {self._joint.edge.side} stood still or stands by; call again later"
            self.counters.dropped("standby")
        elif self.too_large(len(request), self._joint.hub.max_payload):
            trouble = f"the request has {len(request)} bytes, limits.message allows {self._joint.hub.max_payload}"
        elif not self.carry(lambda: call.begin(request), len(request)):
            trouble = "too many large requests are under way; call again later"
            self.counters.dropped("queue")
        if trouble:
            call.end(CallError(trouble))
        return call.abandon

    def ask(self, request: bytes, done: Done) -> Abandon:
        """Call the far server."""
        far = self._far
        if far is None:
            done(CallError(LEFT.format(name=self.side_topic)))
            return lambda: None
        return far.call(request, done)

    def carry(self, work: Callable[[], None], size: int) -> bool:
        """Do a piece of work, at once where it is about few bytes: a congested link makes many of them wait."""
        if size > BULK or self._large.busy:
            return self._large.offer(work, size)
        work()
        return True

    def refuse(self, error: str, reason: str) -> None:
        """Count bytes that are not what their type says."""
        self.bad(error, reason)

    def over(self, call: Passing, result: bytes | CallError | None, nanoseconds: int) -> None:
        """A call ended, or was abandoned with None."""
        with self._lock:
            self._calls.pop(call, None)
            counters = self.counters
            counters.pending -= 1
            if result is None:
                counters.abandoned += 1
            elif isinstance(result, CallError):
                counters.errors += 1
                if counters.failed(str(result)):
                    _log.info("%s %s: %s", self.direction, self.side_topic, result)
            else:
                counters.replies += 1
                counters.bytes += len(result)
                counters.latency(nanoseconds)

    # -- its end -------------------------------------------------------------------------------------------------------

    def close(self, why: str = "") -> None:
        """End every call, and give back both ends."""
        with self._lock:
            far, self._far = self._far, None
            near, self._near = self._near, None
        error = CallError(why or LEFT.format(name=self.side_topic))
        if isinstance(far, HubClient):
            self._end_calls(error)
        if far is not None:
            far.close()  # an edge may still say something better than an error, of a goal for example
        self._end_calls(error)
        if near is not None:
            near.close()
        self._large.close()

    def _end_calls(self, error: CallError) -> None:
        with self._lock:
            calls = list(self._calls)
        for call in calls:
            call.end(error)
            call.leave()

    def status(self) -> dict[str, Any]:
        """The route as it stands in the status document."""
        return {**self.row(active=self.offered, sources=self.servers), "priority": "", "qos": ""}
