"""The YARP network: its name server, the site's or our own, and what tells the network from others."""

from __future__ import annotations

import ipaddress
import logging
import socket
import time
import uuid
from pathlib import Path

from bridge.config.sections.yarp import YarpSection
from yarp_compat.naming import config as conf
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.errors import ConfigError, NamingError
from yarp_compat.naming.server import NameServer
from yarp_compat.wire.contact import Contact
from yarp_compat.wire.profile import Profile

_log = logging.getLogger(__name__)

IDENTITY = "midspan_network"
"""The property of the name server's own port that names the network."""

ASK_SECONDS = 2.0
"""Seconds that any command to the name server may take."""

PATIENCE = 2.0
"""Seconds without an answer after which our own name server is opened, where it may be."""


class YarpNetwork:
    """Joins the network of one name server; one thread calls it.

    Args:
        section: the configuration.
        state: folder in which our own name server remembers.
    """

    def __init__(self, section: YarpSection, state: Path) -> None:
        self._section = section
        self._state = state / "yarp_names.json"
        self._address = address_of(section)
        self.naming = NameClient(self._address, namespace=section.namespace, timeout=ASK_SECONDS)
        self._server: NameServer | None = None
        self._silent_since: float | None = None
        self.identity: str | None = None
        self.trouble = ""

    def look(self) -> list[Contact] | None:
        """All ports that are registered, None where no name server answers."""
        try:
            if self._section.nameserver == "embedded" and self._server is None:
                self._embed()
            found = self.naming.list()
            self._name_network()
        except NamingError as err:
            self.trouble = str(err)
            self._after_silence()
            return None
        self._silent_since, self.trouble = None, ""
        return found

    def _after_silence(self) -> None:
        now = time.monotonic()
        self._silent_since = self._silent_since or now
        if self._section.nameserver != "auto" or self._server is not None or now - self._silent_since < PATIENCE:
            return
        try:
            if _is_here(self._place()):
                self._embed()
        except NamingError as err:
            self.trouble = str(err)

    def _place(self) -> Address:
        return self._address or conf.read(self._section.namespace) or Address("127.0.0.1", conf.DEFAULT_PORT)

    def _embed(self) -> None:
        place = self._place()
        namespace = self._section.namespace or conf.namespace()
        self._server = NameServer(
            place.host, place.port, namespace=namespace, state=self._state, profile=Profile(self._section.profile)
        ).open()
        _log.info("this worker is the YARP name server now: %s at %s port %d", namespace, place.host, place.port)
        if self._address is None and conf.read(self._section.namespace) is None:
            self._tell(place)

    def _tell(self, place: Address) -> None:
        """Say where the name server is, for programs of this user: as yarpserver does with ``--write``."""
        try:
            _log.info("wrote %s", conf.write(place, self._section.namespace))
        except ConfigError as err:
            _log.warning("YARP programs will not find the name server: %s", err)
            self.naming.use(place)

    def _name_network(self) -> None:
        """Learn the network's name; give it one where it has none, or forgot it."""
        root = self.naming.contact.name
        told = [str(value) for value in self.naming.get_property(root, IDENTITY)]
        if not told:
            self.naming.set_property(root, IDENTITY, self.identity or uuid.uuid4().hex)
            told = [str(value) for value in self.naming.get_property(root, IDENTITY)]
        self.identity = told[0] if told else f"{self.naming.address.host}:{self.naming.address.port}{root}"

    @property
    def is_own(self) -> bool:
        """Whether the name server is this worker's."""
        return self._server is not None

    def close(self) -> None:
        """End our own name server, if there is one."""
        server, self._server = self._server, None
        if server is not None:
            server.close()


def address_of(section: YarpSection) -> Address | None:
    """What the configuration says of the name server's place, None where yarp.conf is to say it."""
    return None if section.place is None else Address(*section.place)


def _is_here(place: Address) -> bool:
    """Whether a name server at this place would be on this machine."""
    try:
        found = {info[4][0] for info in socket.getaddrinfo(place.host, place.port, type=socket.SOCK_STREAM)}
    except OSError:
        return False
    return all(ipaddress.ip_address(str(ip).partition("%")[0]).is_loopback or _is_own(str(ip)) for ip in found)


def _is_own(ip: str) -> bool:
    family = socket.AF_INET6 if ":" in ip else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((ip, 0))
        except OSError:
            return False
    return True
