"""The check that names nodes on Cyclone DDS."""

from __future__ import annotations

import pytest

from bridge.doctor.check import Result
from bridge.doctor.checks import CHECKS, cyclone
from tests.doctor.parts import around, hub, only

WORKER = {"worker": "ros2", "side": "ros2"}


def test_nodes_and_unsupported_features_are_named() -> None:
    report = {"nodes": ["/lamp", "/planner"], "served": ["/switch", "/go"], "called": ["/map"]}
    finding = only(cyclone.look_at_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert finding.result is Result.WARN
    for texts in (
        "/lamp, /planner on Cyclone DDS",
        "topics cross",
        "cannot be called (/switch, /go)",
        "not answered (/map)",
    ):
        assert texts in finding.seen
    assert "rmw_fastrtps_cpp" in finding.cure


def test_many_nodes_are_counted() -> None:
    report = {"nodes": [f"/node{number}" for number in range(25)], "served": [], "called": []}
    finding = only(cyclone.look_at_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert "/node9 and 15 more on Cyclone DDS" in finding.seen


@pytest.mark.parametrize("report", [None, [], "text", {}, {"nodes": 3}])
def test_report_of_another_version(report: object) -> None:
    finding = only(cyclone.look_at_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert finding.result is (Result.WARN if isinstance(report, dict) else Result.OK)


def test_without_such_nodes() -> None:
    assert only(cyclone.look_at_nodes(around(hub=hub(WORKER)))).result is Result.OK


def test_without_a_worker() -> None:
    assert only(cyclone.look_at_nodes(around(hub=hub()))).result is Result.SKIP
    assert only(cyclone.look_at_nodes(around())).result is Result.SKIP


def test_the_doctor_runs_it() -> None:
    assert "cyclone" in [check.id for check in CHECKS]
