"""What the routes of one engine share, and what is done for each of them alike."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from bridge.adapters.base import Edge
from bridge.hub.session import Hub
from bridge.messages.conversion import Conversion, ServiceConversion
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry
from bridge.routing.age import Pulse
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.lease import Lease
from bridge.routing.room import OUT, RAISE
from bridge.routing.route import Route
from bridge.routing.typebook import TypeBook
from bridge.routing.verdict import Verdict

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Joint:
    """The two ends that routes join, and their common helpers.

    Attributes:
        hub: the session on the hub.
        edge: the side.
        pulse: tells whether this process stood still.
        lease: tells whether messages may cross at this moment.
        types: definitions that workers tell each other.
        small: carries messages from the hub to the side, urgent ones first.
        bulk: the same for large ones.
        wake: has the engine look at the graphs again soon.
        registry: of types, for the replies that say no.
    """

    hub: Hub
    edge: Edge
    pulse: Pulse
    lease: Lease
    types: TypeBook
    small: Dispatcher
    bulk: Dispatcher
    wake: Callable[[], None]
    registry: Registry | None = None


Converts = TypeVar("Converts", Conversion, ServiceConversion)


def convert(make: Callable[[], Converts], verdict: Verdict) -> Converts | None:
    """Make a route's conversion; None, and the verdict tells why, where its type cannot cross."""
    try:
        return make()
    except MessageTypeError as err:
        verdict.refuse(str(err), err.cure)
        return None


def attempt(route: Route, update: Callable[[], None], verdict: Verdict) -> None:
    """Update a route. Its failure is its own: it is reported, and tried again at the next look."""
    try:
        update()
    except MessageTypeError as err:
        verdict.refuse(str(err), err.cure)
    except OSError as err:
        text, cure = _told(err)
        verdict.refuse(text, cure)
        if verdict.reason != route.refused:
            _log.warning("%s %s is refused: %s; %s", verdict.direction, verdict.topic, text, cure)
    except Exception as err:
        verdict.refuse(f"{type(err).__name__}: {err}", "")
        if verdict.reason != route.refused:
            _log.exception("%s %s", verdict.direction, verdict.topic)
    route.refused = verdict.reason


def _told(err: OSError) -> tuple[str, str]:
    """What the system said, and what helps."""
    if err.errno in OUT:
        return "this process has no file descriptor left", RAISE
    return f"the system says: {err.strerror or err}", "it is tried again every few seconds"
