"""The core of all kinds of ports: a name, a listening socket, inputs and outputs."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from yarp_compat.overriding import override
from yarp_compat.ports import admin, loop
from yarp_compat.ports.base import MessageCounters, OnLine, OnMessage, note_closed, note_open
from yarp_compat.ports.connecting import ConnectingPort
from yarp_compat.ports.connections import AnyOutput, Connections, OnEvent
from yarp_compat.ports.datagrams import SendingGroup
from yarp_compat.ports.listener import Listener
from yarp_compat.ports.message import MessagePeer
from yarp_compat.ports.multicast import SendingGroups
from yarp_compat.ports.naming import Naming
from yarp_compat.ports.outgoing import Content, Item, OutgoingMessage, from_line
from yarp_compat.ports.sockets import registered
from yarp_compat.wire import carriers, framing
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer, PortCommand
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.reply import ReplyEnd

_log = logging.getLogger("yarp.ports")
_KEPT_FOR = 5.0  # seconds for which an input keeps the memory of a large message for the next one


class PortCore(ConnectingPort):
    """A port. All methods may be called from any thread.

    Args:
        name: the port's name; "" or "..." lets the name server choose one.
        on_message: called for each message, on its connection's thread, which then continues with the next message.
            None: messages are dropped, and requests get an empty reply.
        naming: the name server.
        rpc: whether it is an RPC client or server, with at most one output.
        type_name: the announced type of its messages.
        limit: maximum bytes of an accepted message or reply, and of each output's queue.
        host: address to listen on; by default the one that the name server returns.
        number: its TCP port; 0: one of the naming's `numbers`, or assigned by the name server.
        profile: the dialect of Bottles made from text.
        is_input: whether it announces that it reads.
        is_output: whether it writes; otherwise outputs are refused.
        on_event: called when a connection opens or closes; must not block.
        on_line: answers command lines for a name server; called with the line, without ``NAME_SERVER``, and the peer's
            address, on the thread that all ports share unless it may ``wait``.
        replies: whether its owner replies; by default like ``rpc``. If so, the dialect of a port that connects over tcp
            or fast_tcp is queried before the connection is accepted, because a C++ port that waits for a reply answers
            no query.
    """

    def __init__(
        self, name: str, *, on_message: OnMessage | None = None, naming: Naming, rpc: bool = False, type_name: str = "",
        limit: int = framing.DEFAULT_LIMIT, host: str | None = None, number: int = 0, profile: Profile = Profile.YARP3,
        is_input: bool = True, is_output: bool = True, on_event: OnEvent | None = None, on_line: OnLine | None = None,
        replies: bool | None = None,
    ) -> None:  # fmt: skip
        self.name = name
        self.contact = PortContact(name)
        self.naming = naming
        self.rpc = rpc
        self.type_name = type_name
        self.limit = limit
        self.profile = profile
        self.is_input = is_input
        self.is_output = is_output
        self.on_message = on_message
        self.on_line = on_line
        self.replies = rpc if replies is None else replies
        self.counters = MessageCounters()
        self.properties: dict[str, Any] = {}
        self.connections = Connections(on_event)
        self.groups = SendingGroups(naming)
        self._host = host
        self._number = number
        self._life, self._closed = threading.Lock(), threading.Event()
        self._closed.set()
        self._loop: loop.PortLoop | None = None
        self._listener: Listener | None = None
        self._interrupted = False

    def open(self) -> PortContact:
        """Wait for a pending close, register the port and listen; raises `NamingError`, or `OSError` for the socket."""
        self._closed.wait()
        with self._life:
            contact, sock = registered(self.naming, self.name, self._host, self._number)
            self.contact, self.name = contact, contact.name
            self._loop = shared = loop.acquire()
            self.connections.open()
            self._listener = listener = Listener(shared, sock, self._on_introduced, self._on_refused)
            shared.add_check(self._check_connections)
            note_open(self)
        try:
            listener.start()
            self.naming.announce(self.name)
        except OSError:
            self.close()
            raise
        return contact

    def close(self) -> None:
        """Close all connections and unregister the name; return when all threads have ended."""
        with self._life:
            shared, self._loop = self._loop, None
            listener, self._listener = self._listener, None
            if shared is None or listener is None:
                return
            self._closed.clear()
        try:
            self._end(shared, listener)
        finally:
            self._closed.set()

    def _end(self, shared: loop.PortLoop, listener: Listener) -> None:
        self.interrupt()
        note_closed(self)
        shared.remove_check(self._check_connections)
        listener.close()
        self._end_connections()
        try:
            self.naming.unregister(self.name)
        except OSError as error:
            _log.warning("cannot unregister port %s: %s", self.name, error)
        loop.release(shared)
        self.resume()

    @override
    def abandon(self) -> None:
        self._life, self._closed = threading.Lock(), threading.Event()
        self._closed.set()
        self._loop = None
        if self._listener is not None:
            self._listener.abandon()
        for connection in (*self.connections.inputs, *self.connections.leaving, *self.connections.outputs):
            connection.abandon()
        self.connections = Connections(None)
        self.groups.abandon()

    def interrupt(self) -> None:
        """Drop all messages until `resume`."""
        self._interrupted = True

    def resume(self) -> None:
        """Continue after `interrupt`."""
        self._interrupted = False

    @property
    def is_open(self) -> bool:
        """Whether the port is registered and listens."""
        return self._loop is not None

    @property
    def on_event(self) -> OnEvent | None:
        """The callback for connections that open or close; it must not block."""
        return self.connections.on_event

    @on_event.setter
    def on_event(self, on_event: OnEvent | None) -> None:
        self.connections.on_event = on_event

    def write(
        self, payload: Content, envelope: str = "", *, strict: bool = False, wait: bool = False,
        timeout: float | None = None, text: Callable[[], str] | None = None,
        chosen: Callable[[AnyOutput], bool] | None = None,
    ) -> int:  # fmt: skip
        """Send a message to all outputs, or the ``chosen``; return how many accepted it. Text carriers need Bottles.

        The payload may be a function that encodes it in each output's dialect. ``strict``: queue the message behind
        those that wait (a full queue drops the oldest); otherwise it replaces them, but not the one that is being sent.
        ``wait``: block until it is sent to all peers, and acknowledged if the carrier has acknowledgments, for at most
        ``timeout`` seconds; otherwise never block. ``text`` returns the line for text carriers, by default the
        payload's text.
        """
        if self._interrupted:
            self.counters.dropped["interrupted"] += 1
            return 0
        outputs = self.connections.outputs
        if not outputs:
            return 0
        message = OutgoingMessage(payload, envelope, "D", text)
        self.counters.sent += 1
        begun: list[tuple[AnyOutput, Item]] = []
        shared: dict[SendingGroup | None, Item] = {}
        try:
            for output in outputs:
                if chosen is not None and not chosen(output):
                    continue
                try:
                    buffers = message.buffers(output.carrier, output.profile or self.profile)
                except WireError:
                    if not output.carrier.text:
                        raise
                    self.counters.dropped["no text"] += 1  # readers of text must not affect other readers
                    continue
                item = shared.get(output.group) or output.begin(buffers, strict or wait, wait)
                if item is not None:
                    if output.group is not None:
                        shared[output.group] = item  # one message for all readers of the group
                    begun.append((output, item))
            return _finish(begun, timeout) if wait else len(begun)
        except BaseException:  # WireError or KeyboardInterrupt: the shared thread completes the messages begun
            for output, item in begun:
                output.detach(item)
            raise

    def request(
        self, payload: Content, envelope: str = "", *, timeout: float | None = None, parse: ReplyEnd | None = None
    ) -> bytes:
        """Send a request on the first output and wait for the reply, at most ``timeout`` seconds.

        ``parse`` returns the end of the reply at the start of the bytes, or raises `Incomplete` if bytes are missing;
        by default the reply is a Bottle. Raises like `Output.request`, and `ConnectionError` without an output.
        """
        outputs = self.connections.outputs
        if not outputs or self._interrupted:
            msg = f"port {self.name} is {'interrupted' if outputs else 'not connected to a server'}"
            raise ConnectionResetError(msg)
        output = outputs[0]
        deadline = None if timeout is None else time.monotonic() + timeout
        profile = output.profile or self.profile
        buffers = OutgoingMessage(payload, envelope, "d").buffers(output.carrier, profile)
        self.counters.sent += 1
        reply = output.request(buffers, parse, deadline)
        return from_line(reply.strip(), profile) if output.carrier.text else reply

    def call_later(self, seconds: float, callback: Callable[[], object]) -> None:
        """Call back once after a delay, on the thread that all ports share, if the port is open now."""
        shared = self._loop
        if shared is not None:
            shared.call_soon(lambda: shared.call_later(seconds, callback))

    @property
    def answers_in(self) -> Profile | None:
        """The dialect of the port that answers requests; None if it is unknown or not connected."""
        outputs = self.connections.outputs
        return outputs[0].profile if outputs else None

    @property
    def is_writing(self) -> bool:
        """Whether a message is still being sent to a peer."""
        return any(output.busy for output in self.connections.outputs)

    def wait_writes(self, timeout: float | None = None) -> bool:
        """Wait until all messages are sent (and acknowledged, with some carriers); return False after ``timeout`` s."""
        deadline = None if timeout is None else time.monotonic() + timeout
        return all(output.wait_idle(deadline) for output in self.connections.outputs)

    @property
    def lost(self) -> Counter[str]:
        """The number of messages that the port's outputs dropped, by reason; closed outputs included."""
        return self.connections.lost

    def _check_connections(self) -> None:
        """Check idle outputs, and free unused memory of inputs."""
        for output in self.connections.outputs:
            output.check()
        for connection in self.connections.inputs:
            connection.stream.free_unused(_KEPT_FOR)

    def _on_refused(self, peer: str, error: WireError) -> None:
        self.counters.dropped["malformed"] += 1
        level = logging.WARNING if isinstance(error, carriers.CarrierError) else logging.INFO
        _log.log(level, "port %s refused a connection from %s: %s", self.name, peer, error)

    @override
    def administer(self, payload: Buffer, peer: MessagePeer) -> bytes:
        try:
            command = decode(payload, peer.profile)
        except WireError as error:
            _log.info("port %s: invalid administrative command from %s: %s", self.name, peer.route.source, error)
            command = []
        return encode(admin.answer(self, command), peer.profile or self.profile)

    @override
    def execute(self, command: PortCommand) -> tuple[str, ...]:
        return admin.execute(self, command)


def _finish(begun: list[tuple[AnyOutput, Item]], timeout: float | None) -> int:
    """Wait until outputs have sent a message; return how many did so in time."""
    deadline = None if timeout is None else time.monotonic() + timeout
    return sum(item.done or output.finish(item, deadline) for output, item in begun)
