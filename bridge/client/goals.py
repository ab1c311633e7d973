"""Sends goals and waits for them, with their feedback and results."""

from __future__ import annotations

import contextlib
import heapq
import itertools
import logging
import math
import time
import uuid
from collections.abc import Callable, Mapping
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from bridge.client.actions import ActionClient, SentGoal
from bridge.client.errors import ClientError
from bridge.client.services import ServiceCaller, served
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.hub.endpoints.subscription import HubSample, HubSubscription
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import GoalState, names
from bridge.messages.errors import ConversionError
from bridge.text import clean

_log = logging.getLogger(__name__)

SUCCEEDED = GoalState.SUCCEEDED
STATES = {int(state): state.name.lower() for state in GoalState if state.ended}
_POLL_SECONDS = 0.2

Show = Callable[[dict[str, Any]], None]


class GoalEnd(NamedTuple):
    """How a goal ended: its status as in `action_msgs/GoalStatus`, 0 if unknown, and its result."""

    status: int
    result: dict[str, Any]


class CallbackQueue:
    """Runs callbacks on the thread that waits for them; the loop of an action client outside of modules."""

    def __init__(self) -> None:
        self._queue: SimpleQueue[Callable[[], Any]] = SimpleQueue()
        self._timers: list[tuple[float, int, Callable[[], Any]]] = []
        self._numbers = itertools.count()

    def post(self, action: Callable[[], Any]) -> None:
        """Add a callback, from any thread."""
        self._queue.put(action)

    def after(self, seconds: float, action: Callable[[], Any]) -> None:
        """Add a callback that runs after a delay; called by callbacks."""
        heapq.heappush(self._timers, (time.monotonic() + seconds, next(self._numbers), action))

    def run(self, seconds: float) -> None:
        """Run the next callback; return if there is none within ``seconds``."""
        now = time.monotonic()
        due = self._timers[0][0] - now if self._timers else seconds
        if due <= 0.0:
            heapq.heappop(self._timers)[2]()
            return
        with contextlib.suppress(Empty):
            self._queue.get(timeout=max(min(seconds, due), 0.001))()


class _GoalNode:
    """The endpoints of one action client, with JSON values."""

    def __init__(self, client: Client, types: Types) -> None:
        self.hub, self.loop = client.hub, CallbackQueue()
        self._client, self._types = client, types

    def client(self, name: str, type_name: str) -> ServiceCaller:
        return ServiceCaller(self._client, self._types, name, type_name, self.loop.post)

    def subscription_cdr(
        self, topic: str, type_name: str, on_message: Callable[[bytes], None], qos: Qos
    ) -> HubSubscription:
        type_hash = self._types.hash_of(type_name)
        check = self._types.registry.hub_check(type_name, type_hash)

        def receive(data: bytes) -> None:
            try:
                cdr = check(data)
            except ConversionError as err:
                _log.warning("%s: message refused: %s", topic, clean(err))
                return
            on_message(cdr)

        def on_sample(sample: HubSample) -> None:
            data = sample.data()
            self.loop.post(lambda: receive(data))

        return self.hub.subscription(topic, type_name, type_hash, qos, on_sample)

    def decode(self, type_name: str, cdr: bytes) -> dict[str, Any]:
        return self._types.decode(type_name, "", cdr)

    def release(self, end: Any) -> None:
        end.close()


class AwaitedGoal:
    """A goal of an action, with JSON values. Its callbacks run in `send` and `wait`, on the calling thread.

    Args:
        client: the session.
        types: its message types.
        name: the action.
        type_name: its type; by default that of its server.
        check: called at least five times a second while `send` and `wait` wait; an error that it raises ends the wait.

    Raises:
        ClientError: the action has no server, or its type is unknown.
    """

    def __init__(
        self, client: Client, types: Types, name: str, type_name: str = "", check: Callable[[], None] = lambda: None
    ) -> None:
        send = names(name).send_goal
        kind, _ = served(client.hub.graph, send, f"{type_name}_SendGoal" if type_name else "")
        self.name, self.id, self._check = name, uuid.uuid4().bytes, check
        self._node = _GoalNode(client, types)
        self._action = ActionClient(self._node, name, kind.removesuffix("_SendGoal"))
        self._sent: SentGoal | None = None
        self._end: GoalEnd | ClientError | None = None

    def send(self, goal: Mapping[str, Any], show: Show = lambda _feedback: None) -> None:
        """Send the goal and wait for its acceptance; ``show`` receives the feedback.

        Raises `ClientError` if the server rejects the goal, or disappears.
        """
        sent = self._sent = self._action.send(goal, self._on_end, show, self.id)
        while sent.accepted is None and self._end is None:
            self._check()
            self._node.loop.run(_POLL_SECONDS)
        if sent.accepted is not True and isinstance(self._end, ClientError):
            raise self._end

    def wait(self, seconds: float | None = None, each: Callable[[], None] = lambda: None) -> GoalEnd:
        """Wait for the end of the goal; ``each`` is called at least five times a second.

        Raises `TimeoutError` after ``seconds``, and `ClientError` if the goal was rejected or lost.
        """
        end = math.inf if seconds is None else time.monotonic() + seconds
        while self._end is None:
            self._check()
            each()
            left = end - time.monotonic()
            if left <= 0.0:
                raise TimeoutError(f"the goal of {self.name} has not ended in {seconds:g} s")
            self._node.loop.run(min(left, _POLL_SECONDS))
        if isinstance(self._end, ClientError):
            raise self._end
        return self._end

    def cancel(self) -> None:
        """Request the goal's cancellation, even before its acceptance; `wait` repeats a request that failed."""
        if self._sent is not None:
            self._sent.cancel()

    def mute(self) -> None:
        """Stop showing feedback."""
        if self._sent is not None:
            self._sent.feedback = None

    def close(self) -> None:
        """Close the client; an active goal continues on its server."""
        self._action.close()

    def _on_end(self, sent: SentGoal, result: dict[str, Any] | None, why: str) -> None:
        if result is not None:
            self._end = GoalEnd(sent.status, result)
        elif sent.accepted is False:
            self._end = ClientError(f"{self.name}: {clean(why)}")
        else:
            self._end = ClientError(f"the goal was lost: {clean(why)}")
