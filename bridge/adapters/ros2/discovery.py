"""Fast DDS discovery servers: those in ``ROS_DISCOVERY_SERVER``, and whether the ROS 2 side reaches them.

Servers are probed with an RTPS header without submessages, which they ignore. If no program receives at the port, the
server's machine reports that by ICMP, which the next use of the socket returns as an error. If a firewall drops such
reports, it is not known whether the server runs.

If a client of Fast DDS (2.14.5) has not noticed the end of its server, it discards what the next server sends as
duplicates, because both servers have the same GUID, and number their messages from 1. A server that ends without
SIGKILL announces its end, and a killed server is forgotten after its lease; the client then connects to the next one.
"""

from __future__ import annotations

import contextlib
import re
import select
import socket
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import NamedTuple

from typing_extensions import override

from bridge.adapters.ros2.graph.neighbors import udp_sockets
from bridge.concurrency import DelayedCalls

SERVERS = "ROS_DISCOVERY_SERVER"
LOCALHOST_CURE = "set ros2.localhost_only: false"
START_CURE = f"start it, or correct {SERVERS} for the daemon and restart the daemon"

RESTARTED = (
    "was restarted after the ROS 2 side: if it was killed, programs from before and after that may not discover each"
    " other"
)
RESTARTED_CURE = "if a program is missing, restart Midspan and the ROS 2 programs that are older than the server"

PERIOD = 2.0
"""Seconds between two probes."""

LEASE = 30.0
"""Seconds after which Fast DDS has forgotten a killed server; its default lease is 20 s."""

_SERVER = re.compile(r"(?:UDPv4:)?\[?(?P<host>[^\[\]:]+)\]?(?::(?P<port>[0-9]{1,5}))?")
_PORT = 11811
_INVALID = (OverflowError, UnicodeError)
"""What the socket module raises for a port above 65535, and for a host name with an empty or too long part."""

_PROBE = b"RTPS\x02\x03\x01\x0f" + bytes(12)


class Server(NamedTuple):
    """A discovery server at a UDP port; ``host`` is a name or an IPv4 address."""

    host: str
    port: int

    @override
    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def servers(environ: Mapping[str, str]) -> list[Server]:
    """Return the servers in ``ROS_DISCOVERY_SERVER``, ``HOST:PORT;HOST;...``, except those on TCP or IPv6."""
    matches = (_SERVER.fullmatch(text.strip()) for text in environ.get(SERVERS, "").split(";"))
    return [Server(match["host"], int(match["port"] or _PORT)) for match in matches if match is not None]


def elsewhere(listed: Iterable[Server]) -> list[Server]:
    """Return the servers that are not on this machine."""
    return [server for server in listed if not _is_here(server.host)]


def _is_here(host: str) -> bool:
    with socket.socket(type=socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError, *_INVALID):
        probe.bind((host, 0))
        return True
    return False


def excluded(listed: Iterable[Server]) -> str:
    """Return why ``localhost_only`` excludes these servers, "" if it excludes none."""
    names = ", ".join(map(str, elsewhere(listed)))
    return (
        f"{SERVERS} names {names}, but ros2.localhost_only keeps the ROS 2 side on this machine: it discovers nothing"
        if names
        else ""
    )


def silent(server: Server) -> str:
    """Return the text about a server that does not run."""
    return f"no discovery server receives at {server} ({SERVERS}): the ROS 2 side discovers nothing through it"


