"""Makes and ends the connections of a port: outputs by name, inputs of connections that have introduced themselves."""

from __future__ import annotations

import contextlib
import logging
import socket
from typing import Any

from yarp_compat.ports.base import PortBase, dialect_at, port_of_process
from yarp_compat.ports.connections import AnyOutput, Connections
from yarp_compat.ports.datagrams import DatagramInput, DatagramOutput, SendingGroup, datagram_socket
from yarp_compat.ports.dial import dial, dial_group, say_farewell
from yarp_compat.ports.inputs import BinaryInput, Input
from yarp_compat.ports.message import MessagePeer
from yarp_compat.ports.multicast import GroupInput, SendingGroups
from yarp_compat.ports.output import Output
from yarp_compat.ports.textinputs import NameInput, PageInput, TextInput
from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import Carrier, CarrierError, Opening
from yarp_compat.wire.contact import ConnectionRoute, PortContact, is_port_name
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile

QUEUE = 64 << 20  # bytes that wait for one peer at most, except for a single message that is larger

_log = logging.getLogger("yarp.ports")
_JOIN = 5.0  # seconds for which each connection is waited for, and again when its socket is closed
_DONE_HERE = {"recv", "log"}  # modifiers that the reader's port has to honour; `send` is the writer's
_KINDS = {
    carriers.HTTP: PageInput,
    carriers.NAME_SER: NameInput,
    carriers.TEXT: TextInput,
    carriers.TEXT_ACK: TextInput,
}


