"""``python -m bridge.cli.child worker NAME --supervised``: the command line, in a process that the daemon watches."""

from __future__ import annotations

import sys

from bridge.daemon.heartbeat import start_heartbeat

if __name__ == "__main__":
    heartbeat = start_heartbeat()
    try:
        from bridge.cli.main import main

        sys.exit(main())
    finally:
        heartbeat.close()
