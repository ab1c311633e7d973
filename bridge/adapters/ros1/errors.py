"""Errors of the ROS 1 edge.

::

    Ros1Error
     +-- UnreachableError     a master or node does not answer in time, or not at all
     +-- ProtocolError        it answers, but not as ROS 1 does
     +-- RefusedError         it answers, and says no
"""

from __future__ import annotations


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
