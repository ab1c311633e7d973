"""A module's own thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from bridge.modules.loop import Loop
from tests.support.wait import until


@pytest.fixture
def loop() -> Iterator[Loop]:
    made = Loop("a loop")
    made.start()
    yield made
    made.close()


def test_actions_run_in_order_on_one_thread(loop: Loop) -> None:
    seen: list[tuple[int, int]] = []
    for number in range(100):
        loop.post(lambda n=number: seen.append((n, threading.get_ident())))
    loop.call(lambda: None)
    assert [n for n, _ in seen] == list(range(100))
    assert len({thread for _, thread in seen} - {threading.get_ident()}) == 1


def test_a_call_gives_the_result_and_the_error_and_may_be_nested(loop: Loop) -> None:
    assert loop.call(lambda: loop.call(lambda: 7)) == 7
    with pytest.raises(ZeroDivisionError):
        loop.call(lambda: 1 // 0)


def test_what_fails_does_not_end_the_thread(loop: Loop, caplog: pytest.LogCaptureFixture) -> None:
    loop.post(lambda: 1 // 0)
    assert loop.call(lambda: "on") == "on"
    assert "one step failed" in caplog.text


def test_a_timer_leaves_out_the_times_that_were_missed(loop: Loop) -> None:
    ran = threading.Semaphore(0)
    timer = loop.every(0.01, ran.release)
    for _ in range(3):
        assert ran.acquire(timeout=40)

    def counted() -> int:
        found = 0
        while ran.acquire(blocking=False):
            found += 1
        return found

    def hold() -> float:
        counted()
        time.sleep(0.2)  # twenty times are missed
        return time.monotonic()

    went_on = loop.call(hold)
    timer.close()
    loop.call(lambda: None)
    assert counted() <= (time.monotonic() - went_on) / 0.01 + 2


def test_a_timer_that_is_closed_runs_no_more(loop: Loop) -> None:
    ran: list[int] = []
    done = threading.Event()

    def begin() -> None:
        late = loop.after(0.0, lambda: ran.append(1))
        loop.after(0.0, done.set)  # due after it
        late.close()

    loop.call(begin)
    assert done.wait(40)
    assert not ran


def test_timers_and_what_is_posted_take_turns(loop: Loop) -> None:
    loop.every(1e-9, lambda: None)  # due again as soon as it has run
    assert loop.call(lambda: "its turn") == "its turn"

    def on_and_on() -> None:
        loop.post(on_and_on)

    loop.post(on_and_on)
    ran = threading.Event()
    loop.after(0.0, ran.set)
    assert ran.wait(40)


def test_a_step_that_stands_still_is_told(loop: Loop) -> None:
    gate, begun = threading.Event(), threading.Event()
    loop.post(lambda: (begun.set(), gate.wait(40)))
    assert begun.wait(40)
    with pytest.raises(TimeoutError, match="a loop has not answered"):
        loop.call(lambda: None, seconds=0.05)
    assert loop.stuck_for() > 0.04
    gate.set()
    loop.call(lambda: None)
    until(lambda: loop.stuck_for() < 0.04, "nothing stands still any more")


def test_after_the_end_nothing_is_taken() -> None:
    loop = Loop("an ended loop")
    loop.start()
    loop.close()
    loop.close()
    ran: list[int] = []
    loop.post(lambda: ran.append(1))
    loop.after(0, lambda: ran.append(2))
    assert not ran


def test_who_waits_for_a_loop_that_ends_is_told_at_once() -> None:
    loop = Loop("an ending loop")
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
    until(lambda: len(loop._ready) == 1, "the call waits")
    loop.close(seconds=0)
    asking.join(20)
    assert errors == ["an ending loop has ended"], "the step that is under way need not be over"
    with pytest.raises(TimeoutError, match="has ended"):
        loop.call(lambda: None, seconds=40)
    gate.set()
    loop.close()


def test_a_loop_that_ends_itself_still_answers_for_its_last_step(loop: Loop) -> None:
    assert loop.call(lambda: (loop.close(), "the last word")[1]) == "the last word"
