"""Failures of the machine: broken configuration files, a full or read-only disk, no free file descriptors.

The routes keep carrying messages during each of them.
"""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.peer import Peer
from tests.support.process import Process
from tests.support.wait import until

pytestmark = pytest.mark.thorough

STRING = "std_msgs/String"
BROKEN = 100
NO_DESCRIPTORS = "file descriptors are in use; without one, new topics and programs are refused; raise the limit"

needs_root = pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="mounting needs root on Linux")


class Flow:
    """One topic in each direction between real rospy and rclpy programs, to check that messages still cross."""

    def __init__(self, deployment: Deployment) -> None:
        self._ros1, self._ros2 = deployment.ros1(), deployment.ros2()
        self._topics = [
            self._connect(self._ros1, self._ros2, "/to_ros2"),
            self._connect(self._ros2, self._ros1, "/to_ros1"),
        ]
        self._sent = 0
        self.begin()

    def begin(self) -> None:
        """Wait until the routes of both topics carry messages."""
        first = self._sent
        counts = [len(receiver.wait(inbox, 0, 0)) for _, _, receiver, inbox in self._topics]

        def cross() -> bool:
            self.send()
            return all(
                any(int(m["data"]) > first for m in receiver.wait(inbox, count + 1, 0.2, since=count))
                for (_, _, receiver, inbox), count in zip(self._topics, counts, strict=True)
            )

        until(cross, "messages cross in both directions", 60)

    def _connect(self, sender: Peer, receiver: Peer, topic: str) -> tuple[Peer, int, Peer, int]:
        inbox = receiver.subscribe(topic, STRING)
        return sender, sender.advertise(topic, STRING), receiver, inbox

    def send(self) -> str:
        """Publish one message on each topic; return its text."""
        self._sent += 1
        for sender, out, _, _ in self._topics:
            sender.publish(out, {"data": str(self._sent)})
        return str(self._sent)

    def check(self) -> None:
        """Check that ten messages cross in each direction without a loss."""
        sent = [self.send() for _ in range(10)]
        for _, _, receiver, inbox in self._topics:
            received: list[str] = []

            def complete(receiver: Peer = receiver, inbox: int = inbox, received: list[str] = received) -> bool:
                received[:] = [m["data"] for m in receiver.wait(inbox, 0, 0)]
                return set(received) >= set(sent)

            try:
                until(complete, "ten messages cross", 20)
            except AssertionError as err:
                msg = f"sent {sent}, received {received[-20:]}"
                raise AssertionError(msg) from err


def pids(deployment: Deployment) -> set[int]:
    """Return the process ids of the daemon and its workers."""
    assert deployment.daemon is not None

    def complete() -> list[dict[str, Any]] | None:  # a busy worker may not respond in time
        status = deployment.status()
        return status if {document.get("side") for document in status} >= {"router", "ros1", "ros2"} else None

    return {deployment.daemon.pid, *(int(document["pid"]) for document in until(complete, "all workers respond"))}


def broken(number: int, good: str) -> str:
    """Return a broken configuration: truncated, binary, or with a wrong type, an unknown key or an invalid rule."""
    files = [
        f"{good}rooting: {{rule_{number}: 1}}\n",
        f"{good}routing: {{rules: [{{topic: /a, rate: -{number}}}]}}\n",
        f"{good}routing:\n  rules:\n    - {{topic: no_slash_{number}}}\n",
        f"{good}routing: {{rules: [{{regex: '({number}'}}]}}\n",
        f"{good}log: {{level: loud{number}}}\n",
        f"{good}log: [{'[' * (number + 60)}\n",
        f"{good}types: {{folders: [/nowhere/{number}]}}\n",
        f"{good}name: other{number}\n",
        f"{good}log: {{level: info}}\n" * 2,
        f"{good[: len(good) // 2]}\x00\x01{number}",
        "- " * number + "x\n",
        f"{good}log: !!python/object/apply:os.abort [{number}]\n",
    ]
    return files[number % len(files)]


