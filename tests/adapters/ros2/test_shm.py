"""Fast DDS's files in shared memory, in temporary folders."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

import pytest

from bridge.adapters.ros2.graph import neighbors

HELD, DEAD, FRESH = "fastrtps_" + "a" * 16, "fastrtps_" + "b" * 16, "fastrtps_" + "c" * 16
DEAD_3 = "fastdds_" + "b" * 16
"""A segment of Fast DDS 3."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (HELD, DEAD, DEAD_3, FRESH, "fastrtps_port7411", "fastdds_port7411"):
        (tmp_path / name).touch()
        (tmp_path / f"{name}_el").touch()
        if name != FRESH:
            long_ago = time.time() - 60
            os.utime(tmp_path / f"{name}_el", (long_ago, long_ago))
    (tmp_path / "somebody_elses").touch()
    return tmp_path


def test_only_segments_of_dead_processes_are_removed(folder: Path) -> None:
    with (folder / f"{HELD}_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        before = set(folder.iterdir())
        assert neighbors.clean(folder) == 2
        removed = {path.name for path in before - set(folder.iterdir())}
        assert removed == {DEAD, f"{DEAD}_el", DEAD_3, f"{DEAD_3}_el"}


@pytest.mark.parametrize("name", ["fastrtps", "fastdds"])
def test_ports_of_dead_predecessors_are_removed_unless_in_use(folder: Path, name: str) -> None:
    for number in (7413, 7415):
        for file in (f"{name}_port{number}", f"{name}_port{number}_el", f"sem.{name}_port{number}_mutex"):
            (folder / file).touch()
    before = set(folder.iterdir())
    with (folder / f"{name}_port7415_el").open() as used:
        fcntl.flock(used, fcntl.LOCK_SH)
        neighbors.clean_ports([7413, 7415, 7417], folder)
        removed = {path.name for path in before - set(folder.iterdir())}
    assert removed == {f"{name}_port7413", f"{name}_port7413_el", f"sem.{name}_port7413_mutex"}
    neighbors.clean_ports([7415], folder)
    assert not list(folder.glob("*7415*"))


def test_other_users_count_only_while_they_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: mine + 1)
    assert not neighbors.has_other_users(2, folder)
    with (folder / f"{HELD}_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert neighbors.has_other_users(2, folder)
        assert not neighbors.has_other_users(3, folder), "Fast DDS 3 does not use the files of Fast DDS 2"
        monkeypatch.setattr(os, "getuid", lambda: mine)
        assert not neighbors.has_other_users(2, folder)


@pytest.mark.parametrize(("free_mb", "segment_mb"), [(100_000, 32), (512, 32), (256, 32), (64, 8), (63, 0), (0, 0)])
def test_the_segment_is_an_eighth_of_the_free_space(
    monkeypatch: pytest.MonkeyPatch, free_mb: int, segment_mb: int
) -> None:
    real = os.statvfs("/")
    values = [*tuple(real)[:11]]
    values[1], values[4] = 4096, free_mb * 256
    monkeypatch.setattr(os, "statvfs", lambda _path: os.statvfs_result(values))
    assert neighbors.segment_size() == segment_mb << 20


def test_a_read_only_folder_has_no_space(monkeypatch: pytest.MonkeyPatch) -> None:
    values = [*tuple(os.statvfs("/"))[:11]]
    values[1], values[4], values[8] = 4096, 1 << 20, values[8] | os.ST_RDONLY
    monkeypatch.setattr(os, "statvfs", lambda _path: os.statvfs_result(values))
    assert neighbors.segment_size() == 0


def test_a_missing_folder_has_no_space(tmp_path: Path) -> None:
    assert neighbors.segment_size(tmp_path / "none") == 0
    assert neighbors.clean(tmp_path / "none") == 0
    assert not neighbors.has_other_users(2, tmp_path / "none")
