"""Where a port listens."""

from __future__ import annotations

import errno
import os
import socket

_BACKLOG = 1024
"""Connections that wait to be accepted."""


def listening(host: str, number: int, *, host_fixed: bool, number_fixed: bool) -> socket.socket:
    """A socket that listens at an address and number.

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
    try:
        return _at(family, host, number)
    except OSError as error:
        if error.errno == errno.EADDRINUSE and not number_fixed:
            return _at(family, host, 0)
        if error.errno == errno.EADDRNOTAVAIL and not host_fixed:
            return _at(family, "", number)
        raise


def _at(family: int, host: str, number: int) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere this would let two programs listen on one number
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, number))
        sock.listen(_BACKLOG)  # here two of those that share a number are told apart
    except BaseException:
        sock.close()
        raise
    return sock
