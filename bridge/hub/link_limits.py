"""A time limit of TCP for the links to other machines, without which a cut one may stay for a quarter of an hour.

zenoh (1.10) ends a link that was silent for its lease. Over TLS it then waits for a packet that is being written, and
while data goes out that is one which the cut link does not take: until TCP gives up, all that is behind the link counts
as there. The limit has TCP give up in time (RFC 5482; Linux alone has it as ``TCP_USER_TIMEOUT``).
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
import threading
from collections.abc import Callable

import psutil

from bridge.hub.settings import LEASE_MS

_EVERY = 1.0
_OPTION: int | None = getattr(socket, "TCP_USER_TIMEOUT", None)


def _far(address: str) -> bool:
    return not ipaddress.ip_address(address.partition("%")[0]).is_loopback


def limit_links(process: psutil.Process, far: Callable[[str], bool] = _far) -> None:
    """Give this process's connections to other machines the limit; those that have it already, once more.

    Args:
        process: this one.
        far: whether an IP address is another machine's.
    """
    if _OPTION is None:
        return
    with contextlib.suppress(psutil.Error, OSError):
        for connection in process.net_connections("tcp"):
            if connection.raddr and connection.fd >= 0 and far(connection.raddr.ip):
                _limit(connection.fd, _OPTION)


def _limit(descriptor: int, option: int) -> None:
    copy = os.dup(descriptor)  # zenoh may close its own in this moment, and another file have its number
    try:
        link = socket.socket(fileno=copy)
    except OSError:
        os.close(copy)
        return
    with link, contextlib.suppress(OSError):
        link.setsockopt(socket.IPPROTO_TCP, option, LEASE_MS)


class LinkLimits:
    """Gives connections the limit as they are made. On a thread of its own."""

    def __init__(self) -> None:
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="hub-link-limits", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._end.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        process = psutil.Process()
        while not self._end.wait(_EVERY):
            limit_links(process)
