"""The address that a side's worker has announced to other programs, and that its machine can lose."""

from __future__ import annotations

import ipaddress
import logging

from bridge.hub.listeners import has_address

_log = logging.getLogger(__name__)


class AnnouncedAddress:
    """Reports that this machine has lost the announced address, for example in another Wi-Fi network, and its return.

    Attributes:
        trouble: why no program can connect, and the cure; "" if the machine has the address.
    """

    def __init__(self, side: str, registered: str, settings: str) -> None:
        """Set what is registered under the address ("YARP ports are"), and the settings that name the address."""
        self._side, self._registered, self._settings = side, registered, settings
        self.trouble = ""

    def check(self, host: str) -> None:
        """Check the announced address again; the resolution of a host name is not checked."""
        before, now = self.trouble, ""
        if _is_lost(host):
            now = (
                f"this machine does not have the address {host} now, under which its {self._registered} registered:"
                " no program can connect; connect this machine to that network, or restart the daemon with its current"
                f" address ({self._settings})"
            )
        self.trouble = now  # other threads read it at any time
        if now and not before:
            _log.warning("%s: %s", self._side, now)
        elif before and not now:
            _log.info(
                "%s: this machine has the address again under which its %s registered", self._side, self._registered
            )


def _is_lost(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return not has_address(host)
