"""An actionlib server of the side, called by the parts of a ROS 2 action."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from bridge.adapters.base import Deliver
from bridge.adapters.ros1.actions import finding, parts, wire
from bridge.adapters.ros1.actions.client import ActionClient
from bridge.adapters.ros1.actions.finding import Server
from bridge.adapters.ros1.actions.frames import empty
from bridge.adapters.ros1.actions.guard import FrameGuard
from bridge.adapters.ros1.actions.network import ActionTypes, Ear, Mouth, Network
from bridge.adapters.ros1.actions.turns import Turns
from bridge.hub.call import Abandon, CallError, Done
from bridge.hub.qos import Qos
from bridge.messages.errors import ConversionError

AWAY_SECONDS = 5.0
"""How long a server whose connections broke may take to be connected again; its goals are aborted then."""

_QUEUE = Qos(depth=10_000)
"""Of goals and cancel requests none is dropped for another one."""

_REJECTED = wire.goal_response(wire.ZERO, accepted=False)

STOPS = "the bridge does not follow the action any more"


class ActionCaller:
    """Sends goals to the servers of one action, of which it uses one at a time.

    What is known of its goals outlasts `shut`, for those who ask later.
    """

    def __init__(self, name: str, types: ActionTypes, network: Network, guard: FrameGuard) -> None:
        self.name = name
        self._types, self._network, self._guard = types, network, guard
        self._turns = Turns()
        self._client = ActionClient(name, self, time.monotonic, empty(types.result_body))
        self._lock = threading.Lock()
        self._open: list[object] = []
        self._ears: dict[str, Ear] = {}
        self._mouths: dict[str, Mouth] = {}
        self._server: Server | None = None
        self._ready = False
        self._since = 0.0
        self._newest: tuple[bytes, str] | None = None
        self._early: tuple[bytes, str] | None = None
        self._unsure: list[tuple[bytes, Done, _Begun]] = []
        self._listeners: dict[str, list[Deliver]] = {part: [] for part in parts.TOPICS}
        self._states = b""

    # -- the parts -----------------------------------------------------------------------------------------------------

    @property
    def in_use(self) -> bool:
        """Whether a part of it is open, or goals are remembered."""
        return bool(self._open) or self._client.kept > 0

    def caller(self, part: str) -> PartCaller:
        """One of the three services."""
        begin = {
            parts.SEND_GOAL: self._send_goal,
            parts.GET_RESULT: self._client.get_result,
            parts.CANCEL_GOAL: self._client.cancel,
        }[part]
        opened = PartCaller(self._turns, begin, self._close_caller)
        self._take_up(opened)
        return opened

    def subscribe(self, part: str, deliver: Deliver) -> PartSubscription:
        """One of the two topics; a status comes at once where there was one."""
        opened = PartSubscription(lambda: self._unsubscribe(part, deliver, opened))
        self._turns.take(lambda: self._listen(part, deliver))
        self._take_up(opened)
        return opened

    def _take_up(self, opened: object) -> None:
        with self._lock:
            self._open.append(opened)
        self._turns.take(self._connect)

    def _give_back(self, opened: object) -> None:
        with self._lock:
            self._open.remove(opened)
            last = not self._open
        if last:
            self._turns.take(self._disconnect)

    def _close_caller(self, opened: object) -> None:
        self._turns.take(lambda: self._end(STOPS))
        self._give_back(opened)

    def _end(self, reason: str) -> None:
        self._ready = False
        unsure, self._unsure = self._unsure, []
        for _, done, _ in unsure:
            done(_REJECTED)
        self._client.close(reason)

    def _listen(self, part: str, deliver: Deliver) -> None:
        self._listeners[part].append(deliver)
        if part == parts.STATUS and self._states and self._server is not None:
            deliver(self._states, self._source(part), None)

    def _unsubscribe(self, part: str, deliver: Deliver, opened: object) -> None:
        self._turns.take(lambda: self._listeners[part].remove(deliver))
        self._give_back(opened)

    # -- ROS 1 ---------------------------------------------------------------------------------------------------------

    def _connect(self) -> None:
        if self._server is not None:
            self._client.found()
        if not self._open or self._ears:
            return
        network, name, types = self._network, self.name, self._types
        self._mouths = {
            finding.GOAL: network.tell(f"{name}/goal", types.goal, _QUEUE),
            finding.CANCEL: network.tell(f"{name}/cancel", types.cancel, _QUEUE),
        }
        self._ears = {
            finding.STATUS: network.hear(f"{name}/status", types.status, self._on_status, ""),
            finding.FEEDBACK: network.hear(f"{name}/feedback", types.feedback, self._on_feedback, ""),
            finding.RESULT: network.hear(f"{name}/result", types.result, self._on_result, ""),
        }
        self._guard.open(self)

    def _disconnect(self) -> None:
        if self._open:
            return
        self._guard.close(self)
        self._client.disconnected()
        self._server, self._ready = None, False
        handles: list[Ear | Mouth] = [*self._ears.values(), *self._mouths.values()]
        for handle in handles:
            handle.close()
        self._ears, self._mouths = {}, {}

    def poll(self, servers: Sequence[Server]) -> None:
        """Look after the connections; called some ten times a second with the native servers that are alive."""
        self._turns.take(lambda: self._poll(servers))

    def _poll(self, servers: Sequence[Server]) -> None:
        if self._open:
            self._choose(servers)
            self._watch()
            self._decide_unsure()
        self._client.tick()

    def _choose(self, servers: Sequence[Server]) -> None:
        if self._server in servers:
            return
        if self._server is not None:
            self._lose(f"its action server {self._server.node} is gone")
        if servers:
            self._server, self._since = servers[0], time.monotonic()
            self._client.found()
            if self._states:  # what is known of earlier goals is kept with the publisher that is there now
                self._deliver(parts.STATUS, self._states)
            if self._early is not None:  # a list that its connection brought before the master's state was read
                self._newest, self._early = self._early, None
                self._take_statuses()

    def _watch(self) -> None:
        server = self._server
        if server is None:
            return
        hears = all(server.node in mouth.hearers for mouth in self._mouths.values())
        heard = all(server.link(part) in ear.connected for part, ear in self._ears.items())
        now = time.monotonic()
        if hears and heard:
            self._since = now
            if not self._ready:
                self._ready = True
                self._client.connected()
        elif self._ready:
            self._ready = False
            self._client.disconnected()
        elif now - self._since > AWAY_SECONDS:
            self._lose(f"its action server {server.node} is not connected any more")

    def _lose(self, reason: str) -> None:
        self._ready = False
        self._client.lost(reason)
        self._server = None

    def _is_ours(self, source: str, part: str) -> bool:
        """Whether a message's publisher is the server that is used."""
        server = self._server
        if server is None:
            return False
        return source.removesuffix(" latched") == f"publisher {self.name}/{part} {server.node} {server.uri}"

    def _on_status(self, payload: bytes, source: str, _time: int | None) -> None:
        """Only the newest list counts: each names all goals."""
        waiting, self._newest = self._newest, (payload, source)
        if waiting is None:
            self._turns.take(self._take_statuses)

    def _take_statuses(self) -> None:
        newest, self._newest = self._newest, None
        if newest is None:
            return
        payload, source = newest
        if self._is_ours(source, finding.STATUS):
            self._read(finding.STATUS, lambda: self._client.statuses(wire.read_statuses(payload)))
        else:
            self._early = newest

    def _on_feedback(self, payload: bytes, source: str, _time: int | None) -> None:
        self._turns.take(lambda: self._outcome(finding.FEEDBACK, payload, source))

    def _on_result(self, payload: bytes, source: str, _time: int | None) -> None:
        self._turns.take(lambda: self._outcome(finding.RESULT, payload, source))

    def _outcome(self, part: str, payload: bytes, source: str) -> None:
        if self._is_ours(source, part):
            take = self._client.feedback if part == finding.FEEDBACK else self._client.result
            self._read(part, lambda: take(*wire.read_action_outcome(payload)))

    def _read(self, part: str, read: Callable[[], None]) -> None:
        try:
            read()
        except ConversionError as err:
            self._network.refuse(f"{self.name}/{part}", "bad", str(err))

    # -- goals ---------------------------------------------------------------------------------------------------------

    def _send_goal(self, request: bytes, done: Done) -> Abandon:
        """Send a goal in frames that the side has."""
        try:
            uuid, body = wire.read_with_uuid(request)
            body, trouble = self._guard.check(self._types.goal_body, body)
        except ConversionError as err:
            done(CallError(str(err)))
            return _nothing
        if trouble is None:
            begun = _Begun()
            self._unsure.append((uuid + body, done, begun))
            return begun.abandon
        if trouble:
            self._guard.report(self.name, trouble)
            done(_REJECTED)
            return _nothing
        return self._client.send_goal(uuid + body, done)

    def _decide_unsure(self) -> None:
        """Goals whose frames were not known when hardly any transforms had come."""
        unsure, self._unsure = self._unsure, []
        for request, done, begun in unsure:
            if not begun.abandoned:
                begun.begin(self._send_goal(request, done))

    def goal(self, payload: bytes) -> None:
        """Publish a goal."""
        if self._mouths:
            self._mouths[finding.GOAL].send(payload, "")

    def cancel(self, payload: bytes) -> None:
        """Publish a cancel request."""
        if self._mouths:
            self._mouths[finding.CANCEL].send(payload, "")

    def status(self, payload: bytes) -> None:
        """Tell the states of all goals."""
        self._states = payload
        self._deliver(parts.STATUS, payload)

    def feedback(self, payload: bytes) -> None:
        """Tell a feedback."""
        self._deliver(parts.FEEDBACK, payload)

    def _deliver(self, part: str, payload: bytes) -> None:
        for deliver in self._listeners[part]:
            deliver(payload, self._source(part), None)

    def _source(self, part: str) -> str:
        return endpoint_id(self._server, part) if self._server is not None else f"action {self.name} {part}"


