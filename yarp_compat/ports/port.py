"""The engine under all kinds of ports: a name, a listening socket, inputs and outputs."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

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
_LOOK = 0.5  # seconds between looks whether the peers of idle outputs are still there
_KEPT_FOR = 5.0  # seconds for which an input keeps the memory of a large message for the next one


class PortCore(ConnectingPort):
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
        number: its TCP port; 0: one of the naming's `numbers`, or the name server chooses.
        profile: the dialect of Bottles made from text.
        is_input: it reads, as it announces.
        is_output: it writes; otherwise no outputs are made.
        on_event: told when a connection comes or goes; must not block.
        on_line: answers lines to a name server, given without ``NAME_SERVER`` and with the peer's address.
        replies: its owner answers, so who connects is asked for its dialect first; by default RPC ports do.
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
        """Register the port and listen, after a close under way; raises `NamingError`, `OSError` for the address."""
        self._closed.wait()
        with self._life:
            contact, sock = registered(self.naming, self.name, self._host, self._number)
            self.contact, self.name = contact, contact.name
            self._loop = shared = loop.acquire()
            self.connections.open()
            self._listener = Listener(shared, sock, self._opened, self._refused)
            shared.call(self._look)
            note_open(self)
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
            self._end(shared, listener)
        finally:
            self._closed.set()

    def _end(self, shared: loop.PortLoop, listener: Listener) -> None:
        self.interrupt()
        note_closed(self)
        listener.close()
        self._end_connections()
        try:
            self.naming.unregister(self.name)
        except OSError as error:
            _log.warning("port %s could not be unregistered: %s", self.name, error)
        loop.release(shared)
        self.resume()

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
        self.groups.abandon()

    def interrupt(self) -> None:
        """Take and send nothing any more until :meth:`resume`."""
        self._interrupted = True

    def resume(self) -> None:
        """Go on after :meth:`interrupt`."""
        self._interrupted = False

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._loop is not None

    @property
    def on_event(self) -> OnEvent | None:
        """The callback for connections that come or go; it must not block."""
        return self.connections.on_event

    @on_event.setter
    def on_event(self, on_event: OnEvent | None) -> None:
        self.connections.on_event = on_event

    def write(
        self, payload: Content, envelope: str = "", *, strict: bool = False, wait: bool = False,
        timeout: float | None = None, text: Callable[[], str] | None = None,
        chosen: Callable[[AnyOutput], bool] | None = None,
    ) -> int:  # fmt: skip
        """Send a message to all outputs, or the ``chosen``; returns how many took it. Text carriers take Bottles only.

        The payload may be what makes it in each output's dialect. ``strict``: queue it behind messages that are still
        on their way to a peer, the oldest of which make room in a full queue; else it takes their place. ``wait``:
        return when all peers took it, and acknowledged it where the carrier does that, ``timeout`` seconds at most;
        else never wait. ``text`` makes the line for text carriers, by default the payload's own.
        """
        if self._interrupted:
            self.counters.dropped["interrupted"] += 1
            return 0
        outputs = self.connections.outputs
        if not outputs:
            return 0
        made = OutgoingMessage(payload, envelope, "D", text)
        self.counters.sent += 1
        begun: list[tuple[AnyOutput, Item]] = []
        shared: dict[SendingGroup | None, Item] = {}
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
                item = shared.get(output.group) or output.begin(buffers, strict or wait, wait)
                if item is not None:
                    if output.group is not None:
                        shared[output.group] = item  # one message for all readers of the group
                    begun.append((output, item))
            return _finished(begun, timeout) if wait else len(begun)
        except BaseException:  # one cannot be made, or an interrupt from the keyboard: the others go on by themselves
            for output, item in begun:
                output.leave(item)
            raise

    def request(
        self, payload: Content, envelope: str = "", *, timeout: float | None = None, parse: ReplyEnd | None = None
    ) -> bytes:
        """Send a request over the first output, and wait for the reply, ``timeout`` seconds at most.

        ``parse`` says where the reply ends that begins these bytes (raises Incomplete for more); by default a Bottle's
        end. Raises as `Output.request` does, and `ConnectionError` without an output.
        """
        outputs = self.connections.outputs
        if not outputs or self._interrupted:
            msg = f"port {self.name} is {'interrupted' if outputs else 'not connected to anything that could reply'}"
            raise ConnectionResetError(msg)
        output = outputs[0]
        deadline = None if timeout is None else time.monotonic() + timeout
        profile = output.profile or self.profile
        made = OutgoingMessage(payload, envelope, "d").buffers(output.carrier, profile)
        self.counters.sent += 1
        reply = output.request(made, parse, deadline)
        return from_line(reply.strip(), profile) if output.carrier.text else reply

    @property
    def answers_in(self) -> Profile | None:
        """The dialect of the port that answers requests; None where it is not known, or no port does."""
        outputs = self.connections.outputs
        return outputs[0].profile if outputs else None

    @property
    def is_writing(self) -> bool:
        """Whether a message is still on its way to a peer."""
        return any(output.busy for output in self.connections.outputs)

    def wait_writes(self, timeout: float | None = None) -> bool:
        """Wait until all messages are sent, and acknowledged where the carrier does that; False where not in time."""
        deadline = None if timeout is None else time.monotonic() + timeout
        return all(output.wait_idle(deadline) for output in self.connections.outputs)

    @property
    def lost(self) -> Counter[str]:
        """Messages that its outputs dropped, by reason; those of outputs that have ended too."""
        return self.connections.lost

    def _look(self) -> None:
        """On the shared thread, now and then: are the peers of idle outputs still there."""
        shared = self._loop
        if shared is not None:
            for output in self.connections.outputs:
                output.check()
            for connection in self.connections.inputs:
                connection.stream.give_back(_KEPT_FOR)
            shared.later(_LOOK, self._look)

    def _refused(self, peer: str, error: WireError) -> None:
        self.counters.dropped["malformed"] += 1
        level = logging.WARNING if isinstance(error, carriers.CarrierError) else logging.INFO
        _log.log(level, "port %s refused a connection from %s: %s", self.name, peer, error)

    def administer(self, payload: Buffer, peer: MessagePeer) -> bytes:
        """Obey an administrative command; returns the answer's Bottle."""
        try:
            words = decode(payload, peer.profile)
        except WireError as error:
            _log.info("port %s: %s sends no administrative command: %s", self.name, peer.route.source, error)
            words = []
        return encode(admin.answer(self, words), peer.profile or self.profile)

    def obey(self, word: PortCommand) -> tuple[str, ...]:
        """Obey a port command; returns the lines that text carriers answer."""
        return admin.obey(self, word)


def _finished(begun: list[tuple[AnyOutput, Item]], timeout: float | None) -> int:
    """Wait until outputs are done with a message; how many are in time."""
    deadline = None if timeout is None else time.monotonic() + timeout
    return sum(item.done or output.finish(item, deadline) for output, item in begun)
