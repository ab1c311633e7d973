"""A daemon with short limits, so that tests need not wait for the real ones.

Usage: ``python -m tests.peers.daemon.quick CONFIG CORES NAME=SECONDS...``; the names are those of `Timing`.
"""

from __future__ import annotations

import signal
import sys
from pathlib import Path

from bridge.daemon import log
from bridge.daemon.supervisor import Supervisor
from bridge.daemon.worker_run import Timing


def main() -> None:
    file, cores, *limits = sys.argv[1:]
    timing = Timing(**{name: float(seconds) for name, seconds in (limit.split("=") for limit in limits)})
    supervisor = Supervisor(Path(file), timing=timing, cores=int(cores))
    log.setup(supervisor.config, "midspan", log.Style.TERMINAL)
    signal.signal(signal.SIGTERM, lambda *_: supervisor.request_stop())
    signal.signal(signal.SIGHUP, lambda *_: supervisor.request_reload())
    supervisor.run()


if __name__ == "__main__":
    main()
