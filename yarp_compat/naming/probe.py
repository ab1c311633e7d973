"""Which of many ports are surely dead: nobody listens at their address, and its machine says so at once."""

from __future__ import annotations

import errno
import ipaddress
import selectors
import socket
import time
from collections.abc import Iterable

from yarp_compat.wire.contact import Contact

AT_ONCE = 200
_UNDER_WAY = (0, errno.EINPROGRESS, errno.EWOULDBLOCK, getattr(errno, "WSAEWOULDBLOCK", 0))
_REFUSED = (errno.ECONNREFUSED, getattr(errno, "WSAECONNREFUSED", errno.ECONNREFUSED))


def refused(contacts: Iterable[Contact], seconds: float) -> set[str]:
    """The names of those ports whose address refuses connections.

    A machine that does not answer, or a name that only DNS knows, says nothing of its port: those are left out.

    Args:
        contacts: the ports.
        seconds: time for all of them; what has not answered by then is left out.
    """
    dead: set[str] = set()
    todo = [c for c in contacts if _is_address(c.host)]
    end = time.monotonic() + seconds
    while todo and time.monotonic() < end:
        batch, todo = todo[:AT_ONCE], todo[AT_ONCE:]
        dead |= _refused(batch, end)
    return dead


def _refused(batch: list[Contact], end: float) -> set[str]:
    dead: set[str] = set()
    with selectors.DefaultSelector() as waiting:
        for contact in batch:
            _begin(contact, waiting, dead)
        try:
            while waiting.get_map() and (left := end - time.monotonic()) > 0:
                for key, _ in waiting.select(left):
                    probe = key.fileobj
                    assert isinstance(probe, socket.socket)
                    if probe.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) in _REFUSED:
                        dead.add(key.data)
                    waiting.unregister(probe)
                    probe.close()
        finally:
            for key in list(waiting.get_map().values()):
                assert isinstance(key.fileobj, socket.socket)
                key.fileobj.close()
    return dead


def _begin(contact: Contact, waiting: selectors.BaseSelector, dead: set[str]) -> None:
    try:
        probe = socket.socket(socket.AF_INET6 if ":" in contact.host else socket.AF_INET, socket.SOCK_STREAM)
    except OSError:
        return  # no descriptors are left: no reason to think a port dead
    probe.setblocking(False)
    host = "127.0.0.1" if contact.host == "localhost" else contact.host
    try:
        result = probe.connect_ex((host, contact.port))
    except (OSError, OverflowError):
        result = errno.EINVAL
    if result in _UNDER_WAY:
        waiting.register(probe, selectors.EVENT_WRITE, contact.name)
        return
    if result in _REFUSED:
        dead.add(contact.name)
    probe.close()


def _is_address(host: str) -> bool:
    try:
        return host == "localhost" or bool(ipaddress.ip_address(host.partition("%")[0]))
    except ValueError:
        return False
