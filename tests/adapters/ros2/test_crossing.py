"""The edge in a separate process: other users, a small or full /dev/shm, crashes."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.ros2.environment import worker_environment
from bridge.config.model import Config
from bridge.routing.edge import Kind, MadeBy
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, ros2_domain, ros2_environment
from tests.support.wait import until

ROOT = Path(__file__).parents[3]
NOBODY = 65534
AS_NOBODY = (f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")


class Programs:
    """Starts edges and native peers as other users or in another mount namespace, and ends them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.running: list[Peer] = []

    def native(self, user: int = 0, mounts: int | None = None) -> Peer:
        return self._start([str(ROS2_PEER), "native"], ros2_environment(), user, mounts)

    def edge(self, user: int = 0, mounts: int | None = None, **ros2: Any) -> Peer:
        config = Config.model_validate({"ros2": {"domain": ros2_domain(), **ros2}})
        env = {**worker_environment(config, os.environ), "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
        for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
            env.pop(name, None)
        # each user has a separate state that outlives the process, like a worker's
        state = self.folder / f"state-{user}"
        state.mkdir(exist_ok=True)
        if os.geteuid() == 0:
            os.chown(state, user, -1)
        text = json.dumps(config.model_dump(mode="json", by_alias=True, exclude_unset=True))
        return self._start(["-m", "tests.peers.ros2.adapter_program", text, str(state)], env, user, mounts)

    def _start(self, args: list[str], env: dict[str, str], user: int, mounts: int | None) -> Peer:
        env = {**env, "HOME": str(self.folder), "ROS_LOG_DIR": str(self.folder / f"log-{user}")}
        command = [sys.executable, *args]
        if user:
            command = ["setpriv", *AS_NOBODY, *command]
        if mounts is not None:
            command = ["nsenter", f"--mount=/proc/{mounts}/ns/mnt", *command]
        program = Peer(Path(command[1]), Path(command[0]), env, *command[2:])
        self.running.append(program)
        return program

    def stop(self) -> None:
        for program in self.running:
            program.stop()


@pytest.fixture
def programs() -> Iterator[Programs]:
    folder = Path(tempfile.mkdtemp(prefix="midspan-test-ros2-"))
    folder.chmod(0o777)
    programs = Programs(folder)
    yield programs
    programs.stop()
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def own_shm(programs: Programs) -> Iterator[Callable[[str], int]]:
    """Return a function that makes a mount namespace with a /dev/shm of a given size, and returns a pid in it."""
    holders: list[subprocess.Popen[str]] = []

    def mount(size: str) -> int:
        if not shutil.which("unshare") or not shutil.which("nsenter"):
            pytest.skip("needs unshare and nsenter")
        script = f"mount -t tmpfs -o size={size} tmpfs /dev/shm && echo mounted && exec cat"
        command = ["unshare", "--mount", "sh", "-c", script]
        holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        holders.append(holder)
        assert holder.stdout is not None
        if holder.stdout.readline() != "mounted\n":
            pytest.skip("may not mount a separate /dev/shm")
        return holder.pid

    yield mount
    programs.stop()
    for holder in holders:
        holder.communicate()


class Directions:
    """Endpoints of an edge and of a native program for messages in both directions."""

    def __init__(self, edge: Peer, native: Peer) -> None:
        self.edge, self.native = edge, native
        self.inward, self.outward = (
            edge.ask("subscribe", topic="/x/in")["id"],
            edge.ask("advertise", topic="/x/out")["id"],
        )
        self.received, self.sends = (
            native.subscribe("/x/out", "std_msgs/String"),
            native.advertise("/x/in", "std_msgs/String"),
        )

    def cross(self, data: str = "x", seconds: float = 40.0) -> None:
        """Send until this text has arrived on both sides."""

        def both() -> bool:
            self.native.publish(self.sends, {"data": data})
            self.edge.ask("publish", id=self.outward, message=data)
            received = self.edge.ask("wait", id=self.inward, count=1, seconds=0.1)["messages"]
            return data in received and {"data": data} in self.native.wait(self.received, 1, 0.1)

        until(both, "messages cross in both directions", seconds)


def assert_crosses(edge: Peer, native: Peer, data: str = "x", seconds: float = 40.0) -> None:
    """Check that messages cross in both directions between an edge and a native program."""
    Directions(edge, native).cross(data, seconds)


def segments(program: Peer) -> set[Path]:
    """Return the Fast DDS segments in shared memory that a process has mapped, without shared ports."""
    maps = Path(f"/proc/{program.pid}/maps").read_text(encoding="utf-8")
    return {Path(line.split()[-1]) for line in maps.splitlines() if re.search(r"/dev/shm/fastrtps_[0-9a-f]{16}$", line)}


def need_other_user() -> None:
    """Skip if this process cannot run the programs as another user."""
    if os.geteuid() != 0 or not shutil.which("setpriv"):
        pytest.skip("needs root and setpriv to run programs as another user")
    reads = subprocess.run(["setpriv", *AS_NOBODY, sys.executable, "-c", "import bridge"], cwd=ROOT, check=False)
    if reads.returncode != 0:
        pytest.skip("another user cannot read this checkout or its Python")


@pytest.mark.parametrize(("edge_user", "native_user"), [(0, NOBODY), (NOBODY, 0)])
def test_data_crosses_between_users_in_any_order_of_start(programs: Programs, edge_user: int, native_user: int) -> None:
    need_other_user()
    native = programs.native(native_user)
    native.graph()
    assert_crosses(programs.edge(edge_user), native)


@pytest.mark.parametrize(("edge_user", "native_user"), [(0, NOBODY), (NOBODY, 0)])
def test_edge_leaves_shared_memory_when_another_user_appears(
    programs: Programs, own_shm: Callable[[str], int], edge_user: int, native_user: int
) -> None:
    need_other_user()
    mounts = own_shm("1g")
    edge = programs.edge(edge_user, mounts)
    edge.ask("status")
    native = programs.native(native_user, mounts)
    native.advertise("/x/appears", "std_msgs/String")
    reasons = until(lambda: edge.ask("status")["failed"], "the edge requests a restart")
    assert len(reasons) == 1
    assert "another user" in reasons[0]
    edge.stop()
    again = programs.edge(edge_user, mounts)
    assert_crosses(again, native)
    assert again.ask("status")["failed"] == []


def test_data_crosses_to_a_container(programs: Programs, own_shm: Callable[[str], int]) -> None:
    """A node of the same user with a separate /dev/shm."""
    ours, theirs = own_shm("1g"), own_shm("1g")
    edge, native = programs.edge(mounts=ours), programs.native(mounts=theirs)
    native.advertise("/x/appears", "std_msgs/String")
    until(lambda: edge.ask("status")["failed"], "the edge requests a restart")
    edge.stop()
    assert_crosses(programs.edge(mounts=ours), native)


def test_same_user_keeps_shared_memory(programs: Programs, own_shm: Callable[[str], int]) -> None:
    mounts = own_shm("1g")
    edge, native = programs.edge(mounts=mounts), programs.native(mounts=mounts)
    assert_crosses(edge, native)
    assert edge.ask("status")["failed"] == []
    assert segments(edge)


def test_large_messages_are_bridged_while_the_shared_memory_is_full(
    programs: Programs, own_shm: Callable[[str], int]
) -> None:
    """Fast DDS uses UDP; LTTng, which would crash the process without a page for its file, cannot open that file."""
    mounts = own_shm("1m")
    fill = "head -c 2m /dev/zero > /dev/shm/fill 2> /dev/null"
    subprocess.run(["nsenter", f"--mount=/proc/{mounts}/ns/mnt", "sh", "-c", fill], check=False)
    edge = programs.edge(mounts=mounts)
    assert_crosses(edge, programs.native(), "x" * 1_000_000)
    folder = Path(f"/proc/{edge.pid}/root/dev/shm")
    assert [file.name for file in folder.iterdir() if not file.is_symlink()] == ["fill"]
    assert edge.stop(40) == 0


@pytest.mark.thorough
@pytest.mark.parametrize("transport", ["auto", "shared_memory", "udp"])
def test_a_small_shared_memory_suffices(programs: Programs, own_shm: Callable[[str], int], transport: str) -> None:
    """Messages of up to 6 MB cross with a /dev/shm of 64 MB, Docker's default."""
    mounts = own_shm("64m")
    edge = programs.edge(mounts=mounts, transport=transport)
    assert_crosses(edge, programs.native(mounts=mounts), "x" * 1_000_000, 20)
    assert_crosses(edge, programs.native(mounts=mounts), "x" * 6_000_000, 20)
    # the segment of a dead process must not occupy the space of the next one
    edge.signal(signal.SIGKILL)
    edge = programs.edge(mounts=mounts, transport=transport)
    assert_crosses(edge, programs.native(mounts=mounts), "y" * 1_000_000, 20)


def test_a_killed_edge_leaves_the_graph_and_never_counts_as_native(programs: Programs, edge: RunningEdge) -> None:
    killed, native = programs.edge(), programs.native()
    killed.ask("advertise", topic="/x/killed")
    (endpoint,) = edge.until_seen("/x/killed", Kind.PUBLISHER)
    assert endpoint.made_by is MadeBy.MIDSPAN
    until(lambda: native.graph()["publishers"].get("/x/killed"), "the edge is on the native graph")
    killed.signal(signal.SIGKILL)
    programs.edge()  # a worker's successor, with its state
    until(lambda: not native.graph()["publishers"].get("/x/killed"), "the killed edge leaves the graph")
    edge.until_gone("/x/killed", Kind.PUBLISHER)


@pytest.mark.thorough
@pytest.mark.alone
@pytest.mark.parametrize("transport", ["shared_memory", "udp"])
def test_a_successor_discovers_others_at_once_and_not_at_their_next_announcement(
    programs: Programs, transport: str
) -> None:
    native = programs.native()
    sends = native.advertise("/x/in", "std_msgs/String")
    native.ask("count", id=sends, first=1, count=1_000_000, rate=100)
    for _ in range(5):
        edge = programs.edge(transport=transport)
        subscription = edge.ask("subscribe", topic="/x/in")["id"]
        assert edge.ask("wait", id=subscription, count=1, seconds=1.5)["messages"], "announcements come every 3 s"
        edge.signal(signal.SIGKILL)


@pytest.mark.thorough
@pytest.mark.parametrize("seconds", [1.0, 3.0])
def test_everything_crosses_again_after_an_edge_was_suspended(programs: Programs, seconds: float) -> None:
    edge, native = programs.edge(), programs.native()
    directions = Directions(edge, native)
    directions.cross()
    for number in range(2):
        edge.signal(signal.SIGSTOP)
        time.sleep(seconds)  # less than Fast DDS's lease of 20 s, after which the edge would have to restart
        edge.signal(signal.SIGCONT)
        directions.cross(f"again {number}")
    assert native.graph()["publishers"]["/x/out"] == ["midspan"]


def test_clean_stop_leaves_nothing_in_shared_memory(programs: Programs) -> None:
    edge = programs.edge(transport="shared_memory")
    edge.ask("advertise", topic="/x/stop")
    created = segments(edge)
    assert created
    assert edge.popen.stdin is not None
    edge.popen.stdin.close()
    assert edge.popen.wait(40) == 0
    assert not [path for path in created if path.exists()]


def test_records_of_one_edge_reach_the_others(edge: RunningEdge, programs: Programs) -> None:
    edge.edge.announce(b"before it came")
    other = programs.edge()
    until(lambda: other.ask("sightings")["records"] == ["before it came"], "the last record arrives")
    other.ask("announce", record="an answer")
    until(lambda: [s.record for s in edge.edge.sightings()] == [b"an answer"], "the response arrives")
    edge.edge.announce(b"more" * 10_000)
    until(lambda: other.ask("sightings")["records"] == ["more" * 10_000], "each record replaces the last")
    until(lambda: edge.edge.settled(0.0), "the participants present at the start are known")
    assert not edge.edge.settled(time.monotonic()), "a participant that joins now is unknown"
    assert not [e for e in edge.edge.endpoints() if "_midspan" in e.topic]
    other.signal(signal.SIGKILL)
    programs.edge()
    until(lambda: len(edge.edge.sightings()) == 1, "a successor disposes the dead participant")
