"""A client of the YARP name server (Midspan's or yarpserver): one TCP connection per command, as YARP's programs do.

The bytes are those of YARP 3.12.3 (`NameClient.cpp`, `NameserCarrier.cpp`, and captures): ``NAME_SERVER query /p``
without quotes. A command ends with LF if the client reads the whole answer, and with CR LF if it reads only the first
line, as it does for an answer that is a Bottle.
"""

from __future__ import annotations

import logging
import math
import os
import random
import socket
import threading
import time
import weakref
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

from yarp_compat.naming import config
from yarp_compat.naming.allocation import numbers_outside
from yarp_compat.naming.config import Address
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import NameRefusedError, NamingError, NoNameServerError
from yarp_compat.ports.sockets import host_checked
from yarp_compat.ports.text_client import LineSocket
from yarp_compat.wire.carriers import CARRIERS
from yarp_compat.wire.contact import PortContact, is_name
from yarp_compat.wire.text import from_text, plain_text, value_text

Lines = list[str]
Words = list[Any]  # aliases, because a method below is named `list`

TIMEOUT = 5.0
MAX_ANSWER = 32 << 20  # bytes of the largest accepted answer: a list of ten thousand ports is 1 MB
PERIOD = 2.0  # seconds between checks of the registered ports, plus or minus a quarter
AT_ONCE = 5  # ports queried per check while all of them are registered
_log = logging.getLogger("yarp.names")


