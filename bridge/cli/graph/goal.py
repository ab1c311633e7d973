"""An action goal that a verb sends, with its feedback and its result."""

from __future__ import annotations

import base64
import signal
import sys
import threading
import time
import uuid
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Self

from bridge.cli.client import CliClient
from bridge.cli.graph.caller import ServiceCaller
from bridge.cli.messages import Types
from bridge.cli.output import CliError, clean
from bridge.hub.endpoints.calls import CallError
from bridge.hub.endpoints.subscription import HubSample
from bridge.hub.wire.qos import Qos
from bridge.messages.actions import GoalState, names
from bridge.messages.errors import ConversionError

SUCCEEDED = GoalState.SUCCEEDED
STATES = {int(state): state.name.lower() for state in GoalState if state.ended}
_LONGEST = 3600.0


class _Feedback(NamedTuple):
    cdr: bytes


class _End(NamedTuple):
    reply: dict[str, Any] | CallError


class Interrupt:
    """Keeps the first Ctrl-C until `check` raises it, since foreign code might swallow it; raises a second at once."""

    def __init__(self) -> None:
        self._came = self._told = False
        self._before: Any = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._take)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _take(self, _number: int, _frame: object) -> None:
        if self._came:
            raise KeyboardInterrupt
        self._came = True

    def check(self) -> None:
        """Raise `KeyboardInterrupt`, once, where it has come."""
        if self._came and not self._told:
            self._told = True
            raise KeyboardInterrupt


class FollowedGoal:
    """An action goal with its id of 16 bytes; raises `CliError` where the action or its type is unknown."""

    def __init__(self, client: CliClient, name: str, type_name: str, interrupt: Interrupt) -> None:
        types = Types(client)
        parts = names(name)
        self.name, self._types, self._interrupt = name, types, interrupt
        self._send = ServiceCaller(client, types, parts.send_goal, f"{type_name}_SendGoal" if type_name else "")
        self.type_name = self._send.type_name.removesuffix("_SendGoal")
        self._result = ServiceCaller(client, types, parts.get_result)
        self._cancel = ServiceCaller(client, types, parts.cancel_goal)
        self.id = uuid.uuid4().bytes
        self._uuid = {"uuid": base64.b64encode(self.id).decode()}
        self._asked = self._cancel_failed = False
        self._news: SimpleQueue[_Feedback | _End] = SimpleQueue()
        self._feedback_type = f"{self.type_name}_FeedbackMessage"
        self._feedback_hash = types.hash_of(self._feedback_type)
        client.hub.subscription(parts.feedback, self._feedback_type, self._feedback_hash, Qos(depth=100), self._heard)

    def begin(self, goal: dict[str, Any]) -> None:
        """Send it and wait for its acceptance; raises `CliError` where it is rejected."""
        reply = self._send.ask({"goal_id": self._uuid, "goal": goal}, check=self._interrupt.check)
        if not reply["accepted"]:
            raise CliError(f"{self.name} rejected the goal")
        self._ask_result()

    def follow(
        self, timeout: float | None, show: Callable[[dict[str, Any]], None], each: Callable[[], None] = lambda: None
    ) -> dict[str, Any] | CallError:
        """Show feedback until the goal ends, calling ``each`` at least five times a second; raises `TimeoutError`."""
        end = time.monotonic() + (_LONGEST * 24 * 365 if timeout is None else timeout)
        while True:
            self._interrupt.check()
            if self._cancel_failed:
                self._ask_cancel()
            each()
            try:
                news = self._news.get(timeout=min(0.2, max(end - time.monotonic(), 0.0)) or 0.001)
            except Empty:
                if time.monotonic() >= end:
                    raise TimeoutError from None
                continue
            if isinstance(news, _End):
                return news.reply
            self._read(news.cdr, show)

    def cancel(self) -> None:
        """Ask for its cancellation, also where it is not accepted yet; `follow` asks again where the call fails."""
        self._ask_result()
        self._ask_cancel()

    def run(
        self, goal: dict[str, Any], timeout: float | None, show: Callable[[dict[str, Any]], None],
        each: Callable[[], None] = lambda: None, before_cancel: Callable[[], None] = lambda: None,
    ) -> tuple[dict[str, Any], bool]:  # fmt: skip
        """Send the goal and follow it to its end; cancel it at Ctrl-C or after ``timeout`` seconds.

        Returns the result, and whether Ctrl-C came. Raises `CliError` where the goal is rejected or lost.
        """
        interrupted = False
        try:
            self.begin(goal)
            end = self.follow(timeout, show, each)
        except (KeyboardInterrupt, TimeoutError) as err:
            interrupted = isinstance(err, KeyboardInterrupt)
            why = "Ctrl-C" if interrupted else f"{timeout:g} s are over"
            before_cancel()
            print(f"{why}: the goal is being cancelled; Ctrl-C again does not wait", file=sys.stderr)
            self.cancel()
            end = self.follow(None, show, each)
        if isinstance(end, CallError):
            raise CliError(f"the goal was lost: {clean(end)}")
        return end, interrupted

    def _ask_cancel(self) -> None:
        def answered(reply: dict[str, Any] | CallError) -> None:
            self._cancel_failed = isinstance(reply, CallError)

        self._cancel_failed = False
        self._cancel.call({"goal_info": {"goal_id": self._uuid}}, answered)

    def _ask_result(self) -> None:
        if not self._asked:
            self._result.call({"goal_id": self._uuid}, lambda result: self._news.put(_End(result)))
            self._asked = True

    def _heard(self, sample: HubSample) -> None:
        data = sample.data()
        if data[4:20] == self.id:
            self._news.put(_Feedback(data))

    def _read(self, cdr: bytes, show: Callable[[dict[str, Any]], None]) -> None:
        try:
            feedback = self._types.decode(self._feedback_type, self._feedback_hash, cdr)["feedback"]
        except ConversionError as err:
            print(f"# {clean(err)}", file=sys.stderr)
            return
        show(feedback)
