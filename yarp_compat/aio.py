"""`yarp_compat.pythonic` for asyncio: ``async with``, ``async for``, ``await``.

Example::

    async with Reader("/robot/pose:i") as reader:
        async for message in reader:
            x, y = message.values

Blocking operations (requests to the name server, connecting, waiting for a reply) run in a thread.
"""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from typing import Any, Self

from yarp_compat import pythonic
from yarp_compat.overriding import override
from yarp_compat.ports.message import PortMessage
from yarp_compat.pythonic import Content, OpenPort, Received


class _Port:
    """A port of `pythonic` that is opened and closed in a thread."""

    _port: OpenPort

    @property
    def name(self) -> str:
        """The port's name, as registered."""
        return self._port.name

    async def open(self) -> Self:
        await asyncio.to_thread(self._port.open)
        return self

    async def close(self) -> None:
        await asyncio.to_thread(self._port.close)

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def connect(self, target: str) -> Self:
        """Connect the port's output to another port, like `OpenPort.connect`."""
        await asyncio.to_thread(self._port.connect, target)
        return self


class _NotifyingReader(pythonic.Reader):
    """A reader that calls ``wake`` when a message arrives or the port is closed."""

    def __init__(self, wake: Callable[[], None], name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._wake = wake

    @override
    def _on_message(self, message: PortMessage) -> None:
        super()._on_message(message)
        self._wake()

    @override
    def close(self) -> None:
        super().close()
        self._wake()

    @property
    def is_closed(self) -> bool:
        """Whether the port no longer receives messages."""
        return self._inbox.is_closed


class Reader(_Port):
    """An input port: ``async for`` yields each message as a `Received`. For the arguments, see `pythonic.Reader`."""

    _port: _NotifyingReader

    def __init__(self, name: str = "", **options: Any) -> None:
        self._loop: asyncio.AbstractEventLoop | None = None
        self._arrival = asyncio.Event()
        self._port = _NotifyingReader(self._wake, name, **options)

    @override
    async def open(self) -> Self:
        self._loop = asyncio.get_running_loop()
        return await super().open()

    async def read(self) -> Received | None:
        """Wait for the next message; None once the port is closed."""
        while True:
            self._arrival.clear()
            message = self._port.read_now()
            if message is not None or self._port.is_closed:
                return message
            await self._arrival.wait()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Received:
        message = await self.read()
        if message is None:
            raise StopAsyncIteration
        return message

    def _wake(self) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._arrival.set)


class Writer(_Port):
    """An output port; for the arguments, see `pythonic.Writer`."""

    _port: pythonic.Writer

    def __init__(self, name: str = "", **options: Any) -> None:
        self._port = pythonic.Writer(name, **options)

    def write(self, content: Content, envelope: str = "", *, strict: bool = False) -> int:
        """Send a message without blocking, like `pythonic.Writer.write`."""
        return self._port.write(content, envelope, strict=strict)


class Client(_Port):
    """A client of one server; for the arguments, see `pythonic.Client`."""

    _port: pythonic.Client

    def __init__(self, server: str, name: str = "", **options: Any) -> None:
        self._port = pythonic.Client(server, name, **options)

    async def ask(self, content: Content, *, timeout: float | None = None) -> list[Any]:  # noqa: ASYNC109 (a socket's)
        """Send a request and return the values of the reply, like `pythonic.Client.ask`."""
        return await asyncio.to_thread(self._port.ask, content, timeout=timeout)


class Server(_Port):
    """A server: ``respond(values)``, a function or coroutine on the event loop, returns a reply's content."""

    def __init__(self, name: str, respond: Callable[[list[Any]], Content | Awaitable[Content]], **options: Any) -> None:
        self._reader = Reader(name, strict=True, patient=True, rpc=True, **options)
        self._port = self._reader._port
        self._respond = respond
        self._tasks: set[asyncio.Task[None]] = set()

    @override
    async def open(self) -> Self:
        await self._reader.open()
        self._start(self._serve())
        return self

    @override
    async def close(self) -> None:
        """Close the port and cancel pending replies."""
        await super().close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self) -> None:
        # Each connection has at most one pending request, so clients do not wait for each other.
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
