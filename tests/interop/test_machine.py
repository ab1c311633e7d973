"""What the machine refuses: broken files at reload, a full or read-only disk, no descriptors. Everything else flows."""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from tests.interop.deployment import MIDSPAN, Deployment
from tests.support.peer import Peer
from tests.support.process import Process
from tests.support.wait import until

pytestmark = pytest.mark.thorough

STRING = "std_msgs/String"
BROKEN = 100
NO_DESCRIPTORS = "file descriptors are in use; without one, new topics and programs are refused; raise the limit"

needs_root = pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="mounting needs root on Linux")


class Flow:
    """A topic each way between real rospy and rclpy programs, which must go on."""

    def __init__(self, deployment: Deployment) -> None:
        self._ros1, self._ros2 = deployment.ros1(), deployment.ros2()
        self._ways = [self._way(self._ros1, self._ros2, "/to_ros2"), self._way(self._ros2, self._ros1, "/to_ros1")]
        self._sent = 0
        self.begin()

    def begin(self) -> None:
        """Wait until both ways cross: the routes are made."""
        first = self._sent
        before = [len(hearer.wait(heard, 0, 0)) for _, _, hearer, heard in self._ways]

        def cross() -> bool:
            self.send()
            return all(
                any(int(m["data"]) > first for m in hearer.wait(heard, count + 1, 0.2, since=count))
                for (_, _, hearer, heard), count in zip(self._ways, before, strict=True)
            )

        until(cross, "both ways cross", 60)

    def _way(self, sender: Peer, hearer: Peer, topic: str) -> tuple[Peer, int, Peer, int]:
        heard = hearer.subscribe(topic, STRING)
        return sender, sender.advertise(topic, STRING), hearer, heard

    def send(self) -> str:
        """One message each way; its text."""
        self._sent += 1
        for sender, out, _, _ in self._ways:
            sender.publish(out, {"data": str(self._sent)})
        return str(self._sent)

    def check(self) -> None:
        """Each way carries ten messages, none lost."""
        sent = [self.send() for _ in range(10)]
        for _, _, hearer, heard in self._ways:
            came: list[str] = []

            def all_came(hearer: Peer = hearer, heard: int = heard, came: list[str] = came) -> bool:
                came[:] = [m["data"] for m in hearer.wait(heard, 0, 0)]
                return set(came) >= set(sent)

            try:
                until(all_came, "ten cross", 20)
            except AssertionError as err:
                msg = f"of {sent} came {came[-20:]}"
                raise AssertionError(msg) from err


def pids(deployment: Deployment) -> set[int]:
    """The processes of the daemon and its workers."""
    assert deployment.daemon is not None
    return {deployment.daemon.pid, *(int(d["pid"]) for d in deployment.status())}


