"""Word to systemd: ready, reloading, stopping, status and watchdog (sd_notify(3)). Silent without systemd."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Mapping

STATUS_LENGTH = 900
ENVIRONMENT = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""What systemd sets for one process, and that process must not hand on to its children."""


class Notifier:
    """Sends datagrams to ``$NOTIFY_SOCKET``; never blocks, never fails."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        self._socket: socket.socket | None = None
        self._status = ""
        self._fed = 0.0
        self._interval = _watchdog_seconds(environ) / 2
        path = environ.get("NOTIFY_SOCKET", "")
        if path[:1] in {"/", "@"} and hasattr(socket, "AF_UNIX"):
            sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            sock.setblocking(False)
            try:
                sock.connect("\0" + path[1:] if path.startswith("@") else path)
            except OSError:
                sock.close()
            else:
                self._socket = sock

    def ready(self) -> None:
        """Started, or done with reloading."""
        self._send("READY=1")

    def reloading(self) -> None:
        """A reload begins; `ready` ends it."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """The end begins."""
        self._send("STOPPING=1")

    def main_process(self, pid: int) -> None:
        """Another process of the service is its main one from now on."""
        self._send(f"MAINPID={pid}")

    def status(self, text: str) -> None:
        """The one line that ``systemctl status`` shows; sent only when it changed."""
        line = " ".join(text.split())[:STATUS_LENGTH]
        if line != self._status:
            self._status = line
            self._send(f"STATUS={line}")

    def feed_watchdog(self) -> None:
        """To be called from the very loop that must not hang; feeds at half the interval that systemd asks for."""
        now = time.monotonic()
        if self._interval and now - self._fed >= self._interval * 0.9:
            self._fed = now
            self._send("WATCHDOG=1")

    @property
    def watchdog_interval(self) -> float:
        """Seconds between feeds, 0 where no watchdog is asked for."""
        return self._interval

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.send(text.encode())


def _watchdog_seconds(environ: Mapping[str, str]) -> float:
    try:
        if int(environ.get("WATCHDOG_PID", os.getpid())) != os.getpid():
            return 0.0
        return max(int(environ.get("WATCHDOG_USEC", 0)), 0) / 1e6
    except ValueError:
        return 0.0
