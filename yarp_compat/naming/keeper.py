"""Keeps ports registered: a name server that comes back without its memory is told of them again.

YARP's own ports do not do that. One thread of the process asks for a few of its ports now and then, and for all of them
where one is missing or the name server was away; it ends with the last port.
"""

from __future__ import annotations

import logging
import random
import threading
from typing import Protocol

from yarp_compat.naming.errors import NamingError
from yarp_compat.wire.contact import Contact

_log = logging.getLogger("yarp.names")

PERIOD = 2.0
"""Seconds between looks, give or take a quarter."""
AT_ONCE = 5
"""Ports asked for at a look, as long as nothing is amiss."""


class Names(Protocol):
    """A name server's client, as far as it is needed here."""

    def query(self, name: str) -> Contact | None:
        """Where a port is."""
        ...

    def restore(self, name: str) -> None:
        """Register a port again as it was, unless it is closed by now."""
        ...


class Keeper:
    """Looks after registered ports."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[Names, dict[str, Contact]] = {}
        self._away: set[Names] = set()
        self._elsewhere: set[tuple[Names, str]] = set()
        self._turn = 0
        self._wake = threading.Event()
        self._thread: threading.Thread | None = None

    def keep(self, names: Names, contact: Contact) -> None:
        """Look after a port that is registered there and listens."""
        with self._lock:
            self._kept.setdefault(names, {})[contact.name] = contact
            if self._thread is None:
                self._wake.clear()
                self._thread = threading.Thread(target=self._run, name="yarp names", daemon=True)
                self._thread.start()

    def forget(self, names: Names, name: str) -> None:
        """Look after a port no more; returns when the thread has ended, where it was the last."""
        with self._lock:
            ports = self._kept.get(names, {})
            ports.pop(name, None)
            self._elsewhere.discard((names, name))
            if not ports:
                self._kept.pop(names, None)
                self._away.discard(names)
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
                todo = [(names, list(ports.values())) for names, ports in self._kept.items()]
            self._turn += 1
            for names, contacts in todo:
                try:
                    self._look(names, contacts)
                except NamingError as err:
                    if names not in self._away:
                        _log.info("%s", err)
                    self._away.add(names)
                except Exception:
                    _log.exception("ports cannot be kept registered")

    def _look(self, names: Names, contacts: list[Contact]) -> None:
        first = self._turn * AT_ONCE % len(contacts)
        some = (contacts[first:] + contacts[:first])[:AT_ONCE]
        lost = self._lost(names, some)
        if lost or names in self._away:
            lost += self._lost(names, [c for c in contacts if c not in some])
        for contact in lost:
            names.restore(contact.name)
        if lost or names in self._away:
            _log.info("the name server is back: %d of %d ports are registered again", len(lost), len(contacts))
        self._away.discard(names)

    def _lost(self, names: Names, contacts: list[Contact]) -> list[Contact]:
        lost = []
        for contact in contacts:
            found = names.query(contact.name)
            if found is None:
                lost.append(contact)
            elif (found.host, found.port) != (contact.host, contact.port):
                if (names, contact.name) not in self._elsewhere:
                    _log.warning("the name %s was taken by a port at %s", contact.name, found.uri)
                self._elsewhere.add((names, contact.name))
        return lost


KEEPER = Keeper()
"""The process's own."""
