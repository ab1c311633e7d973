"""Errors of the conversion between values and bytes or text."""

from __future__ import annotations


class WireError(ValueError):
    """Raised for bytes that are not a valid YARP message, or values that cannot be encoded; the text names them."""


class Incomplete(WireError):  # noqa: N818 - not necessarily an error: more bytes may arrive
    """The bytes end before the message does."""


class TooLargeError(WireError):
    """A message is larger than the limit."""
