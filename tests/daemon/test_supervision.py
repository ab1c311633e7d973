"""The daemon and its workers as real processes: start, monitor, restart, adopt, stop."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from bridge.daemon.supervisor import AGAIN_SECONDS, STOP_SECONDS
from tests.peers.daemon.daemon import Daemon, alive, exited
from tests.support.wait import until

WORKERS = ("router", "ros1", "ros2")
ALL = (*WORKERS, "sim")
SIM = "sim: {enabled: true}\n"
HEARTBEAT = 2.0
"""The limit for heartbeats in tests, in seconds; a daemon's own is 5 s."""


def test_starts_all_workers_and_stops_them_in_order(daemon: Daemon) -> None:
    daemon.configure(SIM)
    process = daemon.start()
    daemon.wait_ready(process)
    pids = [daemon.wait_started(worker) for worker in ALL]
    assert all(alive(pid) for pid in pids)
    process.signal(signal.SIGTERM)
    assert process.popen.wait(40) == 0
    assert not any(alive(pid) for pid in pids)
    steps = re.findall(r"stopping \w+|\w+ ended with exit code 0", process.output())
    assert steps[:4] == ["stopping sim", "sim ended with exit code 0", "stopping ros1", "stopping ros2"]
    assert set(steps[4:6]) == {"ros1 ended with exit code 0", "ros2 ended with exit code 0"}
    assert steps[6:] == ["stopping router", "router ended with exit code 0"]
    assert [len(daemon.events(worker, "stop")) for worker in ALL] == [1, 1, 1, 1]


@pytest.mark.thorough
def test_crashed_worker_is_restarted_with_growing_pauses(daemon: Daemon) -> None:
    daemon.order("ros1", "crash-at-start")
    process = daemon.start()
    daemon.wait_started("ros2")
    daemon.wait_started("ros1", 4, 30)
    output = process.output()
    pauses = [output.index(f"restarting in {pause} s") for pause in ("0.2", "0.4", "0.8")]
    assert pauses == sorted(pauses)
    assert "ValueError: broken on purpose" in output
    assert len(daemon.pids("ros2")) == 1
    daemon.order("ros1")
    until(lambda: "ros1: running" in process.output(), "ros1 is running again")


