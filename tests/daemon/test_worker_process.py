"""``midspan worker``: with pipes, without a daemon, and as a separate service that outlives daemons."""

from __future__ import annotations

import itertools
import json
import os
import platform
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import psutil
import pytest

from bridge.config.model import Config
from bridge.daemon import protocol, worker_main
from bridge.daemon.control import Commands
from bridge.daemon.protocol import NewConfig, Report, Stop, encode_command
from bridge.daemon.workers import supervised_command
from bridge.worker import Health, Worker
from tests.peers.daemon.daemon import Daemon, alive, exited
from tests.support.wait import until

pytestmark = pytest.mark.thorough


class Supervised:
    """``midspan worker ros1 --supervised``, with the test as its daemon."""

    def __init__(self, daemon: Daemon) -> None:
        self.popen = subprocess.Popen(
            supervised_command("ros1"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=daemon.env,
        )

    def send(self, line: bytes) -> None:
        assert self.popen.stdin is not None
        self.popen.stdin.write(line)
        self.popen.stdin.flush()

    def read(self) -> dict[str, Any]:
        """Return the worker's next report that is not about its current step."""
        while "busy" in (report := self.read_any()):
            pass
        return report

    def read_any(self) -> dict[str, Any]:
        assert self.popen.stdout is not None
        line = self.popen.stdout.readline()
        assert line, "the worker exited"
        report: dict[str, Any] = json.loads(line)
        return report

    def end_of_input(self) -> None:
        assert self.popen.stdin is not None
        self.popen.stdin.close()

    def close(self) -> None:
        self.popen.kill()
        self.popen.wait()
        for pipe in (self.popen.stdin, self.popen.stdout):
            assert pipe is not None
            pipe.close()


@pytest.fixture
def supervised(daemon: Daemon) -> Iterator[Supervised]:
    worker = Supervised(daemon)
    yield worker
    worker.close()


def config(daemon: Daemon, **changes: Any) -> bytes:
    return encode_command(NewConfig(Config(name="test", state=daemon.folder, **changes)))


def test_a_worker_sends_heartbeats_until_the_stop_command(daemon: Daemon, supervised: Supervised) -> None:
    daemon.order("ros1", "print")
    supervised.send(config(daemon))
    assert supervised.read() == {"beat": 1, "state": "running", "text": "ros1 fine"}
    assert supervised.read()["beat"] == 2
    supervised.send(b'{"stop": true}\n')
    assert supervised.popen.wait(40) == 0
    assert len(daemon.events("ros1", "stop")) == 1


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has this setting")
@pytest.mark.parametrize("alone", [False, True])
def test_threads_share_two_heaps(daemon: Daemon, supervised: Supervised, alone: bool) -> None:
    daemon.order("ros1", "heaps")
    if alone:
        daemon.midspan("worker", "ros1", "--config", str(daemon.file))
    else:
        supervised.send(config(daemon))
    until(lambda: bool(daemon.events("ros1", "heaps")), "the worker reports the number of heaps")
    assert daemon.events("ros1", "heaps") == [["heaps", "2"]]


def test_the_garbage_collector_runs_again_after_the_imports(daemon: Daemon, supervised: Supervised) -> None:
    daemon.order("ros1", "collector")
    supervised.send(config(daemon))
    until(lambda: bool(daemon.events("ros1", "collector")), "the worker reports the collector's state")
    assert daemon.events("ros1", "collector") == [["collector", "True"]]


def test_a_worker_reports_its_steps_from_the_start(daemon: Daemon, supervised: Supervised) -> None:
    assert supervised.read_any() == {"busy": "loading Python's libraries", "used": 0.0, "read": 0}
    daemon.order("ros1", "compute-at-start")
    supervised.send(config(daemon))
    until(lambda: supervised.read_any()["busy"] == "computing on purpose", "the report names the current step")
    first = supervised.read_any()["used"]
    until(lambda: supervised.read_any()["used"] > first, "the processor time of the thread that works grows")
    daemon.order("ros1")
    assert supervised.read()["beat"] == 1


def test_the_heartbeat_thread_ends_before_python_does() -> None:
    """Python 3.11 sometimes crashes on exit if a daemon thread runs at that time (seen once: signal 11)."""
    code = """
import os, threading
from bridge.daemon.heartbeat import start_heartbeat
heartbeat = start_heartbeat()
assert "heartbeat" in {thread.name for thread in threading.enumerate()}
heartbeat.close()
os.write(2, " ".join(sorted(thread.name for thread in threading.enumerate())).encode())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr == "MainThread"


def test_the_end_of_input_stops_the_worker(daemon: Daemon, supervised: Supervised) -> None:
    supervised.send(config(daemon))
    supervised.read()
    supervised.end_of_input()
    assert supervised.popen.wait(40) == 0
    assert len(daemon.events("ros1", "stop")) == 1


def test_a_worker_without_a_configuration_exits_at_the_end_of_input(supervised: Supervised) -> None:
    supervised.end_of_input()
    assert supervised.popen.wait(40) == 0


def test_end_of_input_stops_even_a_hanging_worker(daemon: Daemon, supervised: Supervised) -> None:
    supervised.send(config(daemon))
    supervised.read()
    daemon.order("ros1", "hang")
    until(lambda: daemon.events("ros1", "hang"), "the worker hangs")
    supervised.end_of_input()
    assert supervised.popen.wait(40) == 1


def test_a_worker_reports_whether_a_reload_needs_a_restart(daemon: Daemon, supervised: Supervised) -> None:
    supervised.send(config(daemon))
    supervised.read()
    supervised.send(config(daemon, routing={"default": "deny"}))
    until(lambda: "reloaded" in supervised.read(), "the worker reports that the configuration is applied")
    assert daemon.events("ros1", "reload") == [["reload", "deny"]]
    daemon.order("ros1", "refuse-reload")
    supervised.send(config(daemon))
    until(lambda: "restart" in supervised.read(), "the worker reports that it needs a restart")


@pytest.mark.parametrize(
    "line", [b"rubbish\n", b"[]\n", b'{"config": {"nonsense": 1}}\n', b"\xff\xfe\n", b"{" * 5000 + b"\n"]
)
def test_rubbish_from_the_daemon_is_ignored(daemon: Daemon, supervised: Supervised, line: bytes) -> None:
    supervised.send(config(daemon))
    supervised.read()
    supervised.send(line)
    assert supervised.read()["beat"] == 2
    supervised.send(b'{"stop": true}\n')
    assert supervised.popen.wait(40) == 0


@pytest.mark.parametrize(("order", "code"), [("never", 78), ("crash-at-start", 1), ("crash", 1)])
def test_the_exit_code_shows_why_a_worker_ended(daemon: Daemon, supervised: Supervised, order: str, code: int) -> None:
    daemon.order("ros1", order)
    supervised.send(config(daemon))
    assert supervised.popen.wait(40) == code
    assert supervised.popen.stdout is not None
    reports = supervised.popen.stdout.read()
    assert (b'{"failed":"unknown robot"}' in reports) == (order == "never")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_worker_without_a_daemon_runs_until_a_signal(daemon: Daemon, number: signal.Signals) -> None:
    process = daemon.midspan("worker", "ros1", "--config", str(daemon.file))
    daemon.wait_started("ros1")
    process.signal(number)
    assert process.popen.wait(40) == 0
    assert len(daemon.events("ros1", "stop")) == 1


def test_a_worker_without_a_daemon_reloads_and_restarts_if_needed(daemon: Daemon) -> None:
    process = daemon.midspan("worker", "ros1", "--config", str(daemon.file))
    pid = daemon.wait_started("ros1")
    daemon.configure("routing: {default: allowed}\n")
    process.signal(signal.SIGHUP)
    daemon.expect_output(process, "'allowed' is not one of allow, deny; did you mean 'allow'?")
    daemon.configure("routing: {default: deny}\n")
    process.signal(signal.SIGHUP)
    until(lambda: daemon.events("ros1", "reload deny"), "reloaded")
    daemon.order("ros1", "refuse-reload")
    daemon.configure("ros1: {poll: 2}\n")
    process.signal(signal.SIGHUP)
    assert daemon.wait_started("ros1", 2) == pid
    assert len(daemon.events("ros1", "stop")) == 1


def test_a_second_process_of_a_worker_is_refused(daemon: Daemon) -> None:
    daemon.midspan("worker", "ros1", "--config", str(daemon.file))
    pid = daemon.wait_started("ros1")
    second = daemon.midspan("worker", "ros1", "--config", str(daemon.file))
    assert second.popen.wait(40) == 1
    assert f"already runs as process {pid}" in second.output()


def test_a_router_service_outlives_daemons_and_their_stop(daemon: Daemon) -> None:
    service = daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    router = daemon.wait_started("router")
    for count in (1, 2):
        process = daemon.start("--adopt", "router")
        daemon.wait_ready(process)
        daemon.wait_started("ros1", count)
        assert f"connected to process {router}, started by a service" in process.output()
        process.signal(signal.SIGTERM)
        assert process.popen.wait(40) == 0
    assert alive(router)
    assert daemon.pids("router") == [router]
    service.signal(signal.SIGTERM)
    assert service.popen.wait(40) == 0
    assert not (daemon.folder / "state" / "test.router.sock").exists()


def test_a_service_hands_over_to_its_new_process(daemon: Daemon) -> None:
    """For systemd the main process changes while the service continues."""
    path = daemon.folder / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(path))
        systemd.settimeout(40)
        arguments = ("worker", "router", "--control", "--config", str(daemon.file))
        service = daemon.midspan(*arguments, env={"NOTIFY_SOCKET": str(path), "WATCHDOG_PID": "1"})
        daemon.wait_started("router")
        service.signal(signal.SIGUSR2)
        messages: list[str] = []
        while not messages or not messages[-1].startswith("MAINPID="):
            messages.append(systemd.recv(4096).decode())
        new = int(messages[-1].removeprefix("MAINPID="))
        assert psutil.Process(new).ppid() != service.pid, "systemd waits only for its own children to exit"
        assert "STOPPING=1" not in messages
        assert service.popen.wait(20) == 0
        while "READY=1" not in messages:
            messages.append(systemd.recv(4096).decode())
        assert alive(new)
        os.kill(new, signal.SIGTERM)
        while "STOPPING=1" not in messages:
            messages.append(systemd.recv(4096).decode())
        until(exited(new), "the new process exits like the old one")


def test_a_service_continues_if_its_new_process_cannot_start(daemon: Daemon) -> None:
    service = daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    daemon.wait_started("router")
    good = daemon.file.read_text()
    daemon.file.write_text("hub: 5\n")
    service.signal(signal.SIGUSR2)
    daemon.expect_output(service, "hub: ")
    daemon.file.write_text(good)
    assert service.popen.poll() is None
    assert service.stop(40.0) == 0


def test_the_daemon_waits_for_a_service_that_starts_later(daemon: Daemon) -> None:
    process = daemon.start("--adopt", "router")
    daemon.expect_output(process, "router: waiting for its service")
    daemon.wait_started("ros1")
    service = daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    daemon.wait_ready(process)
    service.signal(signal.SIGKILL)
    daemon.expect_output(process, "router ended after")
    daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    until(lambda: process.output().count("router: running") == 2, "the router is adopted again")
    assert len(daemon.pids("router")) == 2


def test_a_service_applies_the_daemons_configuration(daemon: Daemon) -> None:
    daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    daemon.wait_started("router")
    process = daemon.start()
    daemon.wait_ready(process)
    daemon.configure("hub: {domain: 3}\n")
    process.signal(signal.SIGHUP)
    until(lambda: daemon.events("router", "reload"), "reloaded")
    assert len(daemon.pids("router")) == 1


def test_service_restarts_itself_for_a_configuration_that_needs_it(daemon: Daemon) -> None:
    daemon.order("router", "refuse-reload")
    daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    router = daemon.wait_started("router")
    process = daemon.start("--adopt", "router")
    daemon.wait_ready(process)
    daemon.configure("hub: {domain: 3}\n")
    process.signal(signal.SIGHUP)
    assert daemon.wait_started("router", 2) == router
    until(lambda: process.output().count("router: running") == 2, "the router is adopted again")
    assert "restarting in" not in process.output()


def test_daemon_with_another_file_does_not_change_a_service(daemon: Daemon) -> None:
    daemon.order("router", "refuse-reload")
    daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    daemon.wait_started("router")
    other = daemon.folder / "other.yaml"
    other.write_text(daemon.file.read_text() + "hub: {domain: 9}\n")
    process = daemon.midspan("run", "--adopt", "router", "--config", str(other))
    daemon.wait_ready(process)
    assert len(daemon.pids("router")) == 1
    assert daemon.events("router", "reload") == []


def test_a_disabled_service_exits_without_failing(daemon: Daemon) -> None:
    daemon.configure("hub: {router: false}\n")
    process = daemon.midspan("worker", "router", "--control", "--config", str(daemon.file))
    assert process.popen.wait(40) == 0
    assert "router is disabled by the configuration" in process.output()


def test_the_daemon_exits_with_78_if_its_configuration_is_broken(daemon: Daemon) -> None:
    daemon.configure("hubb: 1\n")
    process = daemon.start()
    assert process.popen.wait(40) == 78
    assert process.output() == f"{daemon.file}:3:1: hubb: unknown key 'hubb'; did you mean 'hub'?\n"


def test_service_of_a_side_is_not_killed_by_a_daemon_of_the_same_name(daemon: Daemon) -> None:
    daemon.midspan("worker", "ros1", "--config", str(daemon.file))
    pid = daemon.wait_started("ros1")
    process = daemon.start()
    daemon.expect_output(process, f"ros1: run by process {pid}, not by this daemon")
    daemon.wait_started("ros2")
    assert alive(pid)
    assert daemon.pids("ros1") == [pid]


def test_the_router_stores_its_log_for_the_next_daemon(daemon: Daemon) -> None:
    first = daemon.start()
    daemon.wait_ready(first)
    router = daemon.wait_started("router")
    first.popen.kill()
    first.popen.wait()
    daemon.order("router", "unanswered")
    until(lambda: daemon.events("router", "unanswered"), "the router logs a line while no daemon runs")
    second = daemon.start()
    daemon.expect_output(second, "router: the worker's loop does not respond: the engine does not respond")
    daemon.order("router")
    daemon.wait_ready(second)
    assert daemon.pids("router")[0] == router


def test_a_crash_of_the_router_while_starting_is_logged(daemon: Daemon) -> None:
    daemon.env["MIDSPAN_WORKERS"] = "router=tests.peers.daemon.fakes:Nothing"
    daemon.configure("ros1: {enabled: false}\nros2: {enabled: false}\n")
    process = daemon.start()
    daemon.expect_output(process, "AttributeError: module 'tests.peers.daemon.fakes' has no attribute 'Nothing'")
    daemon.expect_output(process, "router ended with exit code 1")


def test_an_unusable_state_folder_is_reported_with_the_cure(daemon: Daemon) -> None:
    daemon.file.write_text("state: /proc/nothing\n")
    process = daemon.start()
    assert process.popen.wait(40) == 1
    assert "state folder /proc/nothing: " in process.output()
    assert "set 'state' in the configuration" in process.output()


def test_a_state_folder_too_long_for_a_socket_is_refused_with_the_cure(daemon: Daemon) -> None:
    daemon.file.write_text(f"name: test\nstate: {'x' * 90}\n")
    process = daemon.start()
    assert process.popen.wait(40) == 1
    assert "too long for a socket's name; set 'state' in the configuration to a shorter folder" in process.output()


class Reporting(Worker):
    """A worker that reports the given texts, one for each heartbeat."""

    def __init__(self, texts: list[str]) -> None:
        self._texts = texts

    def start(self, config: Config) -> None:
        """Do nothing."""

    def reload(self, config: Config) -> bool:  # noqa: ARG002
        return True

    def health(self) -> Health:
        return Health("running", self._texts.pop(0))

    def stop(self) -> None:
        """Do nothing."""


def test_heartbeats_are_rarer_if_the_text_does_not_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol, "QUIET_INTERVAL", 8.0)
    monkeypatch.setattr(worker_main, "until_tick", lambda period: period)
    commands, at = Commands(), list[float]()
    texts = ["one", "two", "two", "three"]

    def report(_: Report) -> None:
        at.append(time.monotonic())
        if not texts:
            commands.put(Stop())

    worker_main.WorkerLoop(Reporting(texts), commands, report).run(Config())
    first, second, third = (later - earlier for earlier, later in itertools.pairwise(at))
    assert max(first, second) < 8.0, "after a new text, the next report follows soon"
    assert third > 7.5, (
        "after a repeated text, the next report waits for the quiet interval, which begins before the report is written"
    )


def test_a_stop_does_not_wait_while_each_heartbeat_takes_longer_than_its_interval(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As on a busy machine: the next heartbeat is always due already."""
    for interval in ("BEAT_INTERVAL", "QUIET_INTERVAL"):
        monkeypatch.setattr(protocol, interval, 0.0)
    commands, texts, reports = Commands(), ["one", "two"], list[Report]()
    commands.put(Stop())
    end = worker_main.WorkerLoop(Reporting(texts), commands, reports.append).run(Config())
    assert end is worker_main.RunEnd.STOPPED
    assert texts == ["two"], "the stop followed the first heartbeat"
