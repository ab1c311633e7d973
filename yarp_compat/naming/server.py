"""A name server that replaces yarpserver.

It is a port like any other (``/root``): commands in lines from name clients, Bottles over any carrier, and requests
from browsers all reach the same registry. It saves ports, properties and persistent connections in a file, so that a
restart has no effect on running programs, and removes ports whose address refuses connections.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import json
import logging
import selectors
import socket
import threading
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

from yarp_compat.naming.config import DEFAULT_NAMESPACE, DEFAULT_PORT, Address, replace_file
from yarp_compat.naming.connections import Connector
from yarp_compat.naming.registry import OLD, Command, PortRegistry, lines
from yarp_compat.overriding import override
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError, SilentNaming
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.sockets import Openable, host_checked
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text

AT_ONCE = 200  # ports probed at the same time
_UNDER_WAY = (0, errno.EINPROGRESS, errno.EWOULDBLOCK, getattr(errno, "WSAEWOULDBLOCK", 0))
_REFUSED = (errno.ECONNREFUSED, getattr(errno, "WSAECONNREFUSED", errno.ECONNREFUSED))


def refused(contacts: Iterable[PortContact], seconds: float) -> set[str]:
    """Return the names of ports whose address refuses a connection within ``seconds``; silent ports may be alive."""
    dead: set[str] = set()
    todo = [c for c in contacts if _is_address(c.host)]
    end = time.monotonic() + seconds
    while todo:  # the deadline is checked last, because this process may have been suspended until then
        batch, todo = todo[:AT_ONCE], todo[AT_ONCE:]
        dead |= _refused(batch, end)
        if time.monotonic() >= end:
            break
    return dead


def _refused(batch: list[PortContact], end: float) -> set[str]:
    dead: set[str] = set()
    with selectors.DefaultSelector() as selector:
        for contact in batch:
            _begin(contact, selector, dead)
        try:
            while selector.get_map() and (ready := selector.select(max(0.0, end - time.monotonic()))):
                for key, _ in ready:
                    probe = key.fileobj
                    assert isinstance(probe, socket.socket)
                    if probe.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) in _REFUSED:
                        dead.add(key.data)
                    selector.unregister(probe)
                    probe.close()
        finally:
            for key in list(selector.get_map().values()):
                assert isinstance(key.fileobj, socket.socket)
                key.fileobj.close()
    return dead


def _begin(contact: PortContact, selector: selectors.BaseSelector, dead: set[str]) -> None:
    try:
        probe = socket.socket(socket.AF_INET6 if ":" in contact.host else socket.AF_INET, socket.SOCK_STREAM)
    except OSError:
        return  # no descriptors are left, which says nothing about the port
    probe.setblocking(False)
    host = "127.0.0.1" if contact.host == "localhost" else contact.host
    try:
        with host_checked(host):
            result = probe.connect_ex((host, contact.port))
    except OSError:
        result = errno.EINVAL
    if result in _UNDER_WAY:
        selector.register(probe, selectors.EVENT_WRITE, contact.name)
        return
    if result in _REFUSED:
        dead.add(contact.name)
    probe.close()


def _is_address(host: str) -> bool:
    try:
        return host == "localhost" or bool(ipaddress.ip_address(host.partition("%")[0]))
    except ValueError:
        return False


_log = logging.getLogger("yarp.names")

LIMIT = 64 * 1024  # bytes of the longest accepted command
GC_SECONDS = 60.0
YOUNG = 5.0  # seconds after a port's registration without probes: ports register before they listen
PROBE_SECONDS = 1.0  # seconds to probe all ports; a slower port does not count as dead


class NameServer(Openable):
    """A name server; a context manager.

    Attributes:
        address: the address that it listens on.
        contact: its own port.
        registry: the registered ports.
        changes: the number of changes of ports, properties or persistent connections since it was opened.
        port: the port that receives requests and publishes changes.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",  # the address that the server listens on and registers
        port: int = DEFAULT_PORT,  # its TCP port number; it assigns numbers to ports from ``port + 2`` on
        *,
        namespace: str = DEFAULT_NAMESPACE,  # the name of the server's port, which is the network's name
        # the file that stores the state; None: after a restart, ports must register again
        state: Path | None = None,
        gc_seconds: float = GC_SECONDS,  # the period of probes for dead ports; 0: only on the command ``gc``
        profile: Profile = Profile.YARP3,  # the dialect for clients that have not sent any Bottle
    ) -> None:
        self.address = Address(host, port)
        self.contact = self.address.contact(namespace)
        self.registry = PortRegistry(self.contact)
        self._state = state
        self._gc_seconds = gc_seconds
        self._profile = profile
        self._lock = threading.Lock()
        self._suspects: dict[str, float] = {}  # when they were registered
        self._wake = threading.Event()
        self._dirty = False
        self.changes = 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._naming = _OwnNaming(self)
        self._connector = Connector(self._naming)
        self.port = PortCore(
            namespace,
            on_message=self._bottle,
            on_line=self._line,
            naming=self._naming,
            host=host,
            number=port,
            limit=LIMIT,
            profile=profile,
        )

    @override
    def open(self) -> Self:
        """Load the saved state and serve; raises `NamingError` if the address is not available."""
        self._load()
        try:
            self.port.open()
        except OSError as err:
            a = self.address
            raise NamingError(
                f"cannot open a name server at {a.host} port {a.port}: {err.strerror or err}."
                " Another one may be running there: check with 'midspan yarp where'"
            ) from None
        self._thread = threading.Thread(target=self._run, name="yarp name server", daemon=True)
        self._thread.start()
        with self._lock:
            wanted = self.registry.wanted()
        for connection in wanted:
            self._connector.request(connection)
        return self

    @override
    def close(self) -> None:
        """Stop serving; open ports and their connections persist, and the state stays in the file."""
        self._connector.close()
        self.port.close()
        self._stop.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def apply(self, words: Sequence[Any], remote: str) -> Command:
        """Execute a command with its effects."""
        if _is_collection(words):
            self.collect(patience=1)
        with self._lock:
            answer = self.registry.apply(words, remote)
            self._count(answer)
            self._publish(answer)
        self._follow(answer)
        return answer

    def collect(self, patience: int = 2) -> list[str]:
        """Remove ports that refused connections in the last ``patience`` probes, 1 or 2; return their names."""
        with self._lock:
            probed = {
                e.contact: e.since
                for e in self.registry.entries()
                if e.contact.carrier not in ("mcast", "topic")
                and e.contact != self.contact
                and self.registry.age(e) > YOUNG
            }
        refusing = refused(probed, PROBE_SECONDS)
        with self._lock:
            # a port that was registered during a probe, or between two, may belong to the dead port's next program
            entries = [e for e in self.registry.entries() if probed.get(e.contact) == e.since]
            dead = {e.contact.name: e.since for e in entries if e.contact.name in refusing}
            removed = sorted(n for n, since in dead.items() if patience == 1 or self._suspects.get(n) == since)
            self._suspects = {name: since for name, since in dead.items() if name not in removed}
            answer = self.registry.remove(removed)
            self._count(answer)
            self._publish(answer)
        if removed:
            _log.info("removed ports that refuse connections: %s", ", ".join(removed[:20]))
            self._follow(answer)
        return removed

    def _publish(self, answer: Command) -> None:
        """Publish changes. The caller holds the lock, so that they keep their order; writing never blocks."""
        for event in answer.events:
            self.port.write(encode(event, self._profile), strict=True)

    def _follow(self, answer: Command) -> None:
        for connection in answer.connections:
            self._connector.request(connection)
        if answer.changed:
            self._dirty = True
            self._wake.set()

    def _count(self, answer: Command) -> None:
        """Count a change. The caller holds the lock, so that a reader of the count also sees the change."""
        self.changes += answer.changed

    def _line(self, line: str, address: tuple[str, int], *, wait: bool) -> bytes | None:
        """Execute a command in a line; return the reply's bytes, or None if that takes time and may not ``wait``."""
        try:
            command = from_text(line)
        except WireError as err:
            _log.info("invalid command from %s: %s", address[0], err)
            command = []
        if not wait and (_is_collection(command) or self._lock.locked()):
            return None
        values = self.apply(command, address[0]).values
        return _encode_lines(values) if values[:1] == [OLD] else _encoded(to_text(values) + "\r\n")

    def _bottle(self, message: PortMessage) -> None:
        """Execute a command in a Bottle, over any carrier."""
        try:
            command = decode(message.payload, message.peer.profile)
        except WireError as err:
            _log.info("invalid command from %s: %s", message.peer.route.source, err)
            command = []
        values = self.apply(command, message.peer.address[0]).values
        if values[:1] == [OLD]:
            message.reply(_encode_lines(values), plain=True)
        else:
            message.reply(encode(values, message.peer.profile or self._profile))

    def _load(self) -> None:
        if self._state is None:
            return
        try:
            data = self._state.read_bytes()
        except FileNotFoundError:
            return
        except OSError as err:
            _log.warning("cannot read %s (%s): the name server starts empty", self._state, err.strerror)
            return
        try:
            loads(self.registry, data)
        except ValueError as err:
            invalid = self._state.with_suffix(self._state.suffix + ".spoilt")
            with contextlib.suppress(OSError):
                self._state.replace(invalid)
            _log.warning("%s: %s; renamed to %s, and the name server starts empty", self._state, err, invalid.name)
            self.registry = PortRegistry(self.contact)

    def _save(self) -> None:
        if self._state is None:
            return
        with self._lock:
            data = dumps(self.registry)
        try:
            self._state.parent.mkdir(parents=True, exist_ok=True)
            replace_file(self._state, data)
        except OSError as err:
            _log.warning("cannot write %s (%s): ports will be missing after a restart", self._state, err.strerror)

    def _run(self) -> None:
        """Save changes, spending at most a tenth of the time on it, and probe for dead ports periodically."""
        probed_at = time.monotonic()
        while not self._stop.is_set() or self._dirty:
            left = probed_at + self._gc_seconds - time.monotonic() if self._gc_seconds else threading.TIMEOUT_MAX
            self._wake.wait(max(0.0, left))
            self._wake.clear()
            if self._dirty:
                self._dirty = False
                began = time.monotonic()
                self._save()
                self._stop.wait(9 * (time.monotonic() - began))
            if self._gc_seconds and not self._stop.is_set() and time.monotonic() - probed_at >= self._gc_seconds:
                self.collect()
                probed_at = time.monotonic()


class _OwnNaming(SilentNaming):
    """The naming of the name server's own port, which uses the registry directly."""

    def __init__(self, server: NameServer) -> None:
        self._server = server

    @override
    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        return self._server.contact

    @override
    def query(self, name: str) -> PortContact | None:
        return self._server.registry.find(name)


def _is_collection(words: Sequence[Any]) -> bool:
    return bool(words) and words[-1] == "gc" and len(words) < 3


def _encode_lines(values: Sequence[Any]) -> bytes:
    return _encoded("".join(f"{line}\r\n" for line in lines(values)))


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def dumps(registry: PortRegistry) -> bytes:
    """Return the content of a registry's state file."""
    return json.dumps({"version": 1, **registry.state()}, indent=1).encode()


def loads(registry: PortRegistry, data: bytes) -> None:
    """Restore a registry from the output of `dumps`; raises `ValueError` if it is invalid."""
    try:
        state = json.loads(data)
        if state["version"] != 1:
            raise ValueError(f"the version is {state['version']!r}, not 1")
        registry.restore(state)
    except (AttributeError, KeyError, OverflowError, TypeError, RecursionError) as err:
        raise ValueError(f"not the state of a name server ({type(err).__name__}: {err})") from None
