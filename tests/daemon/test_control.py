"""The control socket of a worker that outlives its daemon."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge import state_file
from bridge.config.model import Config
from bridge.daemon import control, protocol, streams
from bridge.daemon.control import Commands, ControlServer, DaemonPipe, with_pipe
from bridge.daemon.local_socket import LocalListener
from bridge.daemon.protocol import Beat, Failed, Hello, NewConfig, decode_command, encode_command, encode_report
from bridge.daemon.worker_channel import Exit, SocketChannel
from bridge.worker import Health
from tests.support.descriptors import no_descriptors
from tests.support.no_threads import no_threads
from tests.support.wait import until
from yarp_compat.selector_loop import SelectorLoop


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


def test_waiting_for_commands_needs_no_wake_ups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit for sending does not make the thread that receives wake up again and again at rest."""
    receive, early, commands = socket.socket.recv, list[str](), list[protocol.Command]()

    def receive_what_has_arrived(sock: socket.socket, size: int, flags: int = 0) -> bytes:
        if threading.current_thread().name == "control-client" and not select.select([sock], [], [], 0)[0]:
            early.append("recv")
        return receive(sock, size, flags)

    monkeypatch.setattr(socket.socket, "recv", receive_what_has_arrived, raising=False)
    server = ControlServer(tmp_path / "socket", "daemon", commands.append)
    with contextlib.closing(server), socket.socket(socket.AF_UNIX) as daemon:
        daemon.settimeout(20)
        daemon.connect(str(tmp_path / "socket"))
        assert b"hello" in daemon.recv(4096)
        for count in range(1, 4):
            daemon.sendall(protocol.encode_command(protocol.Stop()))
            until(lambda count=count: len(commands) == count, "the command has arrived")  # type: ignore[misc]
    until(lambda: all(t.name != "control-client" for t in threading.enumerate()), "the thread ends with its connection")
    assert not early


