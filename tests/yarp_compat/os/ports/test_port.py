"""`Port`, `RpcServer` and `RpcClient`: reading, writing and replying."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

import yarp_compat as yarp
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.pythonic import Client
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

pytestmark = pytest.mark.usefixtures("local")


@pytest.fixture
def pool() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


def opened(kind: type = yarp.Port, name: str = "...") -> yarp.Port:
    port = kind()
    assert port.open(name)
    return port


def connected() -> tuple[yarp.Port, yarp.Port]:
    reader, writer = opened(name="/r"), opened(name="/w")
    assert writer.addOutput("/r")
    until(reader.getInputCount, "the reader is connected")
    return reader, writer


def test_port_writes_to_another(pool: ThreadPoolExecutor) -> None:
    reader, writer = connected()
    sent = pool.submit(writer.write, yarp.Bottle("hello 1 2.5 (a b)"))
    got = yarp.Bottle()
    assert reader.read(got)
    assert got.toString() == "hello 1 2.5 (a b)"
    assert sent.result(20)
    assert (writer.getOutputCount(), reader.getInputCount(), reader.getOutputCount()) == (1, 1, 0)


def test_writer_waits_until_its_message_is_read(pool: ThreadPoolExecutor) -> None:
    reader, writer = connected()
    sent = pool.submit(writer.write, yarp.Bottle("1"))
    until(writer.isWriting, "the message is being sent")
    assert not sent.done()
    got = yarp.Bottle()
    assert reader.read(got)
    assert sent.result(20)


def test_background_writer_does_not_block() -> None:
    reader, writer = connected()
    writer.enableBackgroundWrite(True)
    for number in range(5):
        bottle = yarp.Bottle()
        bottle.addInt32(number)
        assert writer.write(bottle)
    got = yarp.Bottle()
    seen = []
    while not seen or seen[-1] < 4:
        assert reader.read(got)
        seen.append(got.get(0).asInt32())
    assert seen == sorted(seen)


def test_every_type_of_data_is_transferred(pool: ThreadPoolExecutor) -> None:
    reader, writer = connected()
    vector = yarp.Vector([1.0, 2.0, 3.5])
    for sent, empty in (
        (vector, yarp.Vector()),
        (yarp.Stamp(3, 1.5), yarp.Stamp()),
        (yarp.Property("(a 1)"), yarp.Property()),
    ):
        done = pool.submit(writer.write, sent)
        assert reader.read(empty)
        assert empty.to_bytes() == sent.to_bytes()
        assert done.result(20)


@pytest.mark.parametrize("is_read", [False, True])
def test_closing_server_sends_no_empty_reply(pool: ThreadPoolExecutor, is_read: bool) -> None:
    """This holds for an unread request and for one that was read but not answered."""
    server, client = opened(yarp.RpcServer, "/s"), opened(yarp.RpcClient, "/c")
    assert client.addOutput("/s")
    got = yarp.Bottle("as it was")
    future = pool.submit(client.write, yarp.Bottle("question"), got)
    if is_read:
        assert server.read(yarp.Bottle())
    else:
        core = server._core
        until(lambda: core.counters.received, "the request has arrived")
    server.close()
    assert future.result(20) is False
    assert got.toString() == "as it was"


def test_message_of_another_type_is_not_read(pool: ThreadPoolExecutor) -> None:
    reader, writer = connected()
    done = pool.submit(writer.write, yarp.Bottle("not a vector"))
    vector = yarp.Vector([7.0])
    assert not reader.read(vector)
    assert vector.get(0) == 7.0
    assert done.result(20)


def test_envelopes_are_sent_and_read(pool: ThreadPoolExecutor) -> None:
    reader, writer = connected()
    stamp, got = yarp.Stamp(12, 1795143618.25), yarp.Stamp()
    assert writer.setEnvelope(stamp)
    for _ in range(2):  # the envelope is kept until another is set
        done = pool.submit(writer.write, yarp.Bottle("x"))
        assert reader.read(yarp.Bottle())
        assert reader.getEnvelope(got)
        assert (got.getCount(), got.getTime()) == (12, 1795143618.25)
        assert done.result(20)
    assert not opened().getEnvelope(got)


def test_requests_get_replies(pool: ThreadPoolExecutor) -> None:
    server, client = opened(yarp.RpcServer, "/s"), opened(yarp.RpcClient, "/c")
    assert client.addOutput("/s")
    answer = yarp.Bottle()
    future = pool.submit(client.write, yarp.Bottle("add 2 3"), answer)
    command = yarp.Bottle()
    assert server.read(command, True)
    assert server.reply(yarp.Bottle([command.get(1).asInt32() + command.get(2).asInt32()]))
    assert future.result(20)
    assert answer.get(0).asInt32() == 5
    assert not server.reply(answer)  # no further request waits for a reply


def test_announced_reply_that_is_not_sent_is_empty(pool: ThreadPoolExecutor) -> None:
    server, client = opened(yarp.RpcServer, "/s"), opened(yarp.RpcClient, "/c")
    assert client.addOutput("/s")
    answers = [yarp.Bottle("old"), yarp.Bottle("old")]
    future = pool.submit(lambda: [client.write(yarp.Bottle("a"), answer) for answer in answers])
    command = yarp.Bottle()
    assert server.read(command, True)
    assert server.read(command, True)
    assert server.reply(yarp.Bottle("second"))
    assert future.result(20) == [True, True]
    assert [answer.toString() for answer in answers] == ["", "second"]


def test_servers_do_not_write_and_clients_do_not_read() -> None:
    server, client = opened(yarp.RpcServer, "/s"), opened(yarp.RpcClient, "/c")
    assert not server.write(yarp.Bottle())
    assert not server.read(yarp.Bottle(), False)
    assert not client.read(yarp.Bottle())
    assert not client.reply(yarp.Bottle())
    assert not client.write(yarp.Bottle("x"), yarp.Bottle())  # the client has no connection
    assert client.addOutput("/s")
    other = opened(yarp.RpcServer, "/s2")
    assert not client.addOutput("/s2")  # the client already has an output
    assert other.getInputCount() == 0


def test_reply_can_end_the_connection(pool: ThreadPoolExecutor) -> None:
    server, client = opened(yarp.RpcServer, "/s"), opened(yarp.RpcClient, "/c")
    assert client.addOutput("/s")
    answer = yarp.Bottle()
    future = pool.submit(client.write, yarp.Bottle("bye"), answer)
    assert server.read(yarp.Bottle(), True)
    assert server.replyAndDrop(yarp.Bottle("ok"))
    assert future.result(20)
    assert answer.toString() == "ok"
    until(lambda: server.getInputCount() == 0, "the connection has ended")


class Echo(yarp.PortReader):
    def __init__(self) -> None:
        super().__init__()
        self.said: list[str] = []

    def read(self, connection: yarp.ConnectionReader) -> bool:
        if not connection.isValid():
            self.said.append("end")
            return False
        command, answer = yarp.Bottle(), yarp.Bottle()
        if not command.read(connection):
            return False
        self.said.append(f"{connection.getRemoteContact().getName()}: {command.toString()}")
        writer = connection.getWriter()
        if writer is None:
            return True
        answer.addString("got")
        answer.append(command)
        return answer.write(writer)


def test_reader_receives_messages_as_they_arrive() -> None:
    echo = Echo()
    server = yarp.Port()
    server.setReader(echo)
    assert server.open("/s")
    client = opened(name="/c")
    assert client.addOutput("/s")
    answer = yarp.Bottle()
    assert client.write(yarp.Bottle("a 1"), answer)
    assert answer.toString() == "got a 1"
    assert client.write(yarp.Bottle("b"))
    server.close()
    assert echo.said == ["/c: a 1", "/c: b", "end"]


def test_reader_reads_raw_numbers() -> None:
    results = []

    class Raw(yarp.PortReader):
        def read(self, connection: yarp.ConnectionReader) -> bool:
            if connection.isValid():
                results.append(
                    [connection.getSize(), *(connection.expectInt32() for _ in range(4)), connection.isError()]
                )
                results.append([connection.expectFloat64(), connection.isError(), connection.getWriter()])
            return True

    server = yarp.Port()
    server.setReader(Raw())
    assert server.open("/s")
    client = opened(name="/c")
    assert client.addOutput("/s")
    assert client.write(yarp.Bottle("5"))
    assert results[0] == [12, 257, 1, 5, 0, True]
    assert results[1] == [0.0, True, None]


def test_interrupt_releases_readers() -> None:
    reader = opened()
    results: list[bool] = []
    thread = threading.Thread(target=lambda: results.append(reader.read(yarp.Bottle())))
    thread.start()
    reader.interrupt()
    thread.join(20)
    assert results == [False]
    assert not reader.read(yarp.Bottle())
    assert not reader.write(yarp.Bottle())
    reader.resume()
    assert reader.write(yarp.Bottle())


def test_closing_releases_readers_and_writers(pool: ThreadPoolExecutor) -> None:
    reader, writer = connected()
    waiting = pool.submit(writer.write, yarp.Bottle("x"))
    until(writer.isWriting, "the message is being sent")
    reader.close()
    waiting.result(20)
    assert not reader.read(yarp.Bottle())
    assert not reader.isOpen()
    assert reader.getName() == ""
    until(lambda: writer.getOutputCount() == 0, "the writer detects the end of the connection")


def test_unreferenced_port_is_closed() -> None:
    reader = opened(name="/gone")
    assert yarp.Network.exists("/gone")
    del reader
    gc.collect()
    assert not yarp.Network.exists("/gone")


def test_port_is_reopened_with_another_name() -> None:
    port = opened(name="/one")
    assert port.open("/two")
    assert port.getName() == "/two"
    assert not yarp.Network.exists("/one")


def test_invalid_names_are_refused(caplog: pytest.LogCaptureFixture) -> None:
    assert not yarp.Port().open("no/slash")
    assert not yarp.Port().open("/two words")
    assert not yarp.Port().open("/topic@/node")
    assert "/topic+@/node" in caplog.text
    assert yarp.Port().where().getPort() == -1


def test_environment_can_add_a_prefix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("YARP_PORT_PREFIX", "/sim")
    assert opened(name="/camera").getName() == "/sim/camera"


def test_environment_can_rename_a_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the variable's name, as in ``Port::open``, ``_`` replaces all characters except letters and digits.

    The prefix is added after the port is renamed.
    """
    monkeypatch.setenv("YARP_RENAME_camera_rgb_1_o", "/robot/eye:o")
    assert opened(name="/camera/rgb-1:o").getName() == "/robot/eye:o"
    assert opened(name="/camera/rgb:o").getName() == "/camera/rgb:o"
    monkeypatch.setenv("YARP_PORT_PREFIX", "/sim")
    assert opened(name="/camera/rgb-1:o").getName() == "/sim/robot/eye:o"
    monkeypatch.setenv("YARP_RENAME_camera_rgb_1_o", "")
    assert opened(name="/camera/rgb-1:o").getName() == "/sim/camera/rgb-1:o"