def test_a_hundred_broken_configurations_are_rejected_without_effect(running: Deployment) -> None:
    flow = Flow(running)
    processes, good = pids(running), running.file.read_text()
    assert running.daemon is not None
    daemon = running.daemon
    for number in range(1, BROKEN + 1):
        running.file.write_text(broken(number, good))
        running.hang_up()
        until(lambda n=number: daemon.output().count("is rejected") == n, f"refusal {number} in the log", 20)
        if number % 20 == 0:
            flow.check()
    refusals = daemon.output().split("is rejected, the running one is kept:")[1:]
    assert len(refusals) == BROKEN
    for refusal in refusals:
        assert f"{running.file}:" in refusal.splitlines()[1], refusal[:300]
    flow.check()
    running.file.write_text(good + "log: {level: info}\n" + yaml.safe_dump({"routing": {"rules": [{"topic": "/x"}]}}))
    running.hang_up()
    until(lambda: "configuration reloaded" in daemon.output(), "the daemon loads a valid file", 20)
    flow.check()
    assert pids(running) == processes


@contextmanager
def small_disk() -> Iterator[Path]:
    """Mount a 3 MB file system, in a folder whose path is short enough for the daemon's socket."""
    with tempfile.TemporaryDirectory(prefix="midspan-") as name:
        folder = Path(name)
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", name], check=True)
        try:
            yield folder
        finally:
            while os.path.ismount(folder):  # also mounts that a test has added on top
                subprocess.run(["umount", "-l", name], check=True)


def fill(disk: Path) -> Path:
    """Fill the file system to the last byte, and return the file that fills it."""
    litter = disk / "litter"
    with litter.open("wb", buffering=0) as file:
        try:
            while file.write(b"x" * 512):
                pass
        except OSError:
            pass
    return litter


def kill_each_worker(deployment: Deployment, flow: Flow) -> None:
    """Kill the worker of each side, and wait until it and its routes are back."""
    for side in ("ros1", "ros2"):
        pid = int(deployment.answer(side)["pid"])
        os.kill(pid, 9)

        def restarted(side: str = side, pid: int = pid) -> bool:
            worker = deployment.worker(side)
            return worker.get("pid", pid) != pid and worker["state"] == "running"

        until(restarted, f"the worker {side} has restarted", 40, every=0.2)
    flow.begin()


@needs_root
def test_the_daemon_starts_and_bridges_on_a_full_disk(deployment: Deployment) -> None:
    """The state folder and the log are on a full disk."""
    with small_disk() as disk:
        log = disk / "log"
        log.touch()
        litter = fill(disk)
        deployment.master.start()
        deployment.configure(state=str(disk / "state"))
        command = [*MIDSPAN, "run", "--config", str(deployment.file)]
        logged = ["/bin/sh", "-c", 'log=$1; shift; exec "$@" 2>>"$log"', "sh", str(log), *command]
        deployment.daemon = Process(logged, os.environ)
        until(deployment.joined, "both workers have joined", 60, every=0.2)
        flow = Flow(deployment)
        status = deployment.command("status").stdout
        assert f": the state folder {disk / 'state'} has 0 kB left; free space on that disk" in status
        flow.check()
        assert log.read_text() == ""
        litter.unlink()
        deployment.hang_up()
        until(lambda: "configuration reloaded" in log.read_text(), "the log continues", 20)
        flow.check()
        assert deployment.stop_daemon() == 0


