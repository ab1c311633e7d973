"""Executors, delayed calls and bounded queues, used by every part of Midspan.

Each starts its threads with the first job, so that unused executors cost nothing. The threads are daemon threads, so
that a hanging job does not prevent Python from exiting (unlike with `concurrent.futures.ThreadPoolExecutor`).
"""

from __future__ import annotations

import heapq
import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

from typing_extensions import override

_log = logging.getLogger(__name__)

_IDLE_SECONDS = 10.0

Job = Callable[[], object]
Message = TypeVar("Message")


class _OneThread:
    """Base class with one daemon thread, which starts when it is first needed."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._thread: threading.Thread | None = None
        self._closed = False

    def _start(self) -> None:
        if self._thread is None:
            thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            thread.start()  # raises RuntimeError if the system is out of threads; the next job tries again
            self._thread = thread

    def _join(self, seconds: float | None) -> None:
        if self._thread is not None:
            self._thread.join(seconds)

    def _run(self) -> None:
        raise NotImplementedError


class SerialExecutor(_OneThread):
    """Runs jobs in order on one thread.

    Threads that must not block, such as zenoh's receiving threads, submit their blocking jobs to it.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._queue: SimpleQueue[Job | None] = SimpleQueue()
        self._lock = threading.Lock()

    def submit(self, job: Job) -> None:
        """Queue a job; it is ignored after `close`."""
        with self._lock:
            if self._closed:
                return
            self._start()
            self._queue.put(job)

    def close(self) -> None:
        """End the thread after the submitted jobs; wait up to two seconds for it. Safe to call twice."""
        with self._lock:
            self._closed = True
            self._queue.put(None)
        self._join(2.0)

    @override
    def _run(self) -> None:
        while (job := self._queue.get()) is not None:
            try:
                job()
            except Exception:
                _log.debug("%s: a job failed", self._name, exc_info=True)


class InlineExecutor:
    """Runs jobs in order, one at a time, on the threads that submit them; for state that events on many threads change.

    A thread that submits a job while none runs also runs the jobs that are submitted meanwhile. So a job that another
    job submits, for example in a callback, runs after that job, and no lock is held while a job runs.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: deque[Job] = deque()
        self._running = False

    def submit(self, job: Job) -> None:
        """Run a job now, or after those that are running or queued."""
        with self._lock:
            self._jobs.append(job)
            if self._running:
                return
            self._running = True
        try:
            self._run()
        except BaseException:  # an interrupt; the next call of `submit` runs the remaining jobs first
            with self._lock:
                self._running = False
            raise

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._jobs:
                    self._running = False
                    return
                job = self._jobs.popleft()
            try:
                job()
            except Exception:
                _log.exception("an event was not handled")


class WorkerPool:
    """Runs jobs on at most ``limit`` threads, each of which ends after ten idle seconds."""

    def __init__(self, limit: int, name: str) -> None:
        self._limit, self._name = limit, name
        self._condition = threading.Condition()
        self._jobs: deque[tuple[Future[Any], Callable[[], Any]]] = deque()
        self._threads: set[threading.Thread] = set()
        self._numbers = itertools.count()
        self._idle = 0
        self._closed = False

    def submit(self, job: Callable[[], Any]) -> Future[Any]:
        """Run a job as soon as a thread is free. After `close`, or if no thread can be started, cancel it at once."""
        future: Future[Any] = Future()
        with self._condition:
            if not self._closed:
                self._jobs.append((future, job))
                if len(self._jobs) > self._idle and len(self._threads) < self._limit:
                    self._add_thread()
                else:
                    self._condition.notify()
                if self._threads:
                    return future
                self._jobs.clear()
        future.cancel()
        return future

    def _add_thread(self) -> None:
        name = f"{self._name}-{next(self._numbers)}"
        thread = threading.Thread(target=self._run, name=name, daemon=True)
        try:
            thread.start()
        except RuntimeError as err:  # the system is out of threads; the existing ones run the job
            _log.warning("%s: cannot start a thread: %s", self._name, err)
        else:
            self._threads.add(thread)

    def close(self, seconds: float = 0.0) -> None:
        """Cancel the jobs that have not started, and wait up to ``seconds`` for each thread that still runs a job."""
        with self._condition:
            self._closed = True
            waiting, self._jobs = self._jobs, deque()
            threads = list(self._threads)
            self._condition.notify_all()
        for future, _ in waiting:
            future.cancel()
        for thread in threads:
            if thread is not threading.current_thread():
                thread.join(seconds)

    def _run(self) -> None:
        while (taken := self._next()) is not None:
            future, job = taken
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(job())
                except Exception as err:
                    future.set_exception(err)

    def _next(self) -> tuple[Future[Any], Callable[[], Any]] | None:
        with self._condition:
            self._idle += 1
            self._condition.wait_for(lambda: self._jobs or self._closed, _IDLE_SECONDS)
            self._idle -= 1
            if self._jobs:
                return self._jobs.popleft()
            self._threads.discard(threading.current_thread())
            return None


class DelayedCalls(_OneThread):
    """Makes scheduled calls, in sequence, on one thread."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._condition = threading.Condition()
        self._due: list[tuple[float, int, Job]] = []
        self._once: set[Job] = set()
        self._numbers = itertools.count()

    def after(self, seconds: float, call: Job, *, once: bool = False) -> None:
        """Schedule a call after ``seconds``; `close` cancels it.

        With ``once``, do nothing if the same call is already scheduled.
        """
        with self._condition:
            if self._closed or (once and call in self._once):
                return
            self._start()
            if once:
                self._once.add(call)
            number = next(self._numbers)
            heapq.heappush(self._due, (time.monotonic() + seconds, number, call))
            if self._due[0][1] == number:
                self._condition.notify()

    def within(self, seconds: float, call: Job) -> None:
        """Schedule a call after ``seconds``, unless it is already scheduled for an earlier time; drop a later one."""
        with self._condition:
            due = time.monotonic() + seconds
            scheduled = [entry for entry in self._due if entry[2] == call]
            if self._closed or any(entry[0] <= due for entry in scheduled):
                return
            self._due = [entry for entry in self._due if entry not in scheduled]
            heapq.heapify(self._due)
        self.after(seconds, call)

    def every(self, seconds: float, call: Job, first: float | None = None) -> None:
        """Make a call regularly until `close`, ``seconds`` after the end of the last one, even if that one failed.

        The first call is made after ``first`` seconds, by default after ``seconds``.
        """

        def repeat() -> None:
            try:
                call()
            finally:
                self.after(seconds, repeat)

        self.after(seconds if first is None else first, repeat)

    def close(self, seconds: float | None = None) -> None:
        """Cancel all calls; wait up to ``seconds`` for the running call, by default until it ends."""
        with self._condition:
            self._closed = True
            self._due.clear()
            self._once.clear()
            self._condition.notify()
        self._join(seconds)

    @override
    def _run(self) -> None:
        while (call := self._next()) is not None:
            try:
                call()
            except Exception:
                _log.exception("%s: a call failed", self._name)

    def _next(self) -> Job | None:
        with self._condition:
            while not self._closed:
                left = self._due[0][0] - time.monotonic() if self._due else None
                if left is not None and left <= 0:
                    call = heapq.heappop(self._due)[2]
                    self._once.discard(call)
                    return call
                self._condition.wait(left)
        return None


