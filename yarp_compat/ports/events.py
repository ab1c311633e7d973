"""What a port tells its owner about its connections."""

from __future__ import annotations

from dataclasses import dataclass

from yarp_compat.wire.contact import Route


@dataclass(frozen=True, slots=True)
class ConnectionEvent:
    """A connection came or went.

    Attributes:
        route: its names.
        incoming: it brings data to this port.
        up: it came.
    """

    route: Route
    incoming: bool
    up: bool
