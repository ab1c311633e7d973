"""A client of YARP's name server, ours or yarpserver: one TCP connection per command, as YARP's own programs do.

The bytes are those of YARP 3.12.3 (`NameClient.cpp`, `NameserCarrier.cpp`, and captures): ``NAME_SERVER query /p``,
quotes left out, ended by LF where an answer of lines is expected and CR LF where one line, a Bottle, is.
"""

from __future__ import annotations

import logging
import os
import random
import socket
import threading
import weakref
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

from yarp_compat.naming import config
from yarp_compat.naming.allocation import beside
from yarp_compat.naming.config import Address
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import NameRefusedError, NamingError, NoNameServerError
from yarp_compat.ports.text_client import LineSocket
from yarp_compat.wire.carriers import CARRIERS
from yarp_compat.wire.contact import PortContact, is_name
from yarp_compat.wire.text import from_text, plain_text, value_text

Lines = list[str]
Words = list[Any]  # under other names than that of the method below

TIMEOUT = 5.0
MAX_ANSWER = 32 << 20  # bytes of the largest answer that is taken: a list of ten thousand ports is 1 MB
PERIOD = 2.0  # seconds between looks, give or take a quarter
AT_ONCE = 5  # ports asked for at a look, as long as nothing is amiss
_log = logging.getLogger("yarp.names")


