"""Makes, ends and inspects connections between any two ports from a third program, as ``yarp connect`` does.

The functions send administrative commands to the writing port: ``[list] [out] /r`` queries the connection, ``[add]
tcp://r`` connects, ``[del] /r`` disconnects. All functions block, for a bounded time. `Connector` makes the persistent
connections of a name server, a few at a time, and retries failed ones.
"""

from __future__ import annotations

import contextlib
import heapq
import logging
import threading
import time
from collections.abc import Sequence
from typing import Any

from yarp_compat.naming.subscriptions import WantedConnection
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import Naming, NamingError, PortError
from yarp_compat.ports.sockets import open_connection
from yarp_compat.wire.contact import PortContact, is_port_name
from yarp_compat.wire.values import Vocab

_LIST, _OUT, _ADD, _DEL, _VER = (Vocab(name) for name in ("list", "out", "add", "del", "ver"))


def connect(
    naming: Naming, source: str, target: str, carrier: str = "", *, timeout: float = text_client.TIMEOUT
) -> str:
    """Connect two ports over ``carrier``; default: that in a name (``udp://r``), or in the reader's registration.

    Return the writing port's reply. Raises `PortError` if a port is missing or does not reply within ``timeout``
    seconds per step, or if they cannot connect, and `NoNameServerError`.
    """
    writer, reader = _find(naming, source, "source port"), _find(naming, target, "destination port")
    wanted = carrier or _carrier(target) or _carrier(source) or reader.carrier or "tcp"
    answer = _command(naming, writer, target, timeout, [_ADD, _target(target, wanted)])
    return _success(answer, f"{writer.name} could not connect to {target}")


def disconnect(naming: Naming, source: str, target: str, *, timeout: float = text_client.TIMEOUT) -> str:
    """End the connection between two ports and return the writing port's reply. Raises like `connect`."""
    writer = _find(naming, source, "source port")
    answer = _command(naming, writer, target, timeout, [_DEL, _name(target)])
    return _success(answer, f"no connection from {writer.name} to {target}")


def carrier_between(naming: Naming, source: str, target: str, *, timeout: float = text_client.TIMEOUT) -> str:
    """Return the carrier that connects two ports; empty if they are not connected. Raises like `connect`."""
    answer = _command(naming, _find(naming, source, "source port"), target, timeout)
    return next((str(v[1]) for v in answer if isinstance(v, list) and len(v) == 2 and v[0] == "carrier"), "")


def is_connected(naming: Naming, source: str, target: str, *, timeout: float = text_client.TIMEOUT) -> bool:
    """Whether two ports are connected; raises like `connect`."""
    return bool(carrier_between(naming, source, target, timeout=timeout))


def exists(naming: Naming, name: str, *, timeout: float = text_client.TIMEOUT) -> bool:
    """Whether a port is registered and replies as a port (a group of mcast need not); raises `NoNameServerError`."""
    contact = naming.query(name)
    if contact is None:
        return False
    if contact.carrier == "mcast":
        return True
    try:
        return text_client.admin(contact, [_VER], timeout)[:1] == ["ver"]
    except PortError:
        return False


def responds(contact: PortContact, *, timeout: float = text_client.TIMEOUT) -> bool:
    """Whether a port's address accepts connections."""
    end = time.monotonic() + timeout
    try:
        open_connection(contact.host, contact.port, lambda: end).close()
    except OSError:
        return False
    return True


def ping(naming: Naming, name: str, *, timeout: float = text_client.TIMEOUT) -> list[str]:
    """Return a port's description of itself and its connections, as lines; raises like `connect`."""
    return text_client.raw(_find(naming, name, "port"), "<ping>", "*\r\n", timeout)


def _find(naming: Naming, name: str, role: str) -> PortContact:
    parsed = PortContact.parse(name)
    if not parsed.is_valid and not is_port_name(parsed.name):
        raise PortError(
            f"{name!r} is not a valid port name: YARP's names are like /robot/camera, without spaces or commas"
        )
    contact = naming.query(name if parsed.is_valid else parsed.name)
    if contact is None:
        raise PortError(f"{role} {parsed.name} is not registered at the name server")
    return contact


def _command(
    naming: Naming, writer: PortContact, target: str, timeout: float, command: Sequence[Any] = ()
) -> list[Any]:
    """Query the writing port's connection to ``target``, then send it the command, if any.

    Returns the reply to the command, or without a command the description of the connection. If the port does not
    reply, the name server is informed.
    """
    try:
        answer = text_client.admin(writer, [_LIST, _OUT, _name(target)], timeout)
        return text_client.admin(writer, command, timeout) if command else answer
    except PortError:
        if writer.name:
            with contextlib.suppress(NamingError):
                naming.announce(writer.name, alive=False)
        raise