class BoundedQueue(_OneThread, Generic[Message]):
    """A bounded queue with a thread that processes it. If full, it drops the oldest messages.

    A route uses it for large messages, which a slow link of the hub may delay: on a congested link, zenoh waits up to
    2 s to send a message larger than a packet, and a thread that serves all topics of a side must not wait that long.
    ``process`` is called with each message in order, and ``dropped`` for each dropped message; ``max_bytes`` does not
    include the newest message.
    """

    def __init__(
        self, name: str, depth: int, max_bytes: int, process: Callable[[Message], None], dropped: Callable[[], None]
    ) -> None:
        super().__init__(name)
        self._depth, self._max_bytes = depth, max_bytes
        self._process, self._dropped = process, dropped
        self._condition = threading.Condition()
        self._queue: deque[tuple[int, Message]] = deque()
        self._bytes = 0
        self._processing = False

    @property
    def busy(self) -> bool:
        """Whether a message is queued or being processed, so that a later one must be queued."""
        return bool(self._queue) or self._processing  # checked in this order, because `_run` sets the flag first

    @property
    def waiting(self) -> int:
        """Number of queued messages."""
        return len(self._queue)

    def put(self, message: Message, size: int) -> None:
        """Queue a message of ``size`` bytes."""
        with self._condition:
            if self._closed:
                return
            self._add(message, size)
            while len(self._queue) > self._depth or (self._bytes > self._max_bytes and len(self._queue) > 1):
                self._bytes -= self._queue.popleft()[0]
                self._dropped()

    def offer(self, message: Message, size: int) -> bool:
        """Queue a message of ``size`` bytes unless the queue is full; return whether it was queued."""
        with self._condition:
            full = len(self._queue) >= self._depth or (self._queue and self._bytes + size > self._max_bytes)
            if self._closed or full:
                return False
            self._add(message, size)
            return True

    def _add(self, message: Message, size: int) -> None:
        self._start()
        self._queue.append((size, message))
        self._bytes += size
        self._condition.notify()

    def close(self) -> None:
        """Drop the queued messages and end the thread. Safe to call twice."""
        with self._condition:
            self._closed = True
            self._queue.clear()
            self._condition.notify()
        self._join(2.0)

    @override
    def _run(self) -> None:
        while True:
            with self._condition:
                self._processing = False
                while not self._queue and not self._closed:
                    self._condition.wait()
                if self._closed:
                    return
                self._processing = True
                size, message = self._queue.popleft()
                self._bytes -= size
            try:
                self._process(message)
            except Exception:
                _log.exception("%s: one message failed", self._name)


FIRST = 0.2
LONGEST = 10.0
GOOD_LIFE = 30.0


class Backoff:
    """Delays between restarts: they double from 0.2 s to 10 s, and reset after a run of 30 s."""

    def __init__(self, first: float = FIRST, longest: float = LONGEST, good_life: float = GOOD_LIFE) -> None:
        self._first = first
        self._longest = longest
        self._good_life = good_life
        self._next = first

    def pause(self, lived: float) -> float:
        """Return the seconds to wait after a run of ``lived`` seconds."""
        if lived >= self._good_life:
            self._next = self._first
        pause = self._next
        self._next = min(self._next * 2, self._longest)
        return pause

    def reset(self) -> None:
        """Reset the delay, for example after a change of the configuration."""
        self._next = self._first
