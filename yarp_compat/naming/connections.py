"""Connections between any two ports, made and looked at from outside, as ``yarp connect`` and its kin do.

The port that writes is asked, by administrative commands: ``[list] [out] /r`` whether it is connected, ``[add] tcp://r``
to connect, ``[del] /r`` to end it. All of it blocks, for a bounded time.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from typing import Any

from yarp_compat.naming import talk
from yarp_compat.naming.errors import NamingError, PortError
from yarp_compat.naming.naming import Naming
from yarp_compat.wire.contact import Contact, is_port_name
from yarp_compat.wire.values import Vocab

_LIST, _OUT, _ADD, _DEL, _VER = (Vocab(word) for word in ("list", "out", "add", "del", "ver"))


def connect(naming: Naming, source: str, target: str, carrier: str = "", *, timeout: float = talk.TIMEOUT) -> str:
    """Connect two ports; returns what the writing one says of it.

    Args:
        naming: who knows the ports.
        source: the port that writes.
        target: the port that reads; ``udp://r`` chooses the carrier too.
        carrier: how; else what the names say, else what the reading port was registered with.
        timeout: seconds for each step.

    Raises:
        PortError: one of them does not exist or does not answer, or the connection cannot be made.
        NoNameServerError: no name server answers.
    """
    writer, reader = _find(naming, source, "source port"), _find(naming, target, "destination port")
    wanted = carrier or _carrier(target) or _carrier(source) or reader.carrier or "tcp"
    with _noting(naming, writer):
        talk.admin(writer, [_LIST, _OUT, _name(target)], timeout)
        answer = talk.admin(writer, [_ADD, _target(target, wanted)], timeout)
    return _success(answer, f"{writer.name} could not connect to {target}")


def disconnect(naming: Naming, source: str, target: str, *, timeout: float = talk.TIMEOUT) -> str:
    """End the connection between two ports; returns what the writing one says. Errors as `connect`."""
    writer = _find(naming, source, "source port")
    with _noting(naming, writer):
        talk.admin(writer, [_LIST, _OUT, _name(target)], timeout)
        answer = talk.admin(writer, [_DEL, _name(target)], timeout)
    return _success(answer, f"there is no connection from {writer.name} to {target}")


def carrier_between(naming: Naming, source: str, target: str, *, timeout: float = talk.TIMEOUT) -> str:
    """By which carrier two ports are connected; empty where they are not. Errors as `connect`."""
    writer = _find(naming, source, "source port")
    with _noting(naming, writer):
        answer = talk.admin(writer, [_LIST, _OUT, _name(target)], timeout)
    return next((str(v[1]) for v in answer if isinstance(v, list) and len(v) == 2 and v[0] == "carrier"), "")


def is_connected(naming: Naming, source: str, target: str, *, timeout: float = talk.TIMEOUT) -> bool:
    """Whether two ports are connected; errors as `connect`."""
    return bool(carrier_between(naming, source, target, timeout=timeout))


def exists(naming: Naming, name: str, *, timeout: float = talk.TIMEOUT) -> bool:
    """Whether a port is registered and answers as a port does.

    Raises:
        NoNameServerError: no name server answers.
    """
    contact = naming.query(name)
    if contact is None:
        return False
    if contact.carrier == "mcast":
        return True
    try:
        return talk.admin(contact, [_VER], timeout)[:1] == ["ver"]
    except PortError:
        return False


def responds(contact: Contact, *, timeout: float = talk.TIMEOUT) -> bool:
    """Whether anything takes a connection at a port's address."""
    try:
        socket.create_connection((contact.host, contact.port), timeout).close()
    except OSError:
        return False
    return True


def ping(naming: Naming, name: str, *, timeout: float = talk.TIMEOUT) -> list[str]:
    """What a port says of itself and its connections, as lines; errors as `connect`."""
    return talk.raw(_find(naming, name, "port"), "<ping>", "*\r\n", timeout)


def _find(naming: Naming, name: str, role: str) -> Contact:
    asked = Contact.parse(name)
    if not asked.is_valid and not is_port_name(asked.name):
        msg = f"{name!r} is no port name: YARP's are like /robot/camera, without spaces"
        raise PortError(msg)
    contact = naming.query(name if asked.is_valid else asked.name)
    if contact is None:
        msg = f"there is no {role} {asked.name} at the name server"
        raise PortError(msg)
    return contact


@contextlib.contextmanager
def _noting(naming: Naming, contact: Contact) -> Iterator[None]:
    """Tell the name server of a port that does not answer, as YARP's programs do."""
    try:
        yield
    except PortError:
        if contact.name:
            with contextlib.suppress(NamingError):
                naming.announce(contact.name, alive=False)
        raise


def _carrier(text: str) -> str:
    contact = Contact.parse(text)
    return "" if contact.is_valid else contact.carrier


def _name(target: str) -> str:
    return Contact.parse(target).name or target


def _target(target: str, carrier: str) -> str:
    contact = Contact.parse(target)
    return contact.by(carrier).uri.rstrip("/") + contact.name if contact.is_valid else contact.by(carrier).target


def _success(answer: list[Any], problem: str) -> str:
    """The text of an answer ``0 "Added connection ..."``; older ports answer with the text alone."""
    text = str(answer[-1]).strip() if answer else ""
    done = answer[0] == 0 if answer and isinstance(answer[0], int) else text[:1] in ("A", "R")
    if not done:
        msg = f"{problem}: it says {text!r}" if text else problem
        raise PortError(msg)
    return text
