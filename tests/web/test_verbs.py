"""The order of calls and stops of pages."""

from __future__ import annotations

import threading

import pytest

from bridge.web.verbs import verbs
from bridge.web.verbs.verbs import PageVerb, VerbError, Verbs


@pytest.mark.parametrize("waits", [True, False], ids=["waits", "runs"])
def test_drive_that_waits_is_not_executed_after_a_stop(*, waits: bool) -> None:
    """A confirmed stop must not be followed by a goal that was sent before it."""
    may_end, begun, driven = threading.Event(), threading.Semaphore(0), list[str]()

    def wait() -> None:
        begun.release()
        may_end.wait(20)

    known = {
        "wait": PageVerb(wait, {}, {}),
        "goto": PageVerb(lambda: driven.append("goto"), {}, {}, drives=True),
        "stop": PageVerb(lambda: driven.append("stop"), {}, {}, stops=True),
    }
    calls = Verbs(known, lambda action: action(), {})
    try:
        for _ in range(verbs.THREADS if waits else 0):
            calls.begin("wait", {}, "a page")
            assert begun.acquire(timeout=20)
        goal = calls.begin("goto", {}, "a page")
        if not waits:
            goal.result(20)
        calls.begin("stop", {}, "another page").result(20)
        may_end.set()
        if waits:
            with pytest.raises(VerbError, match="not executed: a stop"):
                goal.result(20)
        later = calls.begin("goto", {}, "a page")
        later.result(20)
    finally:
        may_end.set()
        calls.close()
    assert driven == (["stop", "goto"] if waits else ["goto", "stop", "goto"])
