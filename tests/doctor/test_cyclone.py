"""The check that names nodes on Cyclone DDS."""

from __future__ import annotations

import pytest

from bridge.doctor.check import Result
from bridge.doctor.checks import CHECKS, cyclone
from tests.doctor.parts import around, every, hub, only

WORKER = {"worker": "ros2", "side": "ros2"}


def test_nodes_on_cyclone_dds_are_named() -> None:
    report = {"nodes": ["/lamp", "/planner"], "both": []}
    finding = only(cyclone.check_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert finding.result is Result.OK
    assert "/lamp, /planner on Cyclone DDS" in finding.seen
    assert "topics, services and actions are bridged" in finding.seen


def test_services_with_a_second_server_on_another_dds_are_a_warning() -> None:
    report = {"nodes": ["/lamp"], "both": ["/go", "/switch"]}
    finding = only(cyclone.check_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert finding.result is Result.WARN
    assert "another DDS also serves /go, /switch" in finding.seen
    assert "stop one of the servers" in finding.cure


def test_clients_and_servers_on_two_kinds_of_dds_are_a_warning() -> None:
    report = {"nodes": ["/lamp"], "both": [], "mixed": ["/lamp (client /a, server /b on Cyclone DDS)"]}
    finding = only(cyclone.check_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert finding.result is Result.WARN
    assert (
        "/lamp (client /a, server /b on Cyclone DDS): ROS 2 executes these requests with wrong values" in finding.seen
    )
    assert "in two domains" in finding.cure
    report["both"] = ["/go"]
    assert len(every(cyclone.check_nodes(around(hub=hub({**WORKER, "cyclone": report}))))) == 2


def test_many_nodes_are_counted() -> None:
    report = {"nodes": [f"/node{number}" for number in range(25)], "both": []}
    finding = only(cyclone.check_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert "/node9 and 15 more on Cyclone DDS" in finding.seen


@pytest.mark.parametrize("report", [None, [], "text", {}, {"nodes": 3}])
def test_a_report_of_another_version_is_ignored(report: object) -> None:
    finding = only(cyclone.check_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert finding.result is Result.OK


def test_without_nodes_on_cyclone_dds_the_check_passes() -> None:
    assert only(cyclone.check_nodes(around(hub=hub(WORKER)))).result is Result.OK
    report = {"nodes": [], "both": [], "foreign": ["/lamp"], "uncallable": ["/lamp"]}
    finding = only(cyclone.check_nodes(around(hub=hub({**WORKER, "cyclone": report}))))
    assert (finding.result, finding.seen) == (Result.OK, "no node uses Cyclone DDS")


def test_without_a_worker_the_check_is_skipped() -> None:
    assert only(cyclone.check_nodes(around(hub=hub()))).result is Result.SKIP
    assert only(cyclone.check_nodes(around())).result is Result.SKIP


def test_the_doctor_runs_the_check_of_cyclone_dds() -> None:
    assert "cyclone" in [check.id for check in CHECKS]
