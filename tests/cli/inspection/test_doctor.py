"""``midspan doctor`` with and without a daemon."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest

from bridge.doctor.checks import CHECKS
from bridge.status import read_daemon_status
from tests.cli.conftest import Midspan
from tests.peers.daemon.workers import FakeWorker, config_file, status
from tests.peers.hub.network import HubNetwork
from tests.support.ports import free_port

NO_ROS: dict[str, Any] = {"ros1": {"enabled": False}, "ros2": {"enabled": False}}


def results_by_check(done: Any) -> dict[str, list[str]]:
    """Return the results of each check."""
    by_check: dict[str, list[str]] = {}
    for entry in done.json():
        by_check.setdefault(entry["check"], []).append(entry["result"])
    return by_check


def test_without_a_daemon_all_checks_run_or_are_skipped(
    tmp_path: Path, network: HubNetwork, capsys: pytest.CaptureFixture[str]
) -> None:
    nobody = {"hub": {"listen": f"tcp/127.0.0.1:{free_port()}"}}
    midspan = Midspan(config_file(tmp_path, network, **NO_ROS, **nobody), capsys)
    done = midspan("doctor", "--json")
    results = results_by_check(done)
    assert list(results) == [check.id for check in CHECKS]
    assert results["daemon"] == ["warn"]
    assert results["router-port"] == ["ok"]
    assert results["ros1-master"] == results["clock"] == ["skip"]
    assert done.code == (1 if any("fail" in outcomes for outcomes in results.values()) else 0)


def test_with_a_daemon_clock_and_refused_types_are_checked(
    tmp_path: Path, network: HubNetwork, closing: list[FakeWorker], capsys: pytest.CaptureFixture[str]
) -> None:
    midspan = Midspan(config_file(tmp_path, network, **NO_ROS), capsys)
    refused = {"direction": "in", "topic": "/odd", "type": "x/Odd", "reason": "no definition", "cure": "install x"}
    document = status("ros1", daemon="robot2", refused=[refused], pid=0)
    ahead = {"status": document, "time": lambda _params: {"time_ns": time.time_ns() + 3_000_000_000}}
    closing.append(FakeWorker(network, "ros1", daemon="robot2", **ahead))
    for name, digit in (("one", "1"), ("two", "2")):
        worker = FakeWorker(network, name)
        closing.append(worker)
        worker.publish("/map", "nav_msgs/msg/OccupancyGrid", f"RIHS01_{digit * 64}", b"")
    done = midspan("doctor", "--json")
    results = results_by_check(done)
    assert done.code == 1
    for check, result in (("daemon", "ok"), ("types", "fail"), ("type-hash", "fail"), ("clock", "fail")):
        assert results[check] == [result], done.out
    output = midspan("doctor", "--only", "clock", "--only", "types").out
    measured = re.search(r"FAIL  clock: robot2's clock is ([\d.]+) ms", output)
    assert measured, output
    assert float(measured[1]) == pytest.approx(3000, abs=500)  # the measurement is only as exact as the reply is fast
    for text in ("ahead of", "chrony", "FAIL  types: /odd", "cure: install x"):
        assert text in output
    assert "router-port" not in output


def daemon_reports(monkeypatch: pytest.MonkeyPatch, **workers: tuple[str, str]) -> None:
    """Stand in for the daemon ``robot1``, which reports phase and text of each worker, with the PIDs 1, 2 and so on."""
    reports = [
        {"worker": name, "phase": phase, "text": text, "pid": pid, "restarts": 0, "since": 4.0}
        for pid, (name, (phase, text)) in enumerate(workers.items(), 1)
    ]
    document = read_daemon_status({"daemon": "robot1", "workers": reports})
    monkeypatch.setattr("bridge.doctor.daemon_state.ask_daemon", lambda _config: document)


def test_daemon_reports_a_worker_that_does_not_respond(
    tmp_path: Path,
    network: HubNetwork,
    closing: list[FakeWorker],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    daemon_reports(monkeypatch, ros1=("running", ""), modules=("starting", "importing numpy"))
    closing.append(FakeWorker(network, "ros1", status=status("ros1", pid=0)))
    midspan = Midspan(config_file(tmp_path, network, **NO_ROS), capsys)
    assert midspan("doctor", "--only", "daemon").out.splitlines()[:3] == [
        "OK    daemon: robot1/ros1 is running",
        "WARN  daemon: robot1/modules is starting: importing numpy (4.0 s)",
        "      cure: wait",
    ]
    nobody = config_file(tmp_path, network, **NO_ROS, hub={"listen": f"tcp/127.0.0.1:{free_port()}"})
    report = Midspan(nobody, capsys)("doctor", "--only", "daemon").out
    assert "no zenoh router answers" in report
    assert "robot1/modules is starting" in report
    assert "midspan run" not in report


def test_a_running_worker_that_cannot_join_the_hub_is_shown(
    tmp_path: Path,
    network: HubNetwork,
    closing: list[FakeWorker],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    daemon_reports(monkeypatch, router=("running", ""), modules=("running", "waiting: no hub"))
    closing.append(FakeWorker(network, "router", status=status("router", pid=1)))
    midspan = Midspan(config_file(tmp_path, network, **NO_ROS), capsys)
    assert "FAIL  daemon: robot1/modules is running: no answer on the hub; waiting: no hub" in (
        midspan("doctor", "--only", "daemon").out
    )
    shown = midspan("status").out
    assert shown.count("modules") == 1
    assert "no answer on the hub; waiting: no hub" in shown


def test_a_broken_configuration_is_reported_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "midspan.yaml"
    file.write_text(f"hub:\n  listen: tcp/127.0.0.1:{free_port()}\n  domian: 3\n")
    done = Midspan(file, capsys)("doctor", "--only", "config")
    assert done.code == 1
    assert f"{file}:3:3" in done.out
    assert "did you mean 'domain'" in done.out


def test_an_unknown_check_is_refused_and_all_are_listed(midspan: Midspan) -> None:
    done = midspan("doctor", "--only", "astrology")
    assert (done.code, "no check astrology" in done.err) == (1, True)
    assert [line.split()[0] for line in midspan("doctor", "--list").out.splitlines()] == [c.id for c in CHECKS]
