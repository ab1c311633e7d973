"""The end of a port that was open."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from yarp_compat.ports import connecting, loop, process

if TYPE_CHECKING:
    from yarp_compat.ports.listener import Listener
    from yarp_compat.ports.port import PortCore

_JOIN = 5.0
"""Seconds for which each connection is waited for, and again when its socket is closed."""

_log = logging.getLogger("yarp.ports")


def end(port: PortCore, shared: loop.Loop, listener: Listener) -> None:
    """End all connections of a port, give its name back, and leave nothing behind."""
    port.interrupt()
    process.remove(port)
    listener.close()
    port.connections.close()
    for output in port.connections.outputs:
        connecting.drop_output(port, output)
    inputs = [*port.connections.inputs, *port.connections.leaving]
    for connection in inputs:
        connection.close()
    for connection in inputs:
        connection.join(_JOIN)
    try:
        port.naming.unregister(port.name)
    except OSError as error:
        _log.warning("port %s could not be unregistered: %s", port.name, error)
    loop.release(shared)
    port.resume()