class Probe:
    """Probes one server without blocking.

    Attributes:
        refused: whether the server's machine reports that no program receives at the port.
    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self.refused = False
        self._socket: socket.socket | None = None

    def fails(self, seconds: float = 0.0) -> bool:
        """Send a probe; return whether a failure is reported, of the previous probe or, within ``seconds``, of this."""
        self.refused = False
        failed = self._raises(self._receive)
        failed = self._raises(self._send) or failed
        if seconds and self._socket is not None:
            select.select([self._socket], [], [], seconds)
        return self._raises(self._receive) or failed

    def _raises(self, action: Callable[[], None]) -> bool:
        try:
            action()
        except ConnectionRefusedError:  # the socket remains usable
            self.refused = True
            return True
        except (OSError, *_INVALID):  # such as an unknown name, or a network that is unreachable
            self.close()
            return True
        return False

    def _send(self) -> None:
        if self._socket is None:
            self._socket = socket.socket(type=socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.connect(self._server)
        self._socket.send(_PROBE)

    def _receive(self) -> None:
        with contextlib.suppress(BlockingIOError):
            if self._socket is not None:
                self._socket.recv(1)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def failing(listed: Iterable[Server], seconds: float = 0.3) -> list[Server]:
    """Return the servers that do not run, as far as that is reported within ``seconds``."""
    failed: list[Server] = []
    for server in listed:
        probe = Probe(server)
        if probe.fails(seconds):
            failed.append(server)
        probe.close()
    return failed


def _resolved(server: Server) -> Server:
    """Return a server with its IPv4 address, since a look-up may block; unchanged if its name is unknown."""
    with contextlib.suppress(OSError, *_INVALID):
        return server._replace(host=socket.gethostbyname(server.host))
    return server


def _sockets(server: Server) -> frozenset[str]:
    """Return the inodes of this machine's sockets at a server's port; empty if unknown or on another machine."""
    if not _is_here(server.host):
        return frozenset()
    return frozenset(found.inode for found in udp_sockets() or () if found.port == server.port)


class _Watched:
    """What is known about one server.

    Attributes:
        fails: whether it does not run, as far as that is reported.
    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self._probe: Probe | None = None  # None before the first look-up of its name
        self._sockets: frozenset[str] | None = None  # None before it was seen
        self._refused_since: float | None = None
        self.fails = False

    def has_restarted(self) -> bool:
        """Probe the server; return whether it has been restarted so quickly that Fast DDS has not forgotten it.

        Blocks while a look-up of its name takes.
        """
        if self._probe is None:
            self._server = _resolved(self._server)
            self._probe = Probe(self._server)
        now = time.monotonic()
        self.fails = self._probe.fails()
        if self.fails:
            if self._probe.refused and self._refused_since is None:
                self._refused_since = now
            return False
        before, since = self._sockets, self._refused_since
        self._sockets, self._refused_since = _sockets(self._server), None
        if before is None:
            return False
        return now - since < LEASE if since is not None else self._sockets != before

    def close(self) -> None:
        if self._probe is not None:
            self._probe.close()


class ServerWatch:
    """Probes servers regularly; ``localhost_only`` is whether the participant stays on this machine.

    It has a separate thread, because looking up a name may take half a minute on a robot without its network.
    """

    def __init__(self, listed: Collection[Server], *, localhost_only: bool) -> None:
        self._localhost_only, self._excluded = localhost_only, ""
        self._servers = {server: _Watched(server) for server in listed}
        self._restarted: set[Server] = set()
        self._checking = self._closed = False
        self._checks = DelayedCalls("midspan-ros2-servers")
        if self._servers:
            self._checks.every(PERIOD, self._check, first=0.0)

    def _check(self) -> None:
        self._checking = True
        try:
            self._probe_all()
        finally:
            self._checking = False
            if self._closed:  # `close` has not waited for this check
                self._close_sockets()

    def _probe_all(self) -> None:
        if self._localhost_only and not self._excluded:
            self._excluded = excluded(self._servers)
        for server, watched in self._servers.items():
            if watched.has_restarted():
                self._restarted.add(server)

    @property
    def texts(self) -> list[str]:
        """Warnings about servers that are excluded, do not run, or have been restarted."""
        texts = [f"{self._excluded}; {LOCALHOST_CURE}"] if self._excluded else []
        texts += (f"{silent(server)}; {START_CURE}" for server, watched in self._servers.items() if watched.fails)
        restarted = tuple(self._restarted)
        return texts + [f"the discovery server at {server} {RESTARTED}; {RESTARTED_CURE}" for server in restarted]

    def close(self) -> None:
        """End the checks and close the sockets; a check that waits for a look-up closes them when it ends."""
        self._closed = True
        self._checks.close(1.0)
        if not self._checking:
            self._close_sockets()

    def _close_sockets(self) -> None:
        for watched in self._servers.values():
            watched.close()
