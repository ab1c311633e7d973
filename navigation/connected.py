"""Ports that an existing robot's files name, connected to a module's."""

from __future__ import annotations

import logging
import threading
import time

from yarp_compat.naming import connections
from yarp_compat.naming.naming import Naming
from yarp_compat.wire.errors import WireError

_AGAIN = 2.0
_END_SECONDS = 0.4
"""A module that stops has one second for all of its own; what is under way with a machine that is away takes longer."""

_log = logging.getLogger(__name__)


class Connected:
    """Connects a port of the robot's to ours, again after it was away. On a thread of its own.

    Args:
        naming: who knows the ports.
        source: the robot's port.
        target: ours.
    """

    def __init__(self, naming: Naming, source: str, target: str) -> None:
        self._naming, self._source, self._target = naming, source, target
        self.trouble = f"{source} is not connected yet"
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-connect", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Connect no more; what is under way ends by itself."""
        self._end.set()
        self._thread.join(_END_SECONDS)

    def _run(self) -> None:
        begun = time.monotonic()
        while not self._end.is_set():
            try:
                if not connections.carrier_between(self._naming, self._source, self._target, timeout=_AGAIN):
                    connections.connect(self._naming, self._source, self._target, timeout=_AGAIN)
                self.trouble = ""
            except (OSError, WireError) as err:
                if str(err) != self.trouble and time.monotonic() - begun > _AGAIN:
                    _log.info("%s is not connected to %s: %s", self._source, self._target, err)
                self.trouble = str(err) or type(err).__name__
            self._end.wait(_AGAIN)
