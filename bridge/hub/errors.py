"""Errors of the hub.

::

    HubError
     +-- HubConfigError    the zenoh configuration, a name or a certificate file cannot be used
     +-- HubClosedError    the session or the endpoint is closed
     +-- HubWireError      bytes or names are not in rmw_zenoh's format
"""

from __future__ import annotations

import re

_RUST_PLACE = re.compile(r" at \S+\.rs:\d+\.?")


class HubError(Exception):
    """Base of the hub's errors."""


class HubConfigError(HubError):
    """The zenoh configuration, a name of the session or a certificate file cannot be used."""


class HubClosedError(HubError):
    """The hub session or the endpoint is closed."""


class HubWireError(HubError):
    """A key, a token, an attachment or a name is not in rmw_zenoh's format."""


def zenoh_reason(err: Exception) -> str:
    """Return the reason that zenoh reports, without source locations."""
    return _RUST_PLACE.sub("", str(err))
