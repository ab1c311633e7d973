"""The files of a machine's identity.

This module does not import the library that reads certificates, which the router's process rarely needs.
"""

from __future__ import annotations

import os
import ssl
import stat
import sys
from dataclasses import dataclass
from pathlib import Path

from bridge.hub.errors import HubConfigError


@dataclass(frozen=True, slots=True)
class KeyFiles:
    """The files of a machine's identity."""

    ca: Path
    certificate: Path
    key: Path

    def check(self) -> None:
        """Raise `HubConfigError` if a file is missing, a folder, or cannot be read."""
        for file in (self.ca, self.certificate, self.key):
            if not file.exists():
                raise HubConfigError(
                    f"there is no {file}; 'midspan keys make' creates it, and prints which files to copy here"
                )
            if file.is_dir():
                raise HubConfigError(f"{file} is a folder, not a file")
            if not os.access(file, os.R_OK):
                raise HubConfigError(f"{file} cannot be read by this process's user; give it to that user (chown)")

    def trouble(self) -> str:
        """Return which file TLS cannot use, and why; "" if it can use all."""
        return tls_trouble(self.ca, self.certificate, self.key)

    def others_may_use_key(self) -> bool:
        """Return whether the key's mode gives rights to other users; Windows has access lists instead of modes."""
        return sys.platform != "win32" and bool(self.key.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO))


def tls_trouble(ca: Path, certificate: Path | None, key: Path | None) -> str:
    """Return which file TLS cannot use, and why; "" if it can use all."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    for file in filter(None, (ca, certificate)):
        try:
            context.load_verify_locations(file)
        except ssl.SSLError:
            return f"{file} is not a certificate (PEM)"
        except OSError as err:
            return f"{file}: {err.strerror}"
    if certificate is None:
        return ""
    try:
        context.load_cert_chain(certificate, key, password="")
    except OSError as err:
        mismatch = isinstance(err, ssl.SSLError) and err.reason in ("KEY_VALUES_MISMATCH", "KEY_TYPE_MISMATCH")
        return f"{key} is not the key of {certificate}" if mismatch else f"{key} cannot be used: {err}"
    return ""
