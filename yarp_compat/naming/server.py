"""A name server of our own, which YARP programs use without knowing.

It is a port like any other (``/root``): what name clients say in lines, what anybody sends it as a Bottle over any
carrier, and what a browser asks all reach the same registry. It remembers ports, properties and persistent connections
in a file, so that its restart disturbs nobody, and forgets ports at whose address nobody listens any more.
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
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError, SilentNaming
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.sockets import Openable
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.contact import PortContact
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, to_text

AT_ONCE = 200
_UNDER_WAY = (0, errno.EINPROGRESS, errno.EWOULDBLOCK, getattr(errno, "WSAEWOULDBLOCK", 0))
_REFUSED = (errno.ECONNREFUSED, getattr(errno, "WSAECONNREFUSED", errno.ECONNREFUSED))


def refused(contacts: Iterable[PortContact], seconds: float) -> set[str]:
    """The names of ports whose address refuses connections in so many seconds; no answer says nothing."""
    dead: set[str] = set()
    todo = [c for c in contacts if _is_address(c.host)]
    end = time.monotonic() + seconds
    while todo and time.monotonic() < end:
        batch, todo = todo[:AT_ONCE], todo[AT_ONCE:]
        dead |= _refused(batch, end)
    return dead


def _refused(batch: list[PortContact], end: float) -> set[str]:
    dead: set[str] = set()
    with selectors.DefaultSelector() as waiting:
        for contact in batch:
            _begin(contact, waiting, dead)
        try:
            while waiting.get_map() and (left := end - time.monotonic()) > 0:
                for key, _ in waiting.select(left):
                    probe = key.fileobj
                    assert isinstance(probe, socket.socket)
                    if probe.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) in _REFUSED:
                        dead.add(key.data)
                    waiting.unregister(probe)
                    probe.close()
        finally:
            for key in list(waiting.get_map().values()):
                assert isinstance(key.fileobj, socket.socket)
                key.fileobj.close()
    return dead


def _begin(contact: PortContact, waiting: selectors.BaseSelector, dead: set[str]) -> None:
    try:
        probe = socket.socket(socket.AF_INET6 if ":" in contact.host else socket.AF_INET, socket.SOCK_STREAM)
    except OSError:
        return  # no descriptors are left: no reason to think a port dead
    probe.setblocking(False)
    host = "127.0.0.1" if contact.host == "localhost" else contact.host
    try:
        result = probe.connect_ex((host, contact.port))
    except (OSError, OverflowError):
        result = errno.EINVAL
    if result in _UNDER_WAY:
        waiting.register(probe, selectors.EVENT_WRITE, contact.name)
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

LIMIT = 64 * 1024  # bytes of the longest command that is taken
GC_SECONDS = 60.0
YOUNG = 5.0  # seconds for which a port is not looked for: it is registered before it listens
PROBE_SECONDS = 1.0  # seconds for one look at all ports; a port that takes longer to answer is not dead


class NameServer(Openable):
    """A name server; a context manager.

    Attributes:
        address: where it listens.
        contact: its own port.
        registry: what is registered.
        changes: how often its ports, their properties or wished connections changed since it was opened.
        port: at which it is asked, and which tells of what happens.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",  # the address at which it listens, and that it tells others
        port: int = DEFAULT_PORT,  # its TCP port number; ports get numbers from two above it
        *,
        namespace: str = DEFAULT_NAMESPACE,  # its port's name, which is the network's name
        # the file in which it remembers; None: a restart knows nothing, and ports must register again
        state: Path | None = None,
        gc_seconds: float = GC_SECONDS,  # how often it looks for dead ports; 0: only on the command ``gc``
        profile: Profile = Profile.YARP3,  # how it writes Bottles to those who did not send any
    ) -> None:
        self.address = Address(host, port)
        self.contact = self.address.contact(namespace)
        self.registry = PortRegistry(self.contact)
        self._state = state
        self._gc_seconds = gc_seconds
        self._profile = profile
        self._lock = threading.Lock()
        self._suspects: set[str] = set()
        self._wake = threading.Event()
        self._dirty = False
        self.changes = 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._naming = _Own(self)
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

    def open(self) -> Self:
        """Remember what the last one knew, and serve; raises `NamingError` where it cannot listen at its address."""
        self._recall()
        try:
            self.port.open()
        except OSError as err:
            a = self.address
            raise NamingError(
                f"no name server can be opened at {a.host} port {a.port}: {err.strerror or err}."
                " Is another one running there? ('midspan yarp where' asks it)"
            ) from None
        self._thread = threading.Thread(target=self._keep_house, name="yarp name server", daemon=True)
        self._thread.start()
        for wish in self.registry.wanted():
            self._connector.want(wish)
        return self

    def close(self) -> None:
        """Serve no more; ports and their connections are not touched, and what is known stays in the file."""
        self._connector.close()
        self.port.close()
        self._stop.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def apply(self, words: Sequence[Any], remote: str) -> Command:
        """Answer one command and do what follows from it."""
        if words and words[-1] == "gc" and len(words) < 3:
            self.collect(patience=1)
        with self._lock:
            answer = self.registry.apply(words, remote)
            self._count(answer)
            self._tell(answer)
        self._follow(answer)
        return answer

    def collect(self, patience: int = 2) -> list[str]:
        """Forget ports at whose address nobody listens (``patience`` 2: the last time too); returns their names."""
        with self._lock:
            entries = [
                e.contact
                for e in self.registry.entries()
                if e.contact.carrier not in ("mcast", "topic")
                and e.contact != self.contact
                and self.registry.age(e) > YOUNG
            ]
        dead = refused(entries, PROBE_SECONDS)
        gone = sorted(dead if patience == 1 else dead & self._suspects)
        self._suspects = dead - set(gone)
        if gone:
            _log.info("nobody listens any more at the ports %s: forgotten", ", ".join(gone[:20]))
            with self._lock:
                answer = self.registry.remove(gone)
                self._count(answer)
                self._tell(answer)
            self._follow(answer)
        return gone

    def _tell(self, answer: Command) -> None:
        """Tell listeners what changed; with the lock held, as that waits for nobody, so that all hear it in order."""
        for event in answer.events:
            self.port.write(encode(event, self._profile), strict=True)

    def _follow(self, answer: Command) -> None:
        for wish in answer.wishes:
            self._connector.want(wish)
        if answer.changed:
            self._dirty = True
            self._wake.set()

    def _count(self, answer: Command) -> None:
        """Count what changed; with the lock held, so that who saw a number has not seen less than it stands for."""
        self.changes += answer.changed

    def _line(self, line: str, address: tuple[str, int]) -> bytes:
        """A command of a name client, as a line; the answer's bytes."""
        try:
            words = from_text(line)
        except WireError as err:
            _log.info("a command of %s cannot be read: %s", address[0], err)
            words = []
        values = self.apply(words, address[0]).values
        return _in_lines(values) if values[:1] == [OLD] else _encoded(to_text(values) + "\r\n")

    def _bottle(self, message: PortMessage) -> None:
        """A command as a Bottle, over any carrier."""
        try:
            words = decode(message.payload, message.peer.profile)
        except WireError as err:
            _log.info("a command of %s cannot be read: %s", message.peer.route.source, err)
            words = []
        values = self.apply(words, message.peer.address[0]).values
        if values[:1] == [OLD]:
            message.reply(_in_lines(values), plain=True)
        else:
            message.reply(encode(values, message.peer.profile or self._profile))

    def _recall(self) -> None:
        if self._state is None:
            return
        try:
            data = self._state.read_bytes()
        except FileNotFoundError:
            return
        except OSError as err:
            _log.warning("%s cannot be read (%s): the name server begins empty", self._state, err.strerror)
            return
        try:
            loads(self.registry, data)
        except ValueError as err:
            spoilt = self._state.with_suffix(self._state.suffix + ".spoilt")
            with contextlib.suppress(OSError):
                self._state.replace(spoilt)
            _log.warning("%s: %s; it is kept as %s, and the name server begins empty", self._state, err, spoilt.name)
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
            _log.warning("%s cannot be written (%s): a restart will not know the ports", self._state, err.strerror)

    def _keep_house(self) -> None:
        """Write down what changes, at most a tenth of the time; look for dead ports now and then."""
        looked = time.monotonic()
        while not self._stop.is_set() or self._dirty:
            left = looked + self._gc_seconds - time.monotonic() if self._gc_seconds else threading.TIMEOUT_MAX
            self._wake.wait(max(0.0, left))
            self._wake.clear()
            if self._dirty:
                self._dirty = False
                began = time.monotonic()
                self._save()
                self._stop.wait(9 * (time.monotonic() - began))
            if self._gc_seconds and not self._stop.is_set() and time.monotonic() - looked >= self._gc_seconds:
                self.collect()
                looked = time.monotonic()


class _Own(SilentNaming):
    """The naming of the name server's own port: it knows everything, and needs no connection for that."""

    def __init__(self, server: NameServer) -> None:
        self._server = server

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:  # noqa: ARG002
        return self._server.contact

    def query(self, name: str) -> PortContact | None:
        return self._server.registry.find(name)


def _in_lines(values: Sequence[Any]) -> bytes:
    return _encoded("".join(f"{line}\r\n" for line in lines(values)))


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def dumps(registry: PortRegistry) -> bytes:
    """A registry's state as a file holds it."""
    return json.dumps({"version": 1, **registry.state()}, indent=1).encode()


def loads(registry: PortRegistry, data: bytes) -> None:
    """Restore a registry from what `dumps` gave; raises `ValueError` where it is something else."""
    try:
        state = json.loads(data)
        if state["version"] != 1:
            raise ValueError(f"it is of version {state['version']!r}, not 1")
        registry.restore(state)
    except (AttributeError, KeyError, OverflowError, TypeError, RecursionError) as err:
        raise ValueError(f"it is not a name server's state ({type(err).__name__}: {err})") from None
