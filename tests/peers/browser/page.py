"""A client for tests that uses the console's protocol over a real WebSocket."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import Callable, Coroutine
from typing import Any, Self, TypeVar

import websockets.asyncio.client
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tests.peers.browser.protocol import check_done, check_said
from tests.support.wait import until

_T = TypeVar("_T")
PROTOCOL = "midspan.console.1"


class TestPage:
    """A page that acknowledges each value at once, unless ``takes`` is false.

    Attributes:
        values: the newest message of each feed.
        counts: number of messages of each feed.
    """

    __test__ = False

    def __init__(self, port: int, *, takes: bool = True, url: str = "", **options: Any) -> None:
        tls = "s" if "ssl" in options else ""
        join: Any = TlsSocket if tls else connect
        options.setdefault("max_queue", None)  # otherwise a page that has stopped reading cannot be closed
        options.setdefault("origin", f"http{tls}://127.0.0.1:{port}")
        self._stack = contextlib.ExitStack()
        address = url or f"ws{tls}://127.0.0.1:{port}/socket"
        self.socket: ClientConnection = self._stack.enter_context(
            join(address, subprotocols=[Subprotocol(PROTOCOL)], max_size=None, **options)
        )
        self.takes = takes
        self.values: dict[str, dict[str, Any]] = {}
        self.counts: dict[str, int] = {}
        self.others: list[dict[str, Any]] = []  # all other messages
        self._calls = 0

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def watch(self, *feeds: str) -> None:
        for feed in feeds:
            self.send(op="watch", feed=feed)

    def read(self, seconds: float = 0.05) -> bool:
        """Read one message; return whether one arrived."""
        try:
            message = json.loads(self.socket.recv(timeout=seconds))
        except TimeoutError:
            return False
        check_said(message)
        if message["op"] == "value":
            feed = message["feed"]
            self.values[feed] = message
            self.counts[feed] = self.counts.get(feed, 0) + 1
            if self.takes:
                self.send(op="took", feed=feed, n=message["n"])
        else:
            self.others.append(message)
        return True

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 30.0) -> Any:
        """Read until a condition is true; waits are as long as in `tests.support.wait.until`."""

        def read() -> Any:
            if not (value := condition()):
                self.read()
            return value

        try:
            return until(read, what, seconds, every=0.0)
        except AssertionError as err:
            err.add_note(f"{self.values} {self.others}")
            raise

    def value(self, feed: str, wanted: Callable[[Any], Any] = bool, what: str = "") -> Any:
        """Wait until a feed has the wanted value, which is not None (the server has none yet), and return it."""

        def holds() -> bool:
            value = self.values.get(feed, {}).get("value")
            return value is not None and bool(wanted(value))

        self.until(holds, what or f"the feed {feed} has a value")
        return self.values[feed]["value"]

    def call(self, verb: str, **args: Any) -> dict[str, Any]:
        """Call a verb, and return the reply."""
        self._calls += 1
        number = self._calls
        self.send(op="call", id=number, verb=verb, args=args)
        reply: dict[str, Any] = self.until(
            lambda: next((m for m in self.others if m["op"] == "reply" and m["id"] == number), None),
            f"{verb} gets a reply",
        )
        if reply["ok"]:
            check_done(verb, args, reply["value"])
        return reply

    def errors(self) -> list[str]:
        return [message["error"] for message in self.others if message["op"] == "error"]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


class TlsSocket:
    """A socket over TLS that only one thread uses.

    websockets' blocking client reads and writes on two threads, but an OpenSSL object is not thread-safe: on a busy
    machine, one of several hundred connections received no response, or the process crashed.
    """

    def __init__(self, address: str, **options: Any) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="tls-page")
        self._thread.start()

        async def joined() -> websockets.asyncio.client.ClientConnection:
            return await websockets.asyncio.client.connect(address, **options)

        try:
            self._inner = self._wait(joined())
        except BaseException:
            self._end()
            raise
        self.socket = self._inner.transport.get_extra_info("ssl_object")

    def send(self, text: str) -> None:
        self._wait(self._inner.send(text))

    def recv(self, timeout: float) -> str | bytes:
        async def soon() -> str | bytes:
            async with asyncio.timeout(timeout):
                return await self._inner.recv()

        return self._wait(soon())

    def _wait(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._wait(self._inner.close())
        finally:
            self._end()
