"""Sockets of the state folder, as Unix sockets and over loopback TCP, as on Windows."""

from __future__ import annotations

import contextlib
import json
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.config.model import Config
from bridge.daemon import control, local_socket
from bridge.daemon.control import ControlServer
from bridge.daemon.local_socket import LocalListener
from bridge.daemon.protocol import Command, NewConfig, encode_command
from bridge.daemon.query import QueryServer, ask_daemon, request
from tests.support.wait import until
from yarp_compat.selector_loop import SelectorLoop


@pytest.fixture
def _tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the test's sockets use TCP."""
    monkeypatch.setattr(local_socket, "_UNIX", False)


@pytest.fixture(params=["unix", "tcp"])
def _transport(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Test both transports."""
    monkeypatch.setattr(local_socket, "_UNIX", request.param == "unix")


@contextlib.contextmanager
def query_server(folder: Path) -> Iterator[Config]:
    """A daemon's socket, whose loop runs on a thread."""
    loop, closing = SelectorLoop(), threading.Event()
    verbs = {
        "status": lambda _: {"daemon": "test", "pid": 7, "workers": []},
        "log": lambda req: {"after": req["after"]},
    }
    server = QueryServer(loop, folder / "test.daemon.sock", verbs)

    def run() -> None:
        while not closing.is_set():
            loop.step(0.2)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield Config(name="test", state=folder)
    finally:
        closing.set()
        loop.wake()
        thread.join()
        server.close()
        loop.close()


def port_of(path: Path) -> int:
    return int(json.loads(path.read_text(encoding="utf-8"))[0])


def connect_without_secret(path: Path) -> socket.socket:
    """Connect without the secret, as any user of the machine can."""
    return socket.create_connection(("127.0.0.1", port_of(path)), 20.0)


@pytest.mark.usefixtures("_transport")
def test_requests_get_their_response(tmp_path: Path) -> None:
    with query_server(tmp_path) as config:
        status = ask_daemon(config, 20.0)
        assert status is not None
        assert status.pid == 7
        assert request(config, "log", 20.0, after=3) == {"after": 3}
        unknown = request(config, "shutdown", 20.0)
        assert unknown is not None
        assert "not a request" in unknown["error"]
    assert list(tmp_path.iterdir()) == []
    assert ask_daemon(config) is None


@pytest.mark.usefixtures("_transport")
def test_only_the_owner_can_use_the_file(tmp_path: Path) -> None:
    listener = LocalListener(tmp_path / "socket")
    assert stat.S_IMODE((tmp_path / "socket").stat().st_mode) == 0o600
    listener.close()


@pytest.mark.usefixtures("_transport")
def test_a_listener_replaces_the_file_of_a_dead_one(tmp_path: Path) -> None:
    (tmp_path / "socket").write_text("rest")
    listener = LocalListener(tmp_path / "socket")
    accepted: list[bool] = []

    def accept() -> None:
        client, _ = listener.sock.accept()
        with client:
            accepted.append(listener.admit(client, local_socket.receive(client, listener.greeting)))

    thread = threading.Thread(target=accept)
    thread.start()
    local_socket.connect(tmp_path / "socket", 20.0).close()
    thread.join()
    listener.close()
    assert accepted == [True]


@pytest.mark.parametrize(
    "content", ["", "rest", "[]", "{}", '["x", 1, 2]', "[1, 2]", "[99999999, 1, 2]", "\xff", "[0, 1, 2]"]
)
@pytest.mark.usefixtures("_transport")
def test_a_file_without_an_address_is_not_a_listener(tmp_path: Path, content: str) -> None:
    (tmp_path / "socket").write_text(content, encoding="latin-1")
    with pytest.raises(OSError, match=r"."):
        local_socket.connect(tmp_path / "socket", 1.0)


@pytest.mark.usefixtures("_transport")
def test_closing_ends_a_waiting_thread(tmp_path: Path) -> None:
    before = set(threading.enumerate())  # the thread of a server that has just closed may still be ending
    server = ControlServer(tmp_path / "socket", "daemon", lambda _: None)
    (accepting,) = (thread for thread in threading.enumerate() if thread.name == "control" and thread not in before)
    server.close()
    until(lambda: not accepting.is_alive(), "the thread ends")


# -- other users of the machine, who can connect to the port -----------------------------------------------------------


@pytest.mark.usefixtures("_tcp")
def test_requests_without_the_secret_are_refused(tmp_path: Path) -> None:
    with query_server(tmp_path) as config:
        path = tmp_path / "test.daemon.sock"
        for first in (b"", b"0" * 64, b"0" * 63):
            with connect_without_secret(path) as client:
                client.sendall(first + b'{"verb": "status"}\n')
                if len(first) < 64:
                    client.shutdown(socket.SHUT_WR)
                with contextlib.suppress(ConnectionResetError):
                    assert client.recv(1000) == b""
        with contextlib.ExitStack() as stack:
            for _ in range(20):  # silent connections do not exclude the owner
                stack.enter_context(connect_without_secret(path))
            until(lambda: ask_daemon(config, 5.0), "the owner gets a response")


@pytest.mark.usefixtures("_tcp")
def test_commands_without_the_secret_are_refused(tmp_path: Path) -> None:
    commands: list[Command] = []
    server = ControlServer(tmp_path / "socket", "daemon", commands.append)
    try:
        owner = local_socket.connect(tmp_path / "socket", 20.0)
        with owner:
            assert b"hello" in owner.recv(4096)
            with connect_without_secret(tmp_path / "socket") as other:
                other.sendall(b"0" * 64 + encode_command(NewConfig(Config(name="evil"))))
                with contextlib.suppress(ConnectionResetError):
                    assert other.recv(1000) == b"", "the other user gets no report"
            owner.sendall(encode_command(NewConfig(Config(name="test"))))
            until(lambda: commands, "the owner stays connected")
    finally:
        server.close()
    assert [command.config.name for command in commands if isinstance(command, NewConfig)] == ["test"]


def test_greeting_has_one_time_limit_in_total() -> None:
    """A client that sends one byte at a time occupies its thread no longer than a silent one."""
    near, far = socket.socketpair()
    with near, far:
        near.settimeout(0.2)
        ended = threading.Event()

        def send_slowly() -> None:
            for _ in range(100):
                if ended.wait(0.05):
                    return
                far.sendall(b"0")

        thread = threading.Thread(target=send_slowly)
        thread.start()
        try:
            with pytest.raises(TimeoutError):
                local_socket.receive(near, 50)
        finally:
            ended.set()
            thread.join()
        assert near.gettimeout() == 0.2


@pytest.mark.usefixtures("_tcp")
def test_silent_clients_do_not_exclude_the_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "_MAX_GREETINGS", 2)
    server = ControlServer(tmp_path / "socket", "daemon", lambda _: None)
    try:
        with contextlib.ExitStack() as stack:
            for _ in range(6):
                stack.enter_context(connect_without_secret(tmp_path / "socket"))
            owner = stack.enter_context(local_socket.connect(tmp_path / "socket", 20.0))
            assert b"hello" in owner.recv(4096)
    finally:
        server.close()


@pytest.mark.usefixtures("_tcp")
def test_a_program_at_the_port_of_a_dead_listener_gets_no_configuration(tmp_path: Path) -> None:
    """This can happen after a reboot, and a configuration may contain passwords."""
    received: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        (tmp_path / "socket").write_text(json.dumps([server.getsockname()[1], "a" * 64, "b" * 64]))

        def impostor() -> None:
            client, _ = server.accept()
            with client:
                received.append(local_socket.receive(client, 64))
                client.sendall(b"c" * 64)
                received.append(client.recv(1000))

        thread = threading.Thread(target=impostor)
        thread.start()
        with pytest.raises(PermissionError, match="belongs to another program"):
            local_socket.connect(tmp_path / "socket", 20.0)
        thread.join()
    assert received == [b"a" * 64, b""]


@pytest.mark.usefixtures("_tcp")
def test_secrets_differ_between_listeners(tmp_path: Path) -> None:
    texts = set()
    for name in ("first", "second"):
        listener = LocalListener(tmp_path / name)
        texts |= {text for text in json.loads((tmp_path / name).read_text()) if isinstance(text, str)}
        listener.close()
    assert [len(text) for text in texts] == [64] * 4
    assert list(tmp_path.iterdir()) == []
