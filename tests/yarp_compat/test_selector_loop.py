"""The selector loop that the daemon shares with the ports of YARP."""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import NoReturn

import pytest

from tests.support.wait import until
from yarp_compat.selector_loop import CALLS_PER_STEP, SelectorLoop
from yarp_compat.threaded_loop import ThreadedLoop

SELECTORS = [
    getattr(selectors, name)
    for name in ("SelectSelector", "PollSelector", "EpollSelector", "KqueueSelector")
    if hasattr(selectors, name)
]


@pytest.fixture(params=SELECTORS, ids=lambda kind: kind.__name__)
def loop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[SelectorLoop]:
    monkeypatch.setattr(selectors, "DefaultSelector", request.param)
    loop = SelectorLoop()
    yield loop
    loop.close()


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    near, far = socket.socketpair()
    near.setblocking(False)
    with near, far:
        yield near, far


Pair = tuple[socket.socket, socket.socket]


def step_until(loop: SelectorLoop, condition: Callable[[], object], event: str) -> None:
    def stepped() -> bool:
        loop.step(0.1)
        return bool(condition())

    until(stepped, event)


def test_files_call_back_in_the_directions_that_are_watched(loop: SelectorLoop, pair: Pair) -> None:
    near, far = pair
    events = list[str]()
    loop.on_readable(near, lambda: events.append(near.recv(9).decode()))
    loop.step(0.0)
    assert events == []
    loop.on_writable(near, lambda: events.append("writable"))
    loop.step(0.0)
    assert events == ["writable"]
    far.send(b"data")
    loop.step(1.0)
    assert events == ["writable", "data", "writable"]
    loop.on_writable(near, None)
    far.send(b"more")
    loop.step(1.0)
    assert events == ["writable", "data", "writable", "more"]


def test_descriptors_and_sockets_name_the_same_file(loop: SelectorLoop, pair: Pair) -> None:
    near, far = pair
    events = list[str]()
    loop.on_readable(near.fileno(), lambda: events.append("readable"))
    loop.on_writable(near, lambda: events.append("writable"))
    far.send(b"data")
    loop.step(1.0)
    assert events == ["readable", "writable"]
    assert loop.unwatch(near.fileno())
    assert not loop.unwatch(near)
    loop.step(0.0)
    assert len(events) == 2


def test_watch_replaces_both_callbacks(loop: SelectorLoop, pair: Pair) -> None:
    near, _ = pair
    events = list[str]()
    loop.watch(near, writable=lambda: events.append("first"))
    loop.watch(near, writable=lambda: events.append("second"))
    loop.step(0.0)
    loop.watch(near)
    loop.step(0.0)
    assert events == ["second"]
    assert not loop.unwatch(near)


def test_a_file_that_an_earlier_callback_stopped_watching_is_not_called(loop: SelectorLoop) -> None:
    """This holds even if the same callback closed the file, and its descriptor now belongs to another file."""
    pairs = [socket.socketpair() for _ in range(2)]
    calls, reopened = list[str](), list[socket.socket]()

    def end_the_other(other: socket.socket) -> None:
        calls.append("called")
        loop.unwatch(other)
        file = other.fileno()
        other.close()
        reopened.extend(socket.socketpair())
        assert file in {sock.fileno() for sock in reopened}
        loop.on_readable(file, lambda: calls.append("stale"))

    for (near, far), (other, _) in zip(pairs, reversed(pairs), strict=True):
        far.send(b"data")
        loop.on_readable(near, lambda other=other: end_the_other(other))
    loop.step(1.0)
    assert calls == ["called"]
    for sock in (*reopened, *(sock for pair in pairs for sock in pair)):
        loop.unwatch(sock)
        sock.close()


def test_a_closed_socket_cannot_be_watched_but_can_be_released(loop: SelectorLoop) -> None:
    near, far = socket.socketpair()
    far.close()
    loop.on_readable(near, print)
    near.close()
    assert loop.unwatch(near)
    with pytest.raises(ValueError, match="file descriptor"):
        loop.watch(near, print)


def test_timers_run_once_in_the_order_of_their_deadlines(loop: SelectorLoop) -> None:
    runs = list[tuple[str, float]]()
    begun = time.monotonic()
    for name, seconds in (("late", 0.06), ("early", 0.02), ("now", 0.0), ("also now", 0.0)):
        loop.call_later(seconds, lambda name=name: runs.append((name, time.monotonic() - begun)))
    while len(runs) < 4:
        loop.step()
    loop.step(0.0)
    assert [name for name, _ in runs] == ["now", "also now", "early", "late"]
    assert runs[2][1] >= 0.02
    assert runs[3][1] >= 0.06


def test_timers_end_the_wait_of_a_step_and_its_limit_ends_it_before_a_timer(loop: SelectorLoop) -> None:
    runs = list[str]()
    loop.call_later(3600.0, lambda: runs.append("in an hour"))
    loop.step(0.01)
    loop.call_later(0.01, lambda: runs.append("soon"))
    until(lambda: loop.step(60.0) or runs, "the timer ends the wait", 10.0)
    assert runs == ["soon"]


def test_canceled_timers_do_not_run_and_are_not_kept(loop: SelectorLoop) -> None:
    runs = list[str]()
    last = loop.call_later(0.0, lambda: runs.append("last"))
    canceled = [loop.call_later(0.0, lambda: runs.append("canceled")) for _ in range(1000)]
    for timer in canceled:
        loop.cancel(timer)
        loop.cancel(timer)
    assert len(loop._timers) < 40
    loop.step(0.0)
    assert runs == ["last"]
    loop.cancel(last)
    assert loop._canceled == 0


