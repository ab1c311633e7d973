"""Runs only the hub's router, with a configuration in JSON, until SIGTERM."""

from __future__ import annotations

import json
import signal
import sys
import threading

from bridge.config.model import Config
from bridge.hub.router import RouterWorker

stop = threading.Event()
signal.signal(signal.SIGTERM, lambda _number, _frame: stop.set())
worker = RouterWorker()
worker.start(Config.model_validate(json.loads(sys.argv[1])))
try:
    print("listening", flush=True)
    while not stop.wait(0.2):
        pass
finally:
    worker.stop()