def test_renamed_port_of_every_kind_receives_under_its_new_name(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in ("in", "out", "rpc", "ask"):
        monkeypatch.setenv(f"YARP_RENAME_mine_{kind}", f"/theirs/{kind}")
    reader, writer = yarp.BufferedPortBottle(), yarp.BufferedPortBottle()
    assert reader.open("/mine/in")
    assert writer.open(yarp.Contact("/mine/out"))
    server, client = yarp.RpcServer(), yarp.RpcClient()
    assert server.open("/mine/rpc")
    assert client.open("/mine/ask")
    assert yarp.Network.connect("/theirs/out", "/theirs/in")
    assert yarp.Network.connect("/theirs/ask", "/theirs/rpc")
    assert not yarp.Network.exists("/mine/in")
    writer.prepare().addInt32(7)
    writer.write()
    assert reader.read().get(0).asInt32() == 7


def test_environment_can_set_a_ports_number(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    number = free_port()
    monkeypatch.setenv("YARP_PORTNUMBER_camera", str(number))
    monkeypatch.setenv("YARP_RENAME_camera", "/eye")
    port = opened(name="/camera")
    assert (port.getName(), port.where().getPort()) == ("/eye", number)
    for other in ("many", "0"):
        monkeypatch.setenv("YARP_PORTNUMBER_other", other)
        assert opened(name="/other").where().getPort() > 0
        assert f"ignored YARP_PORTNUMBER_other={other}" in caplog.text


def test_an_invalid_new_name_is_reported_with_its_variable(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("YARP_RENAME_camera", "the eye")
    assert not yarp.Port().open("/camera")
    assert "'the eye' is not a port name" in caplog.text
    assert "port /camera is not opened: correct or unset YARP_RENAME_camera, which renames it" in caplog.text


def test_port_reports_itself_and_its_connections() -> None:
    messages: list[str] = []

    class Report(yarp.PortReport):
        def report(self, info: yarp.PortInfo) -> None:
            messages.append(info.message)

    coming: list[tuple[bool, bool, str]] = []

    class Events(yarp.PortReport):
        def report(self, info: yarp.PortInfo) -> None:
            coming.append((info.incoming, info.created, info.sourceName))

    reader, writer, events = opened(name="/r"), opened(name="/w"), Events()
    reader.setReporter(events)
    assert writer.addOutput("/r")
    until(lambda: coming == [(True, True, "/w")], "the new connection is reported")
    reader.getReport(Report())
    assert messages[0].startswith("This is /r at tcp://127.0.0.1:")
    assert messages[1:] == ["There is an input connection from /w to /r using tcp"]
    writer.close()
    until(lambda: len(coming) == 2, "the end of the connection is reported")
    assert coming[1] == (True, False, "/w")


def test_port_listens_at_the_given_address() -> None:
    port = yarp.Port()
    assert port.open(yarp.Contact("/here", "tcp", "127.0.0.1", 0))
    assert port.where().getHost() == "127.0.0.1"
    hidden = yarp.Port()
    assert hidden.open(yarp.Contact("/hidden", "tcp", "127.0.0.1", 0), False)
    assert not yarp.Network.queryName("/hidden").isValid()


def test_ports_need_the_network(caplog: pytest.LogCaptureFixture) -> None:
    yarp.Network.fini()
    try:
        assert not yarp.Port().open("/x")
        assert "yarp.Network.init()" in caplog.text
    finally:
        yarp.Network.init()


@pytest.mark.parametrize("profile", Profile)
def test_replies_are_in_the_clients_dialect(profile: Profile) -> None:
    server, reader = yarp.Port(), Echo()
    server.setReader(reader)
    assert server.open("/s")
    asker = Client("/s", naming=RUNTIME.naming, profile=profile)
    with asker:
        asker.core.connections.outputs[0].profile = profile
        answer = asker.core.request(binary.encode(["x", 2.5], profile))
    assert binary.decode(answer, profile) == ["got", "x", 2.5]


@pytest.mark.parametrize("verbosity", [0, 1])
def test_verbosity_controls_the_log_of_connections(caplog: pytest.LogCaptureFixture, verbosity: int) -> None:
    reader, writer = yarp.Port(), yarp.Port()
    reader.setVerbosity(verbosity)
    assert reader.getVerbosity() == verbosity
    with caplog.at_level("INFO", "yarp"):
        assert reader.open("/quiet/r")
        assert writer.open("/quiet/w")
        assert writer.addOutput("/quiet/r")
        until(lambda: reader.getInputCount() == 1, "the reader is connected")
        until(lambda: not verbosity or "eceiving input" in caplog.text, "the reader logs the connection")
    assert ("eceiving input" in caplog.text) == bool(verbosity)
