"""``midspan yarp``: every verb, with a name server and ports in this process."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bridge.cli.main import main
from tests.cli.conftest import Outcome
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.server import NameServer
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.profile import Profile

Yarp = Callable[..., Outcome]


@pytest.fixture(name="server")
def fixture_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[NameServer]:
    """A name server whose address is in yarp.conf."""
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    with NameServer(port=free_port(room=20), gc_seconds=0) as server:
        (tmp_path / "yarp.conf").write_text(f"127.0.0.1 {server.address.port} yarp\n")
        yield server


@pytest.fixture(name="yarp")
def fixture_yarp(capsys: pytest.CaptureFixture[str]) -> Yarp:
    """The command ``midspan yarp``."""

    def run(*words: str) -> Outcome:
        capsys.readouterr()
        code = main(["yarp", *words])
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return run


class Owner:
    """A port that stores what it receives, and replies with ``got`` and the received content."""

    def __init__(self, name: str, server: NameServer) -> None:
        self.received: list[list[object]] = []
        self.bytes: list[bytes] = []
        self.port = PortCore(name, on_message=self._on_message, naming=NameClient(server.address))
        self.port.open()

    def _on_message(self, message: PortMessage) -> None:
        values = decode(message.payload)
        self.bytes.append(bytes(message.payload))
        self.received.append(values)
        message.reply(encode(["got", *values], Profile.YARP3))


@pytest.fixture(name="owners")
def fixture_owners(server: NameServer) -> Iterator[Callable[[str], Owner]]:
    """A function that opens ports, which are closed after the test."""
    opened: list[Owner] = []

    def make(name: str) -> Owner:
        opened.append(Owner(name, server))
        return opened[-1]

    yield make
    for owner in opened:
        owner.port.close()


def test_where_shows_the_name_server(yarp: Yarp, server: NameServer, tmp_path: Path) -> None:
    """The output shows the address, the file, and whether the server responds; if not, the exit code is 1."""
    done = yarp("where")
    assert (done.code, done.out.splitlines()[0]) == (0, f"/root at 127.0.0.1 port {server.address.port}, responds")
    assert str(tmp_path / "yarp.conf") in done.out
    port = free_port()
    outcome = yarp("where", "--json", "--server", f"127.0.0.1:{port}")
    assert outcome.code == 1
    assert outcome.json() == {"host": "127.0.0.1", "port": port, "name": "/root", "file": None, "reachable": False}
    assert "Start it" in outcome.err


def test_without_any_name_server_the_error_names_the_missing_file(
    yarp: Yarp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error is one line, and names the missing file."""
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path / "none"))
    done = yarp("list")
    assert done.code == 1
    assert str(tmp_path / "none" / "yarp.conf") in done.err
    assert done.err.startswith("midspan: ")
    assert done.err.count("\n") == 1


@pytest.mark.parametrize("verb", ["read", "write"])
def test_a_port_name_without_a_slash_is_refused(yarp: Yarp, server: NameServer, verb: str) -> None:
    """As YARP refuses it."""
    done = yarp(verb, "noslash", *(["--message", "x"] if verb == "write" else ["--count", "0"]))
    assert done.code == 1
    assert "'noslash' is not a port name: YARP's names begin with a slash, as in /noslash" in done.err
    assert [line.split()[0] for line in yarp("list").out.splitlines()] == ["/root"]


def test_ports_are_listed_and_queried(yarp: Yarp, server: NameServer, owners: Callable[[str], Owner]) -> None:
    """Tests the verbs list, name, exists and ping."""
    owner, _ = owners("/a/b"), owners("/c")
    assert [line.split()[0] for line in yarp("list").out.splitlines()] == ["/a/b", "/c", "/root"]
    assert yarp("list", "/a", "--json").json() == [
        {"name": "/a/b", "host": "127.0.0.1", "port": owner.port.contact.port, "carrier": "tcp"}
    ]
    assert yarp("name", "set", "/c", "key", "'two words'", "5").code == 0
    assert yarp("name", "bot", "get", "/c", "key").out == '"\'two" 5 "words\'"\n'
    assert yarp("name", "set", "/c", "key", '"two words"').out == "port /c property key = two words\n"
    assert yarp("name", "query", "/c").out == f"{server.registry.find('/c').registration}\n"  # type: ignore[union-attr]
    assert yarp("name", "unsubscribe", "/a", "/b").out == "[ok]\n"
    assert (yarp("exists", "/c").code, yarp("exists", "/d").code) == (0, 1)
    assert "is not registered" in yarp("exists", "/d").err
    assert "This is /c at tcp://127.0.0.1" in yarp("ping", "/c").out
    done = yarp("ping", "/a")
    assert (done.code, done.err) == (1, "midspan: port /a is not registered with the name server; did you mean /a/b?\n")


