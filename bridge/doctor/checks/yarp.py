"""YARP: does the name server answer, and do this shell's programs and the daemon ask the same one?"""

from __future__ import annotations

from collections.abc import Sequence

from bridge.adapters.yarp.environment import available
from bridge.adapters.yarp.network import ASK_SECONDS, address_of
from bridge.doctor.around import Around
from bridge.doctor.finding import Finding, fail, ok, skip, warn
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.errors import ConfigError, NamingError


def look_at_name_server(around: Around) -> Sequence[Finding]:
    """Does it answer?"""
    section = around.config.yarp
    reason = _why_not(around)
    if reason:
        return [skip(reason)]
    client = NameClient(address_of(section), timeout=ASK_SECONDS)
    try:
        ports = client.list()
    except NamingError as err:
        if section.nameserver == "site":
            cure = "start yarpserver there, or let Midspan be the name server: yarp.nameserver: auto"
            return [fail(str(err), cure)]
        return [warn(str(err), "it is Midspan's own while its yarp worker runs (midspan status)")]
    return [ok(f"{client.address.host} port {client.address.port} answers: {len(ports)} ports")]


def look_at_environment(around: Around) -> Sequence[Finding]:
    """Do the YARP programs of this shell ask the name server that the daemon is told to use?"""
    section = around.config.yarp
    reason = _why_not(around)
    if reason:
        return [skip(reason)]
    try:
        told = conf.read(section.namespace, around.environ)
    except ConfigError as err:
        return [fail(str(err), f"write a line such as '127.0.0.1 10000 yarp' into {_file(around)}")]
    wanted = address_of(section)
    if told is None:
        place = wanted or Address("127.0.0.1", conf.DEFAULT_PORT)
        cure = f"for programs of this user: echo '{place.host} {place.port} yarp' > {_file(around)}"
        return [warn(f"there is no {_file(around)}: YARP programs of this shell find no name server", cure)]
    if wanted is not None and (wanted.host, wanted.port) != (told.host, told.port):
        seen = f"yarp.address is {wanted.host}:{wanted.port}, {_file(around)} says {told.host}:{told.port}"
        return [warn(seen, "set both alike, unless they are one machine's two names")]
    return [ok(f"{_file(around)} says {told.host} port {told.port}")]


def _why_not(around: Around) -> str:
    """Why there is no YARP side to look at, "" where there is."""
    if around.config.yarp.enabled is False:
        return "yarp.enabled is false"
    if around.config.yarp.enabled == "auto" and not around.hub.of_side("yarp"):
        return available(around.config)
    return ""


def _file(around: Around) -> str:
    return str(conf.file(around.config.yarp.namespace, around.environ))
