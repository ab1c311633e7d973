"""Executors, delayed calls and bounded queues."""

from __future__ import annotations

import contextlib
import errno
import threading

import pytest

from bridge.concurrency import BoundedQueue, DelayedCalls, InlineExecutor, SerialExecutor, WorkerPool
from tests.support.no_threads import no_threads
from tests.support.wait import until


def test_a_bounded_queue_keeps_the_order_and_drops_the_oldest() -> None:
    go_on, taken, dropped = threading.Event(), list[int](), list[bool]()

    def take(message: int) -> None:
        assert go_on.wait(40)
        taken.append(message)
        if message == 8:
            raise ValueError(message)

    queue = BoundedQueue[int]("queue", 3, 100, take, lambda: dropped.append(True))
    try:
        assert not queue.busy
        queue.put(0, 1)
        until(lambda: queue.waiting == 0, "the first message is being handled")
        assert queue.busy
        for number in range(1, 8):
            queue.put(number, 1)
        queue.put(8, 99)  # fits together with one other message, not with two
        go_on.set()
        until(lambda: not queue.busy, "all messages are handled")
        assert taken == [0, 7, 8]
        assert len(dropped) == 6
        queue.put(9, 1000)  # the newest message always fits, and a failed message does not stop the queue
        until(lambda: taken[-1] == 9, "the queue continues")
    finally:
        queue.close()
        queue.close()


def test_closing_a_bounded_queue_drops_waiting_messages() -> None:
    inside, go_on, taken = threading.Event(), threading.Event(), list[int]()

    def take(message: int) -> None:
        inside.set()
        assert go_on.wait(40)
        taken.append(message)

    queue = BoundedQueue[int]("queue", 10, 100, take, lambda: None)
    queue.put(1, 1)
    assert inside.wait(40)
    queue.put(2, 1)
    closer = threading.Thread(target=queue.close)
    closer.start()
    until(lambda: queue.waiting == 0, "the waiting message is dropped")
    go_on.set()
    closer.join(40)
    queue.put(3, 1)
    assert taken == [1]


def test_a_full_bounded_queue_refuses_offers() -> None:
    inside, go_on, taken = threading.Event(), threading.Event(), list[int]()

    def take(message: int) -> None:
        inside.set()
        assert go_on.wait(40)
        taken.append(message)

    queue = BoundedQueue[int]("queue", 2, 100, take, lambda: None)
    try:
        assert queue.offer(0, 1000)
        assert inside.wait(40)
        assert [queue.offer(number, size) for number, size in ((1, 60), (2, 60), (3, 40), (4, 0))] == [
            True,
            False,
            True,
            False,
        ]
        go_on.set()
        until(lambda: not queue.busy, "all messages are handled")
        assert taken == [0, 1, 3]
    finally:
        queue.close()
    assert not queue.offer(5, 1)


