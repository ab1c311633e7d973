"""A daemon whose loop hangs as soon as it receives SIGUSR1, while another thread of its process continues.

Usage: ``python -m tests.peers.daemon.hanging CONFIG TICKS HANGS``. The other thread keeps writing to the file TICKS,
and the file HANGS exists once the loop hangs.
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
    supervisor.loop.on_readable(reader, lambda: (Path(sys.argv[3]).touch(), time.sleep(1000)))
    signal.signal(signal.SIGUSR1, lambda *_: os.write(writer, b"x"))
    threading.Thread(target=_tick, args=(Path(sys.argv[2]),), daemon=True).start()
    supervisor.run()


def _tick(file: Path) -> None:
    with file.open("ab", buffering=0) as ticks:
        while True:
            ticks.write(b".")
            time.sleep(0.05)


if __name__ == "__main__":
    main()
