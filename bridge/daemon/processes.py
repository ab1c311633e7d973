"""Sends signals to worker processes, and kills a process with its children, on every system."""

from __future__ import annotations

import contextlib
import os
import signal

import psutil

from bridge.daemon.heartbeat import DUMP_STACKS

_GROUPS = hasattr(os, "killpg")


def terminate(pid: int) -> None:
    """Ask a process to stop with SIGTERM. Windows has no such signal: there only the daemon's command stops it."""
    if _GROUPS:
        _send(pid, signal.SIGTERM)


def dump_stacks(pid: int) -> None:
    """Let a process log the stacks of its threads, if the system has a signal for it."""
    if DUMP_STACKS is not None:
        _send(pid, DUMP_STACKS)


def kill(pid: int) -> None:
    """Kill the leader of a process group with the whole group; on Windows a process with its descendants."""
    if _GROUPS:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
        return
    with contextlib.suppress(psutil.Error):
        leader = psutil.Process(pid)
        for process in (*leader.children(recursive=True), leader):
            with contextlib.suppress(psutil.Error):
                process.kill()


def _send(pid: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)
