"""New certificates in the place of the old ones: zenoh reads them when the door is opened, and never again."""

from __future__ import annotations

import logging
import ssl

from bridge.hub.door import KeyFiles

_log = logging.getLogger(__name__)

_Stamp = tuple[tuple[int, int, int] | None, ...]


class KeyWatch:
    """Notices that a machine's key files were replaced since it was made."""

    def __init__(self, files: KeyFiles) -> None:
        self._files = files
        self._used = self._seen = self._stamp()

    def renewed(self) -> bool:
        """Whether there are new files that can be used: all written, and a key that fits its certificate."""
        stamp, before = self._stamp(), self._seen
        self._seen = stamp
        if stamp == self._used or stamp != before:  # as they were, or still being copied
            return False
        self._used = stamp
        trouble = self._trouble()
        if trouble:
            _log.error("hub.open: the new certificates cannot be used, and the old ones stay: %s", trouble)
        return not trouble

    def _stamp(self) -> _Stamp:
        stamps: list[tuple[int, int, int] | None] = []
        for file in (self._files.ca, self._files.certificate, self._files.key):
            try:
                found = file.stat()
                stamps.append((found.st_mtime_ns, found.st_size, found.st_ino))
            except OSError:
                stamps.append(None)
        return tuple(stamps)

    def _trouble(self) -> str:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        try:
            context.load_verify_locations(self._files.ca)
            context.load_cert_chain(self._files.certificate, self._files.key, password="")
        except (OSError, ssl.SSLError) as err:  # also where a key does not fit its certificate
            return f"{self._files.certificate}: {err}"
        return ""
