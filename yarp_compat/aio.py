"""`yarp_compat.pythonic` for asyncio: ``async with``, ``async for``, ``await``.

Example::

    async with Reader("/robot/pose:i") as reader:
        async for message in reader:
            x, y = message.values

What may take time (the name server, making connections, waiting for an answer) runs in a thread beside the event loop.
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from typing import Any, Self

from yarp_compat import pythonic
from yarp_compat.ports.message import PortMessage
from yarp_compat.pythonic import Content, OpenPort, Received


class _Port:
    """A port of `pythonic`, opened and closed beside the event loop."""

    _port: OpenPort

    @property
    def name(self) -> str:
        """The port's name, as the name server took it."""
        return self._port.name

    async def open(self) -> Self:
        """Open the port."""
        await asyncio.to_thread(self._port.open)
        return self

    async def close(self) -> None:
        """Close the port."""
        await asyncio.to_thread(self._port.close)

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def connect(self, target: str) -> Self:
        """Connect the port's output to another port, as `OpenPort.connect`."""
        await asyncio.to_thread(self._port.connect, target)
        return self


class _Waking(pythonic.Reader):
    """Tells somebody when a message came or the port was closed."""

    def __init__(self, wake: Callable[[], None], name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._wake = wake

    def _on_message(self, message: PortMessage) -> None:
        super()._on_message(message)
        self._wake()

    def close(self) -> None:
        super().close()
        self._wake()

    @property
    def is_closed(self) -> bool:
        """Whether nothing will come any more."""
        return self._inbox.is_closed


class Reader(_Port):
    """Reads: ``async for`` gives each message as a `Received`. Arguments as of `pythonic.Reader`."""

    _port: _Waking

    def __init__(self, name: str = "", **options: Any) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._came = asyncio.Event()
        self._port = _Waking(self._wake, name, **options)

    async def open(self) -> Self:
        """Open the port."""
        self._loop = asyncio.get_running_loop()
        return await super().open()

    async def read(self) -> Received | None:
        """Wait for the next message; None once the port is closed."""
        while True:
            self._came.clear()
            message = self._port.read_now()
            if message is not None or self._port.is_closed:
                return message
            await self._came.wait()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Received:
        message = await self.read()
        if message is None:
            raise StopAsyncIteration
        return message

    def _wake(self) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._came.set)


class Writer(_Port):
    """Writes; arguments as of `pythonic.Writer`."""

    _port: pythonic.Writer

    def __init__(self, name: str = "", **options: Any) -> None:
        self._port = pythonic.Writer(name, **options)

    def write(self, content: Content, envelope: str = "", *, strict: bool = False) -> int:
        """Send a message, and wait for nobody, as `pythonic.Writer.write`."""
        return self._port.write(content, envelope, strict=strict)


class Client(_Port):
    """Asks one server; arguments as of `pythonic.Client`."""

    _port: pythonic.Client

    def __init__(self, server: str, name: str = "", **options: Any) -> None:
        self._port = pythonic.Client(server, name, **options)

    async def ask(self, content: Content, *, timeout: float | None = None) -> list[Any]:  # noqa: ASYNC109 (a socket's)
        """The values of the server's answer, as `pythonic.Client.ask`."""
        return await asyncio.to_thread(self._port.ask, content, timeout=timeout)


class Server(_Port):
    """Answers: ``respond(values)``, a function or coroutine on the event loop, returns an answer's values."""

    def __init__(self, name: str, respond: Callable[[list[Any]], Content | Awaitable[Content]], **options: Any) -> None:
        self._reader = Reader(name, strict=True, patient=True, rpc=True, **options)
        self._port = self._reader._port
        self._respond = respond
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self) -> Self:
        """Open the port and begin to answer."""
        await self._reader.open()
        self._start(self._serve())
        return self

    async def close(self) -> None:
        """Close the port and stop answering."""
        await super().close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self) -> None:
        # Each connection has at most one question open, so clients do not wait for each other.
        async for message in self._reader:
            self._start(self._answer(message))

    async def _answer(self, message: Received) -> None:
        try:
            answer = self._respond(message.values)
            message.reply(await answer if inspect.isawaitable(answer) else answer)
        finally:
            message.raw.give_up()

    def _start(self, work: Any) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
