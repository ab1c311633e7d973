"""The checks of the hub's router."""

from __future__ import annotations

import psutil

from bridge.config.model import Config
from bridge.doctor.check import Check, Findings, fail, ok, warn
from bridge.doctor.checks import connections
from bridge.doctor.context import CheckContext
from bridge.doctor.daemon_state import own_router, unresponsive_router, zenoh_settings
from bridge.hub.errors import HubError
from bridge.hub.router import may_be_slow, port_held, port_holder, probe_router


def check_port(context: CheckContext) -> Findings:
    """Check which program listens at the router's address: Midspan's router, another router, or something else."""
    hub = context.config.hub
    try:
        info = probe_router(hub.listen, hub.zenoh)
    except HubError as err:
        return fail(str(err), "correct hub.zenoh")
    if info is None:
        deaf = unresponsive_router(context.config)
        if deaf:
            return fail(deaf, _cure(context.config))
        if not port_held(hub.listen):
            return ok(f"nothing listens at {hub.listen} yet; the daemon's router will")
        kind = "has not answered as zenoh" if may_be_slow(hub.listen) else "is not zenoh"
        seen = f"{hub.listen} is held by a program that {kind}{_holder(hub.listen)}"
        return fail(seen, "stop that program, or set hub.listen to a free port")
    if info.mode != "router":
        return fail(f"{hub.listen} is held by {info}, which routes nothing", "set hub.listen to a free port")
    if info.daemon:
        return ok(f"{hub.listen} is {info}")
    if pid := own_router(context.config):
        seen = (
            f"the router of {context.config.name} (process {pid}) listens at {hub.listen}, but does not identify itself"
        )
        return fail(seen, _cure(context.config))
    text = f"{hub.listen} is held by {info}{_holder(hub.listen)}"
    if hub.router is True:
        return fail(text, "stop that router, set hub.listen to a free port, or set hub.router to auto (it is true)")
    return warn(f"{text}; it is used as the hub's router", "if that is not intended, set hub.listen to a free port")


def _cure(config: Config) -> str:
    """Return the cure for a router of this daemon that does not answer."""
    usual = "see the checks 'daemon' and 'descriptors'; if both are good, end that process"
    settings = zenoh_settings(config)
    return f"leave out {settings}, and restart the daemon; if that does not help, {usual}" if settings else usual


def _holder(endpoint: str) -> str:
    """Return the process that listens at an endpoint, "" if this user may not see it."""
    try:
        holder = port_holder(endpoint)
        return f" (process {holder.pid}, {holder.name()})" if holder is not None else ""
    except psutil.Error:
        return ""


CHECKS = (
    Check("router-port", "the router's port", check_port),
    Check(
        "keys",
        "the certificates and connections of other machines (`hub.open`)",
        connections.check_connections,
        seconds=connections.SECONDS,
    ),
)
