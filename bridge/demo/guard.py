"""Runs a command and ends it when the guard's standard input ends, so that nothing outlives a demo that was killed.

Usage: ``python guard.py COMMAND...``. Standard library only.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

PATIENCE = 8.0
"""Seconds between SIGTERM and SIGKILL."""


def main() -> int:
    """Run the command; returns its exit code."""
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
    return child.wait()


if __name__ == "__main__":
    sys.exit(main())
