"""Detects network addresses that appear after the participant's start, for example with Wi-Fi, a cable or a VPN.

Fast DDS (2.14) uses the addresses of the interfaces that are up when a participant is created, and never discovers
anything through later ones; rclpy cannot make it rescan.
"""

from __future__ import annotations

import socket
from collections.abc import Callable

import psutil

from bridge.concurrency import DelayedCalls

PERIOD = 2.0
"""Seconds between two checks. New addresses count once two checks in a row find the same ones."""

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
    """Calls ``appeared`` with a text when the machine gets addresses that are not among the ``known`` ones.

    The next call is for other new addresses, if ``appeared`` has not ended the process.

    An address that disappears and returns is not new, because the participant's sockets still use it.
    """

    def __init__(
        self, appeared: Callable[[str], None], later: DelayedCalls, known: Addresses,
        addresses: Callable[[], Addresses] = ipv4_addresses,
    ) -> None:  # fmt: skip
        self._appeared, self._addresses = appeared, addresses
        self._known = known
        self._new: Addresses = frozenset()
        self._reported: Addresses = frozenset()
        later.every(PERIOD, self._check)

    @property
    def text(self) -> str:
        """The new addresses as a sentence; "" if there are none."""
        new = ", ".join(f"{address} on {name}" for name, address in sorted(self._new))
        return f"this machine has a new address that the ROS 2 side does not use: {new}" if new else ""

    def _check(self) -> None:
        before, self._new = self._new, self._addresses() - self._known
        if self._new == before and not self._new <= self._reported:
            self._reported |= self._new
            self._appeared(self.text)
