"""Errors of the conversion between values and bytes or text."""

from __future__ import annotations


class WireError(ValueError):
    """Bytes are not a valid YARP message, or values cannot be encoded; the message names the value and position."""


class Incomplete(WireError):  # noqa: N818 - not necessarily an error: more bytes may arrive
    """The bytes end before the message does."""


class TooLargeError(WireError):
    """A message is larger than the limit."""
