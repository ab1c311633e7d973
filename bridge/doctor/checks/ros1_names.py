"""ROS 1's classic: a network that works one way only, because host names do not resolve, or resolve elsewhere.

Every ROS 1 node tells the master its address by ROS_HOSTNAME, ROS_IP or the machine's name (rosgraph.network), and
whoever wants its data must reach it under that name.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Mapping, Sequence
from urllib.parse import urlsplit

import psutil

from bridge.adapters.ros1.environment import is_local
from bridge.adapters.ros1.errors import Ros1Error
from bridge.doctor.around import Around
from bridge.doctor.checks.ros1 import why_not
from bridge.doctor.finding import Finding, fail, ok, skip, warn
from bridge.doctor.parallel import in_parallel

MAX_NODES = 200
_CONNECT_SECONDS = 1.0
_AT_ONCE = 16
_SHOWN = 5


def look_at_address(around: Around) -> Sequence[Finding]:
    """Is what this machine tells ROS 1 peers as its address really its own, and of use to them?"""
    reason = why_not(around)
    if reason:
        return [skip(reason)]
    name, value = _announced(around)
    remote = not is_local(urlsplit(around.master).hostname or "")
    if not name and not remote:
        return [ok("the master is on this machine: 127.0.0.1 is announced")]
    if not name:
        name, value = "the machine's name", socket.gethostname()
    try:
        addresses = _resolve(value)
    except OSError:
        return [
            fail(
                f"{name} is '{value}', which does not resolve",
                f"set ROS_IP to this machine's address, or add {value} to /etc/hosts",
            )
        ]
    own = _own_addresses()
    if not addresses & own:
        seen = f"{name} is '{value}' ({', '.join(sorted(addresses))}), which is no address of this machine"
        return [fail(seen, f"set it to one of {', '.join(sorted(a for a in own if ':' not in a))}")]
    if remote and all(ipaddress.ip_address(a).is_loopback for a in addresses):
        seen = f"the master is on another machine, but {name} '{value}' resolves to {', '.join(sorted(addresses))} here"
        return [
            fail(
                f"{seen}: its nodes cannot reach this machine",
                "set ros1.ip (ROS_IP) to this machine's address in that network",
            )
        ]
    return [ok(f"{name} is {value}")]


def look_at_nodes(around: Around) -> Sequence[Finding]:
    """Can each node that the master knows be reached from here under the address that it gave?"""
    reason = why_not(around)
    if reason:
        return [skip(reason)]
    look = around.look_at_master()
    if isinstance(look, Ros1Error):
        return [skip("the master does not answer")]
    nodes = dict(sorted(look.uris.items())[:MAX_NODES])
    remote = not is_local(urlsplit(around.master).hostname or "")
    troubles = in_parallel(lambda uri: _trouble(uri, remote=remote), list(nodes.values()), _AT_ONCE)
    groups: dict[Finding, list[str]] = {}
    for node, trouble in zip(nodes, troubles, strict=True):
        if trouble is not None:
            groups.setdefault(trouble, []).append(node)
    if not groups:
        return [ok(f"all {len(nodes)} nodes can be reached")]
    return [_named(finding, names) for finding, names in groups.items()]


def _trouble(uri: str, *, remote: bool) -> Finding | None:
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname or "", parts.port or 80
    except ValueError:
        return fail(f"the address {uri!r} is no address")
    try:
        addresses = _resolve(host)
    except OSError:
        return fail(
            f"the host name '{host}' that they gave does not resolve here",
            f"add '{host}' with its address to /etc/hosts of this machine, or set ROS_IP where they run",
        )
    named = host != "localhost" and not _is_address(host)
    if remote and named and all(ipaddress.ip_address(a).is_loopback for a in addresses):
        return fail(
            f"the host name '{host}' that they gave resolves to {', '.join(sorted(addresses))}, this very machine",
            f"correct '{host}' in /etc/hosts of this machine",
        )
    try:
        socket.create_connection((host, port), _CONNECT_SECONDS).close()
    except ConnectionRefusedError:
        return warn(
            f"nothing answers at {host} ({', '.join(sorted(addresses))}) under the port that they gave",
            "they are dead ('rosnode cleanup' takes them off the master), or the name leads elsewhere from here",
        )
    except OSError as err:
        return fail(
            f"{host} ({', '.join(sorted(addresses))}) cannot be reached: {err}",
            "check route and firewall; ROS 1 nodes use any port",
        )
    return None


def _named(finding: Finding, nodes: Sequence[str]) -> Finding:
    more = f" and {len(nodes) - _SHOWN} more" if len(nodes) > _SHOWN else ""
    return Finding(finding.result, f"{', '.join(nodes[:_SHOWN])}{more}: {finding.seen}", finding.cure)


def _announced(around: Around) -> tuple[str, str]:
    """What is set as this machine's address for ROS 1, and by what."""
    ros1, environ = around.config.ros1, around.environ
    configured: Mapping[str, str | None] = {"ros1.hostname": ros1.hostname, "ros1.ip": ros1.ip}
    inherited = {name: environ.get(name) for name in ("ROS_HOSTNAME", "ROS_IP")}
    for name, value in (configured if ros1.hostname or ros1.ip else inherited).items():
        if value:
            return name, value
    return "", ""


def _resolve(host: str) -> set[str]:
    """Addresses of a host; raises `OSError`."""
    try:
        return {str(info[4][0]).partition("%")[0] for info in socket.getaddrinfo(host, None)}
    except UnicodeError as err:  # a name that cannot be one
        raise OSError(str(err)) from None


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _own_addresses() -> set[str]:
    interfaces = psutil.net_if_addrs().values()
    found = {
        a.address.partition("%")[0]
        for addresses in interfaces
        for a in addresses
        if a.family in (socket.AF_INET, socket.AF_INET6)
    }
    # the whole of 127/8 is this machine's, Debian's 127.0.1.1 for the machine's name among it
    return found | {"127.0.0.1", "127.0.1.1", "::1"}
