"""The router for other machines (``hub.open``), which is separate from the router for this machine's programs.

Its access rules apply to every session that joins through it. Its gossip is disabled, so that this machine's programs
do not discover it: they would connect directly to programs on other machines, and bypass the rules. zenoh reads
certificates only when it opens a session, so `bridge.hub.security.external_access` opens a new session for new files.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import zenoh

from bridge.config.model import Config
from bridge.config.sections.hub import OpenSection
from bridge.config.sections.section import is_loopback
from bridge.hub.errors import HubConfigError, HubError, zenoh_reason
from bridge.hub.links import LinkLimits
from bridge.hub.opening import open_session
from bridge.hub.security.access import ANYBODY, access_control
from bridge.hub.security.endpoints import EndpointMonitor, EndpointStatus
from bridge.hub.security.handshake import Identity
from bridge.hub.security.key_files import KeyFiles
from bridge.hub.security.link_restart import LinkRestarts
from bridge.hub.security.zenoh_log import ZenohLog
from bridge.hub.zenoh_config import MAX_PAYLOAD, connect_endpoint, make_config, router_tree
from yarp_compat.file_names import escaped

KEYS = Path("/etc/midspan/keys")
"""Default folder of this machine's certificate, its key and the authority's certificate."""

_TIMEOUT_MS = 3000
"""Time limit for opening a connection, after which zenoh tries again."""


@dataclass(frozen=True, slots=True)
class ConnectedMachine:
    """A connected machine.

    Attributes:
        name: the name in its certificate, "" if it presented none.
        zid: the zenoh session at the other end of the link, of the machine's router or of another program.
        address: its address and port, in zenoh's format.
        trusted: whether its commands are accepted.
    """

    name: str
    zid: str
    address: str
    trusted: bool


class ExternalRouter:
    """The router to which other machines connect, and which connects to other machines.

    Raises:
        HubError: it cannot be opened; the text is a plain reason.
    """

    def __init__(self, config: Config, zenoh_log: ZenohLog | None = None) -> None:
        self._open = config.hub.open
        self._here = connect_endpoint(config.hub.listen)
        zenoh_config = make_config(external_tree(config), self._open.zenoh)
        identity = Identity.of(zenoh_config)
        files = key_files(config) if has_tls(self._open) else None
        try:
            self._session = open_session(zenoh_config)
        except zenoh.ZError as err:
            places = ", ".join((*self._open.listen, *self._open.connect))
            bad_file = files.trouble() if files is not None else ""  # zenoh's reason does not name it
            raise HubError(f"cannot open {places}: {bad_file or zenoh_reason(err)}") from None
        self._restarts = LinkRestarts(self._session)
        self._limits = LinkLimits(self._restarts.check)
        self._endpoints = EndpointMonitor(
            self._session,
            self._open.listen,
            self._open.connect,
            identity,
            zenoh_log,
            (lambda: _trouble(files)) if files is not None else None,
        )

    @property
    def zid(self) -> str:
        """Zenoh id of the session."""
        return str(self._session.zid())

    def machines(self) -> list[ConnectedMachine]:
        """Return the connected machines."""
        links = self._session.info.links()
        identities = {(str(link.auth_identifier or ""), str(link.zid), str(link.dst)) for link in links}
        return [
            ConnectedMachine(name, zid, address, ANYBODY in self._open.trusted or name in self._open.trusted)
            for name, zid, address in sorted(identities)
            if address != self._here
        ]

    @property
    def trouble(self) -> str:
        """Why the links to other machines cannot be checked, or ""."""
        return self._limits.trouble

    def endpoints(self) -> list[EndpointStatus]:
        """Return the state of each endpoint of ``hub.open``."""
        return self._endpoints.statuses()

    def refused(self) -> int:
        """Return the number of connections that were refused because of a certificate."""
        return self._endpoints.refused()

    def close(self) -> None:
        """Close all connections to other machines."""
        self._endpoints.close()
        self._limits.close()
        self._restarts.close()
        self._session.close()  # type: ignore[no-untyped-call]


def key_files(config: Config) -> KeyFiles:
    """Return the files of this machine's identity."""
    section, folder = config.hub.open, config.hub.open.keys or KEYS
    return KeyFiles(
        section.ca or folder / "ca.pem",
        section.certificate or folder / escaped(f"{config.name}.pem"),
        section.key or folder / escaped(f"{config.name}.key"),
    )


def _trouble(files: KeyFiles) -> str:
    from bridge.hub.security.certificates import early, trouble  # imports a library that only TLS needs

    return trouble(files) or early(files)


def has_tls(section: OpenSection) -> bool:
    """Return whether any endpoint of ``hub.open`` uses TLS."""
    return any(place.startswith(("tls/", "quic/")) for place in (*section.listen, *section.connect))


def external_tree(config: Config) -> dict[str, Any]:
    """Return the zenoh configuration for ``hub.open``; raises `HubConfigError` if a file is missing."""
    section = config.hub.open
    tree = router_tree(section.listen, max_payload=MAX_PAYLOAD)
    tree["connect"] = {
        "endpoints": [connect_endpoint(config.hub.listen), *section.connect],
        "timeout_ms": -1,
        "exit_on_failure": False,
        "retry": {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    # programs on different machines must connect only through their routers
    tree["scouting"]["gossip"] = {"enabled": False}
    tree["transport"]["unicast"] = {"open_timeout": _TIMEOUT_MS, "accept_timeout": _TIMEOUT_MS}
    if has_tls(section):
        files = key_files(config)
        files.check()
        tree["transport"]["link"]["tls"] = {
            "root_ca_certificate": str(files.ca),
            "listen_certificate": str(files.certificate),
            "listen_private_key": str(files.key),
            "connect_certificate": str(files.certificate),
            "connect_private_key": str(files.key),
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    tree["access_control"] = access_control(section, config.rules, _loopback_interfaces())
    return tree


def check_closed(config: zenoh.Config) -> None:
    """Raise `HubConfigError` if a router's final configuration listens for or connects to other machines."""
    for part in ("listen", "connect"):
        value = json.loads(config.get_json(f"{part}/endpoints"))  # a list, or a list for each mode
        lists = value.values() if isinstance(value, dict) else [value]
        for place in (str(place) for places in lists for place in places or ()):
            if not is_loopback(place):
                raise HubConfigError(f"{part}/endpoints has {place}: other machines join only by hub.open")


def _loopback_interfaces() -> list[str]:
    return [
        name
        for name, addresses in psutil.net_if_addrs().items()
        if any(address.address in ("127.0.0.1", "::1") for address in addresses)
    ]
