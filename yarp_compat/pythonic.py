"""YARP ports the Python way: context managers, iteration, plain values. `yarp_compat.aio` is the same for asyncio.

Example::

    with Reader("/robot/pose:i") as reader:
        for message in reader:
            x, y = message.values

Errors are exceptions here: `NamingError` where the name server is not there, `PortError` where a connection cannot be
made, `WireError` where bytes are not what they should be, `TimeoutError`, `ConnectionError`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self, TypeVar

from yarp_compat.naming.client import NameClient
from yarp_compat.os.ports.connection import sender_profile
from yarp_compat.os.ports.inbox import Inbox
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
    """A message that came; ``raw`` is the message of the port's engine."""

    def __init__(self, raw: PortMessage, profile: Profile) -> None:
        self.raw = raw
        self._profile = sender_profile(raw)
        self._reply_profile = self._profile or profile

    @property
    def values(self) -> list[Any]:
        """The values of the Bottle that came; raises `WireError` where it is none."""
        return binary.decode(self.raw.payload, self._profile)

    def to(self, kind: type[T]) -> T:
        """The message as one of YARP's data: ``message.to(yarp.Vector)``; raises `WireError` for something else."""
        content = kind()
        content.from_wire(self.raw.payload, self._profile)
        return content

    @property
    def envelope(self) -> str:
        """The envelope's text, ``12 1795143618.02`` for a stamp, or empty."""
        return self.raw.envelope

    @property
    def source(self) -> str:
        """The name of the port that sent it."""
        return self.raw.peer.route.source

    @property
    def wants_reply(self) -> bool:
        """Whether the sender waits for a reply."""
        return self.raw.wants_reply

    def reply(self, content: Content) -> None:
        """Answer, once."""
        self.raw.reply(payload_of(content)(self._reply_profile))


class OpenPort(Openable):
    """A port that is open between ``with`` and its end. See `Reader`, `Writer`, `Client` and `Server`.

    An empty name lets the name server choose one, by default that of ``yarp.conf``; more options as of `PortCore`.
    """

    def __init__(self, name: str = "", *, naming: Naming | None = None, **options: Any) -> None:
        self.core = PortCore(name, on_message=self._on_message, naming=naming or NameClient(), **options)

    @property
    def name(self) -> str:
        """The port's name, as the name server took it."""
        return self.core.name

    def open(self) -> Self:
        """Open the port, unless it is."""
        if not self.core.is_open:
            self.core.open()
        return self

    def close(self) -> None:
        """Close the port."""
        self.core.close()

    def connect(self, target: str) -> Self:
        """Connect the output to another port; ``udp://r`` says the carrier too. Raises `PortError` where it cannot."""
        done, said = self.core.add_output(target)
        if not done:
            raise PortError(said)
        return self

    def _on_message(self, message: PortMessage) -> None:
        """A message came, on its connection's thread."""


class Reader(OpenPort):
    """Reads: iteration gives each message as a `Received`, and ends when the port is closed; more as of `OpenPort`.

    ``strict``: every message, not the newest only. ``patient``: a reply that is wanted may come after the next messages
    were read; by default it is an empty one when the next is read.
    """

    def __init__(self, name: str = "", *, strict: bool = False, patient: bool = False, **options: Any) -> None:
        super().__init__(name, is_output=False, **options)
        self._inbox = Inbox()
        self._inbox.strict = strict
        self._patient = patient
        self._due: PortMessage | None = None

    def read(self) -> Received | None:
        """Wait for the next message; None once the port is closed."""
        return self._given(self._inbox.pop(wait=True))

    def read_now(self) -> Received | None:
        """The next message, if there is one."""
        return self._given(self._inbox.pop(wait=False))

    def __iter__(self) -> Iterator[Received]:
        while (message := self.read()) is not None:
            yield message

    def __len__(self) -> int:
        return len(self._inbox)

    def close(self) -> None:
        """Close the port; whoever iterates comes to the end."""
        self._inbox.close()
        due, self._due = self._due, None
        if due is not None:
            due.retire()
        super().close()

    def _given(self, message: PortMessage | None) -> Received | None:
        if self._due is not None:
            self._due.give_up()
        self._due = None if self._patient else message
        return None if message is None else Received(message, self.core.profile)

    def _on_message(self, message: PortMessage) -> None:
        if message.wants_reply:
            message.later()
        self._inbox.put(message)


class Writer(OpenPort):
    """Writes plain values or any of YARP's data to all ports that are connected; arguments as of `OpenPort`."""

    def __init__(self, name: str = "", **options: Any) -> None:
        super().__init__(name, is_input=False, **options)

    def write(self, content: Content, envelope: str = "", *, strict: bool = False) -> int:
        """Send a message with an envelope (``stamp.to_text()``), waiting for nobody; returns how many took it.

        ``strict``: after what is still on its way to a slow peer, instead of in its place.
        """
        return self.core.write(payload_of(content), envelope, strict=strict)


class Client(OpenPort):
    """Asks one server, by its port's name; more as of `OpenPort`."""

    def __init__(self, server: str, name: str = "", **options: Any) -> None:
        super().__init__(name, is_input=False, rpc=True, **options)
        self.server = server

    def open(self) -> Self:
        """Open the port and connect it to the server."""
        super().open()
        with closed_on_failure(self):
            return self.connect(self.server)

    def ask(self, content: Content, *, timeout: float | None = None) -> list[Any]:
        """The answer's values; raises `TimeoutError` after so many seconds, `ConnectionError` without the server."""
        return binary.decode(self.core.request(payload_of(content), timeout=timeout))


class Server(OpenPort):
    """Answers: ``respond(values)`` returns an answer, on the client's connection's thread; more as of `OpenPort`."""

    def __init__(self, name: str, respond: Callable[[list[Any]], Content], **options: Any) -> None:
        super().__init__(name, is_output=False, rpc=True, **options)
        self._respond = respond

    def _on_message(self, message: PortMessage) -> None:
        received = Received(message, self.core.profile)
        received.reply(self._respond(received.values))


def payload_of(content: Content) -> Callable[[Profile], Payload]:
    """Makes the bytes of a message's content, in a peer's dialect."""
    if isinstance(content, Portable):
        return content.to_wire
    return lambda profile: binary.encode_parts(content, profile)