def endpoint_id(server: Server, part: str) -> str:
    """The id of the endpoint that a server's part is shown as."""
    return f"action {parts.name_of(server.name, part)} {server.node} {server.uri}"


class _Begun:
    """A call that is begun later than its caller was given the way to abandon it."""

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


class PartCaller:
    """One of an action's services; see `bridge.adapters.base.EdgeCaller`."""

    def __init__(self, turns: Turns, begin: Callable[[bytes, Done], Abandon], close: Callable[[object], None]) -> None:
        self._turns, self._begin, self._close = turns, begin, close
        self._closed = False

    def call(self, request: bytes, done: Done) -> Abandon:
        """See `bridge.adapters.base.EdgeCaller.call`."""
        begun = _Begun()

        def tell(reply: bytes | CallError) -> None:
            if not begun.abandoned:
                done(reply)

        if self._closed:
            done(CallError(STOPS))
            return _nothing
        self._turns.take(lambda: begun.begin(self._begin(request, tell)))
        return lambda: self._turns.take(begun.abandon)

    def close(self) -> None:
        """End all goals of the action that are under way."""
        if not self._closed:
            self._closed = True
            self._close(self)


class PartSubscription:
    """One of an action's topics; see `bridge.adapters.base.EdgeSubscription`."""

    lost = 0

    def __init__(self, close: Callable[[], None]) -> None:
        self._close: Callable[[], None] | None = close

    def close(self) -> None:
        """Stop delivering."""
        close, self._close = self._close, None
        if close is not None:
            close()


def _nothing() -> None:
    """There is nothing to abandon."""
