"""Reports when the daemon is ready, and its status line, to systemd and to the log."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path

from bridge.daemon.notify import Notifier
from bridge.resources import folder_trouble

logger = logging.getLogger("midspan.daemon")

READY_AFTER = 10.0
"""Seconds after which the daemon reports ready in any case: a side without its network must not fail the service."""
STATUS_INTERVAL, ANNOUNCE_INTERVAL = 1.0, 0.25
"""Seconds between two status lines, and between two checks of whether the daemon is ready."""


class Readiness:
    """Reports ready once after each start and reload, and the status line every second.

    Attributes:
        trouble: why the state folder is not writable, or "".
    """

    def __init__(self, notifier: Notifier, status: Callable[[], str], folder: Callable[[], Path]) -> None:
        self.trouble = ""
        self._notifier = notifier
        self._status = status
        self._folder = folder
        self._announced = False
        self._ready_at = 0.0
        self._status_sent = 0.0

    def begin(self) -> None:
        """Start waiting for the workers."""
        self._ready_at = time.monotonic() + READY_AFTER
        self.announce_again()

    def announce_again(self) -> None:
        """Report ready again at the next `step`, because systemd waits for the end of a reload."""
        self._announced = False

    @property
    def pause(self) -> float:
        """Seconds after which `step` has to be called again."""
        return STATUS_INTERVAL if self._announced else ANNOUNCE_INTERVAL

    def step(self, now: float, settled: Callable[[], bool]) -> None:
        """Report what is due; ``settled`` returns whether all workers have started, or cannot."""
        self._notifier.feed_watchdog()
        if not self._announced and (now > self._ready_at or settled()):
            self._announced = True
            self._status_sent = 0.0
            self._send_status(now)
            self._notifier.ready()
            logger.info("ready: %s", self._status())
        self._send_status(now)

    def _send_status(self, now: float) -> None:
        if now - self._status_sent >= STATUS_INTERVAL:
            self._status_sent = now
            self._check_folder()
            self._notifier.status(self._status())

    def _check_folder(self) -> None:
        trouble = folder_trouble(self._folder())
        if trouble != self.trouble:
            self.trouble = trouble
            logger.warning("%s", trouble or "the state folder is writable again")