def test_ports_are_connected_and_disconnected(yarp: Yarp, owners: Callable[[str], Owner]) -> None:
    """Connects, checks and disconnects, also with another carrier and with missing ports."""
    writer, _ = owners("/w"), owners("/r")
    assert yarp("exists", "/w", "/r").code == 1
    assert yarp("connect", "/w", "/r").out == "Added connection from /w to tcp://r\n"
    assert yarp("exists", "/w", "/r").out == "/w is connected to /r by tcp\n"
    assert yarp("connect", "/w", "/r", "fast_tcp").out == "Added connection from /w to fast_tcp://r\n"
    assert [r.carrier for r in writer.port.outputs()] == ["fast_tcp"]
    assert yarp("disconnect", "/w", "/r").out == "Removed connection from /w to /r\n"
    for command, problem in (
        (("disconnect", "/w", "/r"), "no connection from /w to /r"),
        (("connect", "/w", "/rr"), "did you mean /r"),
        (("connect", "/w", "/r", "smoke"), "could not connect to /r"),
        (("connect", "w", "/r"), "port w is not registered"),
    ):
        done = yarp(*command)
        assert done.code == 1
        assert problem in done.err


def test_a_persistent_connection_waits_for_its_ports(yarp: Yarp, owners: Callable[[str], Owner]) -> None:
    """The connection is requested before the ports exist."""
    owners("/w")
    assert yarp("connect", "--persist-from", "/w", "/r", "fast_tcp").code == 0
    assert yarp("connect").out == "/w -> fast_tcp://r [from]\n"
    owners("/r")
    until(lambda: yarp("exists", "/w", "/r").code == 0, "connected")
    assert yarp("disconnect", "--persist", "/w", "/r").code == 0
    assert yarp("connect", "/w").out == ""


def test_clean_removes_only_dead_ports(yarp: Yarp, server: NameServer, owners: Callable[[str], Owner]) -> None:
    """All dead ports are removed, and no others."""
    owners("/live")
    NameClient(server.address).register("/dead", "127.0.0.1", free_port())
    done = yarp("clean", "--timeout", "20")
    assert "/dead does not respond" in done.out
    assert [line.split()[0] for line in yarp("list").out.splitlines()] == ["/live", "/root"]
    assert yarp("clean").out == "all registered ports respond\n"


