"""Notifications to systemd: ready, reloading, stopping, status and watchdog (sd_notify(3)). No-op without systemd."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping

STATUS_LENGTH = 900
_SECONDS = 0.5
"""Time limit for a change of the service's state."""

ENVIRONMENT = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""Variables that systemd sets for one process, which its children must not inherit."""


class Notifier:
    """Sends datagrams to ``$NOTIFY_SOCKET``, and ignores errors.

    If systemd does not read for a moment, a change of the service's state waits for it; any other datagram is dropped.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        self._socket: socket.socket | None = None
        self._status = ""
        self._fed = 0.0
        self._interval = _watchdog_seconds(environ) / 2
        path = environ.get("NOTIFY_SOCKET", "")
        if path[:1] in {"/", "@"} and hasattr(socket, "AF_UNIX"):
            sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            try:
                sock.connect("\0" + path[1:] if path.startswith("@") else path)
            except OSError:
                sock.close()
            else:
                self._socket = sock

    def ready(self) -> None:
        """Report that the start or a reload is complete."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report the beginning of a reload; `ready` reports its end."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Report that the service is stopping."""
        self._send("STOPPING=1")

    def main_process(self, pid: int) -> None:
        """Report the service's new main process."""
        self._send(f"MAINPID={pid}")

    def status(self, text: str) -> None:
        """Set the line that ``systemctl status`` shows; sent only if it changed."""
        line = " ".join(text.split())[:STATUS_LENGTH]
        if line != self._status and self._send(f"STATUS={line}", waits=False):
            self._status = line

    def feed_watchdog(self) -> None:
        """Feed the watchdog at about half of systemd's interval; called often by the loop that must not hang."""
        now = time.monotonic()
        if self._interval and now - self._fed >= self._interval * 0.9:
            self._fed = now
            self._send("WATCHDOG=1", waits=False)

    @property
    def watchdog_interval(self) -> float:
        """Seconds between feeds, 0 without a watchdog."""
        return self._interval

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str, *, waits: bool = True) -> bool:
        """Send a datagram; return whether systemd will receive it."""
        if self._socket is None:
            return False
        try:
            self._socket.settimeout(_SECONDS if waits else 0.0)
            self._socket.send(text.encode())
        except OSError:
            return False
        return True


def _watchdog_seconds(environ: Mapping[str, str]) -> float:
    try:
        if int(environ.get("WATCHDOG_PID", os.getpid())) != os.getpid():
            return 0.0
        return max(int(environ.get("WATCHDOG_USEC", 0)), 0) / 1e6
    except ValueError:
        return 0.0
