"""Making an input of a connection that has introduced itself."""

from __future__ import annotations

import logging
import socket
from typing import TYPE_CHECKING

from yarp_compat.ports.datagrams import DatagramInput, datagram_socket
from yarp_compat.ports.inputs import BinaryInput, Input
from yarp_compat.ports.pages import PageInput
from yarp_compat.ports.textinputs import NameInput, TextInput
from yarp_compat.wire import carriers, header
from yarp_compat.wire.contact import is_port_name
from yarp_compat.wire.header import Opening

if TYPE_CHECKING:
    from yarp_compat.ports.port import PortCore

_log = logging.getLogger("yarp.ports")
_KINDS = {
    carriers.HTTP: PageInput,
    carriers.NAME_SER: NameInput,
    carriers.TEXT: TextInput,
    carriers.TEXT_ACK: TextInput,
}


def answer(port: PortCore, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> Input | None:
    """Answer an introduction.

    Args:
        port: whose input it becomes.
        sock: the connection; closed where nothing comes of it.
        opened: the introduction.
        rest: what came behind that.
        address: the peer's.

    Returns:
        The input, not started; None where the peer went, or the carrier is not for connections from outside.
    """
    if opened.qualifiers:
        text = "port %s: %s asks for %s, which is not offered here: its messages are taken as they come"
        _log.warning(text, port.name, opened.sender, opened.qualifiers)
    try:
        if opened.carrier is carriers.LOCAL:
            _log.info("port %s: %s calls by local, which is for ports of one process", port.name, opened.sender)
            sock.close()
            return None
        if opened.carrier is carriers.UDP:
            with sock:
                made = datagram_socket(sock)
                sock.send(header.answer(opened, made.getsockname()[1]))
            return DatagramInput(port, made, opened, address)
        told = header.answer(opened, port.contact.port)
        if port.replies and opened.carrier in (carriers.TCP, carriers.FAST_TCP) and is_port_name(opened.sender):
            return BinaryInput(port, sock, opened, rest, address, told)
        if told:
            sock.send(told)
    except OSError as error:
        _log.debug("port %s: a connection from %s:%d failed: %s", port.name, *address, error)
        sock.close()
        return None
    return made_of(port, sock, opened, rest, address)


def made_of(port: PortCore, sock: socket.socket, opened: Opening, rest: bytes, address: tuple[str, int]) -> Input:
    """The input of a connection that was answered."""
    return _KINDS.get(opened.carrier, BinaryInput)(port, sock, opened, rest, address)
