"""Shared memory that dead zenoh sessions leave behind."""

from __future__ import annotations

import fcntl
import os
import sys
import time
from pathlib import Path

import pytest

from bridge.hub import shared_memory
from bridge.hub.zenoh_config import POOL
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until


def pool(folder: Path, name: str, age: float = 60.0, size: int = 0) -> Path:
    path = folder / name
    path.touch()
    os.truncate(path, size)
    os.utime(path, (time.time() - age,) * 2)
    return path


def lock(path: Path, pid: int, other_device: int = 0) -> str:
    """Return a line of /proc/locks."""
    stat = path.stat()
    minor = os.minor(stat.st_dev) + other_device
    return f"1: FLOCK  ADVISORY  READ {pid} {os.major(stat.st_dev):02x}:{minor:02x}:{stat.st_ino} 0 EOF\n"


@pytest.mark.skipif(sys.platform != "linux", reason="needs a folder of shared memory")
def test_missing_room_for_shared_memory_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert shared_memory.room_trouble(1 << 10, tmp_path) == ""
    assert "less room than the required 1152921504607 MB" in shared_memory.room_trouble(1 << 60, tmp_path)
    assert "No such file" in shared_memory.room_trouble(1, tmp_path / "none")
    values = [*tuple(os.statvfs(tmp_path))[:11]]
    values[8] |= os.ST_RDONLY
    monkeypatch.setattr(os, "statvfs", lambda _path: os.statvfs_result(values))
    assert shared_memory.room_trouble(1, tmp_path) == f"{tmp_path} is mounted read-only; mount it writable"


def test_only_files_of_dead_sessions_are_removed(tmp_path: Path) -> None:
    dead, held = pool(tmp_path, "1.zenoh"), pool(tmp_path, "2.zenoh")
    young, other = pool(tmp_path, "3.zenoh", 0), pool(tmp_path, "x.zenoh")
    with held.open() as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        assert shared_memory.clean(tmp_path) == 1
    assert [path.exists() for path in (dead, held, young, other)] == [False, True, True, True]
    assert shared_memory.clean(tmp_path / "none") == 0


@pytest.mark.parametrize(
    ("holders", "orphans"),
    [
        ([], 0),
        ([[1]], 0),
        ([[1], [2]], 0),
        ([[1, 2], [2, 1]], 0),
        ([[1], [1]], 1),
        ([[1, 2], [2], [1], [1]], 2),
        ([[1], [1], [2, 3]], 1),
        ([[], [1]], 0),
    ],
)
def test_more_pools_than_living_holders_are_orphans(tmp_path: Path, holders: list[list[int]], orphans: int) -> None:
    lines = []
    for number, pids in enumerate(holders):
        lines += [lock(pool(tmp_path, f"{number}.zenoh", size=POOL), pid) for pid in pids]
    (tmp_path / "locks").write_text("".join([*lines, lock(pool(tmp_path, "99.zenoh", size=4096), 9)]))
    assert shared_memory.orphans(tmp_path, tmp_path) == orphans
    assert shared_memory.orphans(tmp_path, tmp_path / "none") == 0


def test_files_with_the_same_inode_numbers_on_another_device_are_no_pools(tmp_path: Path) -> None:
    pools = [pool(tmp_path, f"{number}.zenoh", size=POOL) for number in range(2)]
    (tmp_path / "locks").write_text("".join(lock(path, 1, other_device=1) for path in pools))
    assert shared_memory.orphans(tmp_path, tmp_path) == 0
    (tmp_path / "locks").write_text("".join(lock(path, 1) for path in pools))
    assert shared_memory.orphans(tmp_path, tmp_path) == 1


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc and /dev/shm")
def test_a_killed_sender_leaves_an_orphan_with_its_listener(tmp_path: Path) -> None:
    """The reason for `shared_memory.orphans`, which is obsolete once zenoh releases the memory of dead processes."""
    with HubNetwork() as network, network.hub_peer("listener") as listener:
        subscription_id = listener.ask("subscription", topic="/image")["id"]
        for number in range(1, 4):
            with network.hub_peer("sender") as sender:
                publisher = sender.ask("publisher", topic="/image", latched=False)["id"]

                def holds(sender=sender, publisher=publisher, number=number) -> bool:
                    sender.ask("put", id=publisher, text="x" * 1_000_000)
                    listener.ask("wait", id=subscription_id, count=1, seconds=0.1)
                    maps = Path(f"/proc/{listener.pid}/maps").read_text(encoding="utf-8").splitlines()
                    return sum(".zenoh" in line and pool_size(line) == POOL for line in maps) >= number

                until(holds, "the listener has the sender's pool")
                sender.stop(0)
        # judged only by the listener's locks, because other programs on this machine start and exit
        locks = Path("/proc/locks").read_text(encoding="utf-8").splitlines(keepends=True)
        (tmp_path / "locks").write_text("".join(line for line in locks if f" {listener.pid} " in line))
        assert shared_memory.orphans(proc=tmp_path) >= 2
        assert shared_memory.orphans() >= 2


def pool_size(line: str) -> int:
    """Return the size of a mapping in bytes, from its line in /proc/<pid>/maps."""
    first, last = line.split()[0].split("-")
    return int(last, 16) - int(first, 16)