def test_write_sends_messages_to_each_port(
    yarp: Yarp, owners: Callable[[str], Owner], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages come from --message and from standard input, and go to one port and to several."""
    first, second = owners("/one"), owners("/two")
    second.port.profile = Profile.YARP4
    assert yarp("write", "/w", "/one", "fast_tcp://two", "-m", "set speed 0.5", "-m", '(a b) "c d"').code == 0
    assert first.received == [["set", "speed", 0.5], [["a", "b"], "c d"]]
    until(lambda: second.received == first.received, "both ports have the messages")
    assert first.bytes[0] == encode(["set", "speed", 0.5], Profile.YARP3)
    assert second.bytes[0] == encode(["set", "speed", 0.5], Profile.YARP4)
    monkeypatch.setattr(sys, "stdin", io.StringIO("1 2\n\n3\n"))
    assert yarp("write", "...", "/one", "--yarp4").code == 0
    assert first.received[2:] == [[1, 2], [3]]
    done = yarp("write", "/one", "-m", "x")
    assert done.code == 1
    assert "/one is in use" in done.err
    assert "Do not know how to connect" in yarp("write", "...", "/none", "-m", "x").err
    assert "no port is connected" in yarp("write", "/w", "-m", "x").err


def test_read_prints_received_messages(yarp: Yarp, server: NameServer, owners: Callable[[str], Owner]) -> None:
    """Messages of another port are printed with their envelopes, as text and as JSON, in either dialect."""
    source = owners("/source")
    stop = threading.Event()

    def write() -> None:
        while not stop.wait(0.01):
            source.port.write(encode(["hi there", 1.5], Profile.YARP4), "7 12.5")

    thread = threading.Thread(target=write)
    thread.start()
    try:
        done = yarp("read", "/in", "/source", "--count", "2", "--envelope")
        assert (done.code, done.out) == (0, '[7 12.5] "hi there" 1.5\n' * 2)
        done = yarp("read", "...", "/source", "--carrier", "fast_tcp", "--count", "1", "--json")
        assert done.json() == {"from": "/source", "envelope": "7 12.5", "text": '"hi there" 1.5'}
        assert yarp("read", "/in", "/none", "--count", "1").code == 1
        assert yarp("read", "/source", "--count", "1").code == 1
    finally:
        stop.set()
        thread.join()
    assert NameClient(server.address).query("/in") is None


def test_signal_ends_the_command(server: NameServer) -> None:
    """A terminated reader unregisters its name."""
    names = NameClient(server.address)
    reader = Process([sys.executable, "-m", "bridge.cli.main", "yarp", "read", "/in"], os.environ)
    try:
        until(lambda: "is open" in reader.output(), "the reader is running", seconds=30.0)
        assert names.query("/in") is not None
        reader.signal(signal.SIGTERM)
        assert reader.popen.wait(40.0) == 0, reader.output()
        assert names.query("/in") is None
    finally:
        reader.stop()


def test_rpc_prints_replies_of_the_owner_and_of_the_port(
    yarp: Yarp, owners: Callable[[str], Owner], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Replies come from a port's owner, or from the port itself."""
    owners("/p")
    assert yarp("rpc", "/p", "-m", "get 1.5 (a b)").out == "got get 1.5 (a b)\n"
    monkeypatch.setattr(sys, "stdin", io.StringIO("one\ntwo\n"))
    assert yarp("rpc", "/p").out == "got one\ngot two\n"
    assert yarp("rpc", "/p", "--admin", "-m", "[ver]").out == "[ver] 1 2 3\n"
    assert yarp("rpc", "/none", "-m", "x").code == 1


@pytest.mark.parametrize(
    "words",
    [
        ("list", "--server", "nowhere"),
        ("list", "--server", "h:0"),
        ("list", "--timeout", "x"),
        ("connect", "--persist", "--persist-to"),
        (),
    ],
)
def test_wrong_usage_exits_with_2(words: tuple[str, ...]) -> None:
    """The exit code is 2."""
    with pytest.raises(SystemExit) as ended:
        main(["yarp", *words])
    assert ended.value.code == 2


def test_timeout_must_be_positive(yarp: Yarp) -> None:
    """A time limit must be more than 0 s."""
    for seconds in ("0", "-1", "nan", "inf"):
        assert "--timeout must be more than" in yarp("list", "--timeout", seconds).err


def test_server_keeps_its_names_over_a_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server writes yarp.conf, serves, exits on SIGTERM, and restores its names after a restart."""
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    port = free_port(room=20)
    args = [sys.executable, "-m", "bridge.cli.main", "yarp", "server", "--write", "--port", str(port)]
    names = NameClient()
    for turn in range(2):
        server = Process(args, os.environ)
        try:
            until(lambda server=server: "web page: " in server.output(), "the server is running", seconds=30.0)
            assert (tmp_path / "yarp.conf").read_text() == f"127.0.0.1 {port} yarp\n"
            if turn == 0:
                names.register("/p")
            assert names.query("/p") is not None
            server.signal(signal.SIGTERM)
            assert server.popen.wait(40.0) == 0, server.output()
        finally:
            server.stop()
    assert json.loads((tmp_path / "yarp.names.json").read_text())["ports"][0][0] == "/p"


def test_a_name_server_that_cannot_start_reports_the_reason(yarp: Yarp, server: NameServer) -> None:
    """Its address is in use, or its port number is invalid."""
    assert "Another one may be running there" in yarp("server").err
    assert "--port must be a number" in yarp("server", "--port", "70000").err
