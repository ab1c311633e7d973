"""The zenoh worker stalls for a while, as on a machine that is short of processor time or memory."""

from __future__ import annotations

import os
import signal
import time

from tests.adapters.zenoh.conftest import Place
from tests.contract.side import WorkerProcess
from tests.support.process import is_stopped
from tests.support.wait import until

SET = "std_srvs/SetBool"


def test_call_during_a_stall_is_served(place: Place) -> None:
    """The worker's lease expires meanwhile, and its threads continue in any order."""
    bridge = place.ros2dds()
    bridge.ask("serve", service="/do", type=SET, reply={"success": True})
    worker = WorkerProcess("zenoh", place.config({"dialect": "ros2dds"}), dict(os.environ))
    try:
        until(lambda: place.far.call("/do", SET).result(2.0)["reply"], "the service is bridged")
        for _ in range(3):
            worker.process.signal(signal.SIGSTOP)
            until(lambda: is_stopped(worker.process.pid), "the worker is stopped")
            call = place.far.call("/do", SET)
            time.sleep(1.8)  # longer than the lease of a lone worker
            worker.process.signal(signal.SIGCONT)
            assert call.result()["reply"]
    finally:
        worker.process.signal(signal.SIGCONT)
        worker.stop()