def test_a_timer_canceled_by_an_earlier_one_of_the_same_step_does_not_run(loop: SelectorLoop) -> None:
    runs = list[str]()
    loop.call_later(0.0, lambda: loop.cancel(second))
    second = loop.call_later(0.0, lambda: runs.append("second"))
    step_until(loop, lambda: not loop._timers, "both timers are due")
    assert runs == []


def test_other_threads_wake_the_loop_with_calls(loop: SelectorLoop) -> None:
    threads, done = list[int](), list[int]()

    def call() -> None:
        for number in range(100):
            loop.call_soon(lambda number=number: (threads.append(threading.get_ident()), done.append(number)))

    other = threading.Thread(target=call)
    other.start()
    step_until(loop, lambda: len(done) == 100, "all calls have run")
    other.join()
    assert done == list(range(100))
    assert set(threads) == {threading.get_ident()}


def test_calls_end_the_wait_of_a_step(loop: SelectorLoop) -> None:
    timer = threading.Timer(0.05, loop.wake)
    timer.start()
    begun = time.monotonic()
    loop.step(60.0)
    assert time.monotonic() - begun < 30.0
    timer.join()


def test_a_signal_handler_may_call(loop: SelectorLoop) -> None:
    runs = list[int]()
    before = signal.signal(signal.SIGINT, lambda number, _frame: loop.call_soon(lambda: runs.append(number)))
    try:
        threading.Timer(0.02, os.kill, args=(os.getpid(), signal.SIGINT)).start()
        step_until(loop, lambda: runs, "the handler's call has run")
    finally:
        signal.signal(signal.SIGINT, before)
    assert runs == [signal.SIGINT]


def test_work_of_one_step_is_bounded(loop: SelectorLoop, pair: Pair) -> None:
    """Calls and timers that schedule themselves again, and a flood of calls, do not keep a socket waiting."""
    near, far = pair
    runs = {"call": 0, "timer": 0, "flood": 0, "socket": 0}

    def again(name: str, schedule: Callable[[Callable[[], None]], object]) -> Callable[[], None]:
        def run() -> None:
            runs[name] += 1
            schedule(run)

        return run

    loop.call_soon(again("call", loop.call_soon))
    loop.call_later(0.0, again("timer", lambda run: loop.call_later(0.0, run)))
    loop.step(0.0)
    loop.step(0.0)
    assert runs["call"] == 2
    assert 1 <= runs["timer"] <= 2
    for _ in range(2 * CALLS_PER_STEP):
        loop.call_soon(lambda: runs.update(flood=runs["flood"] + 1))
    loop.on_readable(near, lambda: runs.update(socket=len(near.recv(1))))
    far.send(b"x")
    loop.step(0.0)
    assert runs["flood"] < CALLS_PER_STEP
    loop.step(60.0)  # does not wait, because calls are left
    assert runs["socket"] == 1
    step_until(loop, lambda: runs["flood"] == 2 * CALLS_PER_STEP, "the rest of the flood has run")


def test_more_wakes_than_its_socket_holds_do_not_block(loop: SelectorLoop) -> None:
    for _ in range(100_000):
        loop.wake()
    loop.step(60.0)
    begun = time.monotonic()
    loop.step(0.02)
    assert time.monotonic() - begun > 0.01, "the first step has consumed all wakes"


@pytest.mark.parametrize("kind", ["file", "timer", "call"])
def test_an_exception_leaves_the_step_and_loses_no_other_callback(loop: SelectorLoop, pair: Pair, kind: str) -> None:
    near, far = pair
    runs = set[str]()

    def fail() -> None:
        loop.unwatch(failing)
        raise ZeroDivisionError

    failing, other = socket.socketpair()
    with failing, other:
        other.send(b"x")
        far.send(b"x")
        if kind == "file":
            loop.on_readable(failing, fail)
        elif kind == "timer":
            loop.call_later(0.0, fail)
        else:
            loop.call_soon(fail)
        loop.on_readable(near, lambda: runs.add("file"))
        loop.call_later(0.0, lambda: runs.add("timer"))
        loop.call_soon(lambda: runs.add("call"))
        with pytest.raises(ZeroDivisionError):
            step_until(loop, lambda: False, "the step raises")
        step_until(loop, lambda: runs == {"file", "timer", "call"}, "the others run")


def test_a_closed_loop_ignores_wakes_from_other_threads(loop: SelectorLoop) -> None:
    closed = SelectorLoop()
    closed.close()
    closed.wake()
    closed.call_soon(print)
    assert not closed.unwatch(0)


def test_select_may_begin_while_another_thread_removes_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """In that case, `select` fails because the file is already closed."""
    monkeypatch.setattr(selectors, "DefaultSelector", selectors.SelectSelector)
    loop = ThreadedLoop("test-select")
    began, closed = threading.Event(), threading.Event()
    results: list[object] = []

    def fail(_pause: float | None) -> NoReturn:
        began.set()
        closed.wait(20)
        raise OSError(errno.EBADF, "Bad file descriptor")

    def select() -> None:
        try:
            results.append(loop._select_open(None))
        except OSError as err:
            results.append(err)

    thread = threading.Thread(target=select)
    unregister = loop._selector.unregister

    def unregister_late(file: int) -> selectors.SelectorKey:
        thread.start()
        assert began.wait(20)
        return unregister(file)

    with contextlib.closing(loop), socket.socket() as sock:
        loop.on_readable(sock, lambda: None)
        monkeypatch.setattr(loop._selector, "select", fail)
        monkeypatch.setattr(loop._selector, "unregister", unregister_late)
        loop.unwatch(sock)
        closed.set()
        thread.join(20)
        monkeypatch.undo()
    assert results == [[]]
