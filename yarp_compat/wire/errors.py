"""Errors in bytes or texts from the network."""

from __future__ import annotations


class WireError(ValueError):
    """Bytes that are no YARP message, or values that no YARP message can hold; the text says what and where."""


class Incomplete(WireError):  # noqa: N818 - it need not be an error: more may come
    """The bytes end before the message does."""


class TooLargeError(WireError):
    """A message announces more bytes than are taken."""
