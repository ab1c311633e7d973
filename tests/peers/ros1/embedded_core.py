"""Midspan's own ROS 1 master, instead of `core.py`.

Usage: embedded_core.py STATE_FILE ADDRESS PORT
"""

import signal
import sys
import threading
from pathlib import Path

from bridge.adapters.ros1.master.embedded import EmbeddedMaster


def main() -> None:
    """Run until a signal arrives."""
    end = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: end.set())
    master = EmbeddedMaster(sys.argv[2], int(sys.argv[3]), state=Path(sys.argv[1]), purge=30.0)
    master.start()
    end.wait()
    master.close()


main()
