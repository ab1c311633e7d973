"""Detecting from GUID prefixes and the process table which participants can share memory."""

from __future__ import annotations

import contextlib
import fcntl
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros2.graph import neighbors
from bridge.adapters.ros2.graph.origins import is_marked, new_prefix
from bridge.concurrency import DelayedCalls

HOST = b"\x01\x0f\x12\x34"
OWN = new_prefix(HOST)


def prefix(pid: int, host: bytes = HOST) -> bytes:
    return host + (pid & 0xFFFF).to_bytes(2, "little") + b"\xab\xcd" + bytes(4)


class Table:
    """A fake process table."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.shm = folder, folder / "shm"
        self.shm.mkdir(parents=True)
        (folder / "sys/kernel").mkdir(parents=True)
        (folder / "sys/kernel/pid_max").write_text("4194304\n")

    def add(self, pid: int, library: str = "/x/libfastrtps.so.2.14", root: str = "/") -> None:
        (self.folder / str(pid)).mkdir()
        (self.folder / str(pid) / "maps").write_text(f"7f00-7f01 r-xp 00000000 08:01 1 {library}\n")
        (self.folder / str(pid) / "root").symlink_to(root)

    @contextlib.contextmanager
    def locked(self, name: str) -> Iterator[None]:
        """A live participant's file in shared memory."""
        with (self.shm / f"{name}_el").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH)
            yield

    def bind(self, *ports: int) -> None:
        (self.folder / "net").mkdir(exist_ok=True)
        rest = "00000000:0000 07 00000000:00000000 00:00000000 00000000  0        0 4711 2 0000000000000000 0"
        lines = [f"{n}: 00000000:{port:04X} {rest}" for n, port in enumerate(ports)]
        (self.folder / "net/udp").write_text("\n".join(["  sl  local_address rem_address   st", *lines, ""]))


@pytest.fixture
def table(tmp_path: Path) -> Table:
    return Table(tmp_path / "proc")


@pytest.fixture
def reports_unreachable(table: Table, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., bool]]:
    """A function that returns whether `MemoryNeighbors` reports one of these participants, which stay the same."""
    monkeypatch.setattr(neighbors, "CONFIRM_SECONDS", 0.01)
    watches: list[neighbors.MemoryNeighbors] = []
    later = DelayedCalls("test-neighbors")

    def detects(*participants: bytes, seconds: float = 40.0) -> bool:
        reported = threading.Event()
        watch = neighbors.MemoryNeighbors(OWN, 2, 3, reported.set, later, proc=table.folder, folder=table.shm)
        watches.append(watch)
        detects.watch = watch  # type: ignore[attr-defined]
        watch.follow(participants)
        watch.follow(participants)
        return reported.wait(seconds)

    yield detects
    for watch in watches:
        watch.close()
    later.close()


def test_only_a_local_process_with_fast_dds_shares_memory(
    table: Table, reports_unreachable: Callable[..., bool]
) -> None:
    table.add(70000)
    assert not reports_unreachable(prefix(70000), OWN, seconds=0.3)


def test_a_participant_without_a_process_of_this_user_is_reported(reports_unreachable: Callable[..., bool]) -> None:
    assert reports_unreachable(prefix(4711))


