"""A watch for new files of a machine's identity."""

from __future__ import annotations

import logging

from bridge.hub.security.key_files import KeyFiles

_log = logging.getLogger(__name__)

_Stamp = tuple[tuple[int, int, int] | None, ...]


def _unsigned(files: KeyFiles) -> str:
    from bridge.hub.security.certificates import CertificateError, unsigned  # only renewals need the library

    try:
        return unsigned(files)
    except CertificateError as err:
        return str(err)


class KeyWatch:
    """Detects that a machine's key files were replaced since this object was created.

    Attributes:
        trouble: why the new files cannot be used, or "".
    """

    def __init__(self, files: KeyFiles) -> None:
        self._files = files
        self.trouble = ""
        self._used = self._seen = self._stamp()

    def renewed(self) -> bool:
        """Return whether there are new, usable files: complete, with the certificate's key and authority."""
        stamp, before = self._stamp(), self._seen
        self._seen = stamp
        if stamp == self._used:
            self.trouble = ""
            return False
        if stamp != before:  # still being copied
            return False
        reason = self._files.trouble() or _unsigned(self._files)
        if not reason:
            self._used, self.trouble = stamp, ""
            return True
        # check them again at the next call: an owner or a mode can be corrected without a change of the files
        trouble = f"the new certificates cannot be used, the old ones stay in use: {reason}"
        if trouble != self.trouble:
            _log.error("hub.open: %s", trouble)
        self.trouble = trouble
        return False

    def _stamp(self) -> _Stamp:
        stamps: list[tuple[int, int, int] | None] = []
        for file in (self._files.ca, self._files.certificate, self._files.key):
            try:
                status = file.stat()
                stamps.append((status.st_mtime_ns, status.st_size, status.st_ino))
            except OSError:
                stamps.append(None)
        return tuple(stamps)
