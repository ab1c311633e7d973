"""``Port``: reads, writes, replies; ``RpcServer`` and ``RpcClient``: ports for requests and replies."""

from __future__ import annotations

import logging
from typing import Any

from yarp_compat.os.ports.connection import ConnectionReader, profile_of, sender_profile
from yarp_compat.os.ports.contact import Contact
from yarp_compat.os.ports.contactable import UnbufferedContactable
from yarp_compat.os.ports.inbox import Handoff
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.overriding import override
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.accessors import setter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import PortReader

log = logging.getLogger("yarp.os.Port")


class Port(UnbufferedContactable):
    """A port without buffers, for any of YARP's data: a writer waits until its message is read."""

    _REPLIES = True

    def __init__(self) -> None:
        super().__init__()
        self._gate = self._handoff = Handoff()
        self._reader: PortReader | None = None
        self._background = False
        self._timeout: float | None = None
        self._due: PortMessage | None = None

    def asPort(self) -> Port:
        """Return this port."""
        return self

    def setTimeout(self, timeout: float) -> bool:
        """Set the timeout for replies and acknowledgments, in seconds; 0 or negative: no limit."""
        self._timeout = timeout if timeout > 0 else None
        return True

    enableBackgroundWrite = setter(
        "_background",
        bool,
        "Select whether `write` returns before the message is sent; a slow peer then gets only the newest.",
    )

    def write(self, data: Any, reply: Any = None, callback: Any = None) -> bool:  # noqa: ARG002
        """Send a message; with a second argument, wait for the reply and read it into that argument.

        Returns False if a peer did not receive it or no reply arrived; True if there are neither connections nor
        ``reply``.
        """
        core = self._core
        if core is None or self._interrupted:
            return False
        try:
            if reply is not None:
                answer = core.request(data.to_wire, self._envelope, timeout=self._timeout)
                reply.from_wire(answer)
                return True
            wait = not self._background
            count = len(core.outputs())
            reached = core.write(data.to_wire, self._envelope, strict=wait, wait=wait, timeout=self._timeout)
        except (WireError, OSError) as err:
            log.error("port %s cannot write: %s", core.name, err)
            return False
        return reached >= count or not wait

    def read(self, data: Any, willReply: bool = False) -> bool:
        """Wait for a message and read it into ``data``; ``willReply``: `reply` will be called before the next `read`.

        Returns False if the port was interrupted or closed, or the message is of another type.
        """
        if self._due is not None:
            self._due.give_up()  # the announced reply was not sent
            self._due = None
        core = self._core
        if core is None or self._interrupted:
            return False
        message = self._handoff.receive(will_reply=willReply)
        if message is None:
            return False
        self._envelope = message.envelope or self._envelope
        try:
            data.from_wire(message.payload, sender_profile(message))
        except WireError as err:
            log.error("port %s: cannot read a message from %s: %s", core.name, message.peer.route.source, err)
            message.give_up()
            return False
        self._due = message if willReply else None
        return True

    def reply(self, data: Any) -> bool:
        """Reply to the message read last with ``read(data, True)``."""
        return self._reply(data)

    def replyAndDrop(self, data: Any) -> bool:
        """Reply and end the connection."""
        if self._due is not None:
            self._due.drop()
        return self._reply(data)

    def _reply(self, data: Any) -> bool:
        message, self._due = self._due, None
        if message is None or not message.wants_reply:
            return False
        try:
            message.reply(data.to_wire(profile_of(message, RUNTIME.profile)))
        except WireError as err:
            log.error("port %s cannot reply: %s", self.getName(), err)
            message.give_up()
            return False
        return True

    def getEnvelope(self, envelope: Any) -> bool:
        """Read the envelope of the message read last; return False if it is missing or of another type."""
        try:
            envelope.from_text(self._envelope)
        except WireError:
            return False
        return bool(self._envelope)

    def setReader(self, reader: PortReader) -> None:
        """Pass each message to ``reader.read(connection)``, on its connection's thread."""
        self._reader = reader

    @override
    def _on_message(self, message: PortMessage) -> None:
        core = self._core
        if core is not None and self._reader is not None:
            self._envelope = message.envelope or self._envelope
            with self._callback_lock:
                answer(self._reader, message, Contact.of(core.contact))
        elif core is None or not self._handoff.deliver(message):
            message.later()
            message.retire()  # the connection closes without a reply: even an empty one would count as a reply

    @override
    def _on_open(self) -> None:
        self._gate = self._handoff = Handoff()

    @override
    def _on_closing(self) -> None:
        self._handoff.close()
        if self._due is not None:
            self._due.retire()
            self._due = None

    @override
    def _on_closed(self, core: PortCore) -> None:
        if self._reader is not None:
            notify_closed(self._reader, Contact.of(core.contact))


def answer(reader: PortReader, message: PortMessage, local: Contact) -> None:
    """Pass a message to a reader and send its reply."""
    connection = ConnectionReader(message, local, RUNTIME.profile)
    reader.read(connection)
    writer = connection.getWriter()
    if writer is None:
        return
    lines = writer.lines() if writer.isTextMode() else None
    if lines:
        message.reply(lines, plain=True)
    else:
        message.reply(writer.writer.buffers())


def notify_closed(reader: PortReader, local: Contact) -> None:
    """Notify a reader that its port is closed, with an invalid connection, as in YARP."""
    try:
        reader.read(ConnectionReader(None, local))
    except Exception:
        log.exception("the reader of %s failed when the port closed", local.getName())


_rpc_log = logging.getLogger("yarp.os.Rpc")


class RpcServer(Port):
    """A port that replies: ``read(command, True)`` and then ``reply(answer)``, or a `PortReader`."""

    def __init__(self) -> None:
        super().__init__()
        self.setRpcServer()

    @override
    def read(self, data: Any, willReply: bool = True) -> bool:
        """Wait for a request; `reply` must follow."""
        if not willReply:
            _rpc_log.error("%s must reply, please use a regular Port if you do not want to", self.getName())
            return False
        return super().read(data, True)

    @override
    def write(self, data: Any, reply: Any = None, callback: Any = None) -> bool:
        """Log an error and return False: a server sends no requests."""
        _rpc_log.error("%s cannot write, please use a regular Port or RpcClient for that", self.getName())
        return False


class RpcClient(Port):
    """A port that sends requests: ``write(command, answer)``. It has one connection."""

    def __init__(self) -> None:
        super().__init__()
        self.setRpcClient()

    @override
    def read(self, data: Any, willReply: bool = False) -> bool:
        """Log an error and return False: a client receives no requests."""
        _rpc_log.error("cannot read from RpcClient %s, please use a regular Port for that", self.getName())
        return False

    @override
    def reply(self, data: Any) -> bool:
        """Return False: a client receives no requests."""
        return False

    replyAndDrop = reply
