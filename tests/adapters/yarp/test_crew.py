"""Threads that wait for others and hold up nobody."""

from __future__ import annotations

import threading

import pytest

from bridge.adapters.yarp.crew import Crew
from tests.support.wait import until


def test_jobs_are_done_a_few_at_a_time_and_tell_their_end() -> None:
    crew, gate, begun = Crew(2, "crew"), threading.Event(), threading.Semaphore(0)

    def held(number: int) -> int:
        begun.release()
        assert gate.wait(20)
        return number

    futures = [crew.submit(lambda n=n: held(n)) for n in range(5)]
    assert begun.acquire(timeout=20)
    assert begun.acquire(timeout=20)
    assert not begun.acquire(timeout=0.1), "more than two at once"
    gate.set()
    assert [future.result(20) for future in futures] == list(range(5))
    failed = crew.submit(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        failed.result(20)
    assert crew.submit(lambda: "still there").result(20) == "still there"
    crew.close(20)
    assert not [t for t in threading.enumerate() if t.name.startswith("crew")]


def test_a_job_that_hangs_holds_up_no_end() -> None:
    crew, gate, begun = Crew(1, "crew"), threading.Event(), threading.Event()
    hanging = crew.submit(lambda: (begun.set(), gate.wait(20)))
    assert begun.wait(20)
    waiting = crew.submit(lambda: None)
    crew.close(0.0)
    assert not hanging.done()
    gate.set()
    assert hanging.result(20)
    assert crew.submit(lambda: None).cancelled()
    until(waiting.cancelled, "what had not begun is not begun")
    until(lambda: not [t for t in threading.enumerate() if t.name.startswith("crew")], "its thread ends")
