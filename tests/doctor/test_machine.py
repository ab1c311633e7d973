"""Checks of this machine: clocks, limits, shared memory, with real processes and files."""

from __future__ import annotations

import fcntl
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge import resources
from bridge.doctor import context
from bridge.doctor.check import Finding, Result
from bridge.doctor.checks import machine, sharedmemory
from bridge.doctor.checks.sharedmemory import shared_files
from bridge.doctor.context import Offset
from bridge.hub.graph.tokens import EndpointKind
from tests.adapters.ros2.graph.test_ports import opened
from tests.doctor.parts import around, hub, only, results
from tests.support.process import Process
from tests.support.wait import until

PROC = Path("/proc")
pytestmark = pytest.mark.skipif(not PROC.is_dir(), reason="needs Linux's /proc")


def test_an_offset_is_measured_within_its_error() -> None:
    measured = context.measure(lambda: time.time_ns() + 2_000_000_000)
    assert measured is not None
    assert abs(measured.seconds - 2.0) <= measured.error + 1e-4


def test_the_quickest_answer_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0]
    answers = iter([50_000_000, 2_000_000, None, 50_000_000])

    def ask() -> int | None:
        wait = next(answers)
        if wait is None:
            return None
        reported = now[0]
        now[0] += wait  # a slow reply looks like a clock that is behind
        return reported

    monkeypatch.setattr(context, "time", SimpleNamespace(time_ns=lambda: now[0], monotonic_ns=lambda: now[0]))
    assert context.measure(ask, 4) == Offset(-0.001, 0.001)
    assert context.measure(lambda: None) is None


@pytest.mark.parametrize(
    ("seconds", "error", "result"),
    [(0.001, 0.001, Result.OK), (0.1, 0.2, Result.OK), (-0.1, 0.01, Result.WARN), (3.0, 0.1, Result.FAIL)],
)
def test_an_offset_between_clocks_is_reported(seconds: float, error: float, result: Result) -> None:
    view = hub(clocks={"robot2/ros1": Offset(9.0, 8.0), "robot2/ros2": Offset(seconds, error)})
    finding = only(machine.check_clocks(around(hub=view)))
    assert finding.result is result
    assert "robot2" in finding.seen
    assert bool(finding.cure) == (result is not Result.OK)


@pytest.mark.parametrize(
    ("source", "kinds", "missing"),
    [
        ("sim", [], True), ("sim", [EndpointKind.SUBSCRIPTION], True), ("sim", [EndpointKind.PUBLISHER], False),
        ("system", [], False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("clocks", [{}, {"robot/ros1": Offset(0.0, 0.001)}])
def test_simulated_time_without_a_publisher_fails_the_check(
    source: str, kinds: list[EndpointKind], missing: bool, clocks: dict[str, Offset]
) -> None:
    ends: Any = [SimpleNamespace(topic="/clock", kind=kind) for kind in kinds]
    view = replace(hub({"worker": "ros1", "side": "ros1"}, clocks=clocks), endpoints=ends)
    finding = only(machine.check_clocks(around({"clock": {"source": source}}, hub=view)))
    assert (finding.result is Result.FAIL) is missing
    assert ("/clock has no publisher" in finding.seen) is missing
    assert ("midspan play --clock" in finding.cure) is missing


def test_a_worker_with_few_free_descriptors_fails_the_check() -> None:
    program = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40)); "
        "held = [open('/dev/null') for _ in range(int(sys.argv[2]))]; print('ready', flush=True); sys.stdin.read()"
    )
    for count, result in ((33, Result.FAIL), (3, Result.WARN)):
        with Process([sys.executable, "-c", program, "midspan", str(count)], dict(os.environ), pipes=True) as process:
            assert process.popen.stdout is not None
            assert process.popen.stdout.readline() == "ready\n"
            document = {"worker": "ros1", "side": "ros1", "pid": process.pid}
            finding = machine.check_descriptors(around(hub=hub(document)))
            assert result in results(finding), finding
            assert (Result.FAIL in results(finding)) is (result is Result.FAIL)
            assert any("each process of robot1 can open at most 40 files" in item.seen for item in finding), finding


def test_a_state_folder_on_a_full_disk_fails_the_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def check_state(folder: Path) -> Finding:
        return only(machine.check_state(around({"state": folder})))

    assert check_state(tmp_path / "later").result is Result.SKIP
    assert check_state(tmp_path).result is Result.OK
    monkeypatch.setattr(resources, "LEAST_ROOM", 1 << 60)
    full = check_state(tmp_path)
    assert full.result is Result.FAIL
    assert full.seen.startswith(f"the state folder {tmp_path} has ")
    assert full.cure == "free space on that disk"


def shm_file(folder: Path, name: str, size: int = 4096, age: float = 60.0) -> Path:
    """Create a shared-memory file as left by Fast DDS or zenoh, with its lock file."""
    file = folder / name
    file.write_bytes(b"x" * size)
    lock = file if name.endswith(".zenoh") else folder / f"{name}_el"
    lock.touch()
    os.utime(file, (time.time() - age, time.time() - age))
    return lock


@contextmanager
def hold_lock(lock: Path, how: int) -> Iterator[None]:
    """Hold a lock as a living process does."""
    with lock.open("rb") as file:
        fcntl.flock(file, how)
        yield


SEGMENT, OTHER_SEGMENT = "fastrtps_0123456789abcdef", "fastrtps_00000000deadbeef"
SEGMENT_3 = "fastdds_00000000deadbeef"
"""A segment of Fast DDS 3."""


