"""Makes, ends and inspects connections between any two ports from outside, as ``yarp connect`` does.

They are administrative commands to the port that writes: ``[list] [out] /r`` asks whether it is connected,
``[add] tcp://r`` connects, ``[del] /r`` ends it. All of it blocks, for a bounded time. `Connector` makes the persistent
connections of a name server, a few at a time, and tries again what did not work at once.
"""

from __future__ import annotations

import contextlib
import heapq
import logging
import socket
import threading
import time
from collections.abc import Sequence
from typing import Any

from yarp_compat.naming.subscriptions import WantedConnection
from yarp_compat.ports import text_client
from yarp_compat.ports.naming import Naming, NamingError, PortError
from yarp_compat.wire.contact import PortContact, is_port_name
from yarp_compat.wire.values import Vocab

_LIST, _OUT, _ADD, _DEL, _VER = (Vocab(word) for word in ("list", "out", "add", "del", "ver"))


def connect(
    naming: Naming, source: str, target: str, carrier: str = "", *, timeout: float = text_client.TIMEOUT
) -> str:
    """Connect two ports by a carrier: this, that in a name (``udp://r``), or that of the reading port's registration.

    Returns what the writing port says. Raises `PortError` where one does not exist or answer within ``timeout`` seconds
    a step, or the connection cannot be made, `NoNameServerError` where no name server answers.
    """
    writer, reader = _find(naming, source, "source port"), _find(naming, target, "destination port")
    wanted = carrier or _carrier(target) or _carrier(source) or reader.carrier or "tcp"
    answer = _asked(naming, writer, target, timeout, [_ADD, _target(target, wanted)])
    return _success(answer, f"{writer.name} could not connect to {target}")


def disconnect(naming: Naming, source: str, target: str, *, timeout: float = text_client.TIMEOUT) -> str:
    """End the connection between two ports; returns what the writing one says. Errors as `connect`."""
    writer = _find(naming, source, "source port")
    answer = _asked(naming, writer, target, timeout, [_DEL, _name(target)])
    return _success(answer, f"there is no connection from {writer.name} to {target}")


def carrier_between(naming: Naming, source: str, target: str, *, timeout: float = text_client.TIMEOUT) -> str:
    """By which carrier two ports are connected; empty where they are not. Errors as `connect`."""
    answer = _asked(naming, _find(naming, source, "source port"), target, timeout)
    return next((str(v[1]) for v in answer if isinstance(v, list) and len(v) == 2 and v[0] == "carrier"), "")


def is_connected(naming: Naming, source: str, target: str, *, timeout: float = text_client.TIMEOUT) -> bool:
    """Whether two ports are connected; errors as `connect`."""
    return bool(carrier_between(naming, source, target, timeout=timeout))


def exists(naming: Naming, name: str, *, timeout: float = text_client.TIMEOUT) -> bool:
    """Whether a port is registered and answers as a port does; raises NoNameServerError."""
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
    """Whether anything takes a connection at a port's address."""
    try:
        socket.create_connection((contact.host, contact.port), timeout).close()
    except OSError:
        return False
    return True


def ping(naming: Naming, name: str, *, timeout: float = text_client.TIMEOUT) -> list[str]:
    """A port's description of itself and its connections, as lines; errors as `connect`."""
    return text_client.raw(_find(naming, name, "port"), "<ping>", "*\r\n", timeout)


def _find(naming: Naming, name: str, role: str) -> PortContact:
    asked = PortContact.parse(name)
    if not asked.is_valid and not is_port_name(asked.name):
        raise PortError(f"{name!r} is no port name: YARP's are like /robot/camera, without spaces")
    contact = naming.query(name if asked.is_valid else asked.name)
    if contact is None:
        raise PortError(f"there is no {role} {asked.name} at the name server")
    return contact


def _asked(naming: Naming, writer: PortContact, target: str, timeout: float, command: Sequence[Any] = ()) -> list[Any]:
    """Ask a port whether it is connected, and have it obey; the name server hears of one that does not answer."""
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
    """The text of an answer ``0 "Added connection ..."``; older ports answer with the text alone."""
    text = str(answer[-1]).strip() if answer else ""
    done = answer[0] == 0 if answer and isinstance(answer[0], int) else text[:1] in ("A", "R")
    if not done:
        raise PortError(f"{problem}: it says {text!r}" if text else problem)
    return text


_log = logging.getLogger("yarp.names")

WORKERS = 4
MAX_WAITING = 10_000
STEP_TIMEOUT = 3.0  # seconds for each step of making a connection
PAUSES = (0.0, 0.5, 2.0, 8.0)
"""Seconds before each try. A port that is gone by then is not tried again: it announces itself when it returns."""


class Connector:
    """Makes connections between other programs' ports."""

    def __init__(self, naming: Naming) -> None:
        self._naming = naming
        self._changed = threading.Condition()
        self._due: list[tuple[float, int, WantedConnection, int]] = []
        self._waiting: set[WantedConnection] = set()
        self._order = 0
        self._idle = 0
        self._closed = False
        self._threads: list[threading.Thread] = []

    def want(self, wish: WantedConnection) -> None:
        """Have a connection made, unless it is there; returns at once."""
        with self._changed:
            if self._closed or wish in self._waiting or len(self._waiting) >= MAX_WAITING:
                return
            self._waiting.add(wish)
            self._put(wish, 0)
            if len(self._due) > self._idle and len(self._threads) < WORKERS:
                name = f"yarp connector {len(self._threads)}"
                thread = threading.Thread(target=self._run, name=name, daemon=True)
                self._threads.append(thread)
                thread.start()

    def close(self) -> None:
        """Make no more connections; returns when the one in work is given up."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _put(self, wish: WantedConnection, attempt: int) -> None:
        self._order += 1
        heapq.heappush(self._due, (time.monotonic() + PAUSES[attempt], self._order, wish, attempt))
        self._changed.notify()

    def _run(self) -> None:
        while (taken := self._take()) is not None:
            wish, attempt = taken
            error = self._make(wish)
            last = error is None or attempt + 1 >= len(PAUSES)
            if error is not None:
                _log.log(
                    logging.WARNING if last else logging.DEBUG,
                    "persistent connection from %s to %s not made: %s", wish.source, wish.target, error,
                )  # fmt: skip
            with self._changed:
                if last or self._closed:
                    self._waiting.discard(wish)
                else:
                    self._put(wish, attempt + 1)

    def _take(self) -> tuple[WantedConnection, int] | None:
        with self._changed:
            self._idle += 1
            try:
                while not self._closed:
                    left = self._due[0][0] - time.monotonic() if self._due else None
                    if left is not None and left <= 0:
                        _, _, wish, attempt = heapq.heappop(self._due)
                        return wish, attempt
                    self._changed.wait(left)
                return None
            finally:
                self._idle -= 1

    def _make(self, wish: WantedConnection) -> NamingError | None:
        try:
            if wish.anew or not is_connected(self._naming, wish.source, wish.target, timeout=STEP_TIMEOUT):
                connect(self._naming, wish.source, wish.target, timeout=STEP_TIMEOUT)
                _log.info("persistent connection from %s to %s made", wish.source, wish.target)
        except NamingError as err:
            return err
        return None
