"""`BufferedPort` and its subclasses."""

from __future__ import annotations

import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

import yarp_compat as yarp
from tests.support.wait import until
from yarp_compat.os.ports import inbox

pytestmark = pytest.mark.usefixtures("local")


def connected(kind: str = "Bottle") -> tuple[yarp.BufferedPort, yarp.BufferedPort]:
    reader, writer = (getattr(yarp, f"BufferedPort{kind}")() for _ in range(2))
    assert reader.open("/r")
    assert writer.open("/w")
    assert yarp.Network.connect("/w", "/r")
    return reader, writer


def send(writer: yarp.BufferedPort, number: int, *, strict: bool = False) -> None:
    bottle = writer.prepare()
    bottle.clear()
    bottle.addInt32(number)
    writer.write(strict)


def test_prepared_object_is_received() -> None:
    reader, writer = connected()
    send(writer, 10)
    got = reader.read()
    assert got.get(0).asInt32() == 10
    assert reader.lastRead() is got
    assert reader.read(False) is None


def test_newest_message_is_read() -> None:
    reader, writer = connected()
    for number in range(20):
        send(writer, number, strict=True)
        until(lambda: reader.getPendingReads() == 1, "the message has arrived")
    writer.waitForWrite()
    assert reader.read().get(0).asInt32() == 19
    assert reader.getPendingReads() == 0


def test_strict_reader_receives_every_message() -> None:
    reader, writer = connected()
    reader.setStrict()
    for number in range(200):
        send(writer, number, strict=True)
    assert [reader.read().get(0).asInt32() for _ in range(200)] == list(range(200))


def test_queue_of_a_strict_reader_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inbox, "LIMIT", 100)
    reader, writer = connected()
    reader.setStrict()
    sent: list[int] = []

    def write() -> None:
        for number in range(100):
            send(writer, number, strict=True)
            sent.append(number)

    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(write)
        until(lambda: reader.getPendingReads() >= 8, "messages are queued")
        time.sleep(0.05)
        assert len(sent) < 20  # the writer waits for the reader
        assert [reader.read().get(0).asInt32() for _ in range(100)] == list(range(100))
        done.result(20)


def test_prepared_object_is_reused_and_can_be_discarded() -> None:
    reader, writer = connected()
    reader.setStrict()
    first = writer.prepare()
    first.addInt32(1)
    assert writer.unprepare()
    assert writer.prepare() is first
    writer.write(True)
    assert writer.prepare() is first
    writer.write(True)
    writer.write(True)  # sends nothing, because no object is prepared
    send(writer, 2, strict=True)
    assert [reader.read().get(0).asInt32() for _ in range(3)] == [1, 1, 2]


def test_callback_receives_messages() -> None:
    reader, writer = connected()
    got: list[tuple[int, str]] = []

    class Take(yarp.BottleCallback):
        def onRead(self, bottle: yarp.Bottle, port: yarp.BufferedPort) -> None:
            got.append((bottle.get(0).asInt32(), port.getName()))

    reader.setStrict()
    on_read = Take()
    reader.useCallback(on_read)
    for number in range(3):
        send(writer, number, strict=True)
    until(lambda: len(got) == 3, "the callback has all messages")
    assert got == [(0, "/r"), (1, "/r"), (2, "/r")]
    reader.disableCallback()
    send(writer, 3)
    assert reader.read().get(0).asInt32() == 3


def test_port_can_be_its_own_callback() -> None:
    got: list[int] = []

    class Mine(yarp.BufferedPortBottle):
        def onRead(self, bottle: yarp.Bottle) -> None:
            got.append(bottle.get(0).asInt32())

    mine = Mine()
    mine.useCallback()  # set before the port is open
    assert mine.open("/mine")
    writer = yarp.BufferedPortBottle()
    assert writer.open("/w")
    assert writer.addOutput("/mine")
    send(writer, 4)
    until(lambda: got == [4], "the callback has the message")


def yarp_threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name.startswith("yarp")}


def test_callback_works_after_failed_opens() -> None:
    """No thread is left over from the failed attempts."""
    got: list[int] = []
    reader, writer = yarp.BufferedPortBottle(), yarp.BufferedPortBottle()
    reader.useCallback(lambda bottle: got.append(bottle.get(0).asInt32()))
    before = yarp_threads()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        for _ in range(3):
            assert not reader.open(yarp.Contact("/r", "tcp", "127.0.0.1", taken.getsockname()[1]))
    assert yarp_threads() <= before
    assert reader.open("/r")
    assert writer.open("/w")
    assert writer.addOutput("/r")
    send(writer, 5)
    until(lambda: got == [5], "the callback has the message")


