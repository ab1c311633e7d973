"""Adds and removes a port's connections: outputs by name, inputs after the peer has introduced itself."""

from __future__ import annotations

import contextlib
import logging
import socket
from typing import Any

from yarp_compat.overriding import override
from yarp_compat.ports.base import PortBase, dialect_at, port_of_process
from yarp_compat.ports.connections import AnyOutput, Connections
from yarp_compat.ports.datagrams import DatagramInput, DatagramOutput, SendingGroup, datagram_socket
from yarp_compat.ports.dial import dial, dial_group, send_farewell
from yarp_compat.ports.inputs import BinaryInput, Input
from yarp_compat.ports.message import MessagePeer
from yarp_compat.ports.multicast import GroupInput, SendingGroups
from yarp_compat.ports.output import Output
from yarp_compat.ports.sockets import closed_on_failure
from yarp_compat.ports.textinputs import NameInput, PageInput, TextInput
from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import Carrier, CarrierError, Opening
from yarp_compat.wire.contact import ConnectionRoute, PortContact, is_port_name
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile

QUEUE = 64 << 20  # maximum bytes queued for one peer; a single message may be larger

_log = logging.getLogger("yarp.ports")
_JOIN = 5.0  # seconds to wait for each connection to end, and again after its socket is shut down
_READER_MODIFIERS = {"recv", "log"}  # modifiers that the reading port has to apply; `send` is for the writing port
_INPUT_TYPES = {
    carriers.HTTP: PageInput,
    carriers.NAME_SER: NameInput,
    carriers.TEXT: TextInput,
    carriers.TEXT_ACK: TextInput,
}