def test_only_the_killed_worker_is_restarted(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    os.kill(daemon.wait_started("ros2"), signal.SIGKILL)
    assert alive(daemon.wait_started("ros2", 2))
    daemon.expect_output(process, "ros2 killed by SIGKILL")
    assert len(daemon.pids("ros1")) == len(daemon.pids("router")) == 1


def test_the_children_of_a_dead_worker_are_killed(daemon: Daemon) -> None:
    daemon.order("ros1", "child")
    process = daemon.start()
    daemon.wait_ready(process)
    child = int(daemon.events("ros1", "child")[0][1])
    assert alive(child)
    os.kill(daemon.wait_started("ros1"), signal.SIGKILL)
    until(exited(child), "the worker's own child is killed")


@pytest.mark.parametrize("worker", ["ros1", "router"])
def test_stopped_process_is_replaced(daemon: Daemon, worker: str) -> None:
    process = daemon.quick(2, heartbeat=HEARTBEAT)
    daemon.wait_ready(process)
    first = daemon.wait_started(worker)
    os.kill(first, signal.SIGSTOP)
    assert alive(daemon.wait_started(worker, 2))
    assert not alive(first)
    daemon.expect_output(process, f"{worker} sent no heartbeat for {HEARTBEAT:g} s")


@pytest.mark.parametrize("order", ["hang", "unanswered"])
def test_worker_whose_loop_hangs_is_replaced(daemon: Daemon, order: str) -> None:
    process = daemon.quick(2, heartbeat=HEARTBEAT)
    daemon.wait_ready(process)
    daemon.order("ros1", order)
    until(lambda: "ros1 sent no heartbeat" in process.output(), "the daemon notices the missing heartbeats")
    if order == "hang":
        daemon.expect_output(process, "fakes.py")  # the file in which the worker hangs; its last output is logged later
    daemon.order("ros1")
    # the second process may also have followed the order, and be replaced
    until(lambda: any(alive(pid) for pid in daemon.pids("ros1")[1:]), "a new process of the worker runs")


def test_worker_that_can_never_work_is_not_restarted_at_once(daemon: Daemon) -> None:
    daemon.order("ros1", "never")
    process = daemon.quick(2, retry=600.0)  # a daemon's own limit is 30 s, in which a busy machine starts few processes
    daemon.wait_ready(process)
    assert "ros1 cannot work: unknown robot" in process.output()
    daemon.order("ros2", "crash")
    daemon.wait_started("ros2", 4)
    assert len(daemon.pids("ros1")) == 1


@pytest.mark.alone
def test_hanging_worker_does_not_delay_the_stop_beyond_five_seconds(daemon: Daemon) -> None:
    daemon.configure(SIM)
    for worker in ALL:
        daemon.order(worker, "hang-at-stop")
    process = daemon.start()
    daemon.wait_ready(process)
    pids = [daemon.wait_started(worker) for worker in ALL]
    process.signal(signal.SIGTERM)
    assert process.popen.wait(40) == 0
    stopped = re.search(r"stopped after ([\d.]+) s", process.output())
    assert stopped  # measured by the daemon's clock, because the exit of its interpreter depends on the machine
    assert float(stopped[1]) <= STOP_SECONDS
    assert not any(alive(pid) for pid in pids)


def test_second_signal_stops_at_once(daemon: Daemon) -> None:
    daemon.order("ros1", "hang-at-stop")
    process = daemon.start()
    daemon.wait_ready(process)
    process.signal(signal.SIGINT)
    daemon.expect_output(process, "stopping ros1")
    again = AGAIN_SECONDS + 0.1
    until(lambda: "ros1 killed" in process.output() or process.signal(signal.SIGINT), "ros1 is killed", every=again)
    assert process.popen.wait(40) == 0
    assert "did not stop in time" not in process.output()
    assert not alive(daemon.wait_started("ros1"))


def test_signals_at_once_are_one_request_to_stop(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    # `timeout` signals the daemon and its group; a stopped daemon receives both at once, however busy the machine is
    for number in (signal.SIGSTOP, signal.SIGTERM, signal.SIGINT, signal.SIGCONT):
        process.signal(number)
    assert process.popen.wait(40) == 0
    assert "killed by SIGKILL" not in process.output()
    assert [len(daemon.events(worker, "stop")) for worker in WORKERS] == [1, 1, 1]


def test_workers_exit_with_a_killed_daemon_and_the_next_one_adopts_the_router(daemon: Daemon) -> None:
    first = daemon.start()
    daemon.wait_ready(first)
    router, ros1, ros2 = (daemon.wait_started(worker) for worker in WORKERS)
    first.popen.kill()
    until(exited(ros1), "ros1 exits with its daemon")
    until(exited(ros2), "ros2 exits with its daemon")
    assert alive(router)
    second = daemon.start()
    daemon.wait_ready(second)
    assert daemon.pids("router") == [router]
    assert len(daemon.pids("ros1")) == len(daemon.pids("ros2")) == 2
    second.signal(signal.SIGTERM)
    assert second.popen.wait(40) == 0
    until(exited(router), "a clean stop of the next daemon also stops the adopted router")


def test_adopted_router_that_dies_is_replaced(daemon: Daemon) -> None:
    first = daemon.start()
    daemon.wait_ready(first)
    router = daemon.wait_started("router")
    first.popen.kill()
    first.popen.wait()
    second = daemon.start()
    daemon.wait_ready(second)
    os.kill(router, signal.SIGKILL)
    assert alive(daemon.wait_started("router", 2))


@pytest.mark.thorough
def test_the_next_daemon_kills_a_hanging_worker_of_a_killed_daemon(daemon: Daemon) -> None:
    first = daemon.start()
    daemon.wait_ready(first)
    ros1 = daemon.wait_started("ros1")
    os.kill(ros1, signal.SIGSTOP)
    first.popen.kill()
    first.popen.wait()
    second = daemon.start()
    assert alive(daemon.wait_started("ros1", 2))
    assert not alive(ros1)
    daemon.expect_output(second, f"process {ros1} of an earlier daemon does not exit")


def test_a_suspended_daemon_does_not_restart_its_workers(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    process.signal(signal.SIGSTOP)
    time.sleep(6)  # longer than the heartbeat limit
    process.signal(signal.SIGCONT)
    daemon.configure("routing: {default: deny}\n")
    process.signal(signal.SIGHUP)
    until(lambda: daemon.events("ros1", "reload"), f"the daemon works again: {process.output()}")
    assert [len(daemon.pids(worker)) for worker in WORKERS] == [1, 1, 1]


def test_second_daemon_is_refused(daemon: Daemon) -> None:
    first = daemon.start()
    daemon.wait_ready(first)
    second = daemon.start()
    assert second.popen.wait(40) == 1
    assert f"a daemon named 'test' already runs (process {first.pid}" in second.output()
    assert "Traceback" not in second.output()
    assert [len(daemon.pids(worker)) for worker in WORKERS] == [1, 1, 1]


def test_log_lines_carry_the_workers_name(daemon: Daemon) -> None:
    daemon.order("ros1", "print")
    process = daemon.start()
    daemon.wait_ready(process)
    daemon.expect_output(process, "ros1: a line on standard output")
    daemon.expect_output(process, "ros1: a line on standard error")


def test_journal_gets_priorities(daemon: Daemon) -> None:
    daemon.order("ros1", "never", "print")
    process = daemon.start(env={"JOURNAL_STREAM": "1:2"})
    daemon.expect_output(process, "<6>midspan: ready")
    lines = process.output().splitlines()
    assert all(line.startswith("<") for line in lines), lines
    assert any(line.startswith("<3>midspan: ros1 cannot work") for line in lines)
    assert any(line.startswith("<3>ros1: cannot work here") for line in lines)


def test_only_the_owner_can_read_the_state_folder(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    assert (daemon.folder / "state").stat().st_mode & 0o777 == 0o700


@pytest.mark.thorough
def test_no_descriptors_or_processes_leak_over_restarts(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    watched = psutil.Process(process.pid)
    before, threads = watched.num_fds(), watched.num_threads()
    for count in range(2, 5):
        os.kill(daemon.wait_started("ros1", count - 1), signal.SIGKILL)
        daemon.wait_started("ros1", count)
        os.kill(daemon.wait_started("router", count - 1), signal.SIGKILL)
        daemon.wait_started("router", count)
    until(lambda: watched.num_fds() == before, "the number of descriptors is the same as before")
    assert len(watched.children()) == len(WORKERS)
    assert watched.num_threads() == threads


def test_open_files_limit_is_raised_for_the_workers(daemon: Daemon) -> None:
    process = daemon.start()
    daemon.wait_ready(process)
    soft, hard = psutil.Process(daemon.wait_started("ros1")).rlimit(psutil.RLIMIT_NOFILE)
    assert soft == min(hard, 1 << 16)


def test_a_suspended_reader_of_the_log_does_not_block_the_daemon(daemon: Daemon, tmp_path: Path) -> None:
    """As after Ctrl-S in the terminal, or with ``midspan run 2>&1 | less``."""
    pipe = tmp_path / "log"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    for filling in (b"-" * 4096, b"-"):
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(writer, filling)
    command = [sys.executable, "-m", "bridge.cli.main", "run", "--config", str(daemon.file)]
    process = subprocess.Popen(command, env=daemon.env, stderr=writer)
    os.set_blocking(writer, True)
    worker = daemon.wait_started("ros1")
    daemon.wait_started("ros2")
    os.kill(worker, signal.SIGKILL)
    daemon.wait_started("ros1", 2)
    process.send_signal(signal.SIGTERM)
    try:
        assert process.wait(40) == 0
    finally:
        os.close(reader)  # ends a blocked write
        os.close(writer)
        process.kill()
        process.wait()