def _carrier(text: str) -> str:
    contact = PortContact.parse(text)
    return "" if contact.is_valid else contact.carrier


def _name(target: str) -> str:
    return PortContact.parse(target).name or target


def _target(target: str, carrier: str) -> str:
    contact = PortContact.parse(target)
    return contact.by(carrier).uri.rstrip("/") + contact.name if contact.is_valid else contact.by(carrier).target


def _success(answer: list[Any], problem: str) -> str:
    """Return the text of a reply ``0 "Added connection ..."``; older ports send only the text."""
    text = str(answer[-1]).strip() if answer else ""
    done = answer[0] == 0 if answer and isinstance(answer[0], int) else text[:1] in ("A", "R")
    if not done:
        raise PortError(f"{problem}: its reply is {text!r}" if text else problem)
    return text


_log = logging.getLogger("yarp.names")

WORKERS = 4  # maximum threads of a `Connector`
MAX_WAITING = 10_000  # maximum connections to make; further requests are ignored
STEP_TIMEOUT = 3.0  # seconds for each step of making a connection
CLOSE_SECONDS = 0.5  # maximum seconds to wait for attempts in progress
PAUSES = (0.0, 0.5, 2.0, 8.0)
"""Seconds before each attempt. After the last attempt, a missing port is connected when it announces itself again."""


class Connector:
    """Makes connections between the ports of other programs, on its own threads."""

    def __init__(self, naming: Naming) -> None:
        self._naming = naming
        self._changed = threading.Condition()
        self._due: list[tuple[float, int, WantedConnection, int]] = []
        self._waiting: set[WantedConnection] = set()
        self._again: set[WantedConnection] = set()  # a port was opened again, perhaps after the attempt had found it
        self._order = 0
        self._idle = 0
        self._closed = False
        self._threads: list[threading.Thread] = []

    def request(self, wanted: WantedConnection) -> None:
        """Make a connection in the background, unless it exists."""
        with self._changed:
            if wanted in self._waiting and wanted.force:
                self._again.add(wanted)
            if self._closed or wanted in self._waiting or len(self._waiting) >= MAX_WAITING:
                return
            self._waiting.add(wanted)
            self._schedule(wanted, 0)
            if len(self._due) > self._idle and len(self._threads) < WORKERS:
                name = f"yarp connector {len(self._threads)}"
                thread = threading.Thread(target=self._run, name=name, daemon=True)
                self._threads.append(thread)
                thread.start()

    def close(self) -> None:
        """Stop making connections; attempts in progress may end later, because ports that hang delay them."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        end = time.monotonic() + CLOSE_SECONDS
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))

    def _schedule(self, wanted: WantedConnection, attempt: int) -> None:
        self._order += 1
        heapq.heappush(self._due, (time.monotonic() + PAUSES[attempt], self._order, wanted, attempt))
        self._changed.notify()

    def _run(self) -> None:
        while (entry := self._next()) is not None:
            wanted, attempt = entry
            error = self._make(wanted)
            last = error is None or attempt + 1 >= len(PAUSES)
            if error is not None:
                _log.log(
                    logging.WARNING if last else logging.DEBUG,
                    "persistent connection from %s to %s failed: %s", wanted.source, wanted.target, error,
                )  # fmt: skip
            with self._changed:
                if wanted in self._again:
                    self._schedule(wanted, 0)
                elif last or self._closed:
                    self._waiting.discard(wanted)
                else:
                    self._schedule(wanted, attempt + 1)

    def _next(self) -> tuple[WantedConnection, int] | None:
        with self._changed:
            self._idle += 1
            try:
                while not self._closed:
                    left = self._due[0][0] - time.monotonic() if self._due else None
                    if left is not None and left <= 0:
                        _, _, wanted, attempt = heapq.heappop(self._due)
                        self._again.discard(wanted)
                        return wanted, attempt
                    self._changed.wait(left)
                return None
            finally:
                self._idle -= 1

    def _make(self, wanted: WantedConnection) -> Exception | None:
        try:
            if wanted.force or not is_connected(self._naming, wanted.source, wanted.target, timeout=STEP_TIMEOUT):
                connect(self._naming, wanted.source, wanted.target, timeout=STEP_TIMEOUT)
                _log.info("persistent connection from %s to %s established", wanted.source, wanted.target)
        except NamingError as err:
            return err
        except Exception as err:  # an error that ended this thread would leave fewer threads, or none
            _log.exception("persistent connection from %s to %s", wanted.source, wanted.target)
            return err
        return None
