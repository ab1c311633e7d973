"""The engine under all kinds of ports: a name, a listening socket, inputs and outputs."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from yarp_compat.naming.naming import Naming
from yarp_compat.ports import accepting, admin, closing, commands, connecting, loop, process
from yarp_compat.ports.address import listening
from yarp_compat.ports.connections import AnyOutput, Connections, OnEvent
from yarp_compat.ports.counters import Counters
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.lines import from_line
from yarp_compat.ports.listener import Listener
from yarp_compat.ports.message import Message
from yarp_compat.ports.outgoing import Content, Outgoing
from yarp_compat.ports.replies import ReplyEnd
from yarp_compat.ports.waiting import Item
from yarp_compat.wire import carriers, message
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.command import PortCommand
from yarp_compat.wire.contact import Contact, Route
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.header import Opening
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile

_log = logging.getLogger("yarp.ports")
_LOOK = 0.5
"""Seconds between looks whether the peers of idle outputs are still there."""

OnMessage = Callable[[Message], Any]
OnLine = Callable[[str, tuple[str, int]], bytes]


class PortCore:
    """A port. All methods may be called from any thread.

    Args:
        name: the port's name; "" or "..." lets the name server choose one.
        on_message: takes each message; on the thread of its connection, which goes on with the next one afterwards.
            None: messages are dropped, and those that want a reply get an empty one.
        naming: the name server.
        rpc: an RPC client or server: it has one output at most.
        type_name: the type of what it writes or reads, as it announces it.
        limit: bytes of the largest message or reply that is taken, and at most of each output's queue.
        host: where to listen; by default where the name server says the port is.
        number: its TCP port; 0: the name server chooses.
        profile: the dialect of Bottles made from text.
        is_input: it reads, as it announces.
        is_output: it writes; otherwise no outputs are made.
        on_event: told when a connection comes or goes; must not block.
        on_line: answers lines to a name server, given without ``NAME_SERVER`` and with the peer's address.
        replies: its owner answers, so who connects is asked for its dialect first; by default RPC ports do.
    """

    def __init__(
        self, name: str, *, on_message: OnMessage | None = None, naming: Naming, rpc: bool = False, type_name: str = "",
        limit: int = message.DEFAULT_LIMIT, host: str | None = None, number: int = 0, profile: Profile = Profile.YARP3,
        is_input: bool = True, is_output: bool = True, on_event: OnEvent | None = None, on_line: OnLine | None = None,
        replies: bool | None = None,
    ) -> None:  # fmt: skip
        self.name = name
        self.contact = Contact(name)
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
        self.counters = Counters()
        self.properties: dict[str, Any] = {}
        self.connections = Connections(on_event)
        self._host = host
        self._number = number
        self._life, self._closed = threading.Lock(), threading.Event()
        self._closed.set()
        self._loop: loop.Loop | None = None
        self._listener: Listener | None = None
        self._interrupted = False

    # -- life ---------------------------------------------------------------------------------------------------------

    def open(self) -> Contact:
        """Register the port and listen; where another thread closes it, when that is done.

        Raises:
            NamingError: the name server cannot be reached, or refuses.
            OSError: its address cannot be listened on.
        """
        self._closed.wait()
        with self._life:
            contact = self.naming.register(self.name, self._host or "", self._number)
            sock: socket.socket | None = None
            try:
                host = self._host or contact.host
                sock = listening(host, contact.port, host_fixed=bool(self._host), number_fixed=bool(self._number))
                if (found := sock.getsockname()[1]) != contact.port:
                    contact = self.naming.register(contact.name, contact.host, found)
            except BaseException:
                if sock is not None:
                    sock.close()
                self.naming.unregister(contact.name)
                raise
            self.contact, self.name = contact, contact.name
            self._loop = shared = loop.acquire()
            self.connections.open()
            self._listener = Listener(shared, sock, self._opened, self._refused)
            shared.call(self._look)
            process.add(self)
        try:
            self.naming.announce(self.name)
        except OSError:
            self.close()
            raise
        return contact

    def close(self) -> None:
        """End all connections, give the name back, and leave nothing behind."""
        with self._life:
            shared, self._loop = self._loop, None
            listener, self._listener = self._listener, None
            if shared is None or listener is None:
                return
            self._closed.clear()
        try:
            closing.end(self, shared, listener)
        finally:
            self._closed.set()

    def abandon(self) -> None:
        """In a child process of fork: let go of the sockets, and say nothing to anybody."""
        self._life, self._closed = threading.Lock(), threading.Event()
        self._closed.set()
        self._loop = None
        if self._listener is not None:
            self._listener.abandon()
        for connection in (*self.connections.inputs, *self.connections.leaving, *self.connections.outputs):
            connection.abandon()
        self.connections = Connections(None)

    def interrupt(self) -> None:
        """Take and send nothing any more until :meth:`resume`."""
        self._interrupted = True

    def resume(self) -> None:
        """Go on after :meth:`interrupt`."""
        self._interrupted = False

    @property
    def loop(self) -> loop.Loop | None:
        """The thread that the port shares with others, None where it is not open."""
        return self._loop

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._loop is not None

    @property
    def on_event(self) -> OnEvent | None:
        """Told when a connection comes or goes; must not block."""
        return self.connections.on_event

    @on_event.setter
    def on_event(self, on_event: OnEvent | None) -> None:
        self.connections.on_event = on_event

    # -- writing ------------------------------------------------------------------------------------------------------

    def write(
        self, payload: Content, envelope: str = "", *, strict: bool = False, wait: bool = False,
        timeout: float | None = None, text: Callable[[], str] | None = None,
        chosen: Callable[[AnyOutput], bool] | None = None,
    ) -> int:  # fmt: skip
        """Send a message to all outputs.

        Args:
            payload: its bytes, in one or several buffers; or what makes them in the dialect of each output.
            envelope: sent with it.
            strict: where an earlier message is still on its way to a peer, queue this one behind it, the oldest of the
                queue go where it is full; else this one takes the place of what waits.
            wait: return when all peers took it, and acknowledged it where the carrier does that; without it, never
                wait.
            timeout: seconds to wait at most.
            text: makes the line for text carriers; by default the payload's own text.
            chosen: which of the outputs get it; by default all.

        Returns:
            how many outputs took it. A text carrier takes Bottles only.
        """
        if self._interrupted:
            self.counters.dropped["interrupted"] += 1
            return 0
        outputs = self.connections.outputs
        if not outputs:
            return 0
        made = Outgoing(payload, envelope, "D", text)
        self.counters.sent += 1
        begun: list[tuple[AnyOutput, Item]] = []
        try:
            for output in outputs:
                if chosen is not None and not chosen(output):
                    continue
                try:
                    buffers = made.buffers(output.carrier, output.profile or self.profile)
                except WireError:
                    if not output.carrier.text:
                        raise
                    self.counters.dropped["no text"] += 1  # who reads it as text must not harm who does not
                    continue
                item = output.begin(buffers, strict or wait, wait)
                if item is not None:
                    begun.append((output, item))
            return _finished(begun, timeout) if wait else len(begun)
        except BaseException:  # one cannot be made, or an interrupt from the keyboard: the others go on by themselves
            for output, item in begun:
                output.leave(item)
            raise

    def request(
        self, payload: Content, envelope: str = "", *, timeout: float | None = None, parse: ReplyEnd | None = None
    ) -> bytes:
        """Send a message that wants a reply over the first output, and wait for it.

        Args:
            payload: the request.
            envelope: sent with it.
            timeout: seconds to wait at most.
            parse: where the reply ends that begins these bytes (raises Incomplete for more); by default a Bottle's end.

        Raises:
            TimeoutError: no reply in time; the connection is closed.
            ConnectionError: there is no output, or it broke.
            WireError: the reply is no Bottle, or above the limit.
        """
        outputs = self.connections.outputs
        if not outputs or self._interrupted:
            msg = f"port {self.name} is {'interrupted' if outputs else 'not connected to anything that could reply'}"
            raise ConnectionResetError(msg)
        output = outputs[0]
        deadline = None if timeout is None else time.monotonic() + timeout
        profile = output.profile or self.profile
        made = Outgoing(payload, envelope, "d").buffers(output.carrier, profile)
        self.counters.sent += 1
        reply = output.request(made, parse, deadline)
        return from_line(reply.strip(), profile) if output.carrier.text else reply

    @property
    def answers_in(self) -> Profile | None:
        """The dialect of the port that answers requests; None where it is not known, or there is none."""
        outputs = self.connections.outputs
        return outputs[0].profile if outputs else None

    @property
    def is_writing(self) -> bool:
        """Whether a message is still on its way to a peer."""
        return any(output.busy for output in self.connections.outputs)

    def wait_writes(self, timeout: float | None = None) -> bool:
        """Wait until all messages have been sent, and acknowledged where the carrier does that.

        False where not in time.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        return all(output.wait_idle(deadline) for output in self.connections.outputs)

    # -- connections --------------------------------------------------------------------------------------------------

    def inputs(self) -> list[Route]:
        """The input connections."""
        return [i.route for i in self.connections.inputs]

    def outputs(self) -> list[Route]:
        """The output connections."""
        return [o.route for o in self.connections.outputs]

    def add_output(self, target: str) -> tuple[bool, str]:
        """Connect this port to another: ``/name``, ``carrier://name`` or ``carrier:/name``.

        Returns:
            whether that was done, and YARP's words about it.
        """
        return connecting.add_output(self, target)

    def remove_output(self, name: str) -> tuple[bool, str]:
        """End the output connection to a port; whether there was one, and YARP's words."""
        return connecting.remove_output(self, name)

    def remove_input(self, name: str) -> tuple[bool, str]:
        """End the input connection from a port; whether there was one, and YARP's words."""
        return connecting.remove_input(self, name)

    def _look(self) -> None:
        """On the shared thread, now and then: are the peers of idle outputs still there."""
        shared = self._loop
        if shared is not None:
            for output in self.connections.outputs:
                output.check()
            shared.later(_LOOK, self._look)

    # -- what comes in ------------------------------------------------------------------------------------------------

    def _opened(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> None:
        """A connection introduced itself; on the shared thread."""
        connection = accepting.answer(self, sock, opened, rest, address)
        if connection is not None:
            self._attach(connection)

    def attach(self, sock: socket.socket, opened: Opening) -> None:
        """Take a connection from a port of the same process."""
        self._attach(accepting.made_of(self, sock, opened, b"", ("", 0)))

    def _attach(self, connection: Input) -> None:
        shared = self._loop
        if shared is None or not self.connections.add_input(connection):
            connection.abandon()
        else:
            connection.start(shared)

    def _refused(self, peer: str, error: WireError) -> None:
        self.counters.dropped["malformed"] += 1
        level = logging.WARNING if isinstance(error, carriers.CarrierError) else logging.INFO
        _log.log(level, "port %s refused a connection from %s: %s", self.name, peer, error)

    def refused(self, route: Route, error: WireError) -> None:
        """A connection said something that is no message."""
        self.counters.dropped["malformed"] += 1
        _log.warning("port %s ends the connection from %s: %s", self.name, route.source, error)

    def ended(self, connection: Input) -> None:
        """An input connection is over."""
        self.connections.ended(connection)

    def turned(self, connection: Input, sock: socket.socket) -> None:
        """An input connection asked to be an output."""
        self.ended(connection)
        route = Route(self.name, connection.route.source, connection.route.carrier)
        with contextlib.suppress(ConnectionAbortedError):
            connecting.take_output(self, sock, route, connection.carrier, connection.profile)

    def deliver(self, incoming: Message) -> None:
        """Give a message to the port's owner.

        Raises:
            ConnectionAbortedError: the port closes: nobody gets an empty reply, or an acknowledgement, for that.
        """
        if self._loop is None:
            msg = f"port {self.name} is closed"
            raise ConnectionAbortedError(msg)
        counters = self.counters
        counters.received += 1
        if self.on_message is None:
            counters.dropped["no reader"] += 1
        elif self._interrupted:
            counters.dropped["interrupted"] += 1
        else:
            try:
                self.on_message(incoming)
            except Exception:
                counters.dropped["failed"] += 1
                incoming.give_up()
                _log.exception("port %s: its owner failed on a message from %s", self.name, incoming.peer.route.source)

    def administer(self, payload: Buffer, connection: Input) -> bytes:
        """Obey an administrative command; the answer's Bottle."""
        try:
            words = decode(payload, connection.profile)
        except WireError as error:
            told = "port %s: %s sends an administrative command that is none: %s"
            _log.info(told, self.name, connection.route.source, error)
            words = []
        return encode(admin.answer(self, words), connection.profile or self.profile)

    def obey(self, word: PortCommand) -> tuple[str, ...]:
        """Obey a port command; the lines that text carriers answer."""
        return commands.obey(self, word)

    def describe(self) -> tuple[str, ...]:
        """The port and its connections, in YARP's words."""
        return commands.describe(self)


def _finished(begun: list[tuple[AnyOutput, Item]], timeout: float | None) -> int:
    """Wait until outputs are done with a message; how many are in time."""
    deadline = None if timeout is None else time.monotonic() + timeout
    return sum(item.done or output.finish(item, deadline) for output, item in begun)
