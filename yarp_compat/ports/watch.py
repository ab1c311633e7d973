"""Registers ports again when a name server has forgotten them: one thread for all ports of a process."""

from __future__ import annotations

import logging
import os
import random
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from yarp_compat.ports.port import PortCore

_log = logging.getLogger("yarp.ports")
PERIOD = 2.0
"""Seconds between looks, about."""


class Watch:
    """Looks now and then whether the name servers of some ports still know them."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._ports: list[PortCore] = []
        self._thread: threading.Thread | None = None
        self._turn = 0

    def add(self, port: PortCore) -> None:
        """Watch a port's name."""
        with self._changed:
            self._ports = [*self._ports, port]
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="yarp-names", daemon=True)
                self._thread.start()

    def remove(self, port: PortCore) -> None:
        """Watch it no longer; the thread ends with the last one."""
        with self._changed:
            self._ports = [p for p in self._ports if p is not port]
            if self._ports or self._thread is None:
                return
            thread, self._thread = self._thread, None
            self._changed.notify_all()
        if thread is not threading.current_thread():
            thread.join()

    def _run(self) -> None:
        own = threading.current_thread()
        while True:
            with self._changed:
                pause = PERIOD * random.uniform(0.8, 1.2)  # noqa: S311
                if self._changed.wait_for(lambda: self._thread is not own, pause):
                    return
                ports = self._ports
            self._turn += 1
            if _forgotten(ports[self._turn % len(ports)]):
                for port in ports:
                    if _forgotten(port):
                        _register(port)


def _forgotten(port: PortCore) -> bool:
    try:
        return port.is_open and port.naming.query(port.name) is None
    except OSError:
        return False  # no name server at the moment


def _register(port: PortCore) -> None:
    try:
        port.register_again()
        _log.info("port %s is registered again: its name server had forgotten it", port.name)
    except OSError as error:
        _log.warning("port %s cannot be registered again: %s", port.name, error)


shared = Watch()


def _forked() -> None:
    global shared
    shared = Watch()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)