def test_process_of_another_user_is_reported(
    table: Table, reports_unreachable: Callable[..., bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    table.add(4711)
    mine = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    assert reports_unreachable(prefix(4711))


def test_a_process_without_fast_dds_does_not_count(table: Table, reports_unreachable: Callable[..., bool]) -> None:
    table.add(1, library="/sbin/init")
    assert reports_unreachable(prefix(1))


def test_a_process_with_another_major_version_of_fast_dds_is_not_reported(
    table: Table, reports_unreachable: Callable[..., bool]
) -> None:
    """Fast DDS 3 is not offered the shared memory of Fast DDS 2, so all of its messages cross by UDP."""
    table.add(4711, library="/x/libfastdds.so.3.2.2")
    assert not reports_unreachable(prefix(4711), seconds=0.3)
    assert reports_unreachable.watch.on_other_major() == 1  # type: ignore[attr-defined]


def test_another_users_fast_dds_of_another_major_version_is_not_reported(
    table: Table, reports_unreachable: Callable[..., bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    table.add(4711)
    mine = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)
    with table.locked("fastdds_port7411"):
        assert not reports_unreachable(prefix(4711), seconds=0.3)
        assert reports_unreachable.watch.on_other_major() == 1  # type: ignore[attr-defined]
        with table.locked("fastrtps_port7413"):
            assert reports_unreachable(prefix(4711)), "it may be the one with the files of Fast DDS 2"


def test_a_process_with_a_separate_dev_shm_is_reported(
    table: Table, reports_unreachable: Callable[..., bool], tmp_path: Path
) -> None:
    (tmp_path / "container/dev/shm").mkdir(parents=True)
    table.add(4711, root=str(tmp_path / "container"))
    assert reports_unreachable(prefix(4711))


def test_a_program_that_has_just_ended_is_not_reported(table: Table) -> None:
    due: list[Callable[[], object]] = []
    later: Any = SimpleNamespace(after=lambda _seconds, call: due.append(call))
    reports: list[bool] = []
    watch = neighbors.MemoryNeighbors(
        OWN, 2, 3, lambda: reports.append(True), later, proc=table.folder, folder=table.shm
    )  # fmt: skip
    watch.follow([prefix(4711)])
    watch.follow([])
    due.pop()()  # the second check
    assert not reports


def test_a_killed_program_is_not_reported_before_its_lease_expires(
    table: Table, reports_unreachable: Callable[..., bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three participants of this host, two have a port of domain 3; the third has no process."""
    table.add(70000)
    table.bind(7400 + 3 * 250 + 10, 7400 + 3 * 250 + 12, 7400 + 3 * 250 + 13, 53, 7410)
    present = (OWN, prefix(70000), prefix(4711))
    assert not reports_unreachable(*present, seconds=0.3)
    table.bind(8160, 8162, 8164)
    assert reports_unreachable(*present), "it is alive, in a container"
    table.bind(8160, 8162)
    monkeypatch.setattr(neighbors, "LEASE_SECONDS", 0.1)
    assert reports_unreachable(*present), "it is present for longer than a dead participant"


def test_programs_that_are_killed_one_after_the_other_are_not_reported(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that crashes at its start is respawned: each of its participants has its own lease."""
    table.bind(8160)
    now = 1000.0
    monkeypatch.setattr(neighbors, "time", SimpleNamespace(monotonic=lambda: now))
    due: list[Callable[[], object]] = []
    later: Any = SimpleNamespace(after=lambda _seconds, call: due.append(call))
    reports: list[bool] = []
    watch = neighbors.MemoryNeighbors(
        OWN, 2, 3, lambda: reports.append(True), later, proc=table.folder, folder=table.shm
    )  # fmt: skip
    for pid in (4711, 4712, 4713):
        watch.follow([prefix(pid)])
        for _ in range(2):
            now += neighbors.LEASE_SECONDS / 2 - 1.0
            due.pop()()
    assert not reports
    now += neighbors.LEASE_SECONDS
    due.pop()()
    assert reports, "the last one is present for longer than a dead participant"


def test_other_hosts_and_other_midspans_do_not_count(reports_unreachable: Callable[..., bool]) -> None:
    assert not reports_unreachable(prefix(1, b"\x01\x0f\x99\x99"), new_prefix(HOST), OWN, seconds=0.3)


def test_udp_is_preferred_until_the_next_boot(tmp_path: Path) -> None:
    assert not neighbors.prefers_udp(tmp_path)
    neighbors.prefer_udp(tmp_path / "deeper")
    assert neighbors.prefers_udp(tmp_path / "deeper")
    (tmp_path / "deeper" / "udp-alone").write_text("another boot")
    assert not neighbors.prefers_udp(tmp_path / "deeper")


def test_new_guid_prefixes_have_the_host_and_the_mark() -> None:
    assert is_marked(OWN)
    assert OWN.startswith(HOST)
    assert is_marked(OWN + bytes(4))
    assert not is_marked(prefix(1))
    assert new_prefix(HOST) != OWN
