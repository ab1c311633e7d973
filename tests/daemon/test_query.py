"""The daemon's status on its socket."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import socket
import threading
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.daemon.local_socket import LocalListener
from bridge.daemon.query import QueryServer, ask_daemon, reload_daemon
from tests.peers.daemon.daemon import Daemon
from tests.support.descriptors import no_descriptors
from tests.support.wait import until
from yarp_compat.selector_loop import SelectorLoop

pytestmark = pytest.mark.thorough


def test_the_daemon_also_reports_workers_that_do_not_run(daemon: Daemon) -> None:
    config = Config(name="test", state=daemon.folder / "state")
    assert ask_daemon(config) is None
    daemon.order("ros1", "never")
    daemon.configure("ros2: {enabled: false}\n")
    process = daemon.start()
    daemon.wait_ready(process)
    status = ask_daemon(config, 20.0)
    assert status is not None
    assert (status.daemon, status.pid, status.refused) == ("test", process.pid, "")
    assert status.config == str(daemon.file)
    workers = {worker["worker"]: worker for worker in status.document()["workers"]}
    assert workers["router"]["phase"] == "running"
    assert workers["router"]["pid"] == daemon.wait_started("router")
    assert (workers["ros1"]["phase"], workers["ros1"]["text"]) == ("cannot work", "unknown robot")
    assert workers["ros2"]["phase"] == "off"
    assert "ros1 cannot work: unknown robot" in status.status


def test_refused_reload_and_restarts_are_reported(daemon: Daemon) -> None:
    config = Config(name="test", state=daemon.folder / "state")
    process = daemon.start()
    daemon.wait_ready(process)
    os.kill(daemon.wait_started("ros1"), signal.SIGKILL)
    daemon.wait_started("ros1", 2)
    daemon.configure("hubb: 1\n")
    process.signal(signal.SIGHUP)
    until(lambda: (status := ask_daemon(config)) is not None and status.refused, "refused")
    status = ask_daemon(config, 20.0)
    assert status is not None
    assert "unknown key 'hubb'" in status.refused
    assert [report.restarts for report in status.workers if report.worker == "ros1"] == [1]
    process.signal(signal.SIGTERM)
    assert process.popen.wait(40) == 0
    assert not (daemon.folder / "state" / "test.daemon.sock").exists()


def test_a_file_instead_of_a_socket_yields_none(tmp_path: Path) -> None:
    (tmp_path / "test.daemon.sock").write_text("no socket")
    assert ask_daemon(Config(name="test", state=tmp_path)) is None
    assert ask_daemon(Config(name="x" * 60, state=tmp_path / ("y" * 90))) is None


def test_a_daemon_of_an_earlier_release_is_not_reported_as_reloaded(tmp_path: Path) -> None:
    """Such a daemon sends its status to each client, and ignores the request."""
    listener = LocalListener(tmp_path / "test.daemon.sock")

    def respond() -> None:
        client, _ = listener.sock.accept()
        with client:
            client.sendall(b'{"daemon": "test", "refused": "", "status": "running"}')
            client.recv(1, socket.MSG_PEEK)  # closes the connection with the request unread

    responder = threading.Thread(target=respond)
    responder.start()
    with contextlib.closing(listener):
        assert "earlier release" in (reload_daemon(Config(name="test", state=tmp_path)) or "")
    responder.join(20)


def test_without_descriptors_a_client_is_disconnected_and_the_loop_does_not_spin(tmp_path: Path) -> None:
    loop = SelectorLoop()
    server = QueryServer(loop, tmp_path / "sock", {"status": lambda _: {}})
    with contextlib.closing(loop), contextlib.closing(server), socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5.0)
        client.connect(str(tmp_path / "sock"))
        with no_descriptors():
            loop.step(5.0)
            assert client.recv(100) == b"", "closed without a response; a pending connection would make the loop spin"
        with socket.socket(socket.AF_UNIX) as again:
            again.settimeout(5.0)
            again.connect(str(tmp_path / "sock"))
            again.sendall(b'{"verb": "status"}\n')
            for _ in range(2):  # one step accepts, the next one reads
                loop.step(5.0)
            assert again.recv(100) == b"{}"


def test_a_response_larger_than_the_buffer_arrives_complete_and_the_request_runs_once(tmp_path: Path) -> None:
    loop = SelectorLoop()
    requests: list[str] = []

    def respond(request: dict[str, Any]) -> dict[str, Any]:
        requests.append(request["verb"])
        return {"log": "x" * 900_000}

    server = QueryServer(loop, tmp_path / "sock", {"log": respond})
    with contextlib.closing(loop), contextlib.closing(server), socket.socket(socket.AF_UNIX) as client:
        client.setblocking(False)
        client.connect(str(tmp_path / "sock"))
        client.sendall(b'{"verb": "log"}\n')
        for _ in range(2):  # one step accepts, the next one reads
            loop.step(5.0)
        client.sendall(b"\n")
        response, parts = b"", 0
        while not response.endswith(b"}"):
            loop.step(0.0)
            with contextlib.suppress(BlockingIOError):
                response += client.recv(1 << 16)
            parts += 1
            assert parts < 1000, f"only {len(response)} bytes arrived"
    assert len(response) > 900_000
    assert requests == ["log"]


def test_the_daemon_reports_why_the_state_folder_is_unusable(daemon: Daemon) -> None:
    config = Config(name="test", state=daemon.folder / "state")
    process = daemon.start()
    daemon.wait_ready(process)
    (daemon.folder / "state").rename(daemon.folder / "elsewhere")
    daemon.expect_output(
        process, f"the state folder {config.state}: No such file or directory; make it writable, or set"
    )
    (daemon.folder / "elsewhere").rename(daemon.folder / "state")
    daemon.expect_output(process, "the state folder is writable again")
    status = ask_daemon(config, 20.0)
    assert status is not None
    assert "state folder" not in status.status


def test_a_client_that_cannot_be_watched_is_disconnected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loop = SelectorLoop()
    server = QueryServer(loop, tmp_path / "sock", {})
    with contextlib.closing(loop), contextlib.closing(server), socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5.0)
        client.connect(str(tmp_path / "sock"))

        def fail(*_: object) -> None:
            raise OSError(errno.ENOSPC, "no space left on device")

        monkeypatch.setattr(loop, "on_readable", fail)
        loop.step(5.0)
        assert client.recv(100) == b""
