"""Short talks with a port of anybody's, as YARP's own tools have them: commands by text, answers as lines.

``CONNACK admin`` is answered by ``Welcome admin``; then each answer ends with ``<ACK>`` (the carrier is text_ack).
An administrative command is announced by a line ``a``, one for the port's owner by ``d``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from yarp_compat.naming.errors import PortError
from yarp_compat.naming.lines import LineSocket
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.text import from_text, to_text

TIMEOUT = 5.0
_ACK = "<ACK>"


def ask(contact: Contact, command: Sequence[Any], *, admin: bool = False, timeout: float = TIMEOUT) -> list[str]:
    """Send a Bottle to a port and return the lines of its answer.

    Args:
        contact: where the port is.
        command: the Bottle's values.
        admin: whether it is a command for the port itself, as ``[list] [out]``, rather than for its owner.
        timeout: seconds for all of it.

    Raises:
        PortError: it does not answer in time, or not as a port does.
    """
    return raw(contact, "admin", f"{'a' if admin else 'd'}\r\n{to_text(command)}\r\n", timeout)


def admin(contact: Contact, command: Sequence[Any], timeout: float = TIMEOUT) -> list[Any]:
    """Send an administrative command and return the values of its answer; errors as `ask`."""
    lines = ask(contact, command, admin=True, timeout=timeout)
    try:
        return from_text(lines[0]) if lines else []
    except WireError as err:
        msg = f"what {contact.name or 'the port'} answers at {contact.uri} is no Bottle: {err}"
        raise PortError(msg) from None


def raw(contact: Contact, sender: str, text: str, timeout: float = TIMEOUT) -> list[str]:
    """Introduce oneself as ``sender``, send lines, and return what comes back before the acknowledgement."""
    try:
        with LineSocket(contact.host, contact.port, timeout) as peer:
            peer.send(f"CONNACK {sender}\r\n{text}".encode("utf-8", "surrogateescape"))
            return _answer(peer, contact)
    except PortError:
        raise
    except OSError as err:
        why = f"no answer within {timeout:g} s" if isinstance(err, TimeoutError) else (err.strerror or str(err))
        msg = f"{contact.name or 'the port'} does not answer at {contact.uri}: {why}"
        raise PortError(msg) from None


def _answer(peer: LineSocket, contact: Contact) -> list[str]:
    welcome = peer.line()
    if not welcome.startswith("Welcome"):
        msg = f"what answers at {contact.uri} is no YARP port: it says {welcome[:60]!r}"
        raise PortError(msg)
    lines: list[str] = []
    while (line := peer.line()) != _ACK:
        lines.append(line)
    return lines
