"""A Python interface to YARP ports: context managers, iteration, plain values. `yarp_compat.aio` is for asyncio.

Example::

    with Reader("/robot/pose:i") as reader:
        for message in reader:
            x, y = message.values

Errors are exceptions: `NamingError` for the name server, `PortError` if a connection cannot be made, `WireError` for
invalid bytes, `TimeoutError`, `ConnectionError`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self, TypeVar

from yarp_compat.naming.client import NameClient
from yarp_compat.os.ports.connection import sender_profile
from yarp_compat.os.ports.inbox import Inbox
from yarp_compat.overriding import override
from yarp_compat.ports.message import Payload, PortMessage
from yarp_compat.ports.naming import Naming, PortError
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.sockets import Openable, closed_on_failure
from yarp_compat.wire import binary
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile

T = TypeVar("T", bound=Portable)

Content = Sequence[Any] | Portable
"""The content of a message: a Bottle's plain values (see `yarp_compat.wire.values`), or any of YARP's data."""


class Received:
    """A received message; ``raw`` is the message of the port itself."""

    def __init__(self, raw: PortMessage, profile: Profile) -> None:
        self.raw = raw
        self._profile = sender_profile(raw)
        self._reply_profile = self._profile or profile

    @property
    def values(self) -> list[Any]:
        """The values of the received Bottle; raises `WireError` if it is not one."""
        return binary.decode(self.raw.payload, self._profile)

    def to(self, kind: type[T]) -> T:
        """Decode the message as a YARP type: ``message.to(yarp.Vector)``; raises `WireError` for another type."""
        content = kind()
        content.from_wire(self.raw.payload, self._profile)
        return content

    @property
    def envelope(self) -> str:
        """The envelope's text, ``12 1795143618.02`` for a stamp, or empty."""
        return self.raw.envelope

    @property
    def source(self) -> str:
        """The name of the sending port."""
        return self.raw.peer.route.source

    @property
    def wants_reply(self) -> bool:
        """Whether the sender waits for a reply."""
        return self.raw.wants_reply

    def reply(self, content: Content) -> None:
        """Send the reply; may be called once."""
        self.raw.reply(payload_of(content)(self._reply_profile))


class OpenPort(Openable):
    """A port that is open inside a ``with`` block. See `Reader`, `Writer`, `Client` and `Server`.

    With an empty name, the name server (by default that of ``yarp.conf``) chooses one. For other options, see
    `PortCore`.
    """

    def __init__(self, name: str = "", *, naming: Naming | None = None, **options: Any) -> None:
        self.core = PortCore(name, on_message=self._on_message, naming=naming or NameClient(), **options)

    @property
    def name(self) -> str:
        """The port's name, as registered."""
        return self.core.name

    @override
    def open(self) -> Self:
        """Open the port, unless it is open."""
        if not self.core.is_open:
            self.core.open()
        return self

    @override
    def close(self) -> None:
        self.core.close()

    def connect(self, target: str) -> Self:
        """Connect the output to another port; ``udp://r`` also selects the carrier. Raises `PortError` on failure."""
        done, reply = self.core.add_output(target)
        if not done:
            raise PortError(reply)
        return self

    def _on_message(self, message: PortMessage) -> None:
        """Handle a message, on its connection's thread."""


class Reader(OpenPort):
    """An input port: iteration yields each message as a `Received`, until the port is closed; see also `OpenPort`.

    ``strict``: yield every message instead of only the newest. ``patient``: a reply may be sent after later messages
    are read; by default, reading the next message sends an empty reply to an unanswered request.
    """

    def __init__(self, name: str = "", *, strict: bool = False, patient: bool = False, **options: Any) -> None:
        super().__init__(name, is_output=False, **options)
        self._inbox = Inbox()
        self._inbox.strict = strict
        self._patient = patient
        self._due: PortMessage | None = None

    def read(self) -> Received | None:
        """Wait for the next message; None once the port is closed."""
        return self._deliver(self._inbox.pop(wait=True))

    def read_now(self) -> Received | None:
        """Return the next message without waiting, or None."""
        return self._deliver(self._inbox.pop(wait=False))

    def __iter__(self) -> Iterator[Received]:
        while (message := self.read()) is not None:
            yield message

    def __len__(self) -> int:
        return len(self._inbox)

    @override
    def close(self) -> None:
        """Close the port, which ends iterations."""
        self._inbox.close()
        due, self._due = self._due, None
        if due is not None:
            due.retire()
        super().close()

    def _deliver(self, message: PortMessage | None) -> Received | None:
        if self._due is not None:
            self._due.give_up()
        self._due = None if self._patient else message
        return None if message is None else Received(message, self.core.profile)

    @override
    def _on_message(self, message: PortMessage) -> None:
        if message.wants_reply:
            message.later()
        self._inbox.put(message)


class Writer(OpenPort):
    """An output port that writes plain values or YARP types to all connected ports; see also `OpenPort`."""

    def __init__(self, name: str = "", **options: Any) -> None:
        super().__init__(name, is_input=False, **options)

    def write(self, content: Content, envelope: str = "", *, strict: bool = False) -> int:
        """Send a message with an envelope (``stamp.to_text()``) without blocking; return the number of receivers.

        ``strict``: queue it after messages that a slow peer has not received yet, instead of replacing them.
        """
        return self.core.write(payload_of(content), envelope, strict=strict)


class Client(OpenPort):
    """A client of one server, given by its port's name; see also `OpenPort`."""

    def __init__(self, server: str, name: str = "", **options: Any) -> None:
        super().__init__(name, is_input=False, rpc=True, **options)
        self.server = server

    @override
    def open(self) -> Self:
        super().open()
        with closed_on_failure(self):
            return self.connect(self.server)

    def ask(self, content: Content, *, timeout: float | None = None) -> list[Any]:
        """Send a request and return the reply's values; raises `TimeoutError` after ``timeout``, `ConnectionError`."""
        return binary.decode(self.core.request(payload_of(content), timeout=timeout))


class Server(OpenPort):
    """A server: ``respond(values)`` returns a reply, on the thread of the client's connection; see also `OpenPort`."""

    def __init__(self, name: str, respond: Callable[[list[Any]], Content], **options: Any) -> None:
        super().__init__(name, is_output=False, rpc=True, **options)
        self._respond = respond

    @override
    def _on_message(self, message: PortMessage) -> None:
        received = Received(message, self.core.profile)
        received.reply(self._respond(received.values))


def payload_of(content: Content) -> Callable[[Profile], Payload]:
    """Return a function that encodes a message's content in a peer's dialect."""
    if isinstance(content, Portable):
        return content.to_wire
    return lambda profile: binary.encode_parts(content, profile)
