"""Offers an action that is served on the hub to the side's actionlib clients."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable

from bridge.adapters.ros1.actions import discovery, wire
from bridge.adapters.ros1.actions.cancel_order import CancelOrder, Client
from bridge.adapters.ros1.actions.frames import empty, frames_in, has_headers, without_slashes
from bridge.adapters.ros1.actions.network import ActionMessages, ActionNetwork, ActionTopics, OpenPart
from bridge.adapters.ros1.actions.orphans import OrphanedGoals
from bridge.adapters.ros1.actions.server import ActionlibServer
from bridge.adapters.ros1.graph.state import node_of
from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done, nothing
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages import actions as ros2_action
from bridge.messages.errors import ConversionError, MessageTypeError

_log = logging.getLogger(__name__)

_FEEDBACK = Qos(depth=100)

GONE = "the action server left"


class ServedAction(ActionTopics):
    """Offers one action while all three of its services exist on the hub, and the side has no server of that name."""

    def __init__(
        self, name: str, network: ActionNetwork, types: Callable[[str], ActionMessages], orphans: OrphanedGoals
    ) -> None:
        super().__init__(name, network)
        self._orphans = orphans
        self.rival = ""
        self._types_of = types
        self._type = ""
        self._calls: dict[str, Call] = {}
        self._parts = 0
        self._pending: dict[object, Abandon] = {}
        self._types: ActionMessages | None = None
        self._server: ActionlibServer | None = None
        self._order: CancelOrder | None = None
        self._unoffered = False
        self._unwatch: Callable[[], object] = lambda: None

    @property
    def type(self) -> str:
        """The action's type, "" while unknown."""
        return self._type

    @property
    def in_use(self) -> bool:
        """Whether a part is open."""
        return self._parts > 0

    def serve(self, part: str, type_name: str, call: Call) -> OpenPart:
        """Serve one of the three services; raises `MessageTypeError` if the action's type is unknown."""
        if part != ros2_action.CANCEL_GOAL:
            self._types_of(discovery.action_type(type_name, part))
        self._count(1)
        self._executor.submit(lambda: self._add_call(part, type_name, call))
        return OpenPart(lambda: self._close(part, call))

    def advertise(self, part: str) -> PartPublisher:
        """Return a publisher for the hub server's status or feedback."""
        self._count(1)
        return PartPublisher(self, part)

    def send(self, part: str, payload: bytes) -> None:
        """Handle a message of the hub server's status or feedback topic."""
        self._executor.submit(lambda: self._on_message(part, payload))

    def withdraw(self) -> None:
        """Count a closed publisher."""
        self._count(-1)

    def _close(self, part: str, call: Call) -> None:
        self._executor.submit(lambda: self._remove_call(part, call))
        self._count(-1)

    def _count(self, more: int) -> None:
        with self._lock:
            self._parts += more

    @property
    def dropped(self) -> int:
        """Number of messages that slow clients missed."""
        return sum(publisher.dropped for publisher in list(self._publishers.values()))

    def _add_call(self, part: str, type_name: str, call: Call) -> None:
        self._calls[part], self._unoffered = call, False
        if part != ros2_action.CANCEL_GOAL:
            self._type = discovery.action_type(type_name, part)
        self._open()

    def _remove_call(self, part: str, call: Call) -> None:
        if self._calls.get(part) is call:
            del self._calls[part]
            self._states = b""
            self._close_server(GONE)

    def poll(self, rival: str) -> None:
        """Do periodic work; ``rival`` is the node that serves an action of this name on the side, "" if none does."""
        self._executor.submit(lambda: self._poll(rival))

    def _poll(self, rival: str) -> None:
        self.rival = rival
        if rival:
            self._close_server(f"{rival} serves {self.name} itself")
        self._open()
        if self._server is not None and self._order is not None:
            self._order.release()
            self._server.tick()

    def _open(self) -> None:
        if self._server is not None or self._unoffered or self.rival or set(self._calls) != set(ros2_action.SERVICES):
            return
        try:
            self._types = types = self._types_of(self._type)
            self._advertise(discovery.STATUS, types.status, LATCHED)
            self._advertise(discovery.FEEDBACK, types.feedback, _FEEDBACK)
            self._advertise(discovery.RESULT, types.result, LATCHED)
        except MessageTypeError as err:
            _log.warning("%s is not offered to ROS 1: %s", self.name, err)
            self._unoffered = True
            self._close_topics()
            return
        self._server = ActionlibServer(
            self.name,
            self,
            time.monotonic,
            lambda: wire.RosTime.of(self._network.clock().now_ns()),
            empty(types.result_body),
            self._orphans,
        )
        self._order = CancelOrder(self._server, self._unread, time.monotonic)
        self._unwatch = self._network.clock().on_jump(lambda: self._executor.submit(self._clock_jumped))
        self._server.open()
        if self._states:
            self._on_message(ros2_action.STATUS, self._states)
        self._subscribe(discovery.GOAL, types.goal, self._on_goal)
        self._subscribe(discovery.CANCEL, types.cancel, self._on_cancel)

    def _close_server(self, reason: str) -> None:
        server, self._server, self._order = self._server, None, None
        if server is None:
            return
        self._unwatch()
        server.close(reason)
        pending, self._pending = self._pending, {}
        for abandon in pending.values():
            abandon()
        self._close_topics()

    def _clock_jumped(self) -> None:
        if self._server is not None:
            self._server.forget_time()

    def _unread(self, client: Client, *, listed: bool) -> bool:
        goals = self._subscriptions.get(discovery.GOAL)
        return goals is not None and goals.unread(*client, listed=listed)

    def _on_goal(self, payload: bytes, source: str, _time: int | None) -> None:
        self._executor.submit(lambda: self._read(discovery.GOAL, lambda: self._goal(payload, node_of(source))))

    def _goal(self, payload: bytes, client: Client) -> None:
        assert self._types is not None
        goal, body = wire.read_action_goal(payload)
        schema = self._types.goal_body
        if self._network.check_frames and has_headers(schema):
            with contextlib.suppress(ConversionError):  # the call reports it, and ends the goal
                body = without_slashes(body, frames_in(schema, body))
        if self._order is not None:
            self._order.goal(goal, body, client)

    def _on_cancel(self, payload: bytes, source: str, _time: int | None) -> None:
        client = node_of(source)
        unread = self._unread(client, listed=False)  # before `submit`, because goals read so far run ahead of this job
        self._executor.submit(lambda: self._read(discovery.CANCEL, lambda: self._cancel(payload, client, unread)))

    def _cancel(self, payload: bytes, client: Client, unread: bool) -> None:
        if self._order is not None:
            self._order.cancel(wire.read_goal_id(payload), client, unread=unread)

    def _on_message(self, part: str, payload: bytes) -> None:
        if part == ros2_action.STATUS:
            self._states = payload
        server = self._server
        if server is None:
            return
        if part == ros2_action.STATUS:
            self._read(discovery.STATUS, lambda: server.states(wire.read_goal_states(payload)))
        else:
            self._read(discovery.FEEDBACK, lambda: server.feedback(*wire.read_with_uuid(payload)))

    def drop_result(self, goal: str) -> None:
        """Drop a goal's result."""
        self._publishers[discovery.RESULT].drop_source(goal)

    def call(self, part: str, request: bytes, done: Done) -> None:
        """Call the hub's server; ``done`` is called through the executor."""
        key = object()
        server = self._server

        def ended(reply: bytes | CallError) -> None:
            self._pending.pop(key, None)
            if self._server is server:
                done(reply)

        self._pending[key] = nothing
        abandon = self._calls[part](request, lambda reply: self._executor.submit(lambda: ended(reply)))
        if key in self._pending:
            self._pending[key] = abandon


class PartPublisher(OpenPart):
    """A `bridge.routing.edge.EdgePublisher` for one of an action's topics."""

    has_subscribers = True

    def __init__(self, action: ServedAction, part: str) -> None:
        super().__init__(action.withdraw)
        self._action, self._part = action, part

    @property
    def dropped(self) -> int:
        """Number of messages that slow clients missed."""
        return self._action.dropped if self._part == ros2_action.FEEDBACK else 0

    def send(self, payload: bytes, source: str) -> None:  # noqa: ARG002 - an action has one server
        """Forward a message of the hub's server."""
        if self._close is not None:
            self._action.send(self._part, payload)

    def drop_source(self, source: str) -> None:
        """Do nothing: when the server leaves, its services are withdrawn, which ends the goals."""
