"""Where a port listens."""

from __future__ import annotations

import errno
import os
import socket


def bound(host: str, number: int, *, host_fixed: bool, number_fixed: bool) -> socket.socket:
    """A socket bound to an address and number; not listening yet.

    Args:
        host: the address.
        number: the TCP port number, or 0.
        host_fixed: nobody but this address will do; otherwise, where it is no address of this machine (whose ports are
            known under another's, which translates), all of this machine's addresses.
        number_fixed: nothing but this number will do; otherwise another one where it is taken.

    Raises:
        OSError: it cannot be had.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere this would let two programs listen on one number
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind((host, number))
        except OSError as error:
            if error.errno == errno.EADDRINUSE and not number_fixed:
                sock.bind((host, 0))
            elif error.errno == errno.EADDRNOTAVAIL and not host_fixed:
                sock.bind(("", number))
            else:
                raise
    except BaseException:
        sock.close()
        raise
    return sock
