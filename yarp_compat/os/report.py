"""``PortReport`` and ``PortInfo``: what a port tells of its connections."""

from __future__ import annotations

from dataclasses import dataclass

from yarp_compat.ports.events import ConnectionEvent
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.contact import Route


@dataclass
class PortInfo:
    """One thing about a port.

    Attributes:
        tag: `PORTINFO_CONNECTION` or `PORTINFO_MISC`.
        incoming: the connection brings data to the port.
        created: it is there; False when it went.
        portName: the port's name.
        sourceName: who sends.
        targetName: who receives.
        carrierName: how.
        message: the same in words.
    """

    PORTINFO_NULL = 0
    PORTINFO_CONNECTION = 1
    PORTINFO_MISC = 2

    tag: int = PORTINFO_NULL
    incoming: bool = False
    created: bool = True
    portName: str = ""
    sourceName: str = ""
    targetName: str = ""
    carrierName: str = ""
    message: str = ""


class PortReport:
    """Derive from it to be told of connections: ``port.getReport(reporter)``, ``port.setReporter(reporter)``."""

    def report(self, info: PortInfo) -> None:
        """Take one thing about a port."""
        raise NotImplementedError(f"{type(self).__name__} has no report")


def report(core: PortCore, reporter: PortReport, event: ConnectionEvent | None = None) -> None:
    """Tell a reporter of one event, or of a port and all its connections."""
    if event is not None:
        reporter.report(_connection(core.name, event.route, incoming=event.incoming, created=event.up))
        return
    reporter.report(PortInfo(PortInfo.PORTINFO_MISC, portName=core.name, message=core.describe()[0]))
    for route in core.outputs():
        reporter.report(_connection(core.name, route, incoming=False, created=True))
    for route in core.inputs():
        reporter.report(_connection(core.name, route, incoming=True, created=True))


def _connection(name: str, route: Route, *, incoming: bool, created: bool) -> PortInfo:
    kind = "input" if incoming else "output"
    words = f"There is an {kind} connection from {route.source} to {route.target} using {route.carrier}"
    return PortInfo(
        PortInfo.PORTINFO_CONNECTION, incoming, created, name, route.source, route.target, route.carrier, words
    )
