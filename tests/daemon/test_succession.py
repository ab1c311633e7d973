"""The handover to a new process when the old one has exited meanwhile."""

from __future__ import annotations

import os

import pytest

from bridge.daemon import succession


def exited_process() -> int:
    pid = os.fork()
    if pid == 0:
        os._exit(0)
    os.waitpid(pid, 0)
    return pid


@pytest.mark.parametrize("pipe_is_open", [True, False])
def test_a_predecessor_that_has_exited_needs_no_stop(monkeypatch: pytest.MonkeyPatch, pipe_is_open: bool) -> None:
    reader, writer = os.pipe()
    if not pipe_is_open:
        os.close(reader)
    monkeypatch.setenv("MIDSPAN_PREDECESSOR", f"{exited_process()}:{writer}")
    assert succession.succeed(lambda: "lock") == "lock"
    assert "MIDSPAN_PREDECESSOR" not in os.environ
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(writer)
    if pipe_is_open:
        assert int(os.read(reader, 16)) == os.getpid()
        os.close(reader)
