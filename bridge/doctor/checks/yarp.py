"""YARP: does the name server answer, and do this shell's programs and the daemon ask the same one?"""

from __future__ import annotations

from bridge.adapters.yarp.environment import available
from bridge.adapters.yarp.network import ASK_SECONDS, address_of
from bridge.doctor.check import Check, Findings, fail, ok, skip, warn
from bridge.doctor.context import CheckContext, Document
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports.naming import NamingConfigError, NamingError


def look_at_name_server(context: CheckContext) -> Findings:
    """Does it answer?"""
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
        return warn(str(err), "it is Midspan's own while its yarp worker runs (midspan status)")
    return ok(f"{client.address.host} port {client.address.port} answers: {len(ports)} ports")


def look_at_environment(context: CheckContext) -> Findings:
    """Do the YARP programs of this shell ask the name server that the daemon is told to use?"""
    section = context.config.yarp
    if reason := _why_not(context):
        return skip(reason)
    try:
        told = conf.read(section.namespace, context.environ)
    except NamingConfigError as err:
        return fail(str(err), f"write a line such as '127.0.0.1 10000 yarp' into {_file(context)}")
    wanted = address_of(section)
    if told is None:
        place = wanted or Address("127.0.0.1", conf.DEFAULT_PORT)
        cure = f"for programs of this user: echo '{place.host} {place.port} yarp' > {_file(context)}"
        return warn(f"there is no {_file(context)}: YARP programs of this shell find no name server", cure)
    if wanted is not None and (wanted.host, wanted.port) != (told.host, told.port):
        seen = f"yarp.address is {wanted.host}:{wanted.port}, {_file(context)} says {told.host}:{told.port}"
        return warn(seen, "set both alike, unless they are one machine's two names")
    return ok(f"{_file(context)} says {told.host} port {told.port}")


def look_at_releases(context: CheckContext) -> Findings:
    """Is the release of every YARP program known that calls one of our ports?"""
    callers = [(port, peer) for port in _module_ports(context) for peer in port.get("peers") or ()]
    callers = [(port, peer) for port, peer in callers if peer.get("generation")]
    if not callers:
        return skip("no YARP program calls a port of a module")
    guessed = {
        peer["port"]: warn(
            f"nothing tells which release of YARP {peer['port']} is of, which calls {port['port']}: it is answered as"
            f" {peer['generation']} does, and others are told of some calls that they failed",
            str(peer["generation_cure"]),
        )
        for port, peer in callers
        if peer.get("generation_cure")
    }
    return [*guessed.values()] or ok("the release of every YARP program that calls is known")


def _module_ports(context: CheckContext) -> list[Document]:
    modules = (document for document in context.hub.documents if document.get("module"))
    return [port for document in modules for port in document.get("ports") or ()]


def _why_not(context: CheckContext) -> str:
    """Why there is no YARP side to look at, "" where there is."""
    if context.config.yarp.enabled is False:
        return "yarp.enabled is false"
    if context.config.yarp.enabled == "auto" and not context.hub.of_side("yarp"):
        return available(context.config)
    return ""


def _file(context: CheckContext) -> str:
    return str(conf.file(context.config.yarp.namespace, context.environ))


CHECKS = (
    Check("yarp-names", "the YARP name server", look_at_name_server),
    Check("yarp-environment", "this shell's YARP against the daemon's", look_at_environment),
    Check("yarp-releases", "the releases of YARP clients", look_at_releases),
)
"""The doctor's checks of this side."""
