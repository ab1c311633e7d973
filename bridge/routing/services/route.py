"""The route of a service and its calls, with the server on one network and the clients on the other."""

from __future__ import annotations

import logging
import time
from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import Any

from typing_extensions import override

from bridge.concurrency import BoundedQueue
from bridge.hub.endpoints.calls import LEFT, Abandon, CallError, ClosedCallError, Done, UnsentCallError
from bridge.hub.endpoints.services import HubClient, HubServer
from bridge.messages.actions import CANCEL_GOAL, GET_RESULT, split
from bridge.messages.errors import MessageError
from bridge.messages.transcode.conversion import ServiceConversion
from bridge.routing.counters import Counters
from bridge.routing.decision import RouteKey
from bridge.routing.edge import EdgeCaller, EdgeServer
from bridge.routing.limits import BULK, QUEUE_BYTES
from bridge.routing.route import EngineContext, Route
from bridge.routing.rules import RoutePolicy
from bridge.routing.services.held import LATE_SECONDS
from bridge.status import RouteStatus

_log = logging.getLogger(__name__)

Convert = Callable[[bytes], bytes] | None


class BridgedCall:
    """A call from a client on one network to the server on the other. It ends exactly once."""

    __slots__ = ("_abandon_far", "_began", "_done", "_has_ended", "_lock", "_route")

    def __init__(self, route: ServiceRoute, done: Done) -> None:
        self._route, self._done = route, done
        self._began = time.monotonic_ns()
        self._lock = Lock()
        self._has_ended = False
        self._abandon_far: Abandon | None = None

    def begin(self, request: bytes) -> None:
        """Convert the request and call the far server; runs on a thread of the edge, zenoh or the route's queue."""
        if self._has_ended:
            return
        try:
            data = request if self._route.request is None else self._route.request(request)
        except (MessageError, ValueError) as err:
            self._route.bad(str(err))
            self.end(CallError(f"the request does not match its type: {err}"))
            return
        try:
            abandon = self._route.ask(data, self._on_result)
        except Exception as err:
            _log.exception("a call could not be made")
            self.end(CallError(f"the call could not be made: {type(err).__name__}: {err}"))
            return
        with self._lock:
            self._abandon_far, has_ended = abandon, self._has_ended
        if has_ended:
            abandon()  # the client left meanwhile; a no-op after the end

    def _on_result(self, result: bytes | CallError) -> None:
        if isinstance(result, CallError):
            closing = self._route.closing  # the reason why the far client was closed
            self.end(closing if closing is not None and isinstance(result, ClosedCallError) else result)
        elif not self._route.carry(lambda: self._finish(result), len(result)):
            self.end(CallError("too many large replies are pending; call again later"))

    def _finish(self, reply: bytes) -> None:
        try:
            data = reply if self._route.reply is None else self._route.reply(reply)
        except (MessageError, ValueError) as err:
            self._route.bad(str(err))
            self.end(CallError(f"the reply does not match its type: {err}"))
            return
        self.end(data)

    def end(self, result: bytes | CallError) -> None:
        """End the call with its first result; later results are ignored."""
        if self._end():
            self._route.count_end(self, result, time.monotonic_ns() - self._began)
            self._done(result)

    def abandon(self) -> None:
        """Cancel the call after its client left; the far server's reply is dropped."""
        if self._end():
            self._route.count_end(self, None, 0)
            self.cancel()

    def cancel(self) -> None:
        """Cancel the call on the far network."""
        with self._lock:
            abandon = self._abandon_far
        if abandon is not None:
            abandon()

    def _end(self) -> bool:
        with self._lock:
            had_ended, self._has_ended = self._has_ended, True
        return not had_ended


class CallCounters(Counters):
    """Counts pending calls and results: replies, errors and abandoned calls.

    ``messages`` counts the calls, and latencies are those of whole calls. Refused calls count as errors, and as drops
    with one of the reasons ``queue`` (too many at once), ``bad``, ``large`` and ``standby``.
    """

    __slots__ = ("abandoned", "errors", "pending", "replies")

    def __init__(self) -> None:
        super().__init__()
        self.replies = self.errors = self.abandoned = self.pending = 0

    @override
    def as_dict(self) -> dict[str, Any]:
        calls = {name: getattr(self, name) for name in ("replies", "errors", "abandoned", "pending")}
        return {**super().as_dict(), "calls": self.messages, **calls}


MAX_CALLS = 1000
"""Maximum number of pending calls of one route; further calls fail at once."""

MAX_RESULTS = 10_000
"""Maximum number of pending result requests of an action, which stay pending while their goals are active."""


