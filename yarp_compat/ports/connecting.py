"""Making and ending the connections of a port, by name."""

from __future__ import annotations

import contextlib
import logging
import socket
from typing import TYPE_CHECKING

from yarp_compat.ports import process
from yarp_compat.ports.datagrams import DatagramOutput
from yarp_compat.ports.dial import dial, say_farewell
from yarp_compat.ports.dialects import dialect_at
from yarp_compat.ports.output import Output
from yarp_compat.wire import carriers
from yarp_compat.wire.carriers import Carrier
from yarp_compat.wire.contact import Contact, Route
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.header import Opening
from yarp_compat.wire.profile import Profile

if TYPE_CHECKING:
    from yarp_compat.ports.connections import AnyOutput
    from yarp_compat.ports.port import PortCore

QUEUE = 64 << 20
"""Bytes that wait for one peer at most, but for a single message that is larger."""

_log = logging.getLogger("yarp.ports")


def add_output(port: PortCore, target: str) -> tuple[bool, str]:
    """Connect a port to another: ``/name``, ``carrier://name`` or ``carrier:/name``.

    Returns:
        whether that was done, and YARP's words about it.
    """
    place = Contact.parse(target)
    try:
        found = place if place.is_valid else port.naming.query(place.name)
    except OSError as error:
        _log.warning("port %s: %s", port.name, error)
        found = None
    if found is None or not found.is_valid:
        return False, f"Do not know how to connect to {target}"
    if not port.is_output:
        return False, "Outputs not allowed"
    name = found.name or found.uri
    former = [o for o in port.connections.outputs if o.route.target == name]
    if port.rpc and len(port.connections.outputs) > len(former):
        return False, "RPC output already connected"
    for output in former:
        drop_output(port, output)
    try:
        carrier, qualifiers = carriers.parse(place.carrier or found.carrier or "tcp")
        if qualifiers:
            told = "port %s: of %s only what the peer is to do is done: messages leave as they are"
            _log.warning(told, port.name, place.carrier)
        _connect(port, found, carrier, qualifiers, Route(port.name, name, carrier.name))
    except (OSError, WireError) as error:
        _log.warning("port %s cannot connect to %s: %s", port.name, target, error)
        return False, f"Cannot connect to {target}"
    return True, f"Added connection from {port.name} to {target}"


def _connect(port: PortCore, contact: Contact, carrier: Carrier, qualifiers: str, route: Route) -> None:
    if carrier is not carriers.LOCAL:
        sock = dial(contact, carrier, port.name, qualifiers)
        take_output(port, sock, route, carrier, None if carrier.text else dialect_at(contact))
        return
    there = process.find(contact)
    if there is None:
        msg = f"{route.target} is not a port of this process, which the carrier local is for"
        raise ConnectionRefusedError(msg)
    ours, theirs = socket.socketpair()
    there.attach(theirs, Opening(carrier, port.name, qualifiers, 0))
    take_output(port, ours, route, carrier, there.profile)


def take_output(port: PortCore, sock: socket.socket, route: Route, carrier: Carrier, profile: Profile | None) -> None:
    """Have a port write on a connection that is made; raises `ConnectionAbortedError` where it is closed or full."""
    shared = port.loop
    if shared is None:
        sock.close()
        msg = f"port {port.name} is closed"
        raise ConnectionAbortedError(msg)
    output: AnyOutput
    if carrier is carriers.UDP:
        output = DatagramOutput(sock, route, port.connections.remove_output)
    else:
        output = Output(
            sock, route, carrier, shared, port.connections.remove_output, port.limit, min(port.limit, QUEUE)
        )
    output.profile = profile
    if not port.connections.add_output(output):
        output.close()
        msg = f"port {port.name} is closed, or has too many outputs"
        raise ConnectionAbortedError(msg)


def remove_output(port: PortCore, name: str) -> tuple[bool, str]:
    """End the output connection to a port; whether there was one, and YARP's words."""
    found = [o for o in port.connections.outputs if o.route.target == name]
    for output in found:
        drop_output(port, output)
    if found:
        return True, f"Removed connection from {port.name} to {name}"
    return False, f"Could not find an outgoing connection to {name}"


def remove_input(port: PortCore, name: str) -> tuple[bool, str]:
    """End the input connection from a port; whether there was one, and YARP's words."""
    found = [i for i in port.connections.inputs if i.route.source == name]
    for connection in found:
        connection.close()
        port.connections.remove_input(connection)
    if found:
        return True, f"Removing connection from {name} to {port.name}"
    return False, f"Could not find an incoming connection from {name}"


def drop_output(port: PortCore, output: AnyOutput) -> None:
    """End an output connection."""
    output.close()
    port.connections.remove_output(output)
    if output.carrier.connectionless:
        with contextlib.suppress(OSError):
            contact = port.naming.query(output.route.target)
            if contact is not None:
                say_farewell(contact, port.name)
