"""``python -m bridge.cli.child worker NAME --supervised``: the command line, in a process that the daemon watches."""

from __future__ import annotations

import gc
import sys

from bridge.daemon.heartbeat import start_heartbeat

if __name__ == "__main__":
    gc.disable()  # imports create no garbage to collect; `WorkerMain` enables collection
    heartbeat = start_heartbeat()
    try:
        from bridge.cli.main import main

        sys.exit(main())
    finally:
        heartbeat.close()
