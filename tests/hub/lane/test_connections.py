"""The connections of a session to the sessions from which it receives."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.connections import LaneConnections
from bridge.hub.lane.inlet import Inlet
from bridge.hub.lane.writer import LaneWriter
from tests.support.wait import until


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_the_end_of_a_connection_is_reported_although_the_next_attempt_fails(tmp_path: Path) -> None:
    disconnected: list[Inlet] = []

    def retry() -> None:
        msg = "can't start new thread"
        raise RuntimeError(msg)

    connections = LaneConnections(tmp_path, retry, lambda _zid: None, disconnected.append, lambda *_: None)
    with contextlib.closing(LaneWriter(tmp_path, "abcd", Blocks(lambda *_: None), lambda *_: None)):
        inlet = connections.inlet("abcd")
        assert isinstance(inlet, Inlet)
    until(lambda: disconnected, "the end is reported")
    assert disconnected == [inlet]
    until(lambda: not inlet._thread.is_alive(), "the thread has ended")
