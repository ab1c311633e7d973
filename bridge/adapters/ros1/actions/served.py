"""An action that is served on the hub, offered to the side's actionlib clients."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable

from bridge.adapters.ros1.actions import finding, parts, wire
from bridge.adapters.ros1.actions.frames import empty, frames_in, names_frames, without_slashes
from bridge.adapters.ros1.actions.network import ActionTypes, Ear, Mouth, Network
from bridge.adapters.ros1.actions.server import ActionServer
from bridge.adapters.ros1.actions.turns import Turns
from bridge.hub.call import Abandon, Call, CallError, Done
from bridge.hub.qos import Durability, Qos
from bridge.messages.errors import ConversionError, MessageTypeError

_log = logging.getLogger(__name__)

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_FEEDBACK = Qos(depth=100)

GONE = "the action server is gone"


class ServedAction:
    """Offers one action while all three of its services are given, and no server of the side's has its name."""

    def __init__(self, name: str, network: Network, types: Callable[[str], ActionTypes]) -> None:
        self.name = name
        self.rival = ""
        self._network, self._types_of = network, types
        self._turns = Turns()
        self._type = ""
        self._calls: dict[str, Call] = {}
        self._lock = threading.Lock()
        self._parts = 0
        self._under_way: dict[object, Abandon] = {}
        self._types: ActionTypes | None = None
        self._server: ActionServer | None = None
        self._ears: list[Ear] = []
        self._mouths: dict[str, Mouth] = {}
        self._states = b""
        self._hopeless = False

    # -- the parts -----------------------------------------------------------------------------------------------------

    @property
    def type(self) -> str:
        """The action's type, "" where it is not told yet."""
        return self._type

    @property
    def in_use(self) -> bool:
        """Whether a part of it is open."""
        return self._parts > 0

    def serve(self, part: str, type_name: str, call: Call) -> PartServer:
        """One of the three services; raises `MessageTypeError` where the action's type is not known."""
        if part != parts.CANCEL_GOAL:
            self._types_of(parts.action_type(type_name, part))
        self._count(1)
        self._turns.take(lambda: self._give(part, type_name, call))
        return PartServer(lambda: self._close(part, call))

    def advertise(self, part: str) -> PartPublisher:
        """One of the two topics."""
        self._count(1)
        return PartPublisher(self, part)

    def send(self, part: str, payload: bytes) -> None:
        """A message of one of the two topics."""
        self._turns.take(lambda: self._heard(part, payload))

    def withdraw(self) -> None:
        """A topic was given back."""
        self._count(-1)

    def _close(self, part: str, call: Call) -> None:
        self._turns.take(lambda: self._withdraw(part, call))
        self._count(-1)

    def _count(self, more: int) -> None:
        with self._lock:
            self._parts += more

    @property
    def dropped(self) -> int:
        """Messages that slow clients missed."""
        return sum(mouth.dropped for mouth in list(self._mouths.values()))

    def _give(self, part: str, type_name: str, call: Call) -> None:
        self._calls[part], self._hopeless = call, False
        if part != parts.CANCEL_GOAL:
            self._type = parts.action_type(type_name, part)
        self._open()

    def _withdraw(self, part: str, call: Call) -> None:
        if self._calls.get(part) is call:
            del self._calls[part]
            self._states = b""
            self._shut(GONE)

    # -- ROS 1 ---------------------------------------------------------------------------------------------------------

    def poll(self, rival: str) -> None:
        """Time has passed; ``rival`` is the node that serves an action of this name on the side itself, or ""."""
        self._turns.take(lambda: self._poll(rival))

    def _poll(self, rival: str) -> None:
        self.rival = rival
        if rival:
            self._shut(f"{rival} serves {self.name} itself")
        self._open()
        if self._server is not None:
            self._server.tick()

    def _open(self) -> None:
        if self._server is not None or self._hopeless or self.rival or set(self._calls) != set(parts.SERVICES):
            return
        network, name = self._network, self.name
        try:
            self._types = types = self._types_of(self._type)
            for part, kind, qos in (
                (finding.STATUS, types.status, _LATCHED),
                (finding.FEEDBACK, types.feedback, _FEEDBACK),
                (finding.RESULT, types.result, _LATCHED),
            ):
                self._mouths[part] = network.tell(f"{name}/{part}", kind, qos)
        except MessageTypeError as err:
            _log.warning("%s is not offered to ROS 1: %s", name, err)
            self._hopeless = True
            self._hush()
            return
        self._server = ActionServer(name, self, time.monotonic, self._now, empty(types.result_body))
        self._server.open()
        if self._states:
            self._heard(parts.STATUS, self._states)
        self._ears = [
            network.hear(f"{name}/goal", types.goal, self._on_goal, ""),
            network.hear(f"{name}/cancel", types.cancel, self._on_cancel, ""),
        ]

    def _shut(self, reason: str) -> None:
        server, self._server = self._server, None
        if server is None:
            return
        server.close(reason)
        under_way, self._under_way = self._under_way, {}
        for abandon in under_way.values():
            abandon()
        self._hush()

    def _hush(self) -> None:
        handles: list[Ear | Mouth] = [*self._ears, *self._mouths.values()]
        for handle in handles:
            handle.close()
        self._ears, self._mouths = [], {}

    def _now(self) -> wire.Stamp:
        return wire.Stamp.of(self._network.clock().now_ns())

    def _on_goal(self, payload: bytes, _source: str, _time: int | None) -> None:
        self._turns.take(lambda: self._read(finding.GOAL, lambda: self._goal(payload)))

    def _goal(self, payload: bytes) -> None:
        assert self._types is not None
        goal, body = wire.read_action_goal(payload)
        schema = self._types.goal_body
        if self._network.check_frames and names_frames(schema):
            with contextlib.suppress(ConversionError):  # the call will say so, and end the goal
                body = without_slashes(body, frames_in(schema, body))
        if self._server is not None:
            self._server.goal(goal, body)

    def _on_cancel(self, payload: bytes, _source: str, _time: int | None) -> None:
        self._turns.take(lambda: self._read(finding.CANCEL, lambda: self._cancel(payload)))

    def _cancel(self, payload: bytes) -> None:
        if self._server is not None:
            self._server.cancel(wire.read_goal_id(payload))

    def _heard(self, part: str, payload: bytes) -> None:
        if part == parts.STATUS:
            self._states = payload
        server = self._server
        if server is None:
            return
        if part == parts.STATUS:
            self._read(finding.STATUS, lambda: server.states(wire.read_goal_states(payload)))
        else:
            self._read(finding.FEEDBACK, lambda: server.feedback(*wire.read_with_uuid(payload)))

    def _read(self, part: str, read: Callable[[], None]) -> None:
        try:
            read()
        except ConversionError as err:
            self._network.refuse(f"{self.name}/{part}", "bad", str(err))

    # -- what the goals ask for ----------------------------------------------------------------------------------------

    def status(self, payload: bytes) -> None:
        """Publish the status list."""
        self._mouths[finding.STATUS].send(payload, "")

    def feedback(self, payload: bytes) -> None:
        """Publish a feedback."""
        self._mouths[finding.FEEDBACK].send(payload, "")

    def result(self, goal: str, payload: bytes) -> None:
        """Publish a result, and keep it for who comes late."""
        self._mouths[finding.RESULT].send(payload, goal)

    def forget(self, goal: str) -> None:
        """Keep a result no longer."""
        self._mouths[finding.RESULT].forget(goal)

    def send_goal(self, request: bytes, done: Done) -> None:
        """Call the hub; likewise the next two."""
        self._call(parts.SEND_GOAL, request, done)

    def get_result(self, request: bytes, done: Done) -> None:
        """See `send_goal`."""
        self._call(parts.GET_RESULT, request, done)

    def cancel_goal(self, request: bytes, done: Done) -> None:
        """See `send_goal`."""
        self._call(parts.CANCEL_GOAL, request, done)

    def _call(self, part: str, request: bytes, done: Done) -> None:
        """Begin a call of the hub's server; its end takes its turn."""
        key = object()
        server = self._server

        def ended(reply: bytes | CallError) -> None:
            self._under_way.pop(key, None)
            if self._server is server:
                done(reply)

        self._under_way[key] = _nothing
        abandon = self._calls[part](request, lambda reply: self._turns.take(lambda: ended(reply)))
        if key in self._under_way:
            self._under_way[key] = abandon


class PartServer:
    """One of an action's services; see `bridge.adapters.base.EdgeServer`."""

    def __init__(self, close: Callable[[], None]) -> None:
        self._close: Callable[[], None] | None = close

    def close(self) -> None:
        """End all goals of the action that are under way, and tell their clients."""
        close, self._close = self._close, None
        if close is not None:
            close()


class PartPublisher:
    """One of an action's topics; see `bridge.adapters.base.EdgePublisher`."""

    def __init__(self, action: ServedAction, part: str) -> None:
        self._action, self._part = action, part
        self._closed = False

    @property
    def dropped(self) -> int:
        """Messages that slow clients missed."""
        return self._action.dropped if self._part == parts.FEEDBACK else 0

    def send(self, payload: bytes, source: str) -> None:  # noqa: ARG002 - an action has one server
        """Take up what the hub's server says."""
        if not self._closed:
            self._action.send(self._part, payload)

    def forget(self, source: str) -> None:
        """The hub's server is gone; that its services are too says the same."""

    def close(self) -> None:
        """Give the topic back."""
        if not self._closed:
            self._closed = True
            self._action.withdraw()


def _nothing() -> None:
    """There is nothing to abandon yet."""
