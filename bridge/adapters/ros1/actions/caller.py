"""Presents an actionlib server as the parts of a ROS 2 action."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from bridge.adapters.ros1.actions import discovery, wire
from bridge.adapters.ros1.actions.cancels import ANY
from bridge.adapters.ros1.actions.client import ActionlibClient
from bridge.adapters.ros1.actions.discovery import FoundServer
from bridge.adapters.ros1.actions.frames import FrameGuard, empty
from bridge.adapters.ros1.actions.network import ActionMessages, ActionNetwork, ActionTopics, OpenPart
from bridge.adapters.ros1.graph.state import publisher_id
from bridge.concurrency import InlineExecutor
from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done, nothing
from bridge.hub.wire.qos import Qos
from bridge.messages import actions as ros2_action
from bridge.messages.errors import ConversionError
from bridge.routing.edge import Deliver

_QUEUE = Qos(depth=10_000)
"""Goals and cancel requests must not be dropped."""

_REJECTED = wire.goal_response(wire.ZERO, accepted=False)

STOPS = "the bridge no longer follows the action"
GONE = "its action server {} left"


class ActionCaller(ActionTopics):
    """Sends goals to one server of an action at a time, and stores their states and results for later clients."""

    def __init__(
        self, name: str, types: ActionMessages, network: ActionNetwork, guard: FrameGuard,
        is_present: Callable[[FoundServer], bool],
    ) -> None:  # fmt: skip
        super().__init__(name, network)
        self._types, self._guard, self._is_present = types, guard, is_present
        self._client = ActionlibClient(name, self, time.monotonic, empty(types.result_body))
        self._open: list[object] = []
        self._server: FoundServer | None = None
        self._ready = False
        self._links: dict[str, int] = {}
        self._newest_statuses: tuple[bytes, str] | None = None
        self._early_statuses: tuple[bytes, str] | None = None
        self._postponed: list[tuple[bytes, Done, _DeferredCall]] = []
        self._listeners: dict[str, list[Deliver]] = {part: [] for part in ros2_action.TOPICS}

    # -- the parts -----------------------------------------------------------------------------------------------------

    @property
    def in_use(self) -> bool:
        """Whether a part is open, or goals are stored."""
        return bool(self._open) or self._client.kept > 0

    def caller(self, part: str) -> PartCaller:
        """Return a client of one of the three services."""
        begin = {
            ros2_action.SEND_GOAL: self._send_goal,
            ros2_action.GET_RESULT: self._client.get_result,
            ros2_action.CANCEL_GOAL: self._cancel,
        }[part]
        opened = PartCaller(self._executor, begin, lambda: self._close_caller(opened))
        self._add_part(opened)
        return opened

    def subscribe(self, part: str, deliver: Deliver) -> OpenPart:
        """Subscribe to one of the two topics; the last status list, if any, is delivered at once."""
        opened = OpenPart(lambda: self._unsubscribe(part, deliver, opened))
        self._executor.submit(lambda: self._add_listener(part, deliver))
        self._add_part(opened)
        return opened

    def _add_part(self, opened: object) -> None:
        with self._lock:
            self._open.append(opened)
        self._executor.submit(self._connect)

    def _remove_part(self, opened: object) -> None:
        with self._lock:
            self._open.remove(opened)
            last = not self._open
        if last:
            self._executor.submit(self._disconnect)

    def _close_caller(self, opened: object) -> None:
        self._executor.submit(lambda: self._end_goals(STOPS))
        self._remove_part(opened)

    def _end_goals(self, reason: str) -> None:
        server, self._ready, self._states = self._server, False, b""
        postponed, self._postponed = self._postponed, []
        for _, done, _ in postponed:
            done(_REJECTED)
        left = server is not None and not self._is_present(server)
        self._client.close(GONE.format(server.node) if server is not None and left else reason)

    def _add_listener(self, part: str, deliver: Deliver) -> None:
        self._listeners[part].append(deliver)
        if part == ros2_action.STATUS and self._states and self._server is not None:
            deliver(self._states, self._source(part), None)

    def _unsubscribe(self, part: str, deliver: Deliver, opened: object) -> None:
        self._executor.submit(lambda: self._listeners[part].remove(deliver))
        self._remove_part(opened)

    # -- ROS 1 ---------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        # a part is opened because a server is on the graph, which `_choose` may not have received yet
        self._client.discovered()
        if not self._open or self._subscriptions:
            return
        self._advertise(discovery.GOAL, self._types.goal, _QUEUE)
        self._advertise(discovery.CANCEL, self._types.cancel, _QUEUE)
        self._subscribe(discovery.STATUS, self._types.status, self._on_status)
        self._subscribe(discovery.FEEDBACK, self._types.feedback, partial(self._on_outcome, discovery.FEEDBACK))
        self._subscribe(discovery.RESULT, self._types.result, partial(self._on_outcome, discovery.RESULT))
        self._guard.open(self)

    def _disconnect(self) -> None:
        if self._open:
            return
        self._guard.close(self)
        self._client.disconnected()
        self._server, self._ready = None, False
        self._close_topics()

    def poll(self, servers: Sequence[FoundServer]) -> None:
        """Check the connections; called about ten times per second with the native servers that are alive."""
        self._executor.submit(lambda: self._poll(servers))

    def _poll(self, servers: Sequence[FoundServer]) -> None:
        if self._open:
            self._choose(servers)
            self._check_connections()
            self._retry_postponed()
        self._client.tick()

    def _choose(self, servers: Sequence[FoundServer]) -> None:
        if self._server in servers:
            return
        if self._server is not None:
            self._lose_server(GONE.format(self._server.node))
        if servers:
            self._server = servers[0]
            self._client.discovered()
            if self._early_statuses is not None:  # a list that arrived before the master's state was read
                self._newest_statuses, self._early_statuses = self._early_statuses, None
                self._read_statuses()

    def _check_connections(self) -> None:
        server = self._server
        if server is None:
            return
        links = {part: publisher.subscribers.get(server.node, 0) for part, publisher in self._publishers.items()}
        listening = {part for part, number in links.items() if number}
        subscribed = all(
            server.link(part) in subscription.connected for part, subscription in self._subscriptions.items()
        )
        for part in listening:
            if self._links.setdefault(part, links[part]) != links[part]:
                self._links[part] = links[part]
                self._client.reconnected(part)
        ready = subscribed and listening >= discovery.TO_SERVER
        if ready and not self._ready:
            self._client.connected()
        elif self._ready and not ready:
            self._client.disconnected()
        self._ready = ready
        self._client.reach(reachable=discovery.CANCEL in listening)

    def _lose_server(self, reason: str) -> None:
        self._ready = False
        self._links.clear()
        self._client.lost(reason)
        self._server, self._states = None, b""

    def _is_ours(self, source: str, part: str) -> bool:
        """Return whether a message comes from the chosen server."""
        server = self._server
        if server is None:
            return False
        return source.removesuffix(" latched") == publisher_id(server.link(part), latching=False)

    def _on_status(self, payload: bytes, source: str, _time: int | None) -> None:
        """Schedule the newest status list; older lists are skipped, because each list names all goals."""
        waiting, self._newest_statuses = self._newest_statuses, (payload, source)
        if waiting is None:
            self._executor.submit(self._read_statuses)

    def _read_statuses(self) -> None:
        newest, self._newest_statuses = self._newest_statuses, None
        if newest is None:
            return
        payload, source = newest
        if self._is_ours(source, discovery.STATUS):
            self._read(discovery.STATUS, lambda: self._client.statuses(wire.read_statuses(payload)))
        else:
            self._early_statuses = newest

    def _on_outcome(self, part: str, payload: bytes, source: str, _time: int | None) -> None:
        self._executor.submit(lambda: self._outcome(part, payload, source))

    def _outcome(self, part: str, payload: bytes, source: str) -> None:
        if self._is_ours(source, part):
            accept = self._client.feedback if part == discovery.FEEDBACK else self._client.result
            self._read(part, lambda: accept(*wire.read_action_outcome(payload)))

    # -- goals ---------------------------------------------------------------------------------------------------------

    def _send_goal(self, request: bytes, done: Done) -> Abandon:
        """Send a goal whose frames are known; reject or postpone any other goal."""
        try:
            uuid, body = wire.read_with_uuid(request)
            body, trouble = self._guard.check(self._types.goal_body, body)
        except ConversionError as err:
            done(CallError(str(err)))
            return nothing
        if trouble is None:
            deferred = _DeferredCall()
            self._postponed.append((uuid + body, done, deferred))
            return deferred.abandon
        if trouble:
            self._guard.report(self.name, trouble)
            done(_REJECTED)
            return nothing
        return self._client.send_goal(uuid + body, done)

    def _cancel(self, request: bytes, done: Done) -> Abandon:
        """Cancel goals; reject those that were postponed, because the server would still receive them later."""
        try:
            uuid, stamp = wire.read_cancel_request(request)
        except ConversionError as err:
            done(CallError(str(err)))
            return nothing
        postponed, self._postponed = self._postponed, []
        for call in postponed:
            if call[0][: wire.UUID_SIZE] != uuid and (uuid, stamp) != (ANY, wire.ZERO):
                self._postponed.append(call)
            elif not call[2].abandoned:
                self._guard.report(self.name, "it was canceled before enough transforms had been received")
                call[1](_REJECTED)
        return self._client.cancel(request, done)

    def _retry_postponed(self) -> None:
        """Retry goals that were postponed because too few transforms had been received."""
        postponed, self._postponed = self._postponed, []
        for request, done, deferred in postponed:
            if not deferred.abandoned:
                deferred.begin(self._send_goal(request, done))

    def deliver(self, part: str, payload: bytes) -> None:
        """Deliver a message of ``status`` or ``feedback`` to the hub."""
        if part == ros2_action.STATUS:
            self._states = payload
        for deliver in self._listeners[part]:
            deliver(payload, self._source(part), None)

    def _source(self, part: str) -> str:
        return endpoint_id(self._server, part) if self._server is not None else f"action {self.name} {part}"


def endpoint_id(server: FoundServer, part: str) -> str:
    """Return the id of the endpoint that presents a part of a server."""
    return f"action {ros2_action.part_name(server.name, part)} {server.node} {server.uri}"


class _DeferredCall:
    """A call that may be abandoned before it begins."""

    def __init__(self) -> None:
        self._abandon: Abandon | None = None
        self.abandoned = False

    def begin(self, abandon: Abandon) -> None:
        self._abandon = abandon
        if self.abandoned:
            abandon()

    def abandon(self) -> None:
        self.abandoned = True
        if self._abandon is not None:
            self._abandon()


class PartCaller(OpenPart):
    """A client of one of an action's services; see `bridge.routing.edge.EdgeCaller`."""

    def __init__(self, executor: InlineExecutor, begin: Call, close: Callable[[], None]) -> None:
        super().__init__(close)
        self._executor, self._begin = executor, begin

    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call; never blocks."""
        deferred = _DeferredCall()

        def publish(reply: bytes | CallError) -> None:
            if not deferred.abandoned:
                done(reply)

        if self._close is None:
            done(CallError(STOPS))
            return nothing
        self._executor.submit(lambda: deferred.begin(self._begin(request, publish)))
        return lambda: self._executor.submit(deferred.abandon)