@pytest.mark.parametrize("proc", [PROC, Path("/nowhere")])
def test_shared_files_are_marked_as_held_young_or_port(tmp_path: Path, proc: Path) -> None:
    ports = {"fastrtps_port7410", "fastdds_port7410"}
    names = (SEGMENT, "12345.zenoh", *ports, "somebody_elses", OTHER_SEGMENT, SEGMENT_3)
    locks = {name: shm_file(tmp_path, name) for name in names}
    shm_file(tmp_path, "99.zenoh", age=0.0)
    with hold_lock(locks[SEGMENT], fcntl.LOCK_EX), hold_lock(locks["12345.zenoh"], fcntl.LOCK_SH):
        finding = {f.path.name: f for f in shared_files(tmp_path, proc)}
    assert finding.keys() == {*names, "99.zenoh"} - {"somebody_elses"}
    assert {name for name, f in finding.items() if f.held} == {SEGMENT, "12345.zenoh"}
    assert {name for name, f in finding.items() if f.young} == {"99.zenoh"}
    assert {name for name, f in finding.items() if f.port} == ports


def test_files_of_dead_processes_in_shared_memory_are_reported(tmp_path: Path) -> None:
    place = around(shm=tmp_path, proc=PROC)
    shm_file(tmp_path, "fastrtps_port7410", sharedmemory.LITTER_BYTES * 2)  # no litter: Fast DDS reuses dead ports
    assert only(sharedmemory.check_litter(place)).result is Result.OK
    segment = shm_file(tmp_path, SEGMENT, sharedmemory.LITTER_BYTES)
    shm_file(tmp_path, "12345.zenoh", 4096)
    with hold_lock(segment, fcntl.LOCK_EX):
        assert only(sharedmemory.check_litter(place)).result is Result.OK
    finding = only(sharedmemory.check_litter(place))
    assert finding.result is Result.WARN
    assert "2 files" in finding.seen
    assert "fastdds shm clean" in finding.cure
    assert f"rm {tmp_path}/12345.zenoh" in finding.cure


def test_programs_whose_shared_memory_port_was_removed_are_reported(tmp_path: Path) -> None:
    place = around(shm=tmp_path, proc=PROC)
    with opened(tmp_path / "fastrtps_port7411"):
        assert only(sharedmemory.check_ports(place)).result is Result.OK
        (tmp_path / "fastrtps_port7411").unlink()
        finding = only(sharedmemory.check_ports(place))
    assert finding.result is Result.WARN
    assert f"(process {os.getpid()})" in finding.seen
    assert only(sharedmemory.check_ports(around(shm=tmp_path / "none", proc=PROC))).result is Result.SKIP


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
@pytest.mark.parametrize(
    ("transport", "result"), [("auto", Result.WARN), ("shared_memory", Result.FAIL), ("udp", Result.OK)]
)
def test_shared_memory_of_another_users_fast_dds_is_reported(tmp_path: Path, transport: str, result: Result) -> None:
    place = around({"ros2": {"transport": transport}}, shm=tmp_path, proc=PROC)
    mine, theirs = shm_file(tmp_path, SEGMENT), shm_file(tmp_path, OTHER_SEGMENT)
    os.chown(tmp_path / OTHER_SEGMENT, 65534, -1)
    with hold_lock(mine, fcntl.LOCK_EX):
        assert only(sharedmemory.check_users(place)).result is Result.OK
    with hold_lock(theirs, fcntl.LOCK_EX):
        finding = only(sharedmemory.check_users(place))
    assert finding.result is result
    assert "nobody" in finding.seen
    kilted = shm_file(tmp_path, SEGMENT_3)
    os.chown(tmp_path / SEGMENT_3, 65534, -1)
    with hold_lock(kilted, fcntl.LOCK_EX):
        assert only(sharedmemory.check_users(place)).result is result, "no worker is known"
        with hold_lock(mine, fcntl.LOCK_EX):  # Fast DDS 2, which does not use the memory of Fast DDS 3
            assert only(sharedmemory.check_users(place)).result is Result.OK


def test_full_shared_memory_fails_the_check(tmp_path: Path) -> None:
    assert only(sharedmemory.check_size(around(shm=tmp_path / "none"))).result is Result.SKIP
    # /sys is a file system without any space
    if Path("/sys").is_mount():
        assert only(sharedmemory.check_size(around(shm=Path("/sys")))).result is Result.FAIL
    assert str(tmp_path) in only(sharedmemory.check_size(around(shm=tmp_path))).seen


def test_a_custom_profile_without_room_in_shared_memory_is_a_warning(tmp_path: Path) -> None:
    profile = tmp_path / "own.xml"
    profile.write_text('<dds><profiles><participant is_default_profile="true"><rtps/></participant></profiles></dds>')
    settings = {"ros2": {"profile": str(profile)}}
    assert only(sharedmemory.check_size(around(settings, shm=tmp_path)))
    if Path("/sys").is_mount():
        findings = sharedmemory.check_size(around(settings, shm=Path("/sys")))
        assert isinstance(findings, list)
        assert findings[1].result is Result.WARN
        assert f"ros2.profile {profile} makes Fast DDS use shared memory, but /sys has no room" in findings[1].seen
        assert "list only UDP transports in the profile" in findings[1].cure


def test_a_process_of_another_program_is_ignored() -> None:
    with Process([sys.executable, "-c", "import sys; sys.stdin.read()"], dict(os.environ), pipes=True) as stranger:
        place = around(hub=hub({"worker": "ros1", "side": "ros1", "pid": stranger.pid}))
        until(lambda: Path(f"/proc/{stranger.pid}/cmdline").read_bytes(), "the process runs")
        assert place.process(place.hub.documents[0]) is None
