"""A goal that a command sends and follows; signals cancel it."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any, Self

from bridge.client.errors import ClientError
from bridge.client.goals import STATES, AwaitedGoal, GoalEnd, Show
from bridge.client.session import Client
from bridge.client.types import Types
from bridge.messages.actions import GoalState

CONFIRM_SECONDS = 5.0
"""Seconds that a command waits for the canceled goal's end after SIGTERM, SIGHUP or an error; container runtimes kill
after 10 s, systemd after 90 s."""


class Interrupted(KeyboardInterrupt):
    """A signal requested the end of the command; ``code`` is the exit code."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number, self.code = signal.Signals(number), 128 + number


class Interrupt:
    """Holds the first SIGINT, SIGTERM or SIGHUP until `check` raises it, as other code might swallow an exception.

    After Ctrl-C, the next signal raises at once. SIGTERM and SIGHUP often come together; signals after them are
    ignored, because the command then ends within `CONFIRM_SECONDS`. A SIGHUP that the caller ignores (``nohup``) stays
    ignored.
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


class FollowedGoal(AwaitedGoal):
    """A goal that ends with the command; raises `ClientError` if the action or its type is unknown."""

    def __init__(self, client: Client, name: str, type_name: str, interrupt: Interrupt) -> None:
        super().__init__(client, Types(client), name, type_name, interrupt.check)
        self._interrupt = interrupt

    def run(
        self, goal: dict[str, Any], timeout: float | None, show: Show,
        each: Callable[[], None] = lambda: None, before_cancel: Callable[[], None] = lambda: None,
    ) -> tuple[GoalEnd, int]:  # fmt: skip
        """Send the goal and follow it to its end. Cancel it on a signal, after ``timeout`` seconds, and on any error.

        After Ctrl-C and the timeout, this waits for the end of the goal; after SIGTERM and SIGHUP, for at most
        `CONFIRM_SECONDS`. Returns the end, and the exit code for the signal that canceled the goal, 0 if no signal did.
        Raises `ClientError` if the goal is rejected or lost.
        """
        self._interrupt.check()  # nothing to cancel yet
        try:
            self.send(goal, show)
            return self.wait(timeout, each), 0
        except Interrupted as err:
            if err.number != signal.SIGINT:
                return self._give_up(err.number.name), err.code
            reason, code = "Ctrl-C", err.code
        except TimeoutError:
            reason, code = f"{timeout:g} s have passed", 0
        except ClientError:
            raise
        except BaseException as err:  # without this command the robot would drive on, for example after `| head`
            self._give_up("the output was closed" if isinstance(err, OSError) else type(err).__name__)
            raise
        self.cancel()
        before_cancel()
        print(f"{reason}: the goal is being canceled; press Ctrl-C again to exit without waiting", file=sys.stderr)
        return self.wait(), code

    def _give_up(self, why: str) -> GoalEnd:
        """Cancel the goal, wait for its end at most `CONFIRM_SECONDS`, and report it in one line."""
        self.mute()
        self.cancel()
        end = GoalEnd(GoalState.UNKNOWN, {})
        try:
            end = self.wait(CONFIRM_SECONDS)
            text = f"the goal was {STATES.get(end.status, 'ended')}"
        except TimeoutError:
            text = f"the goal has not ended within {CONFIRM_SECONDS:g} s of its cancellation; it may still be active"
        except ClientError as err:
            text = str(err)
        with contextlib.suppress(OSError):  # the terminal is closed
            print(f"midspan: {why}: {text}", file=sys.stderr, flush=True)
        return end
