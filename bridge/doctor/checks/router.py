"""Who holds the port of the hub's router?"""

from __future__ import annotations

from collections.abc import Sequence

import psutil

from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, warn
from bridge.hub.errors import HubError
from bridge.hub.router import port_held, probe_router
from bridge.hub.settings import connect_endpoint


def look(around: Around) -> Sequence[Finding]:
    """Our router, another's, something else, or nobody."""
    hub = around.config.hub
    try:
        info = probe_router(hub.listen, hub.zenoh)
    except HubError as err:
        return [fail(str(err), "mend hub.zenoh")]
    if info is None:
        if not port_held(hub.listen):
            return [ok(f"nothing listens at {hub.listen}: the daemon's router will")]
        return [
            fail(
                f"{hub.listen} is held by a program that does not speak zenoh{_holder(hub.listen)}",
                "stop that program, or set hub.listen to a free port",
            )
        ]
    if info.mode != "router":
        return [fail(f"{hub.listen} is held by {info}, which routes nothing", "set hub.listen to a free port")]
    if info.daemon:
        return [ok(f"{hub.listen} is {info}")]
    text = f"{hub.listen} is held by {info}{_holder(hub.listen)}"
    if hub.router is True:
        return [
            fail(text, "hub.router is true: stop that router, set hub.listen to a free port, or hub.router to auto")
        ]
    return [warn(f"{text}; it is used as the hub's router", "where that is not meant, set hub.listen to a free port")]


def _holder(endpoint: str) -> str:
    """The process that listens there, as far as this user may know."""
    port = connect_endpoint(endpoint).partition("?")[0].rpartition(":")[2]
    try:
        for connection in psutil.net_connections("tcp"):
            listens = connection.status == psutil.CONN_LISTEN and tuple(connection.laddr)[1:] == (int(port),)
            if listens and connection.pid:
                return f" (process {connection.pid}, {psutil.Process(connection.pid).name()})"
    except (psutil.Error, OSError, ValueError):
        return ""
    return ""
