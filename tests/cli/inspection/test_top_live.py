"""``midspan top`` on a terminal."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.peers.daemon.workers import FakeWorker, config_file, route, status
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

pty = pytest.importorskip("pty")
ROOT = Path(__file__).parents[3]


def test_top_runs_until_ctrl_c(tmp_path: Path, network: HubNetwork, closing: list[Any]) -> None:
    looks = [0]

    def answer(_params: dict[str, Any]) -> dict[str, Any]:
        looks[0] += 1
        return status("ros1", routes=[route("/scan", messages=7000 + looks[0])])

    closing.append(FakeWorker(network, "ros1", status=answer))
    config = config_file(tmp_path, network)
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "bridge.cli.main", "top", "--interval", "0.1", "--config", str(config)]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "140", "LINES": "30"}
    env["_ROS_WHEELS_BOOTSTRAP_COMPLETE"] = "1"
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=env, start_new_session=True) as top:
        os.close(theirs)
        os.set_blocking(ours, False)
        shown = bytearray()

        def read() -> None:
            with contextlib.suppress(OSError):  # nothing to read yet, or the program's end of the terminal is closed
                shown.extend(os.read(ours, 65536))

        def showing() -> bool:
            read()
            return b"/scan" in shown and b"7003" in shown

        def ended() -> bool:
            read()
            return top.poll() is not None

        try:
            until(showing, "the table is redrawn")
            top.send_signal(signal.SIGINT)
            until(ended, "the command ends")
        finally:
            top.kill()
    os.close(ours)
    assert top.returncode == 0
    assert b"ROS 1 -> hub" in shown