class NameClient:
    """A client of one name server.

    Every method raises NoNameServerError if the server does not answer, and NamingConfigError if yarp.conf is invalid.
    """

    def __init__(
        self,
        address: Address | None = None,  # None: read from yarp.conf, and read again after each failed connection
        *,
        namespace: str | None = None,  # the network's name; None: from the environment or from yarp_namespace.conf
        timeout: float = TIMEOUT,  # seconds per command
        # TCP port numbers for the ports that this client registers; None: derived from the name server's port number
        numbers: range | None = None,
    ) -> None:
        self._numbers = numbers
        self._configured_address = address
        self._namespace = namespace
        self._last_address: Address | None = None
        self._timeout = timeout
        self._registered: dict[str, _Registered] = {}
        self._taken_over: set[str] = set()  # names that another port has registered since
        self._pending: weakref.WeakSet[LineSocket] = weakref.WeakSet()
        self._pending_lock = threading.Lock()
        self._end = math.inf  # when every command has to end

    @property
    def address(self) -> Address:
        """The server's address; raises `NoNameServerError` if no file has it, `NamingConfigError` if one is invalid."""
        address = self._configured_address or self._last_address or config.read(self._namespace)
        if address is None:
            raise NoNameServerError(
                f"no address of YARP's name server: {config.file(self._namespace)} should hold a line such as"
                " '127.0.0.1 10000 yarp'; 'yarp detect --write' or 'midspan yarp server --write' writes it"
            )
        self._last_address = address
        return address

    @property
    def numbers(self) -> range:
        """The range of TCP port numbers for ports; see `Naming.numbers`."""
        return numbers_outside(self.address.port) if self._numbers is None else self._numbers

    @property
    def contact(self) -> PortContact:
        """The contact of the name server itself."""
        return self.address.contact(self._namespace or config.namespace())

    def use(self, address: Address) -> None:
        """Use the name server at this address from now on, instead of the one in yarp.conf."""
        self._configured_address = address

    def hurry(self, seconds: float) -> None:
        """End all commands, pending and later ones, within ``seconds`` of now."""
        with self._pending_lock:
            self._timeout, self._end = seconds, time.monotonic() + seconds
            pending = list(self._pending)
        for peer in pending:
            peer.hurry(seconds)

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        """Register a port with the properties that a C++ port announces; see `Naming.register`."""
        wanted = "..." if name in ("", "...") else name
        if not is_name(wanted):
            raise NameRefusedError(
                f"{name!r} is not a valid port name: YARP's names are like /robot/camera, without spaces or commas"
            )
        host = host or ("" if carrier == "mcast" else self._own_host())  # the name server chooses a group's address
        command: list[Any] = ["register", wanted]
        if host or port or carrier:
            command += [carrier or "tcp", host or "...", port or "..."]
        contact = self._register(command)
        self._registered[contact.name] = _Registered(contact)
        return contact

    def _register(self, command: Sequence[Any]) -> PortContact:
        contact = PortContact.from_registration(self.line(command))
        if contact is None:
            raise NameRefusedError(
                f"the name server at {self._endpoint()} refused {command[1]}: it may be full, or have this name itself"
            )
        for key, values in self._own_properties().items():
            self.line(["set", contact.name, key, *values])
        return contact

    def restore(self, name: str) -> None:
        """Register an open port and its properties again, after the name server has lost them."""
        current = restored = self._registered.get(name)
        while current is not None:
            contact = current.contact
            self._register(["register", name, contact.carrier, contact.host, contact.port])
            for key, values in list(current.properties.items()):
                self._set(name, key, values)
            if current.announced:  # otherwise it does not listen yet, and announces itself later
                self.lines(["announce", name])
            restored, current = current, self._registered.get(name)
            if current is restored:
                return
        if restored is not None:
            self.lines(["unregister", name])  # the port has been closed since

    def unregister(self, name: str) -> None:
        """Remove a port's registration; see `Naming.unregister`."""
        KEEPER.remove(self, name)
        self._registered.pop(name, None)
        if name in self._taken_over:
            self._taken_over.discard(name)
            return
        self.lines(["unregister", name])

    def is_taken(self, name: str) -> bool:
        """Whether another port has taken over a name that this client registered."""
        registered, current = self._registered.get(name), self.query(name)
        if registered is None or current is None:
            return False
        return (current.host, current.port) != (registered.contact.host, registered.contact.port)

    def leave(self, name: str) -> None:
        """Make `unregister` keep the registration, because another port has taken over the name."""
        self._taken_over.add(name)

    def query(self, name: str) -> PortContact | None:
        """Return the address of a port; see `Naming.query`. A contact such as ``tcp://host:10002/`` is only parsed."""
        contact = PortContact.parse(name)
        if contact.is_valid:
            return contact
        if not is_name(contact.name):
            return None
        if contact.name == (self._namespace or config.namespace()):
            return self.contact
        answer = self.lines(["query", contact.name])
        return PortContact.from_registration(answer[0]) if answer else None

    def list(self, prefix: str = "") -> list[PortContact]:
        """Return all registered ports, or only those at and below a prefix."""
        lines = self.lines(["list", prefix] if prefix else ["list"])
        contacts = [PortContact.from_registration(line) for line in lines]
        return [contact for contact in contacts if contact is not None]

    def set_property(self, name: str, key: str, *values: Any) -> None:
        """Set a property of a port; see `Naming.set_property`."""
        registered = self._registered.get(name)
        if registered is not None:
            registered.properties[key] = values
        self._set(name, key, values)

    def _set(self, name: str, key: str, values: Sequence[Any]) -> None:
        command = ["set", name, key, *values]
        if any(_is_quoted(v) for v in values):
            text_client.ask(self.contact, command, timeout=self._timeout)  # this carrier preserves quotes
        else:
            self.line(command)

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        """Return the values of a port's property; see `Naming.get_property`."""
        return from_text(self.line(["bot", "get", name, key]))

    def announce(self, name: str, alive: bool = True) -> None:
        """Announce that a port listens, or no longer does; see `Naming.announce`.

        From then on, `KEEPER` keeps the port registered if this client registered it.
        """
        registered = self._registered.get(name) if alive else None
        if registered is not None:
            registered.announced = True
        self.lines(["announce", name] if alive else ["announce", name, 0])
        if registered is not None:
            KEEPER.keep(self, registered.contact)
            if name not in self._registered:  # meanwhile, the port has been closed
                KEEPER.remove(self, name)

    def lines(self, command: Sequence[Any]) -> Lines:
        """Send a command and return the answer's lines without the end mark; a Bottle such as ``[ok]`` is one line."""
        answer: Lines = []
        with self._ask(_text(command) + b"\n") as peer:
            # a Bottle has no end mark, so `_is_single` lists the commands that return a Bottle
            single = self._is_single(command)
            while True:
                line = peer.line()
                if line.startswith("*"):
                    return answer
                answer.append(line)
                if single or line.startswith("["):
                    return answer

    def line(self, command: Sequence[Any]) -> str:
        """Send a command and return the first line of the answer; "" if the answer is only the end mark."""
        with self._ask(_text(command) + b"\r\n") as peer:
            line = peer.line()
            return "" if line.startswith("*") else line

    def command(self, words: Sequence[Any]) -> Words:
        """Send a command that returns a Bottle: ``["bot", "list"]``, ``["subscribe", "/a", "/b"]``."""
        return from_text(self.line(words))

    @staticmethod
    def _is_single(command: Sequence[Any]) -> bool:
        return bool(command) and command[0] in ("bot", "subscribe", "unsubscribe", "topic", "untopic", "type")

    def _ask(self, data: bytes) -> LineSocket:
        address = self.address
        with self._pending_lock:  # so that `hurry` either finds this command or has already shortened its timeout
            left = self._end - time.monotonic()
            peer = LineSocket(address.host, address.port, min(self._timeout, left), limit=MAX_ANSWER)
            self._pending.add(peer)
        try:
            if left <= 0:
                raise TimeoutError
            peer.open()
            peer.send(data)
        except OSError as err:
            unreachable = self._unreachable(err)
            self._last_address = None  # yarp.conf may have changed
            peer.close()
            raise unreachable from None
        peer.on_error(self._unreachable)
        return peer

    def _unreachable(self, err: OSError) -> NamingError:
        reason = f"no reply within {self._timeout:g} s" if isinstance(err, TimeoutError) else err.strerror or str(err)
        msg = (
            f"YARP's name server does not answer at {self._endpoint()}: {reason}."
            " Start it ('yarpserver' or 'midspan yarp server'), or correct the address in yarp.conf."
        )
        return NoNameServerError(msg)

    def _endpoint(self) -> str:
        address = self._last_address or self._configured_address
        return f"{address.host} port {address.port}" if address else "its address"

    def _own_host(self) -> str:
        """Return this machine's address that starts with ``YARP_IP``, else ``YARP_IP`` itself; "" if it is not set."""
        prefix = os.environ.get("YARP_IP", "")
        return next((ip for ip in self._own_addresses() if ip.startswith(prefix)), prefix) if prefix else ""

    def _own_addresses(self) -> Lines:
        """Return the loopback address and this machine's address on the name server's network."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                address = self.address
                with host_checked(address.host):
                    probe.connect((address.host, address.port))  # sends no packet
                local = str(probe.getsockname()[0])
            except OSError:
                return ["127.0.0.1"]
        return sorted({"127.0.0.1", local})

    def _own_properties(self) -> dict[str, Words]:
        """Return the properties that every C++ port sets."""
        carriers = list(CARRIERS)
        return {"offers": carriers, "accepts": carriers, "ips": self._own_addresses(), "process": [os.getpid()]}


@dataclass(slots=True)
class _Registered:
    """A port that this client registered, with its properties."""

    contact: PortContact
    properties: dict[str, Sequence[Any]] = field(default_factory=dict)
    announced: bool = False


def _is_quoted(value: Any) -> bool:
    """Whether a value would parse differently without its quotes and escapes, which `_text` omits."""
    text = value_text(value)
    plain = plain_text(value) if isinstance(value, str) else text
    return '"' in text and from_text(plain.replace('"', "")) != [value]


def _text(command: Sequence[Any]) -> bytes:
    """Encode a command without quotes, because old name servers do not parse them."""
    parts = [plain_text(w) if isinstance(w, str) else value_text(w) for w in command]
    text = " ".join(["NAME_SERVER", *parts]).replace('"', "")
    if "\n" in text or "\r" in text:
        raise NamingError("a name server command is one line: names and properties cannot contain line breaks")
    return text.encode("utf-8", "surrogateescape")


_OpenPort = tuple[NameClient, PortContact]  # a port and the client that registered it


class Keeper:
    """Keeps ports registered: registers them again after a name server has restarted without its registrations.

    YARP's own ports do not register again. One thread per process queries a few ports at each name server in turn, and
    all of them if one is missing or the name server was unreachable. The thread ends after the last port is removed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ports: dict[NameClient, dict[str, PortContact]] = {}
        self._unreachable: set[Hashable] = set()
        self._taken_over: set[tuple[NameClient, str]] = set()
        self._round = 0
        self._wake = threading.Event()
        self._thread: threading.Thread | None = None

    def keep(self, names: NameClient, contact: PortContact) -> None:
        """Keep an open port registered."""
        with self._lock:
            self._ports.setdefault(names, {})[contact.name] = contact
            if self._thread is None:
                self._wake.clear()
                self._thread = threading.Thread(target=self._run, name="yarp names", daemon=True)
                self._thread.start()

    def remove(self, names: NameClient, name: str) -> None:
        """Stop keeping a port registered; after the last port, wait for the thread to end."""
        with self._lock:
            ports = self._ports.get(names, {})
            ports.pop(name, None)
            self._taken_over.discard((names, name))
            if not ports:
                self._ports.pop(names, None)
            thread = None if self._ports else self._thread
            if thread is not None:
                self._thread = None
                self._wake.set()
        if thread is not None and thread is not threading.current_thread():
            thread.join(1.0)  # it may end later if a name server does not reply

    def _run(self) -> None:
        this_thread = threading.current_thread()
        while not self._wake.wait(PERIOD * random.uniform(0.75, 1.25)):  # noqa: S311 - not a secret
            with self._lock:
                if self._thread is not this_thread:
                    return
                open_ports = [(names, contact) for names, ports in self._ports.items() for contact in ports.values()]
            self.check(open_ports)

    def check(self, open_ports: list[_OpenPort]) -> None:
        """Query a few ports at each name server, not a few per client, because each query is a connection."""
        self._round += 1
        servers: dict[Hashable, list[_OpenPort]] = {}
        for names, contact in open_ports:
            servers.setdefault(_server(names), []).append((names, contact))
        self._unreachable &= servers.keys()
        for server, ports in servers.items():
            try:
                self._check_server(server, ports)
            except NamingError as err:
                if server not in self._unreachable:
                    _log.info("%s", err)
                self._unreachable.add(server)
            except Exception:
                _log.exception("cannot keep the ports registered")

    def _check_server(self, server: Hashable, ports: list[_OpenPort]) -> None:
        first = self._round * AT_ONCE % len(ports)
        sample = (ports[first:] + ports[:first])[:AT_ONCE]
        missing = self._missing(sample)
        if missing or server in self._unreachable:
            missing += self._missing([port for port in ports if port not in sample])
        for names, contact in missing:
            names.restore(contact.name)
        if missing or server in self._unreachable:
            _log.info("the name server is reachable again: registered %d of %d ports again", len(missing), len(ports))
        self._unreachable.discard(server)

    def _missing(self, ports: list[_OpenPort]) -> list[_OpenPort]:
        missing = []
        for names, contact in ports:
            current = names.query(contact.name)
            if current is None:
                missing.append((names, contact))
            elif (current.host, current.port) != (contact.host, contact.port):
                if (names, contact.name) not in self._taken_over:
                    _log.warning("the name %s was taken over by a port at %s", contact.name, current.uri)
                self._taken_over.add((names, contact.name))
        return missing


def _server(names: NameClient) -> Hashable:
    """Return a key for the client's name server: its address, or the client itself if the address is unknown."""
    try:
        return names.address
    except NamingError:
        return names


KEEPER = Keeper()  # one per process
