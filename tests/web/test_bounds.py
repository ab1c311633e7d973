"""Limits for clients and slow peers of the console: connections, time, memory, log lines."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
import time
from concurrent.futures import Future
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus, WebSocketException

from bridge.concurrency import SerialExecutor
from bridge.web.feeds.feed import Feed
from bridge.web.feeds.hub import PolledFeed
from bridge.web.serving import connections
from bridge.web.serving.connections import MOST_CONNECTIONS, MOST_OF_ADDRESS
from bridge.web.serving.console import MOST_PAGES_OF_ADDRESS
from bridge.web.serving.scarce_log import ScarceLog
from bridge.web.verbs import verbs
from bridge.web.verbs.verbs import PageVerb, VerbError
from tests.peers.browser.hostile import client_frame, opening
from tests.peers.browser.page import TestPage
from tests.support.wait import until
from tests.web.conftest import Desk
from tests.web.test_server import ask


def connect(port: int, source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), 20, (source, 0))


def is_closed(sock: socket.socket) -> bool:
    """Return whether the other end closes the connection within the socket's timeout."""
    try:
        while sock.recv(1 << 16):
            pass
    except TimeoutError:
        return False
    except ConnectionError:
        pass
    return True


def gets_response(port: int, source: str) -> bool:
    with contextlib.suppress(ConnectionError), connect(port, source) as sock:
        sock.sendall(b"GET / HTTP/1.0\r\n\r\n")
        return sock.recv(100).startswith(b"HTTP/1.1")
    return False


def test_connections_per_address_are_limited(desk: Desk) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_OF_ADDRESS):
            stack.enter_context(connect(desk.port, "127.0.0.2"))
        assert is_closed(stack.enter_context(connect(desk.port, "127.0.0.2")))
        assert ask(desk.port, "/")[0] == 200
    until(lambda: gets_response(desk.port, "127.0.0.2"), "the connections are released")


def test_the_total_number_of_connections_is_limited() -> None:
    assert 2 * MOST_OF_ADDRESS < MOST_CONNECTIONS


@pytest.mark.parametrize(
    "said",
    [b"", b"GET / HTTP/1.1\r\nHost: ", b"POST /none HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\nx"],
)
def test_an_unfinished_request_is_closed(desk: Desk, monkeypatch: pytest.MonkeyPatch, said: bytes) -> None:
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.3)
    with connect(desk.port) as sock:
        sock.sendall(said)
        assert is_closed(sock)


def test_a_page_outlives_the_time_limit_of_a_request(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_SECONDS", 0.3)

    def opened() -> TestPage | None:
        """Open a page, or return None if the time was over before the request was complete, as on a busy machine."""
        with contextlib.suppress(OSError, WebSocketException):
            return TestPage(desk.port)
        return None

    page = until(opened, "a page is open")
    assert page is not None
    with page, connect(desk.port) as other:
        assert is_closed(other), "the time limit has passed"
        assert page.call("ping")["ok"]


def test_pongs_that_are_not_read_close_the_connection(desk: Desk) -> None:
    with connect(desk.port) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.sendall(opening(f"127.0.0.1:{desk.port}"))
        flood = client_frame(9, b"x" * 125) * 1000
        with pytest.raises(ConnectionError):
            sock.sendall(flood * 500)
    assert ask(desk.port, "/")[0] == 200


class LargeFeed(Feed):
    """A feed whose value is larger than the buffers of a connection."""

    def __init__(self) -> None:
        super().__init__("maps")
        self.opened = threading.Event()

    def open(self) -> None:
        self.put({"names": ["x" * (16 << 20)]})
        self.opened.set()

    def close(self) -> None:
        return


def test_a_page_that_stands_still_is_disconnected(desk: Desk) -> None:
    """For example of a laptop that sleeps while a value is being sent: the connection would wait for the rest."""
    config = desk.console.server._server.config
    config.ws_ping_interval = config.ws_ping_timeout = 1.0
    desk.console.feeds.fixed["maps"] = feed = LargeFeed()
    with contextlib.ExitStack() as stack:

        def watches() -> bool:
            """Open a page that answers no ping; a slow machine may disconnect it before it watches the feed."""
            sock = stack.enter_context(connect(desk.port))
            with contextlib.suppress(ConnectionError):
                sock.sendall(opening(f"127.0.0.1:{desk.port}"))
                sock.recv(4096)
                sock.sendall(client_frame(1, b'{"op": "watch", "feed": "maps"}'))
            return feed.opened.wait(1.0)

        until(watches, "a page watches the feed")
        until(lambda: not desk.console.server.pages, "the page is disconnected")


def test_pages_per_address_are_limited(desk: Desk) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_PAGES_OF_ADDRESS):
            stack.enter_context(TestPage(desk.port, source_address=("127.0.0.2", 0)))
        with pytest.raises(InvalidStatus, match="503"):
            TestPage(desk.port, source_address=("127.0.0.2", 0))
        with TestPage(desk.port) as page:
            assert page.call("ping")["ok"]
    until(lambda: not desk.console.server.pages, "the pages are released")


@pytest.mark.thorough
def test_replies_that_are_not_read_close_the_connection(desk: Desk) -> None:
    with connect(desk.port) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.sendall(opening(f"127.0.0.1:{desk.port}"))
        flood = client_frame(1, b'{"op": "call", "id": 1, "verb": "%s"}' % (b"x" * 80)) * 1000

        def is_disconnected() -> bool:
            try:
                sock.sendall(flood)
            except ConnectionError:
                return True
            return False

        until(is_disconnected, "the page is disconnected", every=0.0)
    with TestPage(desk.port) as page:
        assert page.call("ping")["ok"]


