"""A module's own thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from bridge.modules.loop import EventLoop, Newest
from bridge.progress import working
from tests.support.wait import until


@pytest.fixture
def loop() -> Iterator[EventLoop]:
    event_loop = EventLoop("a loop", limit=0.5)
    event_loop.start()
    yield event_loop
    event_loop.close()


def test_actions_run_in_order_on_one_thread(loop: EventLoop) -> None:
    seen: list[tuple[int, int]] = []
    for number in range(100):
        loop.post(lambda n=number: seen.append((n, threading.get_ident())))
    loop.call(lambda: None)
    assert [n for n, _ in seen] == list(range(100))
    assert len({thread for _, thread in seen} - {threading.get_ident()}) == 1


def test_a_call_returns_its_result_or_raises_its_error_and_may_be_nested(loop: EventLoop) -> None:
    assert loop.call(lambda: loop.call(lambda: 7)) == 7
    with pytest.raises(ZeroDivisionError):
        loop.call(lambda: 1 // 0)


def test_failed_action_does_not_end_the_thread(loop: EventLoop, caplog: pytest.LogCaptureFixture) -> None:
    loop.post(lambda: 1 // 0)
    assert loop.call(lambda: "on") == "on"
    assert "one step failed" in caplog.text


def test_a_timer_skips_missed_times(loop: EventLoop) -> None:
    ran = threading.Semaphore(0)
    timer = loop.every(0.01, ran.release)
    for _ in range(3):
        assert ran.acquire(timeout=40)

    def counted() -> int:
        count = 0
        while ran.acquire(blocking=False):
            count += 1
        return count

    def hold() -> float:
        counted()
        time.sleep(0.2)  # twenty ticks are missed
        return time.monotonic()

    went_on = loop.call(hold)
    timer.close()
    loop.call(lambda: None)
    assert counted() <= (time.monotonic() - went_on) / 0.01 + 2


def test_closed_timer_no_longer_runs(loop: EventLoop) -> None:
    ran: list[int] = []
    done = threading.Event()

    def begin() -> None:
        late = loop.after(0.0, lambda: ran.append(1))
        loop.after(0.0, done.set)  # due after the previous callback
        late.close()

    loop.call(begin)
    assert done.wait(40)
    assert not ran


def test_timers_and_posted_actions_alternate(loop: EventLoop) -> None:
    loop.every(1e-9, lambda: None)  # due again as soon as the callback has run
    assert loop.call(lambda: "its turn") == "its turn"

    def on_and_on() -> None:
        loop.post(on_and_on)

    loop.post(on_and_on)
    ran = threading.Event()
    loop.after(0.0, ran.set)
    assert ran.wait(40)


def test_blocked_step_is_reported(loop: EventLoop) -> None:
    gate, begun = threading.Event(), threading.Event()
    loop.post(lambda: (begun.set(), gate.wait(40)))
    assert begun.wait(40)
    with pytest.raises(TimeoutError, match="a loop has not answered"):
        loop.call(lambda: None, seconds=0.05)
    until(lambda: hung(loop), "the loop is reported as hanging")
    gate.set()
    loop.call(lambda: None, 40.0)
    until(lambda: not judged(loop), "the step is no longer reported")


def compute(done: threading.Event) -> None:
    while not done.is_set():
        sum(range(1000))


def use_processor(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        sum(range(1000))


def hung(loop: EventLoop) -> str:
    """Return the text that reports the loop as hanging; "" if it is not reported."""
    try:
        loop.computes()
    except TimeoutError as err:
        return str(err)
    return ""


def judged(loop: EventLoop) -> str:
    """Return the text that reports the current step as computing or hanging; "" if it is not reported."""
    try:
        return loop.computes()
    except TimeoutError as err:
        return str(err)


def test_computing_step_is_distinguished_from_a_hanging_step(loop: EventLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.progress.ENDLESS", 1000.0)
    done = threading.Event()
    loop.post(lambda: compute(done))
    texts = {f"computes for {seconds} s" for seconds in range(2, 60)}
    try:
        # a process that stands still for longer than the limit is reported as hanging for a moment
        until(
            lambda: judged(loop) in texts,
            "the loop computes for far longer than a step may stand still",
        )
    finally:
        done.set()
    loop.call(lambda: None, 40.0)
    until(lambda: not judged(loop), "the step is no longer reported")
    gate = threading.Event()
    loop.post(lambda: gate.wait(40))
    until(lambda: "computes nothing" in hung(loop), "the loop is reported as hanging")
    gate.set()


def test_endless_step_is_reported(loop: EventLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.progress.ENDLESS", 2)
    done = threading.Event()
    loop.post(lambda: compute(done))
    try:
        until(lambda: "a loop is in an endless loop" in hung(loop), "the endless loop is reported")
    finally:
        done.set()


def test_loop_waits_for_work_that_progresses(loop: EventLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    # a clock that stands still together with this process
    clock = SimpleNamespace(**{**vars(time), "monotonic": time.process_time})
    for name in ("bridge.modules.loop.time", "bridge.progress.time"):
        monkeypatch.setattr(name, clock)
    monkeypatch.setattr("bridge.progress.ENDLESS", 1000.0)
    done = threading.Event()
    threading.Timer(1.5, done.set).start()
    assert loop.work(lambda: (compute(done), "done")[1]) == "done", (
        "the step may compute for three times as long as it may stand still"
    )
    with pytest.raises(ZeroDivisionError):
        loop.work(lambda: 1 // 0)


def test_work_behind_a_hanging_step_is_skipped(loop: EventLoop) -> None:
    gate, ran = threading.Event(), list[int]()
    loop.post(lambda: gate.wait(40))
    with pytest.raises(TimeoutError, match="a loop hangs: it has been in one step for"):
        loop.work(lambda: ran.append(1))
    gate.set()
    loop.call(lambda: None)
    assert not ran


def test_work_that_the_main_thread_awaits_counts_as_its_progress(
    loop: EventLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.progress.BUSY_SECONDS", 0.0)
    with working.busy("waiting"):
        loop.work(lambda: use_processor(0.2), 60.0)
        busy = working.now()
        assert busy is not None
        assert busy.used - time.thread_time() > 0.05
    assert working.now() is None


def test_closed_loop_accepts_no_actions() -> None:
    loop = EventLoop("an ended loop")
    loop.start()
    loop.close()
    loop.close()
    ran: list[int] = []
    loop.post(lambda: ran.append(1))
    loop.after(0, lambda: ran.append(2))
    assert not ran


def test_waiting_call_fails_at_once_when_the_loop_ends() -> None:
    loop = EventLoop("an ending loop")
    gate, errors = threading.Event(), list[str]()
    loop.start()
    loop.post(lambda: gate.wait(40))

    def ask() -> None:
        try:
            loop.call(lambda: None, seconds=40)
        except TimeoutError as err:
            errors.append(str(err))

    asking = threading.Thread(target=ask)
    asking.start()
    until(lambda: loop.waiting == 1, "the call waits")
    loop.close(seconds=0)
    asking.join(20)
    assert errors == ["an ending loop has ended"], "the call fails without waiting for the running step"
    with pytest.raises(TimeoutError, match="has ended"):
        loop.call(lambda: None, seconds=40)
    gate.set()
    loop.close()


def test_loop_that_ends_itself_finishes_its_last_step(loop: EventLoop) -> None:
    assert loop.call(lambda: (loop.close(), "the last word")[1]) == "the last word"


def test_busy_thread_keeps_only_the_newest_value() -> None:
    loop, go_on = EventLoop("the module"), threading.Event()
    loop.start()
    taken: list[int] = []
    newest = Newest(loop, taken.append)
    loop.post(lambda: go_on.wait(40))
    for number in range(5):
        newest.put(number)
    go_on.set()
    loop.call(lambda: None)
    assert taken == [4]
    newest.put(5)
    loop.call(lambda: None)
    assert taken == [4, 5]
    loop.close()
