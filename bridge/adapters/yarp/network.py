"""The YARP network: its name server, its identity, and the names of Midspan's own ports."""

from __future__ import annotations

import ipaddress
import logging
import socket
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

from typing_extensions import override

from bridge.config.sections.yarp import YarpSection
from bridge.hub.listeners import can_bind
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.ports.naming import NamingConfigError, NamingError
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.profile import Profile

PRESENCE = "/midspan/daemon/"
"""Prefix of the ports by which the workers on a YARP network recognize each other."""

OWNER = "midspan_owner"
"""Property of each of Midspan's ports at the name server: the id of the worker that opened it."""

DAEMON = "midspan"
"""Property with the daemon's name, set on its presence port and on the topic ports that it bridges."""


def new_id(length: int = 32) -> str:
    """Return a new id that begins with a letter, because YARP parses a text such as ``75e5e286e164`` as a number."""
    return "m" + uuid.uuid4().hex[: length - 1]


@dataclass(frozen=True, slots=True)
class PortNames:
    """The configured schemes of port names, where ``{topic}`` is the topic; ``daemon`` resolves conflicts of names."""

    output_scheme: str
    input_scheme: str
    rpc_scheme: str
    daemon: str

    def matches(self, name: str) -> bool:
        """Return whether one of the schemes can produce this port name."""
        return any(
            name.startswith(scheme.partition("{topic}")[0]) and name.endswith(scheme.partition("{topic}")[2])
            for scheme in (self.output_scheme, self.input_scheme, self.rpc_scheme)
        )

    def alternative(self, name: str) -> str:
        """Return an alternative name for a port, used if a daemon on another hub has a port for the same topic."""
        for scheme in (self.output_scheme, self.input_scheme, self.rpc_scheme):
            prefix, _, suffix = scheme.partition("{topic}")
            if name.startswith(prefix) and name.endswith(suffix):
                return f"{prefix}/{self.daemon}{name[len(prefix) :]}"
        return name

    def output(self, topic: str) -> str:
        """Return the port that writes the messages of a topic."""
        return self.output_scheme.replace("{topic}", topic)

    def input(self, topic: str) -> str:
        """Return the port that receives messages for a topic."""
        return self.input_scheme.replace("{topic}", topic)

    def rpc(self, service: str) -> str:
        """Return the port that serves a service."""
        return self.rpc_scheme.replace("{topic}", service)


_log = logging.getLogger(__name__)

IDENTITY = "midspan_network"
"""Property of the root port of the name server: the id of the network."""

ASK_SECONDS = 2.0
"""Timeout of a command to the name server."""

PATIENCE = 2.0
"""Seconds without an answer after which Midspan opens its embedded name server, if the configuration permits."""


class _Names(NameClient):
    """A client that queries the registry directly if the name server runs in this process."""

    server: NameServer | None = None

    @override
    def query(self, name: str) -> PortContact | None:
        return super().query(name) if self.server is None else self.server.registry.find(name)


class YarpNetwork:
    """The network of one name server. Used on one thread; an embedded name server stores its registry in ``state``."""

    def __init__(self, section: YarpSection, state: Path) -> None:
        self._section = section
        self._state = state / "yarp_names.json"
        self._address = address_of(section)
        self.naming = _Names(self._address, namespace=section.namespace, timeout=ASK_SECONDS, numbers=section.numbers)
        self._silent_since: float | None = None
        self._listed: tuple[int, list[PortContact]] | None = None
        self.identity: str | None = None
        self.trouble = ""

    def list_ports(self) -> list[PortContact] | None:
        """Return all registered ports, None if no name server answers; an embedded one is read only after changes."""
        server = self.naming.server
        changes = None if server is None else server.changes
        if self._listed is not None and self._listed[0] == changes:
            return self._listed[1]
        try:
            if self._section.nameserver == "embedded" and server is None:
                self._embed()
            ports = self.naming.list()
            self._name_network()
        except NamingError as err:
            self.trouble = str(err)
            self._after_silence()
            return None
        self._silent_since, self.trouble = None, ""
        self._listed = None if changes is None else (changes, ports)
        return ports

    def _after_silence(self) -> None:
        now = time.monotonic()
        self._silent_since = self._silent_since or now
        if self._section.nameserver != "auto" or self.is_own or now - self._silent_since < PATIENCE:
            return
        try:
            if _is_here(self._server_address()):
                self._embed()
        except NamingError as err:
            self.trouble = str(err)

    def _server_address(self) -> Address:
        return self._address or conf.read(self._section.namespace) or Address("127.0.0.1", conf.DEFAULT_PORT)

    def _embed(self) -> None:
        address = self._server_address()
        namespace = self._section.namespace or conf.namespace()
        self.naming.server = NameServer(
            address.host, address.port, namespace=namespace, state=self._state, profile=Profile(self._section.profile)
        ).open()
        _log.info("opened the embedded YARP name server: %s at %s port %d", namespace, address.host, address.port)
        if self._address is None and conf.read(self._section.namespace) is None:
            self._write_address(address)

    def _write_address(self, address: Address) -> None:
        """Write the name server's address for this user's programs, as ``yarpserver --write`` does."""
        try:
            _log.info("wrote %s", conf.write(address, self._section.namespace))
        except NamingConfigError as err:
            _log.warning("YARP programs cannot find the name server: %s", err)
            self.naming.use(address)

    def _name_network(self) -> None:
        """Read the id of the network, or assign one."""
        root = self.naming.contact.name
        values = [str(value) for value in self.naming.get_property(root, IDENTITY)]
        if not values:
            self.naming.set_property(root, IDENTITY, self.identity or new_id())
            values = [str(value) for value in self.naming.get_property(root, IDENTITY)]
        self.identity = values[0] if values else f"{self.naming.address.host}:{self.naming.address.port}{root}"

    @property
    def is_own(self) -> bool:
        """Whether the name server is embedded in this worker."""
        return self.naming.server is not None

    def close(self) -> None:
        server, self.naming.server = self.naming.server, None
        if server is not None:
            server.close()


def address_of(section: YarpSection) -> Address | None:
    """Return the name server's address in the configuration, None if yarp.conf is used."""
    return None if section.place is None else Address(*section.place)


def _is_here(address: Address) -> bool:
    """Return whether this address belongs to this machine."""
    try:
        addresses = {info[4][0] for info in socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)}
    except (OSError, UnicodeError):
        return False
    return all(ipaddress.ip_address(str(ip).partition("%")[0]).is_loopback or can_bind(str(ip)) for ip in addresses)
