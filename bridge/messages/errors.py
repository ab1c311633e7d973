"""Errors of the message layer.

::

    MessageError
     +-- MessageTypeError     a type is unknown, has no counterpart, or cannot be built
     +-- ConversionError      the bytes of one message do not match its type
"""

from __future__ import annotations


class MessageError(Exception):
    """Base of the message layer's errors."""


class MessageTypeError(MessageError):
    """A type is unknown, has no counterpart, or cannot be built here."""

    def __init__(self, message: str, cure: str = "") -> None:
        super().__init__(message)
        self.cure = cure  # what a person can do about it; "" if nothing is known to help


class ConversionError(MessageError):
    """The bytes of one message do not match its type."""
