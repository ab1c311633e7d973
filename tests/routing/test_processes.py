"""Whether another worker's process still runs, detected by the process's name."""

from __future__ import annotations

import os
import subprocess
import sys

from bridge.routing.processes import has_ended, process_name
from tests.support.wait import until


def test_a_process_that_ended_is_known_by_its_name() -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    name = process_name(child.pid)
    assert name
    assert not has_ended(name)
    assert not has_ended(process_name())
    child.kill()
    until(lambda: has_ended(name), "the death of the process is detected before its parent has waited for it")
    child.communicate()
    assert has_ended(name)


def test_a_reused_process_id_is_recognized() -> None:
    place, _, _ = process_name().rpartition(" ")
    assert has_ended(f"{place} 1")


def test_processes_of_other_machines_are_unknown() -> None:
    _, _, remainder = process_name().partition(" ")
    for name in ("", "x", "a b c", f"another-boot {remainder}", f"a b {os.getpid()} 0", "a b -1 0", "\0 \0 \0 \0"):
        assert not has_ended(name)
