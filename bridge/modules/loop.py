"""A module's thread, which handles messages, timers and calls one after the other."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable
from threading import Lock
from typing import Any, Generic, TypeVar

from bridge.clock import RunClock
from bridge.modules.step_failures import StepFailures
from bridge.progress import StepWatch, working

ANSWER_SECONDS = 5.0
STEP_SECONDS = 5.0
"""Seconds without progress after which a step counts as hanging."""
_LOOK = 0.25

Action = Callable[[], Any]


class EventLoop:
    """Runs actions in order on one thread. Safe to use from any thread.

    The callers must limit the number of posted actions: a subscription posts one for each message in its bounded queue.

    Args:
        limit: maximum time in seconds without progress in a step.

    Attributes:
        failures: the errors of actions, except for those that the caller of an action receives.
    """

    def __init__(self, name: str, limit: float = STEP_SECONDS) -> None:
        self._name = name
        self.failures = StepFailures(name)
        self._limit = limit
        self._watch = StepWatch(limit)
        self._begun = threading.Event()
        self._condition = threading.Condition()
        self._ready: deque[Action] = deque()
        self._calls: set[_Call] = set()
        self._timers: list[tuple[float, int, Timer]] = []
        self._numbers = itertools.count()
        self._timer_ran = False
        self._closed = False
        self._busy_since: float | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @property
    def waiting(self) -> int:
        """Number of actions that are waiting for the thread."""
        return len(self._ready)

    def start(self) -> None:
        self._thread.start()
        self._begun.wait()

    def post(self, action: Action) -> None:
        """Run an action soon; it is dropped if the loop has ended."""
        with self._condition:
            if not self._closed:
                self._ready.append(action)
                self._condition.notify()

    def call(self, action: Callable[[], Any], seconds: float = ANSWER_SECONDS, *, late: bool = True) -> Any:
        """Run an action on the thread, and return its result or raise its exception.

        Args:
            action: the action to run.
            seconds: time to wait for the action.
            late: run the action even if it has not begun by the timeout, which a stop requires. If False, such an
                action is dropped; one that has begun gets another `ANSWER_SECONDS` to end.

        Raises:
            TimeoutError: the thread did not run the action in time, or has ended.
        """
        if threading.current_thread() is self._thread:
            return action()
        call = self._ask(action)
        if not call.done.wait(seconds) and (late or self._withdrawn(call) or not call.done.wait(ANSWER_SECONDS)):
            raise TimeoutError(f"{self._name} has not answered for {seconds:g} s")
        return call.outcome()

    def work(self, action: Callable[[], Any], still: float | None = None) -> Any:
        """Run a slow action as `call` does, from another thread, and wait as long as the loop's thread makes progress.

        Args:
            action: the action to run.
            still: maximum time in seconds without progress; by default the loop's limit.

        Raises:
            TimeoutError: the thread hangs, or has ended; an action that has not begun is dropped.
        """
        call, clock = self._ask(action), self._watch.clock
        assert clock is not None
        watch = StepWatch(self._limit if still is None else still, clock)
        with working.waiting_for(clock):
            while not call.done.wait(_LOOK):
                try:
                    watch.judge(self._name, self._busy_since)
                except TimeoutError:
                    self._withdrawn(call)
                    raise
        return call.outcome()

    def computes(self) -> str:
        """Return a text if a step has been computing for long, else "". Call it repeatedly, and from only one thread.

        Raises `TimeoutError` if the current step hangs.
        """
        return self._watch.judge(self._name, self._busy_since)

    def _ask(self, action: Callable[[], Any]) -> _Call:
        call = _Call(action)
        with self._condition:
            if self._closed:
                raise self._end_error()
            self._calls.add(call)
            self._ready.append(lambda: self._answer(call))
            self._condition.notify()
        return call

    def every(self, seconds: float, action: Action) -> Timer:
        """Run an action periodically; missed times are skipped."""
        timer = Timer(self, seconds, action, again=True)
        self._schedule(time.monotonic() + seconds, timer)
        return timer

    def after(self, seconds: float, action: Action) -> Timer:
        """Run an action once, after a delay in seconds."""
        timer = Timer(self, seconds, action, again=False)
        self._schedule(time.monotonic() + seconds, timer)
        return timer

    def close(self, seconds: float = 2.0) -> None:
        """End the thread after its current action; drop the other actions, and fail their callers.

        Safe to call twice, and on the thread itself.
        """
        with self._condition:
            self._closed = True
            self._ready.clear()
            self._timers.clear()
            waiting, self._calls = self._calls, set()
            self._condition.notify()
        for call in waiting:
            call.fail(self._end_error())
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(seconds)

    def _end_error(self) -> TimeoutError:
        """Return the error for callers of a loop that has ended."""
        return TimeoutError(f"{self._name} has ended")

    def _answer(self, call: _Call) -> None:
        if self._withdrawn(call):
            call.run()

    def _withdrawn(self, call: _Call) -> bool:
        """Remove a call that has not begun; return False if it has begun or was removed already."""
        with self._condition:
            waits = call in self._calls
            self._calls.discard(call)
        return waits

    def _schedule(self, due: float, timer: Timer) -> None:
        with self._condition:
            if not self._closed:
                heapq.heappush(self._timers, (due, next(self._numbers), timer))
                self._condition.notify()

    def _run(self) -> None:
        self._watch.begin()
        self._begun.set()
        while True:
            action = self._next()
            if action is None:
                return
            self._busy_since = time.monotonic()
            try:
                action()
            except Exception as err:
                self.failures.add(err)
            self._busy_since = None

    def _next(self) -> Action | None:
        with self._condition:
            while not self._closed:
                now = time.monotonic()
                due = bool(self._timers) and self._timers[0][0] <= now
                # alternate, so that neither timers that take longer than their period nor a flood of posted actions
                # can delay a stop
                if due and not (self._ready and self._timer_ran):
                    self._timer_ran = True
                    return self._due(now).run
                if self._ready:
                    self._timer_ran = False
                    return self._ready.popleft()
                self._condition.wait(self._timers[0][0] - now if self._timers else None)
        return None

    def _due(self, now: float) -> Timer:
        due, _, timer = heapq.heappop(self._timers)
        if timer.again and not timer.closed:
            missed = (now - due) // timer.seconds
            again = due + (missed + 1) * timer.seconds
            heapq.heappush(self._timers, (again, next(self._numbers), timer))
        return timer


class _Call:
    """An action for which a caller waits, and its outcome."""

    def __init__(self, action: Callable[[], Any]) -> None:
        self._action = action
        self.done = threading.Event()
        self.result: Any = None
        self.error: BaseException | None = None

    def run(self) -> None:
        """Run the action, and store its outcome."""
        try:
            self.result = self._action()
        except BaseException as err:
            self.error = err
        self.done.set()

    def outcome(self) -> Any:
        """Return the result of the action, or raise its error."""
        if self.error is not None:
            raise self.error
        return self.result

    def fail(self, error: BaseException) -> None:
        """Set an error instead of running the action."""
        self.error = error
        self.done.set()


class Timer:
    """A scheduled action, created by `EventLoop.every` and `EventLoop.after`."""

    def __init__(self, loop: EventLoop, seconds: float, action: Action, *, again: bool) -> None:
        self.seconds, self.again = seconds, again
        self.closed = False
        self._loop, self._action = loop, action

    def run(self) -> None:
        """Run the action, unless the timer is closed."""
        if not self.closed:
            self._action()

    def close(self) -> None:
        self.closed = True


class ClockTimer:
    """A periodic action on a simulated clock; as in `EventLoop.every`, missed times are skipped."""

    def __init__(self, clock: RunClock, loop: EventLoop, seconds: float, action: Action) -> None:
        self._period = round(seconds * 1e9)
        self._loop, self._action = loop, action
        self._due: int | None = None
        self._last = 0
        self.closed = False
        self._withdraw = clock.on_time(self._on_time)

    def close(self) -> None:
        self.closed = True
        self._withdraw()

    def _on_time(self, now: int) -> None:
        if self._due is None or now < self._last:
            self._due = now + self._period
        self._last = now
        if now >= self._due:
            self._due += (now - self._due) // self._period * self._period + self._period
            self._loop.post(self._run)

    def _run(self) -> None:
        if not self.closed:
            self._action()


T = TypeVar("T")


class Newest(Generic[T]):
    """Passes the newest value to a module's thread; while the thread is busy, newer values replace the pending one.

    Args:
        on_value: called with the value, on the module's thread.
    """

    def __init__(self, loop: EventLoop, on_value: Callable[[T], object]) -> None:
        self._loop, self._on_value = loop, on_value
        self._lock = Lock()
        self._waiting: list[T] = []

    def put(self, value: T) -> None:
        """Pass a value, from any thread."""
        with self._lock:
            posted, self._waiting = bool(self._waiting), [value]
        if not posted:
            self._loop.post(self._run)

    def _run(self) -> None:
        with self._lock:
            (value,), self._waiting = self._waiting, []
        self._on_value(value)