@needs_root
def test_bridging_continues_while_the_disk_is_full_or_read_only(deployment: Deployment) -> None:
    with small_disk() as disk:
        deployment.start(state=str(disk / "state"))
        assert deployment.daemon is not None
        daemon = deployment.daemon
        flow = Flow(deployment)
        litter = fill(disk)
        until(lambda: "has 0 kB left; free space on that disk" in daemon.output(), "the log reports the full disk", 20)
        kill_each_worker(deployment, flow)
        flow.check()
        litter.unlink()
        # While files are open for writing, the file system itself cannot become read-only, as a failing disk's does;
        # a bind mount of it can.
        subprocess.run(["mount", "--bind", str(disk), str(disk)], check=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", str(disk)], check=True)
        until(
            lambda: "Read-only file system; make it writable" in daemon.output(),
            "the log reports the read-only disk",
            20,
        )
        warning = f": the state folder {disk / 'state'}: Read-only file system; make it writable, or set 'state'"
        assert warning in deployment.command("status").stdout
        doctor = deployment.command("doctor", "--only", "state-folder")
        assert doctor.returncode == 1
        assert "Read-only file system" in doctor.stdout
        kill_each_worker(deployment, flow)
        flow.check()
        deployment.hang_up()
        until(lambda: "configuration reloaded" in daemon.output(), "the daemon loads a valid file", 20)
        subprocess.run(["mount", "-o", "remount,bind,rw", str(disk)], check=True)
        until(lambda: "the state folder is writable again" in daemon.output(), "the log reports the recovery", 20)
        flow.check()


def test_an_unwritable_state_folder_at_the_start_is_refused_with_the_cure(
    deployment: Deployment, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    deployment.configure(state=str(file / "state"))
    done = deployment.command("run")
    assert done.returncode == 1
    assert f"state folder {file / 'state'}: Not a directory; set 'state' in the configuration to" in done.stderr


def test_a_worker_without_descriptors_recovers(running: Deployment) -> None:
    assert running.daemon is not None
    daemon = running.daemon
    flow = Flow(running)
    processes = pids(running)
    ros1, ros2 = running.ros1(), running.ros2()
    for side, program, receiver in (("ros1", ros1, ros2), ("ros2", ros2, ros1)):
        pid = int(running.answer(side)["pid"])
        used = len(list(Path(f"/proc/{pid}/fd").iterdir()))
        limits = resource.prlimit(pid, resource.RLIMIT_NOFILE)
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (used + 4, limits[1]))
        topics = [f"/{side}_{number}" for number in range(12)]
        inboxes = [receiver.subscribe(topic, STRING) for topic in topics]
        out = [program.advertise(topic, STRING) for topic in topics]
        until(lambda s=side: NO_DESCRIPTORS in str(running.worker(s).get("warnings")), "the warning is reported", 20)
        flow.check()
        printed: list[str] = []

        def named(printed: list[str] = printed) -> bool:  # a busy worker may not respond to the command in time
            printed[:] = [running.command("status").stdout]
            return NO_DESCRIPTORS in printed[0]

        until(named, "midspan status has the warning")
        until(lambda s=side: re.search(f"{s}: .*{NO_DESCRIPTORS}", daemon.output()), "the log has the warning", 20)
        assert "Errno" not in printed[0]
        if side == "ros1":  # ROS 1 needs one socket per publisher
            refused = "this process has no file descriptor left"
            until(lambda r=refused: r in running.command("status").stdout, "status names the reason", 20)

        def diagnosed() -> bool:
            doctor = running.command("doctor", "--only", "descriptors")
            return doctor.returncode == 1 and "LimitNOFILE=" in doctor.stdout

        until(diagnosed, "midspan doctor has the warning")
        resource.prlimit(pid, resource.RLIMIT_NOFILE, limits)

        def all_cross(
            program: Peer = program, receiver: Peer = receiver, out: list = out, inboxes: list = inboxes
        ) -> bool:
            for endpoint in out:
                program.publish(endpoint, {"data": "late"})
            return all(receiver.wait(inbox, 1, 0.1) for inbox in inboxes)

        until(all_cross, f"the refused topics of {side} cross", 40)
        flow.check()
    assert pids(running) == processes


def test_a_router_without_descriptors_recovers(running: Deployment) -> None:
    """Programs cannot join, but the joined ones continue; the log has the reason, and the router recovers."""
    assert running.daemon is not None
    daemon = running.daemon
    flow = Flow(running)
    pid = int(running.answer("router")["pid"])
    limits = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    used = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (used, limits[1]))
    until(lambda: re.search(f"router: .*{NO_DESCRIPTORS}", daemon.output()), "the log has the warning", 20)
    assert running.command("topic", "list").returncode == 1
    flow.check()
    resource.prlimit(pid, resource.RLIMIT_NOFILE, limits)
    until(lambda: running.command("topic", "list").returncode == 0, "programs can join again", 30)
    flow.check()
    assert running.answer("router")["pid"] == pid
