"""The daemon's notifications to systemd, on a real datagram socket."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.daemon import notify
from bridge.daemon.notify import Notifier
from tests.peers.daemon.daemon import Daemon
from tests.support.process import Process, is_stopped
from tests.support.wait import until


class Systemd:
    """The receiving end of ``$NOTIFY_SOCKET``.

    Its queue has room for only ten datagrams on some systems, so a thread reads them while a test does something else;
    with ``lock``, nothing is read.
    """

    def __init__(self, path: Path, watchdog: float) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.setblocking(False)
        self.env = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": str(int(watchdog * 1e6))}
        self.messages: list[str] = []
        self.lock = threading.RLock()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._closed.is_set():
            select.select([self._socket], [], [], 0.1)
            self.read()

    def read(self) -> list[str]:
        """Read what has arrived; return everything so far."""
        with self.lock:
            while True:
                try:
                    self.messages.append(self._socket.recv(65536).decode())
                except BlockingIOError:
                    return list(self.messages)

    def expect(self, text: str, seconds: float = 40.0) -> None:
        until(lambda: any(text in message for message in self.read()), f"{text} among {self.messages}", seconds)

    def count(self, text: str) -> int:
        return sum(text in message for message in self.read())

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        self._socket.close()


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    systemd = Systemd(tmp_path / "notify", 1.0)
    yield systemd
    systemd.close()


def test_systemd_is_notified_of_status_readiness_and_stopping(daemon: Daemon, systemd: Systemd) -> None:
    process = daemon.start(env=systemd.env)
    systemd.expect("READY=1")
    line = "STATUS=router running: router fine | ros1 running: ros1 fine | ros2 running: ros2 fine"
    assert line in systemd.messages
    assert systemd.messages.index(line) < systemd.messages.index("READY=1")
    process.signal(signal.SIGTERM)
    assert process.popen.wait(40) == 0
    systemd.expect("STOPPING=1")


def test_what_systemd_has_no_room_for_is_not_lost(systemd: Systemd, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its queue has room for ten or some hundred datagrams, depending on the system."""
    monkeypatch.setattr(notify, "_SECONDS", 40.0)
    notifier = Notifier(systemd.env)
    ready = threading.Thread(target=notifier.ready)
    with systemd.lock:
        for number in range(2000):
            notifier.status(str(number))
        ready.start()
    systemd.expect("READY=1")
    ready.join()
    assert "STATUS=1999" not in systemd.messages
    notifier.status("1999")
    systemd.expect("STATUS=1999")
    notifier.close()


def test_the_daemon_is_ready_even_if_a_side_does_not_work(daemon: Daemon, systemd: Systemd) -> None:
    daemon.order("ros1", "never")
    daemon.order("ros2", "wait")
    daemon.start(env=systemd.env)
    systemd.expect("READY=1")
    systemd.expect("ros1 cannot work: unknown robot | ros2 waiting: ros2 fine")


def test_status_reports_restarts_and_refused_reloads(daemon: Daemon, systemd: Systemd) -> None:
    process = daemon.start(env=systemd.env)
    systemd.expect("READY=1")
    os.kill(daemon.wait_started("ros1"), signal.SIGKILL)
    systemd.expect("ros1 running: ros1 fine (restarted 1x)")
    daemon.configure("hubb: 1\n")
    process.signal(signal.SIGHUP)
    systemd.expect("reload refused, the running configuration is kept: " + str(daemon.file) + ":3:1: hubb: unknown key")


def test_reload_is_announced(daemon: Daemon, systemd: Systemd) -> None:
    process = daemon.start(env=systemd.env)
    systemd.expect("READY=1")
    process.signal(signal.SIGHUP)
    systemd.expect("RELOADING=1\nMONOTONIC_USEC=")
    until(lambda: systemd.count("READY=1") == 2, "the daemon is ready again")


def test_watchdog_is_fed_unless_the_daemon_is_stopped(daemon: Daemon, systemd: Systemd) -> None:
    process = daemon.start(env=systemd.env)
    systemd.expect("READY=1")
    fed = systemd.count("WATCHDOG=1")
    until(lambda: systemd.count("WATCHDOG=1") >= fed + 3, "the watchdog is fed")
    process.signal(signal.SIGSTOP)
    until(lambda: is_stopped(process.pid), "the daemon is suspended")
    fed = systemd.count("WATCHDOG=1")
    time.sleep(1.5)  # longer than the watchdog's interval
    assert systemd.count("WATCHDOG=1") == fed
    process.signal(signal.SIGCONT)
    until(lambda: systemd.count("WATCHDOG=1") > fed, "the watchdog is fed again")


def test_watchdog_is_not_fed_if_only_the_loop_hangs(daemon: Daemon, systemd: Systemd) -> None:
    ticks, hangs = daemon.folder / "ticks", daemon.folder / "hangs"
    command = [sys.executable, "-m", "tests.peers.daemon.hanging", str(daemon.file), str(ticks), str(hangs)]
    process = Process(command, {**daemon.env, **systemd.env})
    daemon.processes.append(process)
    systemd.expect("READY=1")
    fed = systemd.count("WATCHDOG=1")
    until(lambda: systemd.count("WATCHDOG=1") > fed, "the watchdog is fed")
    process.signal(signal.SIGUSR1)
    until(hangs.exists, "the daemon hangs")
    fed, ticked = systemd.count("WATCHDOG=1"), ticks.stat().st_size
    time.sleep(1.5)  # longer than the watchdog's interval
    assert systemd.count("WATCHDOG=1") == fed
    until(lambda: ticks.stat().st_size > ticked, "another thread of the daemon continues")
    process.signal(signal.SIGKILL)


def test_workers_do_not_inherit_the_daemons_systemd_variables(daemon: Daemon, systemd: Systemd) -> None:
    daemon.start(env=systemd.env)
    systemd.expect("READY=1")
    for worker in ("router", "ros1", "ros2"):
        environ = Path(f"/proc/{daemon.wait_started(worker)}/environ").read_bytes()
        assert b"NOTIFY_SOCKET" not in environ
        assert b"WATCHDOG_USEC" not in environ


def test_an_abstract_socket_is_notified_and_a_foreign_watchdog_is_not_fed(tmp_path: Path) -> None:
    name = f"midspan-test-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind("\0" + name)
        receiver.settimeout(5)
        environ = {"NOTIFY_SOCKET": "@" + name, "WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"}
        notifier = Notifier(environ)
        notifier.feed_watchdog()
        notifier.status("two\nlines")
        notifier.status("two lines")
        notifier.ready()
        assert [receiver.recv(100) for _ in range(2)] == [b"STATUS=two lines", b"READY=1"]
        notifier.close()


@pytest.mark.parametrize("environ", [{}, {"NOTIFY_SOCKET": "/nowhere/at/all"}, {"WATCHDOG_USEC": "x"}])
def test_without_systemd_nothing_is_sent(environ: dict[str, str]) -> None:
    notifier = Notifier(environ)
    notifier.ready()
    notifier.feed_watchdog()
    notifier.close()
    assert notifier.watchdog_interval == 0.0