class ServiceRoute(Route):
    """A service that is bridged in its ``direction``. Calls to a missing server fail; they are never queued."""

    kind = "service"
    request: Convert = None
    reply: Convert = None
    closing: CallError | None = None
    """The error with which pending calls end because the route closes; None before."""

    def __init__(
        self, key: RouteKey, names: tuple[str, str], conversion: ServiceConversion, policy: RoutePolicy,
        context: EngineContext,
    ) -> None:  # fmt: skip
        super().__init__(key, names, (conversion.hub.name, conversion.side.name), policy, context)
        self.counters: CallCounters = CallCounters()
        self.conversion = conversion
        self.servers = 0
        self._may_be_late = split(self.hub_topic)[1] in {CANCEL_GOAL, GET_RESULT}
        self._most = MAX_RESULTS if self.hub_type.endswith("_GetResult") else MAX_CALLS
        self._calls: dict[BridgedCall, None] = {}
        self._lock = Lock()
        self._far: HubClient | EdgeCaller | None = None
        self._near: HubServer | EdgeServer | None = None
        name = f"midspan-{self.direction}{self.side_topic}"
        self._large = BoundedQueue[Callable[[], None]](
            name, 2 * self._most, QUEUE_BYTES, lambda work: work(), lambda: None
        )

    @abstractmethod
    def open(self) -> None:
        """Open the endpoints that are missing; called only by the engine's loop."""

    @property
    def offered(self) -> bool:
        """Whether clients can see the service."""
        return self._near is not None

    def call(self, request: bytes, done: Done) -> Abandon:
        """Start a call from a client on the near network; see `bridge.hub.endpoints.calls.Call`."""
        call = BridgedCall(self, done)
        trouble = ""
        with self._lock:
            self.counters.crossed(len(request))
            self.counters.pending += 1
            if len(self._calls) >= self._most:
                trouble = f"{self._most} calls of {self.side_topic} are already pending; call again later"
            self._calls[call] = None
        if trouble:
            self.counters.dropped("queue")
        elif self.too_large(len(request)):
            trouble = f"the request has {len(request)} bytes, limits.message allows {self._max_payload}"
        if trouble:
            call.end(UnsentCallError(trouble))
        elif self._context.stall_detector.hung(LATE_SECONDS) and not self._may_be_late:
            # the lease has not expired while the machine slept, because the monotonic clock stood
            self._refuse_call(call)
        else:
            begin, refuse = partial(self._begin, call, request), partial(self._refuse_call, call)
            self._context.held_calls.admit(call, len(request), begin, refuse)
        return call.abandon

    def _begin(self, call: BridgedCall, request: bytes) -> None:
        if not self.carry(lambda: call.begin(request), len(request)):
            self.counters.dropped("queue")
            call.end(UnsentCallError("too many large requests are pending; call again later"))

    def _refuse_call(self, call: BridgedCall) -> None:
        """Refuse a call because the worker lacks the lease."""
        self.counters.dropped("standby")
        side = self._context.edge.side
        call.end(UnsentCallError(f"the bridge to {side} was suspended or is on standby; call again later"))

    def ask(self, request: bytes, done: Done) -> Abandon:
        """Call the far server."""
        far = self._far
        if far is None:
            done(CallError(LEFT.format(name=self.side_topic)))
            return lambda: None
        return far.call(request, done)

    def carry(self, work: Callable[[], None], size: int) -> bool:
        """Run ``work`` at once; queue it if it or earlier work is large, because a congested link may block it."""
        if size > BULK or self._large.busy:
            return self._large.offer(work, size)
        work()
        return True

    def count_end(self, call: BridgedCall, result: bytes | CallError | None, nanoseconds: int) -> None:
        """Count the end of a call, which took ``nanoseconds``; a result of None means that it was abandoned."""
        self._context.held_calls.drop(call)
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
                counters.clear_error()
                counters.replies += 1
                counters.bytes += len(result)
                counters.add_latency(nanoseconds)

    @override
    def close(self, why: str = "") -> None:
        with self._lock:
            far, self._far = self._far, None
            near, self._near = self._near, None
        error = self.closing = CallError(why or LEFT.format(name=self.side_topic))
        if isinstance(far, HubClient):
            self._end_calls(error)
        if far is not None:
            far.close()  # an edge may still send a better result than an error, for example a goal's result
        self._end_calls(error)
        if near is not None:
            near.close()
        self._large.close()

    def _end_calls(self, error: CallError) -> None:
        with self._lock:
            calls = list(self._calls)
        for call in calls:
            call.end(error)
            call.cancel()

    @override
    def status(self) -> RouteStatus:
        return RouteStatus(**self.row(active=self.offered, sources=self.servers), priority="", qos="")