class ConnectingPort(PortBase):
    """A port's methods for its connections."""

    is_input: bool
    is_output: bool
    type_name: str
    properties: dict[str, Any]
    connections: Connections
    groups: SendingGroups

    def inputs(self) -> list[ConnectionRoute]:
        """Return the routes of the input connections."""
        return [i.route for i in self.connections.inputs]

    def outputs(self) -> list[ConnectionRoute]:
        """Return the routes of the output connections."""
        return [o.route for o in self.connections.outputs]

    def add_output(self, target: str) -> tuple[bool, str]:
        """Connect this port to another: ``/name``, ``carrier://name`` or ``carrier:/name``.

        Returns:
            whether it is connected, and YARP's message.
        """
        parsed = PortContact.parse(target)
        try:
            contact = parsed if parsed.is_valid else self.naming.query(parsed.name)
        except OSError as error:
            _log.warning("port %s: %s", self.name, error)
            contact = None
        if contact is None or not contact.is_valid:
            return False, f"Do not know how to connect to {target}"
        if not self.is_output:
            return False, "Outputs not allowed"
        name = contact.name or contact.uri
        former = [o for o in self.connections.outputs if o.route.target == name]
        if self.rpc and len(self.connections.outputs) > len(former):
            return False, "RPC output already connected"
        for output in former:
            self._drop_output(output)
        try:
            carrier, qualifiers = carriers.parse(parsed.carrier or contact.carrier or "tcp")
            _check_modifiers(qualifiers)
            self._connect(contact, carrier, qualifiers, ConnectionRoute(self.name, name, carrier.name))
        except (OSError, WireError) as error:
            _log.warning("port %s cannot connect to %s: %s", self.name, target, error)
            reason = f": {error}" if isinstance(error, CarrierError) else ""  # YARP gives no reason for other errors
            return False, f"Cannot connect to {target}{reason}"
        return True, f"Added connection from {self.name} to {target}"

    def _connect(self, contact: PortContact, carrier: Carrier, qualifiers: str, route: ConnectionRoute) -> None:
        if carrier is carriers.MCAST:
            self._connect_group(contact, qualifiers, route)
            return
        if carrier is not carriers.LOCAL:
            sock = dial(contact, carrier, self.name, qualifiers)
            self._add_established(sock, route, carrier, None if carrier.text else dialect_at(contact))
            return
        peer = port_of_process(contact)
        if peer is None:
            raise ConnectionRefusedError(f"{route.target} is not a port of this process, as the carrier local requires")
        ours, theirs = socket.socketpair()
        peer.attach(theirs, Opening(carrier, self.name, qualifiers, 0))
        self._add_established(ours, route, carrier, peer.profile)

    def _connect_group(self, contact: PortContact, qualifiers: str, route: ConnectionRoute) -> None:
        """Write to a multicast group, and ask the peer to join it."""
        profile, joined = dialect_at(contact), list[SendingGroup]()

        def join(interface: str) -> tuple[str, int]:
            joined.append(self.groups.join(self.name, interface, profile or self.profile))
            return joined[0].address

        try:
            dial_group(contact, self.name, qualifiers, join)
            self._add_established(joined[0].socket(), route, carriers.MCAST, profile, joined[0])
        except BaseException:
            for group in joined:
                self.groups.leave(group)
            raise

    def _add_established(
        self, sock: socket.socket, route: ConnectionRoute, carrier: Carrier, profile: Profile | None,
        group: SendingGroup | None = None,
    ) -> None:  # fmt: skip
        """Add an established output; raises `ConnectionAbortedError` if the port is closed or has too many outputs."""
        shared, on_lost = self._loop, self.connections.remove_output
        if shared is None:
            sock.close()
            raise ConnectionAbortedError(f"port {self.name} is closed")
        output: AnyOutput
        if carrier in (carriers.UDP, carriers.MCAST):
            output = DatagramOutput(sock, route, on_lost, group, self.connections.lost)
        else:
            room = min(self.limit, QUEUE)
            output = Output(sock, route, carrier, shared, on_lost, self.limit, room, self.connections.lost)
        output.profile = profile
        if not self.connections.add_output(output):
            output.close()
            raise ConnectionAbortedError(f"port {self.name} is closed, or has too many outputs")

    def remove_output(self, name: str) -> tuple[bool, str]:
        """Close the output connection to a port; return whether it existed, and YARP's message."""
        outputs = [o for o in self.connections.outputs if o.route.target == name]
        for output in outputs:
            self._drop_output(output)
        if outputs:
            return True, f"Removed connection from {self.name} to {name}"
        return False, f"Could not find an outgoing connection to {name}"

    def _drop_output(self, output: AnyOutput) -> None:
        output.close()
        if not self.connections.remove_output(output):
            return  # another thread has removed it
        if output.group is not None:
            self.groups.leave(output.group)
        if output.carrier.connectionless:
            with contextlib.suppress(OSError):
                contact = self.naming.query(output.route.target)
                if contact is not None:
                    send_farewell(contact, self.name)

    def _on_introduced(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> None:
        """Add a connection whose peer has introduced itself; called on the shared thread."""
        connection = self._answer(sock, opened, rest, address)
        if connection is not None:
            self._attach(connection)

    @override
    def attach(self, sock: socket.socket, opened: Opening) -> None:
        self._attach(self._input(sock, opened, b"", ("", 0)))

    def _attach(self, connection: Input) -> None:
        shared = self._loop
        if shared is None or not self.connections.add_input(connection):
            connection.abandon()
        else:
            connection.start(shared)

    def _input(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> Input:
        return _INPUT_TYPES.get(opened.carrier, BinaryInput)(self, sock, opened, rest, address)

    def _answer(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> Input | None:
        """Answer an introduction; return the input, which is not started yet, or None after closing the connection.

        The connection is closed if the peer has left, uses ``local`` from another process, or requires carrier
        modifiers.
        """
        try:
            if opened.qualifiers and (opened.modifiers & _READER_MODIFIERS or "send" not in opened.modifiers):
                self._refuse_modifiers(sock, opened)
                return None
            if opened.carrier is carriers.MCAST:
                return GroupInput(self, sock, opened, address)
            if opened.carrier is carriers.LOCAL:
                _log.info("port %s: %s uses the carrier local from another process", self.name, opened.sender)
                sock.close()
                return None
            if opened.carrier is carriers.UDP:
                with sock:
                    datagrams = datagram_socket(sock)
                    with closed_on_failure(datagrams):
                        sock.send(carriers.answer(opened, datagrams.getsockname()[1]))
                return DatagramInput(self, datagrams, opened, address)
            greeting = carriers.answer(opened, self.contact.port)
            if self.replies and opened.carrier in (carriers.TCP, carriers.FAST_TCP) and is_port_name(opened.sender):
                return BinaryInput(self, sock, opened, rest, address, greeting)
            if greeting:
                sock.send(greeting)
        except OSError as error:
            _log.debug("port %s: a connection from %s:%d failed: %s", self.name, *address, error)
            sock.close()
            return None
        return self._input(sock, opened, rest, address)

    def _refuse_modifiers(self, sock: socket.socket, opened: Opening) -> None:
        """Close a connection that requires carrier modifiers: its messages would be wrong without them.

        Text carriers, on which people type, get an error text. Other carriers get no answer: C++ ports ignore the
        content of an answer, and ``yarp connect`` fails only if the connection closes without an answer
        (``TcpCarrier::expectReplyToHeader``, 3.9 and 4.0).
        """
        with sock:
            if opened.carrier.text:
                modifiers = opened.qualifiers.encode(errors="replace")
                sock.send(b"* Error. This port does not support carrier modifiers: %b\r\n" % modifiers)
        msg = f"carrier modifier {opened.qualifiers} is not supported; connect without it"
        self.refused(ConnectionRoute(opened.sender, self.name, opened.carrier.name), CarrierError(msg))

    def remove_input(self, name: str) -> tuple[bool, str]:
        """Close the input connection from a port; return whether it existed, and YARP's message."""
        inputs = [i for i in self.connections.inputs if i.route.source == name]
        for connection in inputs:
            connection.close()
            self.connections.remove_input(connection)
        if inputs:
            return True, f"Removing connection from {name} to {self.name}"
        return False, f"Could not find an incoming connection from {name}"

    @override
    def ended(self, peer: MessagePeer, reversed_socket: socket.socket | None = None) -> None:
        self.connections.ended(peer)
        if reversed_socket is not None:
            route = ConnectionRoute(self.name, peer.route.source, peer.route.carrier)
            with contextlib.suppress(ConnectionAbortedError):
                self._add_established(reversed_socket, route, peer.carrier, peer.profile)

    def _end_connections(self) -> None:
        """Close all connections and wait until their threads have ended."""
        self.connections.close()
        for output in self.connections.outputs:
            self._drop_output(output)
        inputs = [*self.connections.inputs, *self.connections.leaving]
        for connection in inputs:
            connection.close()
        for connection in inputs:
            connection.join(_JOIN)


def _check_modifiers(qualifiers: str) -> None:
    """Reject modifiers that this port would have to apply; ``recv`` is for the peer to apply."""
    wanted = {part.partition(".")[0] for part in qualifiers.split("+") if part}
    if wanted and ("recv" not in wanted or wanted & {"send", "log"}):
        raise CarrierError(f"this port does not support carrier modifiers ({qualifiers[:60]!r}); connect without them")
