"""Checks that hang or fail."""

from __future__ import annotations

import threading

from bridge.doctor.check import Check, Result, examine, ok
from bridge.doctor.checks import CHECKS
from bridge.doctor.checks.ros1 import in_parallel
from tests.doctor.parts import around


def test_hanging_and_failing_checks_do_not_affect_others() -> None:
    never = threading.Event()

    def hang(_around: object) -> list[object]:
        never.wait()
        return []

    def break_(_around: object) -> list[object]:
        msg = "boom"
        raise LookupError(msg)

    checks = [
        Check("hangs", "", hang, seconds=0.1),  # type: ignore[arg-type]
        Check("breaks", "", break_),  # type: ignore[arg-type]
        Check("works", "", lambda _around: [ok("fine")]),
    ]
    result = {report.check.id: report.findings[0] for report in examine(around(), checks)}
    never.set()
    assert {name: finding.result for name, finding in result.items()} == {
        "hangs": Result.FAIL,
        "breaks": Result.FAIL,
        "works": Result.OK,
    }
    assert "hangs" in result["hangs"].seen
    assert "boom" in result["breaks"].seen


def test_ids_are_unique() -> None:
    ids = [check.id for check in CHECKS]
    assert len(set(ids)) == len(ids)


def test_outcomes_are_in_the_order_of_the_items() -> None:
    first = threading.Event()

    def work(item: int) -> int:
        if item == 0:
            assert first.wait(40)  # item 0 ends last
        elif item == 9:
            first.set()
        return item * 2

    assert in_parallel(work, list(range(10)), 4) == [item * 2 for item in range(10)]
    assert in_parallel(work, [], 4) == []
