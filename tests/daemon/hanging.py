"""A daemon whose loop hangs as soon as it gets SIGUSR1, while another thread of its process goes on.

Usage: ``python -m tests.daemon.hanging CONFIG TICKS``; the other thread writes to the file TICKS.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from pathlib import Path

from bridge.daemon.supervisor import Supervisor


def main() -> None:
    supervisor = Supervisor(Path(sys.argv[1]))
    reader, writer = os.pipe()
    supervisor._loop.on_readable(reader, lambda: time.sleep(1000))
    signal.signal(signal.SIGUSR1, lambda *_: os.write(writer, b"x"))
    threading.Thread(target=_tick, args=(Path(sys.argv[2]),), daemon=True).start()
    supervisor.run()


def _tick(file: Path) -> None:
    count = 0
    while True:
        count += 1
        file.write_text(str(count))
        time.sleep(0.05)


if __name__ == "__main__":
    main()