def test_few_jobs_run_at_a_time_and_each_reports_its_end() -> None:
    pool, gate, begun = WorkerPool(2, "pool"), threading.Event(), threading.Semaphore(0)

    def held(number: int) -> int:
        begun.release()
        assert gate.wait(20)
        return number

    futures = [pool.submit(lambda n=n: held(n)) for n in range(5)]
    assert begun.acquire(timeout=20)
    assert begun.acquire(timeout=20)
    assert not begun.acquire(timeout=0.1), "no more than two jobs run at once"
    gate.set()
    assert [future.result(20) for future in futures] == list(range(5))
    failed = pool.submit(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        failed.result(20)
    assert pool.submit(lambda: "still there").result(20) == "still there"
    pool.close(20)
    assert not [t for t in threading.enumerate() if t.name.startswith("pool")]


def test_a_job_that_hangs_does_not_delay_closing_the_pool() -> None:
    pool, gate, begun = WorkerPool(1, "pool"), threading.Event(), threading.Event()
    hanging = pool.submit(lambda: (begun.set(), gate.wait(20)))
    assert begun.wait(20)
    waiting = pool.submit(lambda: None)
    pool.close(0.0)
    assert not hanging.done()
    gate.set()
    assert hanging.result(20)
    assert pool.submit(lambda: None).cancelled()
    until(waiting.cancelled, "the waiting job is canceled")
    until(lambda: not [t for t in threading.enumerate() if t.name.startswith("pool")], "the executor's threads end")


def test_a_regular_call_is_repeated_after_a_failure() -> None:
    calls, made = DelayedCalls("delayed"), list[int]()

    def fail() -> None:
        made.append(len(made))
        raise OSError(errno.EMFILE, "Too many open files")

    with contextlib.closing(calls):
        calls.every(0.01, fail, first=0.0)
        until(lambda: len(made) > 2, "the call is repeated")


def test_a_call_within_a_time_runs_at_the_earliest_of_the_requested_times() -> None:
    calls = DelayedCalls("calls")
    executed: list[str] = []

    def call() -> None:
        executed.append("call")

    try:
        calls.within(1000.0, call)
        calls.after(0.2, lambda: executed.append("last"))
        calls.within(0.1, call)
        calls.within(900.0, call)
        until(lambda: "last" in executed, "the calls are made")
        assert executed == ["call", "last"]
        assert [entry for entry in calls._due if entry[2] == call] == [], "the later request has been dropped"
    finally:
        calls.close()


def test_a_call_requested_twice_with_once_runs_once() -> None:
    calls, executed = DelayedCalls("delayed"), list[str]()
    begun, go_on = threading.Semaphore(0), threading.Semaphore(0)

    def once() -> None:
        executed.append("once")

    def hold() -> None:
        begun.release()
        assert go_on.acquire(timeout=40)

    try:
        calls.after(0.0, hold)  # no other call is due before all are requested
        calls.after(0.05, once, once=True)
        calls.after(0.1, once, once=True)
        calls.after(0.3, lambda: executed.append("last"))  # requested after the others, so that it is due after them
        calls.after(0.0, lambda: 1 // 0)  # the failure does not stop later calls
        go_on.release()
        until(lambda: "last" in executed, "all calls have run")
        assert executed == ["once", "last"]
        calls.after(0.0, once, once=True)
        until(lambda: executed[-1] == "once", "the call may be requested again")
        assert begun.acquire(timeout=40)
        calls.after(0.0, hold)
        assert begun.acquire(timeout=40)
        calls.after(0.0, lambda: executed.append("never"))  # is due, and waits for the call that runs
        calls.close(0.0)
    finally:
        go_on.release(2)
        calls.close()
    calls.after(0.0, lambda: executed.append("never"))
    assert "never" not in executed


def test_a_job_that_submits_another_sees_it_run_after_itself() -> None:
    executor, done = InlineExecutor(), list[str]()

    def outer() -> None:
        executor.submit(lambda: done.append("inner"))
        done.append("outer")

    executor.submit(outer)
    executor.submit(lambda: 1 // 0)  # the failure does not stop later jobs
    executor.submit(lambda: done.append("next"))
    assert done == ["outer", "inner", "next"]


def test_an_interrupted_job_leaves_the_executor_usable() -> None:
    executor, done = InlineExecutor(), list[str]()

    def interrupted() -> None:
        executor.submit(lambda: done.append("left"))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        executor.submit(interrupted)
    executor.submit(lambda: done.append("next"))
    assert done == ["left", "next"]


def test_without_threads_a_job_is_canceled_or_waits_for_a_running_one() -> None:
    pool, gate, begun = WorkerPool(2, "pool"), threading.Event(), threading.Event()
    with contextlib.closing(pool):
        with no_threads("pool"):
            assert pool.submit(lambda: 1).cancelled()
        running = pool.submit(lambda: (begun.set(), gate.wait(20)))
        assert begun.wait(20)
        with no_threads("pool"):
            waiting = pool.submit(lambda: 2)
        assert not waiting.cancelled()
        gate.set()
        assert (running.result(20)[1], waiting.result(20)) == (True, 2)
        pool.close(20)


def test_an_executor_that_found_no_thread_starts_one_for_the_next_job() -> None:
    done = list[str]()
    queue = BoundedQueue[str]("lone", 3, 100, done.append, lambda: None)
    serial, delayed = SerialExecutor("lone"), DelayedCalls("lone")

    def later() -> None:
        done.append("later")

    submits = (
        lambda: queue.put("message", 1),
        lambda: serial.submit(lambda: done.append("job")),
        lambda: delayed.after(0.0, later, once=True),
    )
    with contextlib.closing(queue), contextlib.closing(serial), contextlib.closing(delayed):
        with no_threads("lone"):
            for submit in submits:
                with pytest.raises(RuntimeError):
                    submit()
        for submit in submits:
            submit()
        until(lambda: sorted(done) == ["job", "later", "message"], "each job runs once")