def test_callback_may_fail_and_close_the_port(caplog: pytest.LogCaptureFixture) -> None:
    reader, writer = connected()
    reader.setStrict()
    calls = []

    def on_read(bottle: yarp.Bottle) -> None:
        calls.append(bottle.get(0).asInt32())
        if calls == [0]:
            raise RuntimeError
        reader.close()

    reader.useCallback(on_read)
    send(writer, 0, strict=True)
    send(writer, 1, strict=True)
    until(reader.isClosed, "the callback closes the port")
    # the next test must not share this port's thread
    until(lambda: all(t.name != "yarp callback /r" for t in threading.enumerate()), "the port has closed")
    assert calls == [0, 1]
    assert "a callback failed" in caplog.text


def test_callbacks_hold_a_lock() -> None:
    reader, writer = connected()
    got: list[int] = []
    assert not reader.lockCallback()
    reader.setCallbackLock()
    reader.useCallback(lambda bottle: got.append(bottle.get(0).asInt32()))
    assert reader.lockCallback()
    send(writer, 1)
    time.sleep(0.05)
    assert got == []
    reader.unlockCallback()
    until(lambda: got == [1], "the callback has the message")
    until(reader.tryLockCallback, "the callback has returned")
    reader.unlockCallback()


@pytest.mark.parametrize("end", ["interrupt", "close"])
def test_waiting_read_ends(end: str) -> None:
    reader, _ = connected()
    results = []
    thread = threading.Thread(target=lambda: results.append(reader.read()))
    thread.start()
    getattr(reader, end)()
    thread.join(20)
    assert results == [None]


def test_messages_of_another_type_are_skipped(caplog: pytest.LogCaptureFixture) -> None:
    reader, writer = yarp.BufferedPortVector(), yarp.BufferedPortBottle()
    assert reader.open("/r")
    assert writer.open("/w")
    assert writer.addOutput("/r")
    reader.setStrict()
    writer.prepare().fromString("no vector")
    writer.writeStrict()
    writer.prepare().fromString("1.0 2.0")
    writer.writeStrict()
    assert [reader.read().get(i) for i in range(1)] == [1.0]
    assert "skipped a message from /w" in caplog.text


def test_envelopes_belong_to_messages() -> None:
    reader, writer = connected()
    reader.setStrict()
    for number in range(3):
        writer.setEnvelope(yarp.Stamp(number, 0.5 * number))
        send(writer, number, strict=True)
    stamp = yarp.Stamp()
    for number in range(3):
        assert reader.read().get(0).asInt32() == number
        assert reader.getEnvelope(stamp)
        assert (stamp.getCount(), stamp.getTime()) == (number, 0.5 * number)


def test_replier_answers_requests() -> None:
    class Answer(yarp.PortReader):
        def read(self, connection: yarp.ConnectionReader) -> bool:
            question = yarp.Bottle()
            question.read(connection)
            return yarp.Bottle(["re", *question]).write(connection.getWriter())

    reader, writer = connected()
    answer = Answer()
    reader.setReplier(answer)
    client, got = yarp.RpcClient(), yarp.Bottle()
    assert client.open("/c")
    assert client.addOutput("/r")
    assert client.write(yarp.Bottle("a"), got)
    assert got.toString() == "re a"
    send(writer, 5)
    assert reader.read().get(0).asInt32() == 5


@pytest.mark.parametrize("kind", ["Vector", "ImageRgb", "Matrix", "Sound", "Property", "ImageMono"])
def test_each_kind_of_data_has_a_buffered_port(kind: str) -> None:
    reader, writer = connected(kind)
    data = writer.prepare()
    if kind in ("Vector", "Matrix"):
        data.resize(*((3,) if kind == "Vector" else (2, 2)))
    elif kind.startswith("Image"):
        data.resize(4, 3)
        data.zero()
    sent = data.to_bytes()
    writer.write()
    assert reader.read().to_bytes() == sent
    assert type(reader).__name__ == f"BufferedPort{kind}"
    assert issubclass(getattr(yarp, f"{kind}Callback"), yarp.TypedReaderCallback)
