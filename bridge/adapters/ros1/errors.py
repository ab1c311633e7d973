"""Errors of the ROS 1 edge.

::

    Ros1Error
     +-- UnreachableError     a master or node does not answer in time, or not at all
     +-- ProtocolError        it answers, but not as ROS 1 does
     +-- RefusedError         it answers, and says no
     +-- ExhaustedError       it was not asked: this process has no file descriptor left
"""

from __future__ import annotations

import socket

from bridge.routing import room


class Ros1Error(Exception):
    """Base of the ROS 1 edge's errors."""


class UnreachableError(Ros1Error):
    """A master or node does not answer in time, or not at all.

    Attributes:
        refused: its machine answers that nobody listens there.
    """

    def __init__(self, message: str, *, refused: bool = False) -> None:
        super().__init__(message)
        self.refused = refused


class ProtocolError(Ros1Error):
    """A peer's answer is not what ROS 1's protocols say."""


class RefusedError(Ros1Error):
    """A peer says no: it is not a publisher of that topic, or it wants another type."""


class ExhaustedError(Ros1Error):
    """A peer was not asked, since this process has no file descriptor left: that says nothing of the peer."""


def unanswered(what: str, err: OSError) -> Ros1Error:
    """What it means that a connection failed.

    Args:
        what: went wrong, for people, where it is the peer's fault.
        err: what the system says.
    """
    # without a descriptor a host's name cannot be looked up either, and the resolver does not say why
    own = err.errno in room.OUT or (isinstance(err, socket.gaierror) and not room.has_descriptor())
    if own:
        msg = f"this process has no file descriptor left to connect to it with; {room.RAISE}"
        return ExhaustedError(msg)
    msg = f"{what}: {str(err) or type(err).__name__}"
    return UnreachableError(msg, refused=isinstance(err, ConnectionRefusedError))
