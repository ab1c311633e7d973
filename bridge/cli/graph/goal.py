"""An action goal that a verb sends, with its feedback and its result."""

from __future__ import annotations

import base64
import contextlib
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
CONFIRM_SECONDS = 5.0
"""Seconds that a terminated verb waits for the goal's end; container runtimes kill after 10 s, systemd after 90 s."""

_UNKNOWN_GOAL = 2
"""``ERROR_UNKNOWN_GOAL_ID`` of action_msgs/srv/CancelGoal: the request may have overtaken the goal."""

_FOREVER = 3600.0 * 24 * 365


class _Feedback(NamedTuple):
    cdr: bytes


class _End(NamedTuple):
    reply: dict[str, Any] | CallError


class Interrupted(KeyboardInterrupt):
    """A signal asked the verb to end; ``code`` is the exit code."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number, self.code = signal.Signals(number), 128 + number


class Interrupt:
    """Holds the first SIGINT, SIGTERM or SIGHUP until `check` raises it, since foreign code might swallow an exception.

    After Ctrl-C, the next signal raises at once. SIGTERM and SIGHUP often come together; what follows them is ignored,
    as their handling is bounded. A SIGHUP that the caller ignores (``nohup``) stays ignored.
    """

    def __init__(self) -> None:
        self._first: int = 0
        self._raised = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in _ENDING:
                if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, _frame: object) -> None:
        if self._first == signal.SIGINT:
            raise Interrupted(number)
        self._first = self._first or number

    def check(self) -> None:
        """Raise `Interrupted`, once, if a signal has arrived."""
        if self._first and not self._raised:
            self._raised = True
            raise Interrupted(self._first)


_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


class GoalEnd(NamedTuple):
    """How a goal ended.

    Attributes:
        status: the state of `action_msgs/GoalStatus`, 0 (unknown) if the server did not confirm its cancellation.
        code: the exit code for the signal that canceled the goal, 0 without one.
    """

    status: int
    result: dict[str, Any]
    code: int = 0


class FollowedGoal:
    """An action goal with its id of 16 bytes; raises `CliError` if the action or its type is unknown."""

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
        client.hub.subscription(
            parts.feedback, self._feedback_type, self._feedback_hash, Qos(depth=100), self._on_feedback
        )

    def begin(self, goal: dict[str, Any]) -> None:
        """Send the goal and wait for its acceptance; raises `CliError` if the server rejects it."""
        reply = self._send.ask({"goal_id": self._uuid, "goal": goal}, check=self._interrupt.check)
        if not reply["accepted"]:
            raise CliError(f"{self.name} rejected the goal")
        self._ask_result()

    def follow(
        self, timeout: float | None, show: Callable[[dict[str, Any]], None], each: Callable[[], None] = lambda: None
    ) -> dict[str, Any] | CallError:
        """Show feedback until the goal ends, calling ``each`` at least five times a second; raises `TimeoutError`."""
        end = time.monotonic() + (_FOREVER if timeout is None else timeout)
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
        """Request the goal's cancellation, also before its acceptance; `follow` repeats a request that failed."""
        self._ask_result()
        self._ask_cancel()

    def run(
        self, goal: dict[str, Any], timeout: float | None, show: Callable[[dict[str, Any]], None],
        each: Callable[[], None] = lambda: None, before_cancel: Callable[[], None] = lambda: None,
    ) -> GoalEnd:  # fmt: skip
        """Send the goal and follow it to its end. Cancel it on a signal, after ``timeout`` seconds, and on any error.

        After Ctrl-C and the timeout this waits for the end of the goal, after SIGTERM and SIGHUP for `CONFIRM_SECONDS`.
        Raises `CliError` if the goal is rejected or lost.
        """
        self._interrupt.check()  # nothing to cancel yet
        try:
            self.begin(goal)
            return self._ended(self.follow(timeout, show, each))
        except Interrupted as err:
            if err.number != signal.SIGINT:
                return self._give_up(err.number.name)._replace(code=err.code)
            reason, code = "Ctrl-C", err.code
        except TimeoutError:
            reason, code = f"{timeout:g} s are over", 0
        except CliError:
            raise
        except BaseException as err:  # without its client a robot would drive on, here for example after `| head`
            self._give_up("the output was closed" if isinstance(err, OSError) else type(err).__name__)
            raise
        self.cancel()
        before_cancel()
        print(f"{reason}: the goal is being canceled; Ctrl-C again does not wait", file=sys.stderr)
        return self._ended(self.follow(None, show, each), code)

    def _give_up(self, why: str) -> GoalEnd:
        """Cancel the goal, wait for its end at most `CONFIRM_SECONDS`, and report it in one line."""
        self.cancel()
        try:
            end = self._ended(self.follow(CONFIRM_SECONDS, lambda _feedback: None))
            text = f"the goal was {STATES.get(end.status, 'ended')}"
        except TimeoutError:
            end = GoalEnd(GoalState.UNKNOWN, {})
            text = f"the goal has not ended within {CONFIRM_SECONDS:g} s after its cancellation; it may still be active"
        except CliError as err:
            end, text = GoalEnd(GoalState.UNKNOWN, {}), str(err)
        with contextlib.suppress(OSError):  # the terminal is closed
            print(f"midspan: {why}: {text}", file=sys.stderr, flush=True)
        return end

    def _ended(self, end: dict[str, Any] | CallError, code: int = 0) -> GoalEnd:
        if isinstance(end, CallError):
            raise CliError(f"the goal was lost: {clean(end)}")
        return GoalEnd(end["status"], end["result"], code)

    def _ask_cancel(self) -> None:
        def answered(reply: dict[str, Any] | CallError) -> None:
            self._cancel_failed = isinstance(reply, CallError) or reply["return_code"] == _UNKNOWN_GOAL

        self._cancel_failed = False
        self._cancel.call({"goal_info": {"goal_id": self._uuid}}, answered)

    def _ask_result(self) -> None:
        if not self._asked:
            self._result.call({"goal_id": self._uuid}, lambda result: self._news.put(_End(result)))
            self._asked = True

    def _on_feedback(self, sample: HubSample) -> None:
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
