"""Limits of requests in flight, and detection of ended processes."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from bridge.adapters.ros2.graph import neighbors
from bridge.adapters.ros2.graph.neighbors import ProcessWatch
from bridge.adapters.ros2.services import pacing
from bridge.adapters.ros2.services.pacing import PATIENCE, ROOM, SentRequests


def test_requests_wait_for_replies(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(pacing, "time", SimpleNamespace(monotonic=lambda: now[0]))
    requests = SentRequests()
    for number in range(1, ROOM + 1):
        assert requests.wait() == 0
        requests.on_sent(number)
    assert requests.wait() == pytest.approx(PATIENCE)
    now[0] += PATIENCE / 2
    requests.on_reply(3)  # so 1 and 2 were taken before
    assert requests.wait() == 0
    for number in (ROOM + 1, ROOM + 2, ROOM + 3):
        requests.on_sent(number)
    now[0] += PATIENCE / 2
    requests.on_reply(1)  # does not show whether queued ones were taken
    assert requests.wait() == pytest.approx(PATIENCE / 2)
    now[0] += PATIENCE / 2 + 0.001
    assert requests.wait() == 0


def test_the_end_of_a_process_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(neighbors, "loaded_majors", lambda process: {2} if process.exists() else set())
    own_prefix = b"\x01\x0f\x00\x01" + os.urandom(8)
    program = subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE)
    prefix = own_prefix[:4] + (program.pid & 0xFFFF).to_bytes(2, "little") + bytes(6)
    elsewhere = b"\x01\x0f\x00\x02" + prefix[4:]
    try:
        watched = ProcessWatch(own_prefix)
        assert not watched.has_ended(prefix)
        assert not watched.has_ended(elsewhere)
        program.kill()
        os.waitid(os.P_PID, program.pid, os.WEXITED | os.WNOWAIT)
        assert watched.has_ended(prefix)  # although its parent has not waited for it yet
    finally:
        program.communicate()
    assert watched.has_ended(prefix)
    assert not watched.has_ended(elsewhere)
    assert not ProcessWatch(own_prefix).has_ended(prefix)  # never seen alive: DDS decides
