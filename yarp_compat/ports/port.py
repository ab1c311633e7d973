"""The engine under all kinds of ports: a name, a listening socket, inputs and outputs."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from yarp_compat.naming.naming import Naming
from yarp_compat.ports import admin, loop
from yarp_compat.ports.counters import Counters
from yarp_compat.ports.dial import dial
from yarp_compat.ports.events import ConnectionEvent
from yarp_compat.ports.inputs import Input
from yarp_compat.ports.listener import Listener
from yarp_compat.ports.message import Message, Payload
from yarp_compat.ports.output import Item, Output
from yarp_compat.ports.sending import flat
from yarp_compat.wire import carriers, command, message
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import Contact, Route, rooted
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.header import Opening
from yarp_compat.wire.header import answer as opening_answer
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text

_log = logging.getLogger("yarp.ports")
_LOOK = 0.5
"""Seconds between looks whether the peers of idle outputs are still there."""

OnMessage = Callable[[Message], Any]
OnEvent = Callable[[ConnectionEvent], None]


class PortCore:
    """A port. All methods may be called from any thread.

    Args:
        name: the port's name; "" or "..." lets the name server choose one.
        on_message: takes each message; on the thread of its connection, which goes on with the next one afterwards. None: messages are
            dropped, and those that want a reply get an empty one.
        naming: the name server.
        rpc: an RPC client or server: it has one output at most.
        type_name: the type of what it writes or reads, as it announces it.
        limit: bytes of the largest message or reply that is taken, and of each output's queue.
        host: where to listen; by default where the name server says the port is.
        number: its TCP port; 0: the name server chooses.
        profile: the dialect of Bottles made from text.
        is_input: it takes inputs. is_output: it makes outputs.
        on_event: told when a connection comes or goes; must not block.
    """

    def __init__(
        self, name: str, *, on_message: OnMessage | None = None, naming: Naming, rpc: bool = False, type_name: str = "",
        limit: int = message.DEFAULT_LIMIT, host: str | None = None, number: int = 0, profile: Profile = Profile.YARP3,
        is_input: bool = True, is_output: bool = True, on_event: OnEvent | None = None,
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
        self.on_event = on_event
        self.counters = Counters()
        self.properties: dict[str, Any] = {}
        self._host = host
        self._number = number
        self._loop: loop.Loop | None = None
        self._listener: Listener | None = None
        self._lock = threading.RLock()
        self._inputs: list[Input] = []
        self._outputs: list[Output] = []
        self._interrupted = False

    # -- life ---------------------------------------------------------------------------------------------------------

    def open(self) -> Contact:
        """Register the port and listen.

        Raises:
            NamingError: the name server cannot be reached, or refuses.
            OSError: its address cannot be listened on.
        """
        contact = self.naming.register(self.name, self._host or "", self._number)
        try:
            sock = self._bound(contact.host, contact.port)
            found = sock.getsockname()[1]
            if found != contact.port:
                contact = self.naming.register(contact.name, contact.host, found)
        except BaseException:
            self.naming.unregister(contact.name)
            raise
        self.contact, self.name = contact, contact.name
        self._loop = loop.acquire()
        self._listener = Listener(self._loop, sock, self._opened, self._refused)
        self._loop.call(self._look)
        self.naming.announce(self.name)
        return contact

    def _bound(self, host: str, number: int) -> socket.socket:
        """A socket at the port's address; with another number where that one is taken and nobody asked for it."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_STREAM)
        try:
            if hasattr(socket, "SO_REUSEADDR") and socket.has_dualstack_ipv6 is not None:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                sock.bind((self._host or host, number))
            except OSError as error:
                if error.errno == errno.EADDRINUSE and not self._number:
                    sock.bind((self._host or host, 0))
                elif error.errno == errno.EADDRNOTAVAIL and not self._host:
                    sock.bind(
                        ("", number)
                    )  # known under an address that is not this machine's own: behind a translation
                else:
                    raise
        except BaseException:
            sock.close()
            raise
        return sock

    def close(self) -> None:
        """End all connections, give the name back, and leave nothing behind."""
        with self._lock:
            shared, self._loop = self._loop, None
            listener, self._listener = self._listener, None
        if shared is None or listener is None:
            return
        self.interrupt()
        listener.close()
        with self._lock:
            outputs, inputs = list(self._outputs), list(self._inputs)
        for output in outputs:
            self._drop_output(output)
        for connection in inputs:
            connection.close()
        for connection in inputs:
            connection.join(5.0)
        try:
            self.naming.unregister(self.name)
        except OSError as error:
            _log.warning("port %s could not be unregistered: %s", self.name, error)
        finally:
            loop.release(shared)

    def interrupt(self) -> None:
        """Take and send nothing any more, and let nobody wait, until :meth:`resume`."""
        self._interrupted = True

    def resume(self) -> None:
        """Go on after :meth:`interrupt`."""
        self._interrupted = False

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._loop is not None

    # -- writing ------------------------------------------------------------------------------------------------------

    def write(
        self, payload: Payload, envelope: str = "", *, strict: bool = False, wait: bool = False, timeout: float | None = None,
        text: Callable[[], str] | None = None,
    ) -> int:  # fmt: skip
        """Send a message to all outputs.

        Args:
            payload: its bytes, in one or several buffers.
            envelope: sent with it.
            strict: where an earlier message is still on its way to a peer, queue this one behind it (else it takes the place of what waits).
            wait: return when all peers took it (and acknowledged it, where the carrier does that). Without it, never waits.
            timeout: seconds to wait at most.
            text: makes the line for text carriers; by default the payload's own text.

        Returns:
            how many outputs took it.
        """
        if self._interrupted:
            self.counters.dropped["interrupted"] += 1
            return 0
        outputs = self._outputs
        if not outputs:
            return 0
        return self._write(outputs, payload, envelope, "D", strict, wait, timeout, text)

    def _write(
        self, outputs: Sequence[Output], payload: Payload, envelope: str, key: str, strict: bool, wait: bool, timeout: float | None,
        text: Callable[[], str] | None,
    ) -> int:  # fmt: skip
        begun: list[tuple[Output, Item]] = []
        binary: list[Buffer] = []
        line: list[Buffer] = []
        for output in outputs:
            if output.carrier.text:
                line = line or [self._line(payload, envelope, key, text)]
            else:
                binary = binary or self._framed(payload, envelope, key)
            item = output.begin(line if output.carrier.text else binary, strict=strict or wait, wait=wait)
            if item is not None:
                begun.append((output, item))
        self.counters.sent += 1
        if not wait:
            return len(begun)
        deadline = None if timeout is None else time.monotonic() + timeout
        return sum(output.finish(item, deadline) for output, item in begun)

    @staticmethod
    def _framed(payload: Payload, envelope: str, key: str) -> list[Buffer]:
        buffers = [payload] if isinstance(payload, (bytes, bytearray, memoryview)) else payload
        return flat([message.prefix(message.size(payload), key, envelope), *buffers])

    def _line(self, payload: Payload, envelope: str, key: str, text: Callable[[], str] | None) -> bytes:
        word = f"{key} {envelope}" if envelope else key
        return word.encode() + b"\r\n" + (text().encode() + b"\r\n" if text else self.to_line(payload))

    def request(
        self,
        payload: Payload,
        envelope: str = "",
        *,
        timeout: float | None = None,
        parse: Callable[[Buffer], int] | None = None,
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
        outputs = self._outputs
        if not outputs or self._interrupted:
            msg = f"port {self.name} is {'interrupted' if outputs else 'not connected to anything that could reply'}"
            raise ConnectionResetError(msg)
        output = outputs[0]
        deadline = None if timeout is None else time.monotonic() + timeout
        if output.carrier.text:
            return self.from_line(output.request([self._line(payload, envelope, "d", None)], parse, deadline).strip())
        return output.request(self._framed(payload, envelope, "d"), parse, deadline)

    # -- connections --------------------------------------------------------------------------------------------------

    def inputs(self) -> list[Route]:
        """The input connections."""
        with self._lock:
            return [i.route for i in self._inputs]

    def outputs(self) -> list[Route]:
        """The output connections."""
        return [o.route for o in self._outputs]

    def add_output(self, target: str) -> tuple[bool, str]:
        """Connect this port to another: ``/name``, ``carrier://name`` or ``carrier:/name``.

        Returns:
            whether that was done, and YARP's words about it.
        """
        place = Contact.parse(target)
        try:
            found = place if place.is_valid else self.naming.query(place.name)
        except OSError as error:
            _log.warning("%s: %s", self.name, error)
            found = None
        if found is None or not found.is_valid:
            return False, f"Do not know how to connect to {target}"
        name = found.name or found.uri
        if not self.is_output:
            return False, "Outputs not allowed"
        with self._lock:
            former = [o for o in self._outputs if o.route.target == name]
            if self.rpc and len(self._outputs) > len(former):
                return False, "RPC output already connected"
        for output in former:
            self._drop_output(output)
        try:
            carrier, qualifiers = carriers.parse(place.carrier or found.carrier or "tcp")
            sock = dial(found, carrier, self.name, qualifiers)
        except (OSError, WireError) as error:
            _log.warning("port %s cannot connect to %s: %s", self.name, target, error)
            return False, f"Cannot connect to {target}"
        if not self._add(sock, Route(self.name, name, carrier.name), carrier):
            return False, f"Cannot connect to {target}"
        return True, f"Added connection from {self.name} to {target}"

    def _add(self, sock: socket.socket, route: Route, carrier: carriers.Carrier) -> bool:
        with self._lock:
            if self._loop is None:
                sock.close()
                return False
            output = Output(sock, route, carrier, self._loop, self._lost, self.limit)
            self._outputs = [*self._outputs, output]
        self._tell(route, incoming=False, up=True)
        return True

    def remove_output(self, name: str) -> tuple[bool, str]:
        """End the output connection to a port; whether there was one, and YARP's words."""
        found = [o for o in self._outputs if o.route.target == name]
        for output in found:
            self._drop_output(output)
        if found:
            return True, f"Removed connection from {self.name} to {name}"
        return False, f"Could not find an outgoing connection to {name}"

    def remove_input(self, name: str) -> tuple[bool, str]:
        """End the input connection from a port; whether there was one, and YARP's words."""
        with self._lock:
            found = [i for i in self._inputs if i.route.source == name]
        for connection in found:
            connection.close()
            self.ended(connection)
        if found:
            return True, f"Removing connection from {name} to {self.name}"
        return False, f"Could not find an incoming connection from {name}"

    def _drop_output(self, output: Output) -> None:
        output.close()
        self._lost(output)

    def _lost(self, output: Output) -> None:
        with self._lock:
            if output not in self._outputs:
                return
            self._outputs = [o for o in self._outputs if o is not output]
        self._tell(output.route, incoming=False, up=False)

    def _look(self) -> None:
        """On the shared thread, now and then: are the peers of idle outputs still there."""
        shared = self._loop
        if shared is None:
            return
        for output in self._outputs:
            output.check()
        shared.later(_LOOK, self._look)

    def _tell(self, route: Route, *, incoming: bool, up: bool, reason: str = "") -> None:
        if self.on_event is not None:
            try:
                self.on_event(ConnectionEvent(route, incoming, up, reason))
            except Exception:
                _log.exception("port %s: its owner failed to take an event", self.name)

    # -- what comes in ------------------------------------------------------------------------------------------------

    def _opened(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> None:
        """A connection introduced itself; on the shared thread."""
        del address
        try:
            sock.send(opening_answer(opened, self.contact.port))
        except OSError:
            sock.close()
            return
        sock.setblocking(True)
        connection = Input(self, sock, opened, rest)
        with self._lock:
            if self._loop is None:
                sock.close()
                return
            former = [i for i in self._inputs if i.route.source == opened.sender] if rooted(opened.sender) else []
            self._inputs.append(connection)
        for one in former:
            one.close()
            self.ended(one)
        self._tell(connection.route, incoming=True, up=True)
        connection.start()

    def _refused(self, peer: str, error: WireError) -> None:
        self.counters.dropped["malformed"] += 1
        _log.info("port %s refused a connection from %s: %s", self.name, peer, error)

    def refused(self, route: Route, error: WireError) -> None:
        """A connection said something that is no message."""
        self.counters.dropped["malformed"] += 1
        _log.warning("port %s ends the connection from %s: %s", self.name, route.source, error)

    def ended(self, connection: Input) -> None:
        """An input connection is over."""
        with self._lock:
            if connection not in self._inputs:
                return
            self._inputs.remove(connection)
        self._tell(connection.route, incoming=True, up=False)

    def turned(self, connection: Input, sock: socket.socket) -> None:
        """An input connection asked to be an output."""
        self.ended(connection)
        route = Route(self.name, connection.route.source, connection.route.carrier)
        if not self._add(sock, route, connection.carrier):
            sock.close()

    def deliver(self, incoming: Message) -> None:
        """Give a message to the port's owner."""
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
        except WireError:
            words = []
        return encode(admin.answer(self, words), connection.profile or self.profile)

    def obey(self, word: command.PortCommand, connection: Input) -> tuple[str, ...]:
        """Obey a port command; the lines that text carriers answer."""
        del connection
        if word.key == "/":
            return (self.add_output(word.text)[1],)
        if word.key == "!":
            return (self.remove_output(word.text[1:])[1],)
        if word.key == "~":
            return (self.remove_input(word.text[1:])[1],)
        if word.key == "*":
            return self.describe()
        if word.key in ("?", "h"):
            return command.HELP
        return command.NOT_UNDERSTOOD

    def describe(self) -> tuple[str, ...]:
        """The port and its connections, in YARP's words."""
        outs = [
            f"There is an output connection from {r.source} to {r.target} using {r.carrier}" for r in self.outputs()
        ]
        ins = [f"There is an input connection from {r.source} to {r.target} using {r.carrier}" for r in self.inputs()]
        return (
            f"This is {self.name} at {self.contact.uri}",
            *(outs or ["There are no outgoing connections"]),
            *(ins or ["There are no incoming connections"]),
        )

    def to_line(self, payload: Payload) -> bytes:
        """A Bottle's line of text, with its end."""
        data = payload if isinstance(payload, (bytes, bytearray, memoryview)) else b"".join(payload)
        return to_text(decode(data)).encode(errors="surrogateescape") + b"\r\n"

    def from_line(self, line: bytes) -> bytes:
        """The Bottle of a line of text."""
        return encode(from_text(line.decode(errors="surrogateescape")), self.profile)


__all__ = ["PortCore", "contextlib"]
