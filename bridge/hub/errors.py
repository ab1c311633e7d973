"""Errors of the hub.

::

    HubError
     +-- HubConfigError    the zenoh configuration cannot be used
     +-- HubClosedError    the session is closed
     +-- HubWireError      bytes or names are not in rmw_zenoh's format
"""

from __future__ import annotations

import re

_RUST_PLACE = re.compile(r" at \S+\.rs:\d+\.?")


class HubError(Exception):
    """Base of the hub's errors."""


class HubConfigError(HubError):
    """The zenoh configuration cannot be read, or zenoh refuses it."""


class HubClosedError(HubError):
    """The hub session or the endpoint is closed."""


class HubWireError(HubError):
    """A key, a token, an attachment or a name is not in rmw_zenoh's format."""


def zenoh_reason(err: Exception) -> str:
    """Return the reason that zenoh reports, without source locations."""
    return _RUST_PLACE.sub("", str(err))