def test_a_message_with_too_many_parts_closes_the_connection(desk: Desk) -> None:
    with connect(desk.port) as sock:
        sock.sendall(opening(f"127.0.0.1:{desk.port}"))
        until(lambda: b"hello" in sock.recv(1 << 16), "the hello arrives")
        with contextlib.suppress(ConnectionError):
            sock.sendall(client_frame(1, b"", fin=False) + client_frame(0, b"", fin=False) * 2000)
        assert is_closed(sock)


def test_a_call_that_waited_too_long_is_not_executed(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verbs, "BEGIN_SECONDS", -1.0)
    with TestPage(desk.port) as page:
        assert "not executed: " in page.call("explain", name="/x")["error"]
        assert "not executed" not in page.call("stop").get("error", ""), "a stop is never rejected as too late"


def test_waiting_calls_of_a_closed_page_are_canceled(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    known, kept = desk.console.verbs, desk.console.verbs.begin
    may_end, begun, calls = threading.Event(), list[int](), list[Future[Any]]()

    def run(n: int) -> None:
        begun.append(n)
        may_end.wait(30)

    def begin(verb: str, args: Any, who: str) -> Future[Any]:
        calls.append(kept(verb, args, who))
        return calls[-1]

    def waiting() -> list[Future[Any]]:
        return [call for call in calls if not call.running() and not call.done()]

    monkeypatch.setitem(known.known, "goto", PageVerb(run, {"n": int}, {}))
    monkeypatch.setattr(known, "begin", begin)
    try:
        with TestPage(desk.port) as page:
            for number in range(10):
                page.send(op="call", id=number, verb="goto", args={"n": number})
            until(lambda: len(calls) == 10 and len(begun) == verbs.THREADS, "some calls run, the others wait")
            waited = waiting()
            assert len(waited) == 10 - verbs.THREADS
        until(lambda: all(call.cancelled() for call in waited), "waiting calls are canceled")
    finally:
        may_end.set()
    with TestPage(desk.port) as page:
        assert page.call("ping")["ok"]
    assert len(begun) == verbs.THREADS


def test_a_ping_does_not_wait_for_other_calls(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without a reply for 2 s close their connection, and report their other calls as lost."""
    may_end, begun = threading.Event(), threading.Semaphore(0)

    def run(n: int) -> None:
        begun.release()
        may_end.wait(40)

    monkeypatch.setitem(desk.console.verbs.known, "goto", PageVerb(run, {"n": int}, {}))
    try:
        with TestPage(desk.port) as page:
            for number in range(verbs.THREADS):
                page.send(op="call", id=100 + number, verb="goto", args={"n": number})
            for _ in range(verbs.THREADS):
                assert begun.acquire(timeout=20)
            assert page.call("ping")["ok"]
    finally:
        may_end.set()


GOOD = {"names": ["house"], "current": "house"}


class FailingFeed(Feed):
    """A feed whose first attempts to open fail."""

    TIMES = 100

    def __init__(self) -> None:
        super().__init__("maps")
        self.opened = 0

    def open(self) -> None:
        self.opened += 1
        if self.opened <= self.TIMES:
            raise KeyError("no such thing")
        self.put(GOOD)

    def close(self) -> None:
        return


def test_a_failing_feed_is_reported_and_can_be_watched_again(desk: Desk) -> None:
    desk.console.feeds.fixed["maps"] = FailingFeed()
    with TestPage(desk.port) as page, TestPage(desk.port) as other:
        for attempt in range(1, FailingFeed.TIMES + 1):
            page.watch("maps")
            page.until(lambda attempt=attempt: len(page.errors()) == attempt, "the error is reported")
        assert set(page.errors()) == {"maps cannot be opened: 'no such thing'"}
        page.watch("maps")
        assert page.value("maps") == GOOD
        other.watch("maps")
        assert other.value("maps") == GOOD


def test_a_feed_continues_after_an_error(desk: Desk) -> None:
    console, repaired, asking = desk.console, threading.Event(), SerialExecutor("asking")

    def answer() -> dict[str, Any]:
        if not repaired.is_set():
            raise KeyError("gone")
        return GOOD

    console.feeds.fixed["maps"] = PolledFeed(console.host, "maps", asking, answer)
    with contextlib.closing(asking), TestPage(desk.port) as page:
        page.watch("maps")
        page.until(lambda: page.values.get("maps", {}).get("why") == "KeyError: 'gone'", "the reason is reported")
        repaired.set()  # not before, because a page gets only the newest value
        assert page.value("maps") == GOOD


def test_warnings_caused_by_clients_are_rate_limited(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    scarce = ScarceLog("midspan.web.scarce")  # a server of an earlier test may still log

    def lines() -> list[str]:
        return [record.getMessage() for record in caplog.records if record.name == "midspan.web.scarce"]

    with caplog.at_level(logging.WARNING, "midspan.web"):
        for number in range(100):
            scarce.warn(f"bad {number}")
        assert len(lines()) == 20
        later = time.monotonic() + 11.0
        monkeypatch.setattr(time, "monotonic", lambda: later)
        scarce.warn("another warning")
    assert lines()[20:] == ["80 further warnings were suppressed", "another warning"]


def test_a_late_call_raises_a_verb_error(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verbs, "BEGIN_SECONDS", -1.0)
    with pytest.raises(VerbError, match="not executed"):
        desk.console.verbs.begin("ping", {}, "a page").result(20)
