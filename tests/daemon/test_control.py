"""The control socket of a worker that outlives its daemon."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

from bridge.daemon.control import ControlServer
from bridge.daemon.protocol import Beat
from bridge.worker import Health


def test_hello_comes_before_all_other_reports(tmp_path: Path) -> None:
    server = ControlServer(tmp_path / "socket", "daemon", lambda _: None)
    closing = threading.Event()

    def beat() -> None:
        while not closing.is_set():
            server.report(Beat(1, Health("running", "x")))

    beating = threading.Thread(target=beat)
    beating.start()
    try:
        for _ in range(50):
            with socket.socket(socket.AF_UNIX) as daemon:
                daemon.settimeout(20)
                daemon.connect(str(tmp_path / "socket"))
                assert b"hello" in daemon.recv(4096).split(b"\n")[0]
    finally:
        closing.set()
        beating.join()
        server.close()
