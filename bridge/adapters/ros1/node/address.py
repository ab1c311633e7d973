"""The address of this machine's ROS 1 nodes, from ``ROS_HOSTNAME``, ``ROS_IP`` and ``ROS_IPV6``.

The rules are those of rosgraph (https://wiki.ros.org/ROS/NetworkSetup, https://wiki.ros.org/ROS/EnvironmentVariables):
``ROS_HOSTNAME`` has precedence over ``ROS_IP``. If neither is set, the address is the machine's name or, if that is a
loopback name, the first address of a network interface, preferably not a loopback one. A node for which a loopback
address is set listens only there, any other node on all interfaces.
"""

from __future__ import annotations

import ipaddress
import logging
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import psutil

_log = logging.getLogger(__name__)

_BACKLOG = 128


@dataclass(frozen=True, slots=True)
class NodeAddress:
    """``host`` is announced to peers, ``bind`` is the address to listen on; ``ipv6`` selects the protocol."""

    host: str
    bind: str
    ipv6: bool

    @classmethod
    def of(cls, environ: Mapping[str, str]) -> NodeAddress:
        """Return the address for an environment."""
        ipv6 = environ.get("ROS_IPV6") == "on"
        configured = environ.get("ROS_HOSTNAME") if "ROS_HOSTNAME" in environ else environ.get("ROS_IP")
        if configured:
            _check(configured, "ROS_HOSTNAME" if "ROS_HOSTNAME" in environ else "ROS_IP")
        return cls(configured or _machine_host(ipv6=ipv6), _bind_address(configured or "", ipv6=ipv6), ipv6)

    @property
    def in_uri(self) -> str:
        """The host in the form that a URI contains."""
        return f"[{self.host}]" if ":" in self.host else self.host

    def listen(self) -> socket.socket:
        """Return a socket that listens on a free port; raises `OSError`."""
        family = socket.AF_INET6 if self.ipv6 else socket.AF_INET
        dual = self.ipv6 and socket.has_dualstack_ipv6()
        return socket.create_server((self.bind, 0), family=family, backlog=_BACKLOG, dualstack_ipv6=dual)


def _check(configured: str, name: str) -> None:
    """Log a value that other nodes cannot connect to."""
    trouble = ""
    if "://" in configured:
        trouble = "it must not contain a protocol"
    elif name == "ROS_HOSTNAME" and ":" in configured and not _is_ipv6(configured):
        trouble = "it must not contain a port"
    elif name == "ROS_IP" and not _is_address(configured):
        trouble = "it must be an IPv4 or IPv6 address, without a port"
    if trouble:
        _log.warning("%s is %r: %s; ROS 1 nodes cannot connect to this one", name, configured, trouble)


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def _is_ipv6(text: str) -> bool:
    return ":" in text and _is_address(text)


def _bind_address(configured: str, *, ipv6: bool) -> str:
    if configured != "localhost" and configured != "::1" and not configured.startswith("127."):
        return "::" if ipv6 else "0.0.0.0"  # noqa: S104 - all interfaces, like every ROS 1 node
    if ipv6:
        return "::1"
    return configured if configured.startswith("127.") else "127.0.0.1"


def _machine_host(*, ipv6: bool) -> str:
    name = socket.gethostname()
    if name and name != "localhost" and not name.startswith("127."):
        return name
    addresses = list(_interface_addresses(ipv6=ipv6))
    others = [a for a in addresses if not ipaddress.ip_address(a).is_loopback]
    return next(iter(others or addresses), "::1" if ipv6 else "127.0.0.1")


def _interface_addresses(*, ipv6: bool) -> Iterator[str]:
    """Yield the network interfaces' addresses, IPv6 first if ``ipv6``.

    IPv6 link-local addresses are left out, because they are valid only with the name of an interface.
    """
    families = (socket.AF_INET6, socket.AF_INET) if ipv6 else (socket.AF_INET,)
    entries = [entry for interface in psutil.net_if_addrs().values() for entry in interface]
    for family in families:
        for entry in entries:
            if entry.family == family and "%" not in entry.address and not entry.address.startswith("fe80:"):
                yield entry.address
