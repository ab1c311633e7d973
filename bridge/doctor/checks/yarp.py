"""YARP: whether the name server answers, and whether this shell's programs and the daemon use the same one."""

from __future__ import annotations

from bridge.adapters.yarp.environment import available
from bridge.adapters.yarp.network import ASK_SECONDS, address_of
from bridge.doctor.check import Check, Findings, fail, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.status import ModuleStatus, PortStatus
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports.naming import NamingConfigError, NamingError

MAX_NAMED = 10  # clients in one line of the report


def check_name_server(context: CheckContext) -> Findings:
    """Check that the name server answers."""
    section = context.config.yarp
    if reason := _why_not(context):
        return skip(reason)
    client = NameClient(address_of(section), timeout=ASK_SECONDS)
    try:
        ports = client.list()
    except NamingError as err:
        if section.nameserver == "site":
            cure = "start yarpserver there, or let Midspan be the name server: yarp.nameserver: auto"
            return fail(str(err), cure)
        return warn(str(err), "Midspan's own name server runs with its yarp worker (midspan status)")
    return ok(f"{client.address.host} port {client.address.port} answers: {len(ports)} ports")


def check_environment(context: CheckContext) -> Findings:
    """Check whether the YARP programs of this shell use the daemon's name server."""
    section = context.config.yarp
    if reason := _why_not(context):
        return skip(reason)
    try:
        configured = conf.read(section.namespace, context.environ)
    except NamingConfigError as err:
        return fail(str(err), f"write a line such as '127.0.0.1 10000 yarp' into {_file(context)}")
    wanted = address_of(section)
    if configured is None:
        place = wanted or Address("127.0.0.1", conf.DEFAULT_PORT)
        cure = f"for programs of this user: echo '{place.host} {place.port} yarp' > {_file(context)}"
        return warn(f"{_file(context)} does not exist: YARP programs of this shell cannot find the name server", cure)
    if wanted is not None and (wanted.host, wanted.port) != (configured.host, configured.port):
        seen = f"yarp.address is {wanted.host}:{wanted.port}, {_file(context)} has {configured.host}:{configured.port}"
        return warn(seen, "set both to the same address, unless these are two names of one machine")
    return ok(f"{_file(context)} names {configured.host} port {configured.port}")


def check_releases(context: CheckContext) -> Findings:
    """Report the release of each YARP client of Midspan's ports, and the setting for clients of unknown release."""
    clients = {peer.port: (port, peer) for port in _module_ports(context) for peer in port.peers if peer.generation}
    if not clients:
        return skip("no YARP program is connected to a module's port")
    guessed = [
        warn(
            f"the YARP release of {name} at {port.port} is unknown ({peer.generation_why}): it gets the replies of"
            f" {peer.generation}, some of which clients of other releases read as failures",
            peer.generation_cure,
        )
        for name, (port, peer) in clients.items()
        if peer.generation_cure
    ]
    known = [
        f"{name}: {peer.generation} ({peer.generation_why})"
        for name, (_, peer) in clients.items()
        if not peer.generation_cure
    ]
    more = f", and {len(known) - MAX_NAMED} more" if len(known) > MAX_NAMED else ""
    return [*guessed, *([ok("; ".join(known[:MAX_NAMED]) + more)] if known else [])]


def _module_ports(context: CheckContext) -> list[PortStatus]:
    modules = (document for document in context.hub.documents if isinstance(document, ModuleStatus))
    return [port for module in modules for port in module.ports]


def _why_not(context: CheckContext) -> str:
    """Return why the YARP side is not checked, "" if it is."""
    if context.config.yarp.enabled is False:
        return "yarp.enabled is false"
    if context.config.yarp.enabled == "auto" and not context.hub.of_side("yarp"):
        return available(context.config)
    return ""


def _file(context: CheckContext) -> str:
    return str(conf.file(context.config.yarp.namespace, context.environ))


CHECKS = (
    Check("yarp-names", "the YARP name server", check_name_server),
    Check("yarp-environment", "this shell's YARP against the daemon's", check_environment),
    Check("yarp-releases", "the releases of YARP clients", check_releases),
)
"""The doctor's checks of this side."""
