"""Who can share memory with us, told from the GUID prefix and the process table."""

from __future__ import annotations

import os
from pathlib import Path

from bridge.adapters.ros2 import neighbours
from bridge.adapters.ros2.mark import is_marked, new_prefix

HOST = b"\x01\x0f\x12\x34"
OWN = new_prefix(HOST)


def prefix(pid: int, host: bytes = HOST) -> bytes:
    return host + (pid & 0xFFFF).to_bytes(2, "little") + b"\xab\xcd" + bytes(4)


def test_process_of_our_user_is_no_stranger() -> None:
    assert neighbours.strangers([prefix(os.getpid())], OWN) == []


def test_process_of_another_user_or_of_none_is_a_stranger(tmp_path: Path) -> None:
    (tmp_path / "sys/kernel").mkdir(parents=True)
    (tmp_path / "sys/kernel/pid_max").write_text("4194304\n")
    (tmp_path / "70000").mkdir()
    gone, ours = prefix(4711), prefix(70000)
    assert neighbours.strangers([gone, ours], OWN, tmp_path) == [gone]


def test_other_hosts_and_other_midspans_do_not_count() -> None:
    elsewhere = prefix(1, b"\x01\x0f\x99\x99")
    assert neighbours.strangers([elsewhere, new_prefix(HOST), OWN], OWN) == []


def test_note_holds_until_the_next_boot(tmp_path: Path) -> None:
    assert not neighbours.noted(tmp_path)
    neighbours.note(tmp_path / "deeper")
    assert neighbours.noted(tmp_path / "deeper")
    (tmp_path / "deeper" / "udp-alone").write_text("another boot")
    assert not neighbours.noted(tmp_path / "deeper")


def test_mark() -> None:
    assert is_marked(OWN)
    assert OWN.startswith(HOST)
    assert is_marked(OWN + bytes(4))
    assert not is_marked(prefix(1))
    assert new_prefix(HOST) != OWN