def broken(number: int, good: str) -> str:
    """One of many broken configurations: cut off, of the wrong kind, unknown keys, bad rules, no text at all."""
    wrong = [
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
    return wrong[number % len(wrong)]


def test_a_hundred_broken_configurations(running: Deployment) -> None:
    flow = Flow(running)
    before, good = pids(running), running.file.read_text()
    assert running.daemon is not None
    daemon = running.daemon
    for number in range(1, BROKEN + 1):
        running.file.write_text(broken(number, good))
        running.hang_up()
        until(lambda n=number: daemon.output().count("is not taken up") == n, f"refusal {number} in the log", 20)
        if number % 20 == 0:
            flow.check()
    refusals = daemon.output().split("is not taken up, the running one is kept:")[1:]
    assert len(refusals) == BROKEN
    for refusal in refusals:
        assert f"{running.file}:" in refusal.splitlines()[1], refusal[:300]
    flow.check()
    running.file.write_text(good + "log: {level: info}\n" + yaml.safe_dump({"routing": {"rules": [{"topic": "/x"}]}}))
    running.hang_up()
    until(lambda: "configuration loaded again" in daemon.output(), "a good one is taken up", 20)
    flow.check()
    assert pids(running) == before


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A real file system of 3 MB."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        while os.path.ismount(folder):  # also what a test laid over it
            subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(disk: Path) -> Path:
    """Leave not one byte of room."""
    litter = disk / "litter"
    with litter.open("wb", buffering=0) as file:
        try:
            while file.write(b"x" * 512):
                pass
        except OSError:
            pass
    return litter


def kill_each_worker(deployment: Deployment, flow: Flow) -> None:
    """Kill each side's worker; each comes back, and its routes."""
    for side in ("ros1", "ros2"):
        pid = int(deployment.worker(side)["pid"])
        os.kill(pid, 9)

        def back(side: str = side, pid: int = pid) -> bool:
            worker = deployment.worker(side)
            return worker.get("pid", pid) != pid and worker["state"] == "running"

        until(back, f"{side} is back", 40, every=0.2)
    flow.begin()


@needs_root
def test_a_full_disk_from_the_start(deployment: Deployment, tmp_path: Path) -> None:
    """State folder and log on a disk without a byte left."""
    with small_disk(tmp_path / "disk") as disk:
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
        said = deployment.command("status").stdout
        assert f": the state folder {disk / 'state'} has 0 kB of room left; make room" in said
        flow.check()
        assert log.read_text() == ""
        litter.unlink()
        deployment.hang_up()
        until(lambda: "configuration loaded again" in log.read_text(), "the log goes on", 20)
        flow.check()
        assert deployment.stop_daemon() == 0


@needs_root
def test_a_disk_that_fills_up_and_turns_read_only(deployment: Deployment, tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as disk:
        deployment.start(state=str(disk / "state"))
        assert deployment.daemon is not None
        daemon = deployment.daemon
        flow = Flow(deployment)
        litter = fill(disk)
        until(lambda: "has 0 kB of room left; make room" in daemon.output(), "it is told", 20)
        kill_each_worker(deployment, flow)
        flow.check()
        litter.unlink()
        # Not the file system itself: it holds files that are open for writing, which a failing disk would not ask.
        subprocess.run(["mount", "--bind", str(disk), str(disk)], check=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", str(disk)], check=True)
        until(lambda: "Read-only file system; make it writable" in daemon.output(), "it is told", 20)
        warning = f": the state folder {disk / 'state'}: Read-only file system; make it writable, or set 'state'"
        assert warning in deployment.command("status").stdout
        doctor = deployment.command("doctor", "--only", "state-folder")
        assert doctor.returncode == 1
        assert "Read-only file system" in doctor.stdout
        kill_each_worker(deployment, flow)
        flow.check()
        deployment.hang_up()
        until(lambda: "configuration loaded again" in daemon.output(), "a good file is taken up all the same", 20)
        subprocess.run(["mount", "-o", "remount,bind,rw", str(disk)], check=True)
        until(lambda: "the state folder can be written again" in daemon.output(), "it is told", 20)
        flow.check()


def test_an_unwritable_state_folder_at_the_start(deployment: Deployment, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    deployment.configure(state=str(file / "state"))
    done = deployment.command("run")
    assert done.returncode == 1
    assert f"state folder {file / 'state'}: Not a directory; set 'state' in the configuration to" in done.stderr


def test_no_descriptors_left(running: Deployment) -> None:
    assert running.daemon is not None
    daemon = running.daemon
    flow = Flow(running)
    before = pids(running)
    ros1, ros2 = running.ros1(), running.ros2()
    for side, program, hearer in (("ros1", ros1, ros2), ("ros2", ros2, ros1)):
        pid = int(running.worker(side)["pid"])
        used = len(list(Path(f"/proc/{pid}/fd").iterdir()))
        limits = resource.prlimit(pid, resource.RLIMIT_NOFILE)
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (used + 4, limits[1]))
        topics = [f"/{side}_{number}" for number in range(12)]
        heard = [hearer.subscribe(topic, STRING) for topic in topics]
        out = [program.advertise(topic, STRING) for topic in topics]
        until(lambda s=side: NO_DESCRIPTORS in str(running.worker(s).get("warnings")), "it is told", 20)
        flow.check()
        said = running.command("status").stdout
        assert NO_DESCRIPTORS in said
        until(lambda s=side: re.search(f"{s}: .*{NO_DESCRIPTORS}", daemon.output()), "the log tells it, too", 20)
        assert "Errno" not in said
        if side == "ros1":  # one socket for each publisher that is heard
            refused = "this process has no file descriptor left"
            until(lambda r=refused: r in running.command("status").stdout, "the refused topics say why", 20)
        doctor = running.command("doctor", "--only", "descriptors")
        assert doctor.returncode == 1
        assert "LimitNOFILE=" in doctor.stdout
        resource.prlimit(pid, resource.RLIMIT_NOFILE, limits)

        def all_cross(program: Peer = program, hearer: Peer = hearer, out: list = out, heard: list = heard) -> bool:
            for endpoint in out:
                program.publish(endpoint, {"data": "late"})
            return all(hearer.wait(h, 1, 0.1) for h in heard)

        until(all_cross, f"what was refused on {side} crosses", 40)
        flow.check()
    assert pids(running) == before


def test_a_router_without_descriptors(running: Deployment) -> None:
    """Nobody can join; who has joined goes on, the log says why, and it recovers."""
    assert running.daemon is not None
    daemon = running.daemon
    flow = Flow(running)
    pid = int(running.worker("router")["pid"])
    limits = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    used = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (used, limits[1]))
    until(lambda: re.search(f"router: .*{NO_DESCRIPTORS}", daemon.output()), "the log tells it", 20)
    assert running.command("status").returncode == 1
    flow.check()
    resource.prlimit(pid, resource.RLIMIT_NOFILE, limits)
    until(lambda: running.command("status").returncode == 0, "others can join again", 30)
    flow.check()
    assert running.worker("router")["pid"] == pid