class ConnectingPort(PortBase):
    """The connections of a port."""

    is_input: bool
    is_output: bool
    type_name: str
    properties: dict[str, Any]
    connections: Connections
    groups: SendingGroups

    def inputs(self) -> list[ConnectionRoute]:
        """The input connections."""
        return [i.route for i in self.connections.inputs]

    def outputs(self) -> list[ConnectionRoute]:
        """The output connections."""
        return [o.route for o in self.connections.outputs]

    def add_output(self, target: str) -> tuple[bool, str]:
        """Connect this port to another: ``/name``, ``carrier://name`` or ``carrier:/name``.

        Returns:
            whether that was done, and YARP's words about it.
        """
        place = PortContact.parse(target)
        try:
            found = place if place.is_valid else self.naming.query(place.name)
        except OSError as error:
            _log.warning("port %s: %s", self.name, error)
            found = None
        if found is None or not found.is_valid:
            return False, f"Do not know how to connect to {target}"
        if not self.is_output:
            return False, "Outputs not allowed"
        name = found.name or found.uri
        former = [o for o in self.connections.outputs if o.route.target == name]
        if self.rpc and len(self.connections.outputs) > len(former):
            return False, "RPC output already connected"
        for output in former:
            self._drop_output(output)
        try:
            carrier, qualifiers = carriers.parse(place.carrier or found.carrier or "tcp")
            _check_modifiers(qualifiers)
            self._connect(found, carrier, qualifiers, ConnectionRoute(self.name, name, carrier.name))
        except (OSError, WireError) as error:
            _log.warning("port %s cannot connect to %s: %s", self.name, target, error)
            why = f": {error}" if isinstance(error, CarrierError) else ""  # YARP says no more than that it cannot
            return False, f"Cannot connect to {target}{why}"
        return True, f"Added connection from {self.name} to {target}"

    def _connect(self, contact: PortContact, carrier: Carrier, qualifiers: str, route: ConnectionRoute) -> None:
        if carrier is carriers.MCAST:
            self._connect_group(contact, qualifiers, route)
            return
        if carrier is not carriers.LOCAL:
            sock = dial(contact, carrier, self.name, qualifiers)
            self._take_output(sock, route, carrier, None if carrier.text else dialect_at(contact))
            return
        there = port_of_process(contact)
        if there is None:
            raise ConnectionRefusedError(f"{route.target} is no port of this process, which the carrier local is for")
        ours, theirs = socket.socketpair()
        there.attach(theirs, Opening(carrier, self.name, qualifiers, 0))
        self._take_output(ours, route, carrier, there.profile)

    def _connect_group(self, contact: PortContact, qualifiers: str, route: ConnectionRoute) -> None:
        """Write to a multicast group, and have the peer take what is sent there."""
        profile, joined = dialect_at(contact), list[SendingGroup]()

        def join(interface: str) -> tuple[str, int]:
            joined.append(self.groups.join(self.name, interface, profile or self.profile))
            return joined[0].address

        try:
            dial_group(contact, self.name, qualifiers, join)
            self._take_output(joined[0].socket(), route, carriers.MCAST, profile, joined[0])
        except BaseException:
            for group in joined:
                self.groups.leave(group)
            raise

    def _take_output(
        self, sock: socket.socket, route: ConnectionRoute, carrier: Carrier, profile: Profile | None,
        group: SendingGroup | None = None,
    ) -> None:  # fmt: skip
        """Write on a connection that is made; raises `ConnectionAbortedError` where the port is closed or full."""
        shared, gone = self._loop, self.connections.remove_output
        if shared is None:
            sock.close()
            raise ConnectionAbortedError(f"port {self.name} is closed")
        output: AnyOutput
        if carrier in (carriers.UDP, carriers.MCAST):
            output = DatagramOutput(sock, route, gone, group, self.connections.lost)
        else:
            room = min(self.limit, QUEUE)
            output = Output(sock, route, carrier, shared, gone, self.limit, room, self.connections.lost)
        output.profile = profile
        if not self.connections.add_output(output):
            output.close()
            raise ConnectionAbortedError(f"port {self.name} is closed, or has too many outputs")

    def remove_output(self, name: str) -> tuple[bool, str]:
        """End the output connection to a port; returns whether there was one, and YARP's words."""
        found = [o for o in self.connections.outputs if o.route.target == name]
        for output in found:
            self._drop_output(output)
        if found:
            return True, f"Removed connection from {self.name} to {name}"
        return False, f"Could not find an outgoing connection to {name}"

    def _drop_output(self, output: AnyOutput) -> None:
        output.close()
        if not self.connections.remove_output(output):
            return  # another thread does it
        if output.group is not None:
            self.groups.leave(output.group)
        if output.carrier.connectionless:
            with contextlib.suppress(OSError):
                contact = self.naming.query(output.route.target)
                if contact is not None:
                    say_farewell(contact, self.name)

    def _opened(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> None:
        """Take a connection that introduced itself; on the shared thread."""
        connection = self._answered(sock, opened, rest, address)
        if connection is not None:
            self._attach(connection)

    def attach(self, sock: socket.socket, opened: Opening) -> None:
        """Take a connection from a port of the same base."""
        self._attach(self._input(sock, opened, b"", ("", 0)))

    def _attach(self, connection: Input) -> None:
        shared = self._loop
        if shared is None or not self.connections.add_input(connection):
            connection.abandon()
        else:
            connection.start(shared)

    def _input(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> Input:
        return _KINDS.get(opened.carrier, BinaryInput)(self, sock, opened, rest, address)

    def _answered(self, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> Input | None:
        """Answer an introduction; the input, not started, or None, with the connection closed.

        None where the peer went, the carrier is not for others, or messages are to be modified as is not done here.
        """
        try:
            if opened.qualifiers and (opened.modifiers & _DONE_HERE or "send" not in opened.modifiers):
                self._refuse_modifiers(sock, opened)
                return None
            if opened.carrier is carriers.MCAST:
                return GroupInput(self, sock, opened, address)
            if opened.carrier is carriers.LOCAL:
                _log.info("port %s: %s calls by local, which is for ports of one process", self.name, opened.sender)
                sock.close()
                return None
            if opened.carrier is carriers.UDP:
                with sock:
                    made = datagram_socket(sock)
                    sock.send(carriers.answer(opened, made.getsockname()[1]))
                return DatagramInput(self, made, opened, address)
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
        """Close a connection whose messages cannot be modified as is wished: taken as they come they would be wrong.

        A person who types gets an answer. A C++ port ignores what the answer to its introduction says, and only a
        connection that ends without one is to ``yarp connect`` a failure (``TcpCarrier::expectReplyToHeader``, 3.9 and
        4.0).
        """
        with sock:
            if opened.carrier.text:
                wish = opened.qualifiers.encode(errors="replace")
                sock.send(b"* Error. This port offers no carrier modifiers: %b\r\n" % wish)
        msg = f"it asks for the carrier modifier {opened.qualifiers}, which no port offers here; connect it without"
        self.refused(ConnectionRoute(opened.sender, self.name, opened.carrier.name), CarrierError(msg))

    def remove_input(self, name: str) -> tuple[bool, str]:
        """End the input connection from a port; returns whether there was one, and YARP's words."""
        found = [i for i in self.connections.inputs if i.route.source == name]
        for connection in found:
            connection.close()
            self.connections.remove_input(connection)
        if found:
            return True, f"Removing connection from {name} to {self.name}"
        return False, f"Could not find an incoming connection from {name}"

    def ended(self, peer: MessagePeer, turned: socket.socket | None = None) -> None:
        """An input connection is over; ``turned`` is its socket where it asked to be an output."""
        self.connections.ended(peer)
        if turned is not None:
            route = ConnectionRoute(self.name, peer.route.source, peer.route.carrier)
            with contextlib.suppress(ConnectionAbortedError):
                self._take_output(turned, route, peer.carrier, peer.profile)

    def _end_connections(self) -> None:
        """End all connections, and wait until they have ended."""
        self.connections.close()
        for output in self.connections.outputs:
            self._drop_output(output)
        inputs = [*self.connections.inputs, *self.connections.leaving]
        for connection in inputs:
            connection.close()
        for connection in inputs:
            connection.join(_JOIN)


def _check_modifiers(qualifiers: str) -> None:
    """Refuse what this port would have to do to the messages; ``recv`` is asked of the peer."""
    wanted = {part.partition(".")[0] for part in qualifiers.split("+") if part}
    if wanted and ("recv" not in wanted or wanted & {"send", "log"}):
        raise CarrierError(f"this port offers no carrier modifiers, such as {qualifiers[:60]!r}; connect it without")