def test_a_daemon_can_connect_after_a_lack_of_descriptors(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    server = ControlServer(tmp_path / "socket", "daemon", lambda _: None)
    with contextlib.closing(server), socket.socket(socket.AF_UNIX) as daemon:
        daemon.settimeout(20)
        with no_descriptors():
            daemon.connect(str(tmp_path / "socket"))
            until(lambda: "the daemon cannot connect: Too many open files" in caplog.text, "accept failed")
        assert b"hello" in daemon.recv(4096)


def test_a_connection_admitted_late_does_not_replace_a_later_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entered, go_on = threading.Event(), threading.Event()
    admit = LocalListener.admit

    def admit_first_late(listener: LocalListener, client: socket.socket, greeting: bytes) -> bool:
        if not entered.is_set():
            entered.set()
            go_on.wait(20)
        return admit(listener, client, greeting)

    monkeypatch.setattr(LocalListener, "admit", admit_first_late)
    server = ControlServer(tmp_path / "socket", "daemon", lambda _: None)
    with contextlib.closing(server), socket.socket(socket.AF_UNIX) as first, socket.socket(socket.AF_UNIX) as second:
        for daemon in (first, second):
            daemon.settimeout(20)
            daemon.connect(str(tmp_path / "socket"))
            assert entered.wait(20)
        assert b"hello" in second.recv(4096)
        go_on.set()
        assert first.recv(4096) == b""
        server.report(Beat(1, Health("running", "x")))
        assert b"running" in second.recv(4096)


def test_commands_of_a_replaced_connection_are_dropped(tmp_path: Path) -> None:
    """They would take effect after those of the daemon that has replaced it."""
    handled, entered, go_on = list[str](), threading.Event(), threading.Event()
    serving = list[threading.Thread]()

    def handle(command: protocol.Command) -> None:
        assert isinstance(command, NewConfig)
        serving.append(threading.current_thread())
        if command.config.name == "first":
            entered.set()
            assert go_on.wait(20)
        handled.append(command.config.name)

    server = ControlServer(tmp_path / "socket", "daemon", handle)
    with contextlib.closing(server), socket.socket(socket.AF_UNIX) as old, socket.socket(socket.AF_UNIX) as new:
        for daemon, names in ((old, ("first", "late")), (new, ("new",))):
            daemon.settimeout(20)
            daemon.connect(str(tmp_path / "socket"))
            assert b"hello" in daemon.recv(4096)
            daemon.sendall(b"".join(encode_command(NewConfig(Config(name=name))) for name in names))
            assert entered.wait(20)
        until(lambda: handled == ["new"], "the new connection's command is handled")
        go_on.set()
        serving[0].join(20)
        assert handled == ["new", "first"]


def test_a_daemon_can_connect_after_a_lack_of_threads(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    server = ControlServer(tmp_path / "socket", "daemon", lambda _: None)
    with contextlib.closing(server), socket.socket(socket.AF_UNIX) as first, socket.socket(socket.AF_UNIX) as second:
        for daemon in (first, second):
            daemon.settimeout(20)
        with no_threads("control-client"):
            first.connect(str(tmp_path / "socket"))
            assert first.recv(4096) == b""
        assert "the daemon cannot connect: can't start new thread" in caplog.text
        second.connect(str(tmp_path / "socket"))
        assert b"hello" in second.recv(4096)


@contextlib.contextmanager
def listening(config: Config) -> Iterator[tuple[SelectorLoop, SocketChannel, socket.socket]]:
    """A daemon's channel to a worker, and the socket at which the worker accepts its connections."""
    kind, loop = SimpleNamespace(name="tests"), SelectorLoop()
    listener: Any = SimpleNamespace(on_report=lambda _: None, on_exit=lambda _: None)
    channel = SocketChannel(loop, listener, cast("Any", kind), config)
    with contextlib.closing(loop), socket.socket(socket.AF_UNIX) as worker:
        worker.bind(str(state_file.control_socket(config, kind.name)))
        worker.listen()
        worker.settimeout(20)
        yield loop, channel, worker
        channel.detach()


def test_a_line_that_ends_with_its_connection_does_not_spoil_the_next_one(tmp_path: Path) -> None:
    """A worker ends the connection when the daemon does not read for a while, in the middle of a report."""
    with listening(Config(name="test", state=tmp_path)) as (loop, channel, worker):
        for pid, rest in ((101, b'{"beat": '), (102, b"")):
            assert channel.adopt()
            daemon, _ = worker.accept()
            daemon.sendall(encode_report(Hello(pid, "service")) + rest)
            until(lambda pid=pid: loop.step(0.1) or channel.pid == pid, f"process {pid} is connected")
            channel.detach()
            daemon.close()


def test_a_configuration_that_a_lost_connection_did_not_deliver_is_sent_again(tmp_path: Path) -> None:
    """A worker ends the connection when the daemon does not read for a while, just before a reload."""
    config = Config(name="test", state=tmp_path)
    with listening(config) as (loop, channel, worker):
        assert channel.adopt()
        worker.accept()[0].close()
        channel.send(NewConfig(config))
        loop.step(20.0)  # sees the end of the connection
        daemon, _ = worker.accept()
        daemon.settimeout(20)
        with daemon, daemon.makefile("rb") as lines:
            assert decode_command(lines.readline()) == NewConfig(config)


def test_why_a_worker_failed_is_read_after_its_exit(tmp_path: Path) -> None:
    """On a busy machine, the daemon sees the exit before it reads the last report."""
    with listening(Config(name="test", state=tmp_path)) as (loop, channel, worker):
        reports = list[object]()
        listener: Any = channel._listener
        listener.on_report, listener.on_exit = reports.append, reports.append
        assert channel.adopt()
        daemon, _ = worker.accept()
        hello = Hello(101, "daemon")
        daemon.sendall(encode_report(hello))
        until(lambda: loop.step(0.1) or channel.pid == 101, "the worker is connected")
        daemon.sendall(encode_report(Beat(1, Health("running", "x"))) * 3000)  # more than one read
        daemon.sendall(encode_report(Failed("the port is taken")))
        daemon.close()
        channel._process = subprocess.Popen(["true"])
        channel._process.wait()
        channel.poll()
        assert reports[-2:] == [Failed("the port is taken"), Exit(0)]
        assert len(reports) == 3003


def test_why_a_worker_failed_is_reported_before_the_daemon_connects(tmp_path: Path) -> None:
    """On a busy machine, the daemon connects late."""
    server = ControlServer(tmp_path / "socket", "daemon", lambda _: None)
    with contextlib.closing(server), socket.socket(socket.AF_UNIX) as daemon:
        piped = list[protocol.Report]()
        report = with_pipe(server, piped.append)
        report(Beat(1, Health("running", "x")))
        report(Failed("the port is taken"))
        assert piped == [Failed("the port is taken")]
        daemon.settimeout(20)
        daemon.connect(str(tmp_path / "socket"))
        assert b"hello" in daemon.recv(4096)
        report(Failed("the port is taken"))
        assert b"the port is taken" in daemon.recv(4096)
        assert len(piped) == 1


def test_reports_over_the_pipe_are_read_until_the_worker_is_connected(tmp_path: Path) -> None:
    with listening(Config(name="test", state=tmp_path)) as (loop, channel, worker):
        reports = list[object]()
        listener: Any = channel._listener
        listener.on_report = reports.append
        reading, writing = os.pipe()
        channel._start_reports = streams.reader(loop, os.fdopen(reading, "rb"), channel._on_start)
        with os.fdopen(writing, "wb", buffering=0) as pipe:
            assert channel.adopt()
            pipe.write(encode_report(Failed("the port is taken")))
            until(lambda: loop.step(0.1) or reports, "the report is read")
            assert reports == [Failed("the port is taken")]
            daemon, _ = worker.accept()
            daemon.sendall(encode_report(Hello(101, "daemon")))
            until(lambda: loop.step(0.1) or channel.pid == 101, "the worker is connected")
            assert channel._start_reports is None
            daemon.close()


def test_a_worker_stops_if_it_cannot_read_the_daemons_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise it would ignore each later command, and outlive the daemon."""
    ended = threading.Event()
    monkeypatch.setattr(control, "end_process_after", lambda _: ended.set())
    reading, writing = os.pipe()
    pipe, commands = object.__new__(DaemonPipe), Commands()  # the constructor replaces this process's own descriptors
    pipe._input, pipe._lines, pipe._waiting = writing, protocol.Lines(), []
    try:
        pipe.read_to(commands, stop_at_end=True)
        assert commands.get(timeout=20) == protocol.Stop("the daemon has exited")
        assert ended.wait(40), "later it would end the process of the tests"
    finally:
        os.close(reading)
        os.close(writing)


def test_a_configuration_that_cannot_be_parsed_is_a_protocol_error() -> None:
    """The thread that reads the commands must survive errors in the sections of other packages."""

    def parse(_data: dict[str, Any]) -> Config:
        raise ImportError("no module named 'rover'")

    with pytest.raises(protocol.ProtocolError, match="an invalid configuration: no module named 'rover'"):
        decode_command(b'{"config": {}}', parse)