class NameClient:
    """Asks a name server.

    Every method raises NoNameServerError where nobody answers, and NamingConfigError where yarp.conf cannot be used.
    """

    def __init__(
        self,
        address: Address | None = None,  # where it is; None looks it up in yarp.conf, again whenever it was not reached
        *,
        namespace: str | None = None,  # the network's name; None: what the environment or YARP's file says
        timeout: float = TIMEOUT,  # seconds that any command may take
        # the TCP port numbers that ports registered here choose from; None: those of `allocation.beside`
        numbers: range | None = None,
    ) -> None:
        self._numbers = numbers
        self._given = address
        self._namespace = namespace
        self._found: Address | None = None
        self._timeout = timeout
        self._registered: dict[str, _Registered] = {}
        self._left: set[str] = set()
        self._asking: weakref.WeakSet[LineSocket] = weakref.WeakSet()
        self._asking_lock = threading.Lock()
        self._hurried = self._given_up = False

    @property
    def address(self) -> Address:
        """The address; raises `NoNameServerError` where no file says it, `NamingConfigError` where one is wrong."""
        address = self._given or self._found or config.read(self._namespace)
        if address is None:
            raise NoNameServerError(
                f"no file says where YARP's name server is: {config.file(self._namespace)} should hold a line such as"
                " '127.0.0.1 10000 yarp' ('yarp detect --write' or 'midspan yarp server --write' makes it)"
            )
        self._found = address
        return address

    @property
    def numbers(self) -> range:
        """The TCP port numbers that ports choose theirs from; see `Naming.numbers`."""
        return beside(self.address.port) if self._numbers is None else self._numbers

    @property
    def contact(self) -> PortContact:
        """The name server's own port."""
        return self.address.contact(self._namespace or config.namespace())

    def use(self, address: Address) -> None:
        """Ask the name server at this address from now on, whatever yarp.conf says."""
        self._given = address

    def hurry(self, seconds: float) -> None:
        """Limit every command to so many seconds, those under way too; after one that takes longer, all fail."""
        self._timeout, self._hurried = seconds, True
        with self._asking_lock:
            pending = list(self._asking)
        for peer in pending:
            peer.hurry(seconds)

    def register(self, name: str, host: str = "", port: int = 0, *, carrier: str = "") -> PortContact:
        """Register a port, and say what a C++ port says of itself; see `Naming.register`."""
        wanted = "..." if name in ("", "...") else name
        if not is_name(wanted):
            raise NameRefusedError(
                f"{name!r} cannot be the name of a port: YARP's names are like /robot/camera, without spaces"
            )
        host = host or ("" if carrier == "mcast" else self._own_host())  # a group's address is the name server's
        command: list[Any] = ["register", wanted]
        if host or port or carrier:
            command += [carrier or "tcp", host or "...", port or "..."]
        contact = self._enter(command)
        self._registered[contact.name] = _Registered(contact)
        return contact

    def _enter(self, command: Sequence[Any]) -> PortContact:
        """Register a port, and say what a C++ port says of itself."""
        contact = PortContact.from_registration(self.line(command))
        if contact is None:
            raise NameRefusedError(
                f"the name server at {self._where()} did not take {command[1]}: it may be full, or the name is its own"
            )
        for key, words in self._about().items():
            self.line(["set", contact.name, key, *words])
        return contact

    def restore(self, name: str) -> None:
        """Tell a name server that forgot it of a port that listens, and of what was set at it."""
        known = former = self._registered.get(name)
        while known is not None:
            contact = known.contact
            self._enter(["register", name, contact.carrier, contact.host, contact.port])
            for key, values in list(known.properties.items()):
                self._set(name, key, values)
            self.lines(["announce", name])
            former, known = known, self._registered.get(name)
            if known is former:
                return
        if former is not None:
            self.lines(["unregister", name])  # it was closed meanwhile

    def unregister(self, name: str) -> None:
        """Forget a port; see `Naming.unregister`."""
        KEEPER.forget(self, name)
        self._registered.pop(name, None)
        if name in self._left:
            self._left.discard(name)
            return
        self.lines(["unregister", name])

    def is_taken(self, name: str) -> bool:
        """Whether another port has taken a name that was registered here."""
        known, found = self._registered.get(name), self.query(name)
        if known is None or found is None:
            return False
        return (found.host, found.port) != (known.contact.host, known.contact.port)

    def leave(self, name: str) -> None:
        """Another port has taken a name of ours: `unregister` will leave it to that one."""
        self._left.add(name)

    def query(self, name: str) -> PortContact | None:
        """The address of a port; see `Naming.query`. ``tcp://host:10002/`` is its own answer."""
        known = PortContact.parse(name)
        if known.is_valid:
            return known
        if not is_name(known.name):
            return None
        if known.name == (self._namespace or config.namespace()):
            return self.contact
        answer = self.lines(["query", known.name])
        return PortContact.from_registration(answer[0]) if answer else None

    def list(self, prefix: str = "") -> list[PortContact]:
        """All registered ports, or those at and below a prefix."""
        found = [PortContact.from_registration(line) for line in self.lines(["list", prefix] if prefix else ["list"])]
        return [contact for contact in found if contact is not None]

    def set_property(self, name: str, key: str, *values: Any) -> None:
        """Keep values under a key of a port; see `Naming.set_property`."""
        if name in self._registered:
            self._registered[name].properties[key] = values
        self._set(name, key, values)

    def _set(self, name: str, key: str, values: Sequence[Any]) -> None:
        command = ["set", name, key, *values]
        if any(_is_quoted(v) for v in values):
            text_client.ask(self.contact, command, timeout=self._timeout)  # a carrier that keeps quotes
        else:
            self.line(command)

    def get_property(self, name: str, key: str) -> Sequence[Any]:
        """The values under a key of a port; see `Naming.get_property`."""
        return from_text(self.line(["bot", "get", name, key]))

    def announce(self, name: str, alive: bool = True) -> None:
        """Say that a port listens now, or does not; see `Naming.announce`. `KEEPER` looks after those of our own."""
        self.lines(["announce", name] if alive else ["announce", name, 0])
        if alive and name in self._registered:
            KEEPER.keep(self, self._registered[name].contact)

    def lines(self, command: Sequence[Any]) -> Lines:
        """Any command that is answered in lines, without the end mark, or by a Bottle such as ``[ok]``, as one line."""
        answer: Lines = []
        with self._ask(_text(command) + b"\n") as peer:
            # a Bottle has no end mark; the commands answered by one are few and known
            single = self._is_single(command)
            while True:
                line = peer.line()
                if line.startswith("*"):
                    return answer
                answer.append(line)
                if single or line.startswith("["):
                    return answer

    def line(self, command: Sequence[Any]) -> str:
        """Any command of which the answer's first line is enough; the end mark is no answer."""
        with self._ask(_text(command) + b"\r\n") as peer:
            line = peer.line()
            return "" if line.startswith("*") else line

    def command(self, words: Sequence[Any]) -> Words:
        """Any command, answered as a Bottle: ``["bot", "list"]``, ``["subscribe", "/a", "/b"]``."""
        return from_text(self.line(words))

    @staticmethod
    def _is_single(command: Sequence[Any]) -> bool:
        return bool(command) and command[0] in ("bot", "subscribe", "unsubscribe", "topic", "untopic", "type")

    def _ask(self, data: bytes) -> LineSocket:
        address, peer = self.address, None
        try:
            if self._given_up:
                raise TimeoutError
            peer = LineSocket(address.host, address.port, self._timeout, limit=MAX_ANSWER)
            with self._asking_lock:
                self._asking.add(peer)
            peer.send(data)
        except OSError as err:
            self._found = None  # the file may say another place by now
            if peer is not None:
                peer.close()
            raise self._absent(err) from None
        peer.on_error(self._absent)
        return peer

    def _absent(self, err: OSError) -> NamingError:
        self._given_up = self._hurried and isinstance(err, TimeoutError)
        why = f"no answer within {self._timeout:g} s" if isinstance(err, TimeoutError) else (err.strerror or str(err))
        msg = (
            f"YARP's name server does not answer at {self._where()}: {why}."
            " Start it ('yarpserver' or 'midspan yarp server'), or correct that address in yarp.conf."
        )
        return NoNameServerError(msg)

    def _where(self) -> str:
        address = self._found or self._given
        return f"{address.host} port {address.port}" if address else "its address"

    def _own_host(self) -> str:
        """The address that ``YARP_IP`` chooses: it is one, or the beginning of one of this machine's."""
        prefix = os.environ.get("YARP_IP", "")
        return next((ip for ip in self._own_addresses() if ip.startswith(prefix)), prefix) if prefix else ""

    def _own_addresses(self) -> Lines:
        """Loopback, and the address by which the name server's network sees this machine."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((self.address.host, self.address.port))  # sends nothing
                towards = str(probe.getsockname()[0])
            except OSError:
                return ["127.0.0.1"]
        return sorted({"127.0.0.1", towards})

    def _about(self) -> dict[str, Words]:
        known = list(CARRIERS)
        return {"offers": known, "accepts": known, "ips": self._own_addresses(), "process": [os.getpid()]}


@dataclass(slots=True)
class _Registered:
    """A port that this client registered, with its properties."""

    contact: PortContact
    properties: dict[str, Sequence[Any]] = field(default_factory=dict)


def _is_quoted(value: Any) -> bool:
    """Whether a value would be read as something else without its quotes."""
    text = value_text(value)
    return from_text(text.replace('"', "")) != [value] if '"' in text else False


def _text(command: Sequence[Any]) -> bytes:
    """A command as the text protocol has it: words without quotes, which old name servers do not know."""
    words = [plain_text(w) if isinstance(w, str) else value_text(w) for w in command]
    text = " ".join(["NAME_SERVER", *words]).replace('"', "")
    if "\n" in text or "\r" in text:
        raise NamingError("a name server's command is one line: no line breaks in names and properties")
    return text.encode("utf-8", "surrogateescape")


_Kept = tuple[NameClient, PortContact]  # a port and the client that registered it


class Keeper:
    """Keeps ports registered: registers them again at a name server that returns without its memory.

    YARP's own ports do not do that. One thread of the process asks each name server for a few of its ports now and
    then, and for all of them where one is missing or the name server was away; it ends with the last port.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[NameClient, dict[str, PortContact]] = {}
        self._away: set[Hashable] = set()
        self._elsewhere: set[tuple[NameClient, str]] = set()
        self._turn = 0
        self._wake = threading.Event()
        self._thread: threading.Thread | None = None

    def keep(self, names: NameClient, contact: PortContact) -> None:
        """Look after a port that is registered there and listens."""
        with self._lock:
            self._kept.setdefault(names, {})[contact.name] = contact
            if self._thread is None:
                self._wake.clear()
                self._thread = threading.Thread(target=self._run, name="yarp names", daemon=True)
                self._thread.start()

    def forget(self, names: NameClient, name: str) -> None:
        """Look after a port no more; returns when the thread has ended, where it was the last."""
        with self._lock:
            ports = self._kept.get(names, {})
            ports.pop(name, None)
            self._elsewhere.discard((names, name))
            if not ports:
                self._kept.pop(names, None)
            ended = None if self._kept else self._thread
            if ended is not None:
                self._thread = None
                self._wake.set()
        if ended is not None and ended is not threading.current_thread():
            ended.join(1.0)  # longer only where a name server does not answer

    def _run(self) -> None:
        me = threading.current_thread()
        while not self._wake.wait(PERIOD * random.uniform(0.75, 1.25)):  # noqa: S311 - no secret
            with self._lock:
                if self._thread is not me:
                    return
                kept = [(names, contact) for names, ports in self._kept.items() for contact in ports.values()]
            self.ask(kept)

    def ask(self, kept: list[_Kept]) -> None:
        """Ask each name server for some of its ports: all clients' together, since each question is a connection."""
        self._turn += 1
        servers: dict[Hashable, list[_Kept]] = {}
        for names, contact in kept:
            servers.setdefault(_server(names), []).append((names, contact))
        self._away &= servers.keys()
        for server, ports in servers.items():
            try:
                self._look(server, ports)
            except NamingError as err:
                if server not in self._away:
                    _log.info("%s", err)
                self._away.add(server)
            except Exception:
                _log.exception("ports cannot be kept registered")

    def _look(self, server: Hashable, ports: list[_Kept]) -> None:
        first = self._turn * AT_ONCE % len(ports)
        some = (ports[first:] + ports[:first])[:AT_ONCE]
        lost = self._lost(some)
        if lost or server in self._away:
            lost += self._lost([port for port in ports if port not in some])
        for names, contact in lost:
            names.restore(contact.name)
        if lost or server in self._away:
            _log.info("the name server is back: %d of %d ports are registered again", len(lost), len(ports))
        self._away.discard(server)

    def _lost(self, ports: list[_Kept]) -> list[_Kept]:
        lost = []
        for names, contact in ports:
            found = names.query(contact.name)
            if found is None:
                lost.append((names, contact))
            elif (found.host, found.port) != (contact.host, contact.port):
                if (names, contact.name) not in self._elsewhere:
                    _log.warning("the name %s was taken by a port at %s", contact.name, found.uri)
                self._elsewhere.add((names, contact.name))
        return lost


def _server(names: NameClient) -> Hashable:
    """The name server that a client asks, the same for all its clients; where that is not known, the client itself."""
    try:
        return names.address
    except NamingError:
        return names


KEEPER = Keeper()  # the process's own
