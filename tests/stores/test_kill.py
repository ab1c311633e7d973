"""A store whose process is killed while it writes: no acknowledged change is lost."""

from __future__ import annotations

import contextlib
import random
import signal
import sys
from pathlib import Path

import pytest

from bridge.stores.kinds import LOCATION
from bridge.stores.replica import Replica
from bridge.stores.store import Store
from tests.peers.hub.network import ROOT
from tests.support.process import Process

WRITER = Path(__file__).with_name("writer.py")
MORE_THAN_ANY = 10**9
"""More puts than the writer can make, so that it is killed in the middle, however late."""


@pytest.mark.thorough
@pytest.mark.parametrize("again", range(2))
def test_kill_in_the_middle_of_writes(tmp_path: Path, again: int) -> None:
    file = tmp_path / "store.sqlite"
    last = random.randrange(100, 900)
    acknowledged = write(file, 0, kill_at=last)
    check(file, acknowledged)
    if again:  # a second process continues with the file, and is killed too
        acknowledged = write(file, acknowledged + 1, kill_at=acknowledged + 50)
        check(file, acknowledged)


def write(file: Path, first: int, kill_at: int) -> int:
    """Start a writing process, kill it once it acknowledges ``kill_at``, and return the last acknowledged number."""
    with Process(
        [sys.executable, WRITER, file, str(first), str(MORE_THAN_ANY)], {"PYTHONPATH": str(ROOT)}, pipes=True
    ) as process:
        assert process.popen.stdout is not None
        acknowledged_ = -1
        for line in process.popen.stdout:
            acknowledged_ = int(line)
            if acknowledged_ == kill_at:
                process.signal(signal.SIGKILL)
        assert acknowledged_ >= kill_at, process.output()
        return acknowledged_


def check(file: Path, acknowledged: int) -> None:
    """Check that every name has its last acknowledged value, or the one being written."""
    with contextlib.closing(Replica(file, "reader")) as replica:
        stored = {name: value.x for name, value in Store(replica).all(LOCATION).items()}
    wanted = {f"l{number % 400}": float(number) for number in range(acknowledged + 1)}
    under_way = {f"l{(acknowledged + 1) % 400}": float(acknowledged + 1)}
    assert stored in (wanted, wanted | under_way)
