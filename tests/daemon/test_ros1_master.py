"""The embedded ROS 1 master under the daemon: it outlives a crash, and keeps its state over a clean restart."""

from __future__ import annotations

import contextlib
import os
import signal
import xmlrpc.client
from typing import Any

from bridge.config.model import Config
from bridge.daemon.query import ask_daemon
from bridge.doctor.daemon_state import without_node
from tests.peers.daemon.daemon import Daemon
from tests.support.ports import free_port
from tests.support.wait import until


def test_the_master_outlives_a_killed_daemon_and_a_clean_restart_keeps_its_state(daemon: Daemon) -> None:
    port = free_port()
    daemon.configure(f"ros1: {{master: embedded, listen: '127.0.0.1:{port}', purge: 0}}\n")
    master = xmlrpc.client.ServerProxy(f"http://127.0.0.1:{port}/")

    def call(method: str, *params: Any) -> Any:
        with contextlib.suppress(OSError):
            return getattr(master, method)("/node", *params)[2]  # type: ignore[index]
        return None

    first = daemon.start()
    daemon.wait_ready(first)
    process = call("getPid")
    report = until(lambda: ask_daemon(Config(name="test", state=daemon.folder / "state")), "the daemon answers")
    assert [(each.worker, each.state, each.pid) for each in without_node(report)] == [
        ("ros1_master", "running", process)
    ]
    call("registerPublisher", "/t", "std_msgs/String", "http://127.0.0.1:1/")
    call("setParam", "/x", 5)
    first.popen.kill()
    first.popen.wait()
    assert call("getPid") == process

    second = daemon.start()
    daemon.wait_ready(second)
    assert call("getPid") == process
    assert call("shutdown", "why") == 0
    os.kill(process, signal.SIGKILL)
    until(lambda: call("getPid") not in (None, process), "the master is restarted")
    process = call("getPid")
    assert call("getParam", "/x") == 5
    second.signal(signal.SIGTERM)
    assert second.popen.wait(40) == 0
    assert call("getPid") is None

    third = daemon.start()
    daemon.wait_ready(third)
    assert call("getParam", "/x") == 5
    assert call("lookupNode", "/node") == "http://127.0.0.1:1/"
    os.kill(call("getPid"), signal.SIGSTOP)  # the master hangs, and the daemon kills it
    third.signal(signal.SIGTERM)
    third.popen.wait(40)
    assert [path.name for path in (daemon.folder / "state").rglob("*.sock")] == []
    master("close")()
