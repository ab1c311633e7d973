"""Runs a command and ends it when the guard's standard input ends, so that nothing outlives a killed demo.

Usage: ``python guard.py COMMAND...``. Standard library only. Processes left by the command are killed (Linux): a killed
daemon leaves its router, and a roscore its master; these have their own sessions and do not receive the signals.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

PATIENCE = 8.0
"""Seconds between SIGTERM and SIGKILL."""

_PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h: orphans below this process become its children


def main() -> int:
    """Run the command, and return its exit code."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    child = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
    signal.signal(signal.SIGTERM, lambda *_: child.terminate())

    def watch() -> None:
        while os.read(0, 4096):
            pass
        child.terminate()
        try:
            child.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            child.kill()

    threading.Thread(target=watch, name="watch", daemon=True).start()
    code = child.wait()
    while left := _children():
        for pid in left:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    return code


def _children() -> list[int]:
    """Return the process ids of the remaining children; empty without proc(5)."""
    pids = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # the process has ended
            if int(file.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[1]) == os.getpid():
                pids.append(int(file.parent.name))
    return pids


if __name__ == "__main__":
    sys.exit(main())
