"""Network addresses that come after the participant, such as those of Wi-Fi, a cable or a VPN.

Fast DDS (2.14) uses the addresses of the interfaces that are up when a participant is created, and discovers nothing
by later ones; rclpy cannot make it search again.
"""

from __future__ import annotations

import socket
from collections.abc import Callable

import psutil

from bridge.concurrency import DelayedCalls

PERIOD = 2.0
"""Seconds between two checks. An address counts once two of them have the same new ones."""

Addresses = frozenset[tuple[str, str]]


def ipv4_addresses() -> Addresses:
    """Return the names of this machine's running interfaces except loopback, each with an IPv4 address."""
    states = psutil.net_if_stats()
    return frozenset(
        (name, entry.address)
        for name, entries in psutil.net_if_addrs().items()
        for entry in entries
        if entry.family == socket.AF_INET
        and not entry.address.startswith("127.")
        and name in states
        and states[name].isup
    )


class InterfaceWatch:
    """Calls ``appeared`` once, with a text, when there are addresses that were not there when it was made.

    An address that goes and returns is not new: the participant's sockets still have it.
    """

    def __init__(
        self, appeared: Callable[[str], None], later: DelayedCalls, addresses: Callable[[], Addresses] = ipv4_addresses
    ) -> None:
        self._appeared, self._later, self._addresses = appeared, later, addresses
        self._known = addresses()
        self._new: Addresses = frozenset()
        self._later.after(PERIOD, self._check)

    @property
    def text(self) -> str:
        """The new addresses as a sentence, "" if there are none."""
        new = ", ".join(f"{address} on {name}" for name, address in sorted(self._new))
        return f"this machine has a new address that the ROS 2 side does not use: {new}" if new else ""

    def _check(self) -> None:
        before, self._new = self._new, self._addresses() - self._known
        if self._new and self._new == before:
            self._appeared(self.text)
        else:
            self._later.after(PERIOD, self._check)
