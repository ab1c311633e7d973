"""The Python interface to ports, with and without asyncio."""

from __future__ import annotations

import asyncio
import threading

import pytest

import yarp_compat as yarp
from tests.support.wait import until
from yarp_compat import aio
from yarp_compat.ports.naming import LocalNaming, PortError
from yarp_compat.pythonic import Client, Reader, Server, Writer
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reply import recognize


@pytest.fixture
def naming() -> LocalNaming:
    return LocalNaming()


def test_messages_are_iterated(naming: LocalNaming) -> None:
    with Reader("/r", strict=True, naming=naming) as reader, Writer("/w", naming=naming).open().connect("/r") as writer:
        for number in range(3):
            assert writer.write([number, "a", 2.5, [1]], f"{number} 1.5", strict=True) == 1
        writer.write(yarp.Vector([1.0, 2.0]), strict=True)
        seen = []
        for message in reader:
            if len(seen) == 3:
                assert message.to(yarp.Vector).get(1) == 2.0
                break
            seen.append((message.values, message.envelope, message.source, message.wants_reply))
        assert seen == [([n, "a", 2.5, [1]], f"{n} 1.5", "/w", False) for n in range(3)]
        assert reader.read_now() is None


def test_iteration_ends_with_the_port(naming: LocalNaming) -> None:
    reader = Reader("/r", naming=naming).open()
    seen = []
    thread = threading.Thread(target=lambda: seen.extend(reader))
    thread.start()
    reader.close()
    thread.join(20)
    assert not thread.is_alive()
    assert seen == []


def test_a_server_replies_to_a_client(naming: LocalNaming) -> None:
    with Server("/s", lambda values: [len(values), *values], naming=naming), Client("/s", naming=naming) as client:
        assert client.ask(["a", 1]) == [2, "a", 1]
        assert client.name.startswith("/tmp/port/")


def test_replies_are_in_the_dialect_of_the_client(naming: LocalNaming) -> None:
    with Server("/s", lambda values: [values[0] / 2], naming=naming):
        for profile in Profile:
            with Client("/s", naming=naming, profile=profile) as client:
                client.core.connections.outputs[0].profile = profile
                answer = client.core.request(binary.encode([3.0], profile))
                assert binary.decode(answer, profile) == [1.5]
                assert recognize(answer) is profile


def test_a_reader_may_reply(naming: LocalNaming) -> None:
    with Reader("/r", strict=True, naming=naming) as reader, Client("/r", naming=naming) as client:
        answers = []
        thread = threading.Thread(target=lambda: answers.extend(client.ask([n]) for n in range(2)))
        thread.start()
        first = reader.read()
        assert first.wants_reply
        second = None
        while second is None:  # if the owner reads the next message without replying, an empty reply is sent
            second = reader.read_now()
        second.reply(["two"])
        thread.join(20)
        assert answers == [[], ["two"]]


def test_a_request_that_another_one_replaces_gets_an_empty_reply(naming: LocalNaming) -> None:
    """Otherwise its sender would wait until the reader is closed."""
    with Reader("/r", naming=naming) as reader, Client("/r", naming=naming) as first:
        answers: dict[str, list[object]] = {}
        waits = threading.Thread(target=lambda: answers.update(first=first.ask(["first"], timeout=20)), daemon=True)
        waits.start()
        until(lambda: len(reader), "the first request has arrived")
        with Client("/r", naming=naming) as second:
            asks = threading.Thread(target=lambda: answers.update(second=second.ask(["second"], timeout=20)))
            asks.start()
            waits.join(20)
            assert answers == {"first": []}
            newest = reader.read()
            assert newest is not None
            assert newest.values == ["second"]
            newest.reply(["done"])
            asks.join(20)
            assert answers == {"first": [], "second": ["done"]}


def test_a_closed_reader_sends_no_empty_reply(naming: LocalNaming) -> None:
    reader, failed = Reader("/r", naming=naming).open(), list[Exception]()
    with Client("/r", naming=naming) as client:

        def ask() -> None:
            try:
                client.ask(["?"])
            except ConnectionError as error:
                failed.append(error)

        thread = threading.Thread(target=ask)
        thread.start()
        assert reader.read() is not None
        reader.close()
        thread.join(20)
    assert failed


def test_failures_raise_exceptions(naming: LocalNaming) -> None:
    with Writer("/w", naming=naming) as writer, pytest.raises(PortError, match="/nowhere"):
        writer.connect("/nowhere")
    with pytest.raises(PortError, match="/nowhere"):
        Client("/nowhere", naming=naming).open()
    waiting = threading.Event()
    server = Server("/s", lambda _: [waiting.wait(40)], naming=naming)
    with server, Client("/s", naming=naming) as client:
        with pytest.raises(TimeoutError):
            client.ask([1], timeout=0.05)
        waiting.set()


def test_asyncio_ports_exchange_messages(naming: LocalNaming) -> None:
    async def slowly(values: list[object]) -> list[object]:
        await asyncio.sleep(0.01)
        return [len(values)]

    async def run() -> None:
        client, other = (aio.Client("/s", naming=naming) for _ in range(2))
        async with aio.Server("/s", slowly, naming=naming), client, other:
            assert await asyncio.gather(client.ask([1, 2]), other.ask([])) == [[2], [0]]
        async with aio.Reader("/r", strict=True, naming=naming) as reader, aio.Writer("/w", naming=naming) as writer:
            await writer.connect("/r")
            for number in range(3):
                writer.write([number], strict=True)
            seen = []
            async for message in reader:
                seen.append(message.values[0])
                if len(seen) == 3:
                    break
            assert seen == [0, 1, 2]
            waiting = asyncio.ensure_future(reader.read())
            await asyncio.sleep(0)
            await reader.close()
            assert await waiting is None

    asyncio.run(run())


def test_a_server_replies_after_a_failed_request(naming: LocalNaming, caplog: pytest.LogCaptureFixture) -> None:
    def divide(values: list[float]) -> list[float]:
        return [values[0] / values[1]]

    with Server("/s", divide, naming=naming), Client("/s", naming=naming) as client:
        assert client.ask([1.0, 0.0]) == []
        assert client.ask([1.0, 2.0]) == [0.5]
    assert "ZeroDivisionError" in caplog.text

    async def run() -> None:
        async with aio.Server("/s", divide, naming=naming), aio.Client("/s", naming=naming) as client:
            assert await client.ask([1.0, 0.0]) == []
            assert await client.ask([1.0, 2.0]) == [0.5]

    asyncio.run(run())
    until(lambda: caplog.text.count("ZeroDivisionError") >= 2, "the second failure is logged")
